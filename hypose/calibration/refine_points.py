"""Cameras and 3D points from the person's key points in all views: bundle adjustment with the points eliminated.

The key points need not be joints: any point that all views see as the same place will do, so the person is a
calibration object without a model. Robust rows (Cauchy), points eliminated by the Schur complement, so a step costs one
small system for the cameras.
Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6; Hartley & Zisserman 2004, appendix 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.compute.linear import SharedEquations
from hypose.compute.losses import lorentzian
from hypose.errors import EvidenceError
from hypose.fitting.problem import Rule, SharedProblem
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_exp, so3_log, transform
from hypose.io.calibrations import calibration_camera

# ---- refine camera -------------------------------------------------------------------------------------------------
# Small changes of cameras as unknowns of a least-squares problem, and the gauge: which world a refined rig lives in.
#
# A camera's change is (w, v[, log focal factor]): p' = exp(w) p + v of points p in the camera's frame, focal length
# f exp(log factor). Images and points fix a rig only up to a similarity of the whole world; refined rigs are
# laid onto the old one so that few cameras move far rather than all a little (iteratively reweighted, an L1 fit).


@dataclass(frozen=True)
class CameraChange:
    """How far one camera is from where the old calibration had it. turn_deg: angle; move_m: distance of the centres;
    focal: factor on the focal length; image_px: median movement of the person's points in its image, px of the
    calibrated size."""

    name: str
    turn_deg: float
    move_m: float
    focal: float
    image_px: float


def apply_parameters(camera: Camera, x: Array) -> Camera:
    """The camera changed by x (6,) or more; a radial term is not part of a Camera and is left to the caller."""
    motion = se3(so3_exp(x[:3]), x[3:6])
    k = camera.K
    if len(x) > 6 and x[6] != 0:
        k = k.copy()
        k[:2, :2] *= np.exp(x[6])
    return replace(camera, K=k, camera_from_world=motion @ camera.camera_from_world)


def by_camera(points_camera: Array, gradient_camera: Array, unknowns: int = 6) -> Array:
    """(R, unknowns) derivative of rows with respect to a camera's change at zero.

    points_camera (R, 3) m, gradient_camera (R, 3): derivative of each row with respect to its point, both in the
    camera's frame; unknowns 6, or 7 with the focal length."""
    parts = [np.cross(points_camera, gradient_camera), gradient_camera]
    if unknowns > 6:  # u - c = f x / z: scaling f scales x and y
        parts.append((points_camera[:, :2] * gradient_camera[:, :2]).sum(1)[:, None])
    return np.concatenate(parts, 1)


def change_from(old: Camera, new: Camera) -> Array:
    """(7,) the change that takes the old camera to the new one; the inverse of `changed`."""
    motion = new.camera_from_world @ se3_inverse(old.camera_from_world)
    return np.r_[so3_log(motion[:3, :3]), motion[:3, 3], np.log(new.K[0, 0] / old.K[0, 0])]


def transform_rig(rig: CameraRig, new_from_old: Array) -> CameraRig:
    """The same cameras after the whole world moved rigidly: points x -> new_from_old x."""
    back = se3_inverse(new_from_old)
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ back) for c in rig))


def gauge(new: CameraRig, old: CameraRig, points_new: Array) -> Array:
    """Rigid old_from_new (4, 4) that lays a refined rig and its world onto the old one.

    Cameras are compared by where their centres lie and where their axes meet the person (points_new (N, 3) m, in the
    refined world): four points each. A camera that really moved is let go (weights 1 / distance)."""
    middle = np.nanmedian(points_new, axis=0)
    reach = float(np.median(np.linalg.norm(new.positions - middle, axis=1)))
    marks_new = np.stack([_marks(c, reach) for c in new])
    marks_old = np.stack([_marks(c, reach) for c in old])
    weight = np.ones(len(new))
    motion = np.eye(4)
    for _ in range(30):
        w = np.repeat(weight, marks_new.shape[1])
        motion, _ = procrustes(marks_new.reshape(-1, 3), marks_old.reshape(-1, 3), w)
        gap = np.linalg.norm(transform(motion, marks_new.reshape(-1, 3)) - marks_old.reshape(-1, 3), axis=1)
        distance = np.sqrt((gap.reshape(len(new), -1) ** 2).mean(1))
        weight = 1 / np.maximum(distance, 1e-3 * reach)
    return motion


def _marks(camera: Camera, reach: float) -> Array:
    """(4, 3) points fixed to a camera: its centre, and three where it looks, at the person's distance."""
    local = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, 0.3, 1.0]]) * reach
    return transform(se3_inverse(camera.camera_from_world), local)


def changes(old: CameraRig, new: CameraRig, points_world: Array) -> tuple[CameraChange, ...]:
    """What moved between two rigs of one world; points_world (N, 3) m are the person's."""
    out = []
    p = points_world[np.isfinite(points_world).all(1)]
    for a, b in zip(old, new, strict=True):
        turn = np.degrees(np.linalg.norm(so3_log(b.camera_from_world[:3, :3] @ a.camera_from_world[:3, :3].T)))
        shift = np.linalg.norm(a.project_pinhole(p) - b.project_pinhole(p), axis=1)
        out.append(
            CameraChange(
                a.name,
                float(turn),
                float(np.linalg.norm(a.position - b.position)),
                float(b.K[0, 0] / a.K[0, 0]),
                float(np.nanmedian(shift)) if len(p) else float("nan"),
            )
        )
    return tuple(out)


def scale_rig(rig: CameraRig, factor: float) -> CameraRig:
    """The rig with all lengths multiplied by a factor."""
    return CameraRig(tuple(calibration_camera.rescaled(c, factor) for c in rig))


def free_cameras(rig: CameraRig, fixed: tuple[str, ...]) -> NDArray[np.bool_]:
    """(C,) True for the cameras that may move; a CalibrationError lists the names there are."""
    if fixed:
        rig.select(fixed)
    return np.array([c.name not in fixed for c in rig])


_Shared = tuple[list[Camera], Array]
"""cameras, radial (C,)"""
_ITERATIONS = 30
FEWEST_POINTS = 60
"""3D points (over all frames) below which a rig is not adjusted"""


HOLD = (0.3, 0.5, 0.05)
"""sd (rad, m, share of the focal length) of the weak pull of every camera to where it is, which fixes the gauge"""


class CameraUnknowns:
    """What changes of a rig's cameras, P numbers each: `changed`, and one radial distortion term where that is asked
    for. free (C,): cameras that may move, None: all. hold: as `HOLD`."""

    def __init__(
        self,
        rig: CameraRig,
        focal: bool,
        free: NDArray[np.bool_] | None,
        radial: bool = False,
        hold: tuple[float, float, float] = HOLD,
    ) -> None:
        self.start, self.focal, self.radial = rig, focal, radial
        pull = [hold[0]] * 3 + [hold[1]] * 3 + [hold[2]] * focal + [1.0] * radial
        self.hold = np.array(pull) ** -2.0
        self.count = len(pull)
        self.turns = np.tile(np.arange(len(pull)) < 3, len(rig))
        self.free = np.repeat(
            np.ones(len(rig), dtype=bool) if free is None else np.asarray(free, dtype=bool), len(pull)
        )

    def held(self, cameras: Sequence[Camera], radial: Array | None = None) -> tuple[Array, float]:
        """(C, P) distance from the start and its cost."""
        x = np.stack([change_from(a, b) for a, b in zip(self.start, cameras, strict=True)])[:, : 6 + self.focal]
        if radial is not None and self.radial:
            x = np.concatenate([x, radial[:, None]], 1)
        return x, 0.5 * float((self.hold * x**2).sum())


def pinhole_derivative(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) from the principal point, and their derivatives (N, 2, 3), of points (N, 3) in the camera's frame,
    without lens distortion."""
    k, z = camera.K[:2, :2], np.maximum(points[:, 2], 1e-3)[:, None]
    offset = (points[:, :2] / z) @ k.T
    return offset, np.concatenate([k / z[..., None], -(offset / z)[..., None]], -1)


@dataclass(frozen=True)
class PointAdjustment:
    """Hold the result of `adjust`.

    rig: the refined cameras; its world frame is fixed by a weak prior on the start cameras (`HOLD`).
    points (N, 3): 3D key points, m; NaN where fewer than two views see the point.
    radial (C,): radial distortion term of each camera; 0 unless it was estimated.
    radial_sd (C,): standard deviation of radial; 0 unless it was estimated.
    before: median reprojection error at the start, px, over the detections used.
    after: the same after the adjustment, px.
    """

    rig: CameraRig
    points: Array
    radial: Array
    radial_sd: Array
    before: float
    after: float


def adjust(
    rig: CameraRig,
    pixels: Array,
    confidence: Array,
    free: NDArray[np.bool_] | None = None,
    *,
    focal: bool = False,
    radial: bool = False,
    hold: tuple[float, float, float] = HOLD,
    iterations: int = _ITERATIONS,
) -> PointAdjustment:
    """Refines a rig on key points.

    pixels (C, N, 2) undistorted px of the rig; confidence (C, N), 0 = not seen; free (C,): cameras that may move;
    focal: focal lengths are unknowns too; radial: so is one radial distortion term per camera; hold: as `HOLD`.
    An EvidenceError when too few points are seen by two views."""
    w = np.where((confidence > 0.3) & np.isfinite(pixels).all(-1), confidence, 0.0)
    uv = np.nan_to_num(pixels)
    keep = (w > 0).sum(0) >= 2
    if keep.sum() < FEWEST_POINTS:
        raise EvidenceError(
            f"Only {int(keep.sum())} key points are seen by two cameras; at least {FEWEST_POINTS} (over all frames) "
            "are needed to refine a calibration: use more frames, or silhouettes."
        )
    unknowns = CameraUnknowns(rig, focal, free, radial, hold)
    found = PointBundle(uv[:, keep], w[:, keep], default_scale(uv, w), unknowns).adjusted(iterations)
    points = np.full((uv.shape[1], 3), np.nan)
    points[keep] = found.points
    return replace(found, points=points)


def default_scale(pixels: Array, confidence: Array) -> float:
    """sd of a detection in px: 0.8 % of the spread of a view's points (a person fills about four of their sd)."""
    spread = [np.std(p[c > 0], axis=0).max() * 4 for p, c in zip(pixels, confidence, strict=True) if (c > 0).sum() > 9]
    return max(0.008 * float(np.median(spread)) if spread else 2.0, 0.5)


class PointBundle(SharedProblem[_Shared]):
    """The least-squares problem of `adjust`: pixels (C, N, 2), confidence (C, N) of points that two views see; scale:
    sd of a detection, px."""

    def __init__(self, pixels: Array, confidence: Array, scale: float, unknowns: CameraUnknowns) -> None:
        self.uv, self.confidence, self.scale, self.unknowns = pixels, confidence, 2 * scale, unknowns
        self.free, self.limited, self.largest = unknowns.free, unknowns.turns, 0.2

    def residuals(self, cameras: list[Camera], radial: Array, points: Array) -> tuple[Array, Array, float]:
        """(C, N, 2) px, (C, N) weights of squared px, and the robust cost."""
        r = np.zeros_like(self.uv)
        for c, camera in enumerate(cameras):
            r[c] = bent(camera, camera.project_pinhole(points), radial[c]) - self.uv[c]
        seen = self.confidence > 0
        behind = seen & ~np.isfinite(r).all(-1)
        r = np.where(np.isfinite(r), r, 0.0)
        rho, slope, _ = lorentzian((r**2).sum(-1) / self.scale**2, 4 * self.confidence / self.scale**2)
        cost = 2 * float((self.confidence * rho).sum()) + 20.0 * int(behind.sum())
        weight = np.where(behind, 0.0, slope)
        return r, weight, cost

    def rows(self, cameras: list[Camera], radial: Array, points: Array) -> tuple[Array, Array, Array, Array]:
        """(C, N, 2) px, (C, N) weights, and derivatives by the cameras' unknowns (C, N, 2, P) and by the points
        (C, N, 2, 3)."""
        r, weight, _ = self.residuals(cameras, radial, points)
        size, (n_cameras, n) = self.unknowns.count, weight.shape
        jc, jp = np.zeros((n_cameras, n, 2, size)), np.zeros((n_cameras, n, 2, 3))
        for c, camera in enumerate(cameras):
            p = transform(camera.camera_from_world, points)
            offset, d = pinhole_derivative(camera, p)
            r2 = ((p[:, :2] / np.maximum(p[:, 2:], 1e-3)) ** 2).sum(1)
            if radial[c] != 0:
                d = d * (1 + radial[c] * r2)[:, None, None]  # its own slope is small against this
            more = [offset] * self.unknowns.focal + [offset * r2[:, None]] * self.unknowns.radial
            jc[c] = np.concatenate([np.cross(p[:, None], d), d, *(m[..., None] for m in more)], -1)
            jp[c] = d @ camera.camera_from_world[:3, :3]
        return r, weight, jc, jp

    def equations(self, cameras: list[Camera], radial: Array, points: Array) -> SharedEquations:
        """Of the cameras' unknowns (C P,), shared by the points'."""
        r, weight, jc, jp = self.rows(cameras, radial, points)
        size, (n_cameras, n) = self.unknowns.count, weight.shape
        wjc = weight[..., None, None] * jc
        x, _ = self.unknowns.held(cameras, radial)
        hessian = np.zeros((n_cameras, size, n_cameras, size))
        for c, block in enumerate(np.einsum("cnxp,cnxq->cpq", wjc, jc)):
            hessian[c, :, c] = block + np.diag(self.unknowns.hold)
        return SharedEquations(
            hessian.reshape(n_cameras * size, -1),
            (np.einsum("cnxp,cnx->cp", wjc, r) + self.unknowns.hold * x).ravel(),
            np.einsum("cn,cnxi,cnxj->nij", weight, jp, jp),
            np.einsum("cn,cnxi,cnx->ni", weight, jp, r),
            np.einsum("cnxp,cnxi->nicp", wjc, jp).reshape(n, 3, -1),
        )

    def evaluate(self, state: tuple[_Shared, Array]) -> tuple[float, Callable[[], SharedEquations]]:
        """Cost and, when asked for, equations."""
        (cameras, radial), points = state
        cost = self.residuals(cameras, radial, points)[2] + self.unknowns.held(cameras, radial)[1]
        return cost, partial(self.equations, cameras, radial, points)

    def moved(self, state: tuple[_Shared, Array], step: Array, own: Array) -> tuple[tuple[_Shared, Array], float]:
        """Apply a step."""
        (cameras, radial), points = state
        x = step.reshape(len(cameras), self.unknowns.count)
        new = [apply_parameters(c, d if self.unknowns.focal else d[:6]) for c, d in zip(cameras, x, strict=True)]
        shared = new, radial + (x[:, -1] if self.unknowns.radial else 0.0)
        return (shared, points + own), float(np.abs(x).max())

    def adjusted(self, iterations: int) -> PointAdjustment:
        """Triangulate the points with the cameras at the start, and adjust both."""
        rig = self.unknowns.start
        points = triangulate(rig, self.uv, self.confidence)[0]
        lost = ~np.isfinite(points).all(1)
        points[lost] = np.nanmedian(points[~lost], axis=0)
        start = (list(rig), np.zeros(len(rig))), points
        found = self.solve(start, iterations, Rule(damping=1e-3, least=1e-7, gain=1e-6))
        (cameras, radial), points = found.state
        sd = np.zeros(len(cameras))
        if self.unknowns.radial:
            s = found.equations.reduced().hessian
            sd = np.sqrt(np.maximum(np.diag(np.linalg.pinv(s)).reshape(len(cameras), -1)[:, -1], 0))
        before, after = self._median(*start[0], start[1]), self._median(cameras, radial, points)
        return PointAdjustment(CameraRig(tuple(cameras)), points, radial, sd, before, after)

    def _median(self, cameras: list[Camera], radial: Array, points: Array) -> float:
        r, _, _ = self.residuals(cameras, radial, points)
        return float(np.median(np.linalg.norm(r, axis=-1)[self.confidence > 0]))


def bent(camera: Camera, pixels: Array, radial: float) -> Array:
    """Where a camera with a radial term shows the pixels (N, 2) of a pinhole camera."""
    if radial == 0:
        return pixels
    centre = camera.K[:2, 2]
    offset = pixels - centre
    r2 = ((offset / camera.K[[0, 1], [0, 1]]) ** 2).sum(-1, keepdims=True)
    return centre + offset * (1 + radial * r2)


def point_residual(rig: CameraRig, pixels: Array, confidence: Array, *, min_confidence: float = 0.5) -> Array:
    """(C, N) px between detections (C, N, 2) and the triangulation of all views; NaN where there is none.

    Points are triangulated from detections with a confidence above 0.3; those above min_confidence are judged."""
    points, _ = triangulate(rig, pixels, np.where(confidence > 0.3, confidence, 0.0))
    distance = np.stack(
        [np.linalg.norm(c.project_pinhole(points) - p, axis=-1) for c, p in zip(rig, pixels, strict=True)]
    )
    return np.where(confidence > min_confidence, distance, np.nan)


def left_out_residual(rig: CameraRig, pixels: Array, confidence: Array) -> Array:
    """(C, N) px between each camera's detections and the triangulation of all the others; NaN where there is none."""
    out = np.full(confidence.shape, np.nan)
    used = np.where(confidence > 0.3, confidence, 0.0)
    for c in range(len(rig)):
        others = [k for k in range(len(rig)) if k != c]
        if len(others) < 2:
            continue
        less = CameraRig(tuple(rig[k] for k in others))
        points, _ = triangulate(less, pixels[others], used[others])
        out[c] = np.linalg.norm(rig[c].project_pinhole(points) - pixels[c], axis=-1)
    return np.where(confidence > 0.5, out, np.nan)

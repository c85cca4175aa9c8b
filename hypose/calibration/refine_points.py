"""Refinement of cameras and 3D points from key points: bundle adjustment with the points eliminated.

The key points need not be joints: any points that all views see at the same place are suitable, so no body model is
needed. Rows are robust (Cauchy). Points are eliminated with the Schur complement, so a step solves one small system for
the cameras.
Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6; Hartley and Zisserman 2004, appendix 6.
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
from hypose.io.calibrations.camera_tables import rescaled

# ---- refine camera -------------------------------------------------------------------------------------------------
# Small changes of cameras as unknowns of a least-squares problem, and the gauge: which world a refined rig lives in.
#
# A camera's change is (w, v[, log focal factor]): p' = exp(w) p + v of points p in the camera's frame, focal length
# f exp(log factor). Images and points fix a rig only up to a similarity of the whole world; refined rigs are
# laid onto the old one so that few cameras move far rather than all a little (iteratively reweighted, an L1 fit).


@dataclass(frozen=True)
class CameraChange:
    """The difference of one camera from its old calibration.

    name: name of the camera.
    turn_deg: rotation, degrees.
    move_m: distance of the centres, m.
    focal: factor on the focal length.
    image_px: median movement of the person's points in its image, px of the calibrated size.
    """

    name: str
    turn_deg: float
    move_m: float
    focal: float
    image_px: float


def apply_parameters(camera: Camera, x: Array) -> Camera:
    """Change a camera by its parameters.

    x: (6,) rotation vector (rad) and translation (m) in the camera's frame; optionally (7,) with the logarithm of the
        focal factor. Further elements, such as a radial term, are ignored.
    """
    motion = se3(so3_exp(x[:3]), x[3:6])
    k = camera.K
    if len(x) > 6 and x[6] != 0:
        k = k.copy()
        k[:2, :2] *= np.exp(x[6])
    return replace(camera, K=k, camera_from_world=motion @ camera.camera_from_world)


def by_camera(points_camera: Array, gradient_camera: Array, unknowns: int = 6) -> Array:
    """Compute the derivatives of residuals with respect to a small change of a camera.

    points_camera: (R, 3) in the camera's frame, m.
    gradient_camera: (R, 3) derivative of each row with respect to its point, in the camera's frame.
    unknowns: 6, or 7 with the focal length.
    Returns: (R, unknowns), columns: rotation (rad), translation (m), log of the focal length (`apply_parameters`).
    """
    parts = [np.cross(points_camera, gradient_camera), gradient_camera]
    if unknowns > 6:  # u - c = f x / z: scaling f scales x and y
        parts.append((points_camera[:, :2] * gradient_camera[:, :2]).sum(1)[:, None])
    return np.concatenate(parts, 1)


def change_from(old: Camera, new: Camera) -> Array:
    """Compute the parameters (7,) that change the old camera to the new one; the inverse of `apply_parameters`."""
    motion = new.camera_from_world @ se3_inverse(old.camera_from_world)
    return np.r_[so3_log(motion[:3, :3]), motion[:3, 3], np.log(new.K[0, 0] / old.K[0, 0])]


def transform_rig(rig: CameraRig, new_from_old: Array) -> CameraRig:
    """Copy the rig after the whole world was moved rigidly: points x -> new_from_old x, with new_from_old (4, 4)."""
    back = se3_inverse(new_from_old)
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ back) for c in rig))


def gauge(new: CameraRig, old: CameraRig, points_new: Array) -> Array:
    """Compute the rigid motion that aligns a refined rig and its world with the old one.

    Cameras are compared by four points each: the centre, and three where they look, at the person's distance.

    new, old: the refined and the old rig.
    points_new: (N, 3) points of the person in the refined world, m.
    Returns: (4, 4) old_from_new.
    Why: the weights are 1 / distance, so that a camera that really moved has little influence.
    """
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
    """Compute four points (4, 3) fixed to a camera: its centre, and three in front of it at the person's distance."""
    local = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, 0.3, 1.0]]) * reach
    return transform(se3_inverse(camera.camera_from_world), local)


def changes(old: CameraRig, new: CameraRig, points_world: Array) -> tuple[CameraChange, ...]:
    """Compute the change of each camera between two rigs of the same world.

    old, new: the rigs, with the same cameras in the same order.
    points_world: (N, 3) points of the person, m.
    Returns: one per camera: rotation, displacement, focal factor, and movement of the points in the image.
    """
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
    """Multiply all lengths of a rig by a factor."""
    return CameraRig(tuple(rescaled(c, factor) for c in rig))


_Shared = tuple[list[Camera], Array]
"""Cameras, and radial terms (C,)."""
_ITERATIONS = 30
FEWEST_POINTS = 60
"""Least number of 3D points over all frames for the adjustment of a rig."""


HOLD = (0.3, 0.5, 0.05)
"""Standard deviations (rad, m, share of the focal length) of the weak prior that holds every camera where it is and so
fixes the gauge."""


class CameraUnknowns:
    """Unknowns of a rig's cameras, P per camera: those of `apply_parameters`, and a radial distortion term on
    request.

    focal: focal lengths are unknowns.
    free: (C,) cameras that may move; None for all.
    radial: there is a radial term.
    hold: standard deviations of the prior on each camera's change, in the order of `HOLD`.
    """

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
        """Compute the differences of cameras from the start, and the cost of the prior.

        Returns: (C, P) parameters, and the cost.
        """
        x = np.stack([change_from(a, b) for a, b in zip(self.start, cameras, strict=True)])[:, : 6 + self.focal]
        if radial is not None and self.radial:
            x = np.concatenate([x, radial[:, None]], 1)
        return x, 0.5 * float((self.hold * x**2).sum())


def pinhole_derivative(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Project points without lens distortion, and compute the derivatives.

    points: (N, 3) in the camera's frame, m.
    Returns: (N, 2) px relative to the principal point; derivatives with respect to the points (N, 2, 3).
    """
    k, z = camera.K[:2, :2], np.maximum(points[:, 2], 1e-3)[:, None]
    offset = (points[:, :2] / z) @ k.T
    return offset, np.concatenate([k / z[..., None], -(offset / z)[..., None]], -1)


@dataclass(frozen=True)
class PointAdjustment:
    """The result of `adjust`.

    rig: the refined cameras; the world frame is fixed by a weak prior on the start cameras (`HOLD`).
    points: (N, 3) key points, m; NaN where fewer than two views see the point.
    radial: (C,) radial distortion term of each camera; 0 unless it was estimated.
    radial_sd: (C,) standard deviation of radial; 0 unless it was estimated.
    before: median reprojection error at the start, px, over the detections used.
    after: median reprojection error after the adjustment, px, over the same detections.
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
    """Refine a rig with the key points of a person (bundle adjustment).

    pixels: (C, N, 2) undistorted px of the rig.
    confidence: (C, N); 0 where not seen.
    free: (C,) cameras that may move; None for all.
    focal: estimate focal lengths as well.
    radial: estimate a radial distortion term per camera as well.
    hold: standard deviations of the prior on each camera's change, in the order of `HOLD`.
    iterations: largest number of iterations.
    Raises: EvidenceError where two views see too few common points.
    """
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
    """Estimate the standard deviation of a detection, px: 0.8 % of the person's size in the median view.

    The size is taken as four standard deviations of the points (C, N, 2) with confidence (C, N) above 0.
    """
    spread = [np.std(p[c > 0], axis=0).max() * 4 for p, c in zip(pixels, confidence, strict=True) if (c > 0).sum() > 9]
    return max(0.008 * float(np.median(spread)) if spread else 2.0, 0.5)


class PointBundle(SharedProblem[_Shared]):
    """Least-squares problem of `adjust`.

    pixels: (C, N, 2) px of points that at least two views see.
    confidence: (C, N).
    scale: standard deviation of a detection, px.
    unknowns: unknowns of the cameras.
    """

    def __init__(self, pixels: Array, confidence: Array, scale: float, unknowns: CameraUnknowns) -> None:
        self.uv, self.confidence, self.scale, self.unknowns = pixels, confidence, 2 * scale, unknowns
        self.free, self.limited, self.largest = unknowns.free, unknowns.turns, 0.2

    def residuals(self, cameras: list[Camera], radial: Array, points: Array) -> tuple[Array, Array, float]:
        """Compute residuals and robust weights.

        radial: (C,) radial term of each camera.
        points: (N, 3) m.
        Returns: residuals (C, N, 2), px; weights (C, N) of squared px; the robust cost.
        """
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
        """Compute residuals and derivatives.

        radial: (C,) radial term of each camera.
        points: (N, 3) m.
        Returns: residuals (C, N, 2), px; weights (C, N); derivatives with respect to the cameras' unknowns (C, N, 2, P)
            and to the points (C, N, 2, 3).
        """
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
        """Assemble the normal equations: shared unknowns (C P,) of the cameras, own unknowns of the points."""
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
        """Compute the cost, and return it with a function that computes the equations."""
        (cameras, radial), points = state
        cost = self.residuals(cameras, radial, points)[2] + self.unknowns.held(cameras, radial)[1]
        return cost, partial(self.equations, cameras, radial, points)

    def moved(self, state: tuple[_Shared, Array], step: Array, own: Array) -> tuple[tuple[_Shared, Array], float]:
        """Apply a step to cameras and points.

        state: cameras with their radial terms, and points (N, 3), m.
        step: (C P,) step of the cameras.
        own: (N, 3) step of the points.
        Returns: the new state, and the largest change of a camera.
        """
        (cameras, radial), points = state
        x = step.reshape(len(cameras), self.unknowns.count)
        new = [apply_parameters(c, d if self.unknowns.focal else d[:6]) for c, d in zip(cameras, x, strict=True)]
        shared = new, radial + (x[:, -1] if self.unknowns.radial else 0.0)
        return (shared, points + own), float(np.abs(x).max())

    def adjusted(self, iterations: int) -> PointAdjustment:
        """Triangulate the points with the start cameras, and adjust both."""
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
    """Apply a radial term to the pixels (N, 2) of a pinhole camera.

    The offset from the principal point is multiplied by 1 + radial r^2, where r is the offset in focal lengths.
    """
    if radial == 0:
        return pixels
    centre = camera.K[:2, 2]
    offset = pixels - centre
    r2 = ((offset / camera.K[[0, 1], [0, 1]]) ** 2).sum(-1, keepdims=True)
    return centre + offset * (1 + radial * r2)


def point_residual(rig: CameraRig, pixels: Array, confidence: Array, *, min_confidence: float = 0.5) -> Array:
    """Compute the distances between detections and the triangulation of all views.

    Points are triangulated from detections with a confidence above 0.3.

    pixels: (C, N, 2) undistorted px.
    confidence: (C, N).
    min_confidence: detections above this are judged.
    Returns: (C, N) px; NaN where there is none.
    """
    points, _ = triangulate(rig, pixels, np.where(confidence > 0.3, confidence, 0.0))
    distance = np.stack(
        [np.linalg.norm(c.project_pinhole(points) - p, axis=-1) for c, p in zip(rig, pixels, strict=True)]
    )
    return np.where(confidence > min_confidence, distance, np.nan)


def left_out_residual(rig: CameraRig, pixels: Array, confidence: Array) -> Array:
    """Compute the distances between each camera's detections and the triangulation of all other cameras.

    pixels: (C, N, 2) undistorted px.
    confidence: (C, N).
    Returns: (C, N) px; NaN where the own confidence is at most .5, or fewer than two other cameras have more than .3.
    """
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

"""Refinement of cameras and 3D points from key points, by bundle adjustment.

The key points need not be joints: any points that all views see at the same place are suitable, so no body model is
needed. Rows are robust (Cauchy).
Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6; Hartley and Zisserman 2004, appendix 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.bundle import Bundle, Observations
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.compute.losses import lorentzian
from hypose.errors import EvidenceError
from hypose.fitting.problem import Rule
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_log, transform
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


MARKS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, 0.3, 1.0]])
"""(4, 3) points fixed to a camera: its centre, and three in front of it, in units of the person's distance."""


def gauge(new: CameraRig, old: CameraRig, points_new: Array) -> Array:
    """Compute the rigid motion that aligns a refined rig and its world with the old one.

    Cameras are compared by four points each: the centre, and three where they look, at the person's distance.

    new, old: the refined and the old rig.
    points_new: (N, 3) points of the person in the refined world, m.
    Returns: (4, 4) old_from_new.
    Why: the weights are 1 / distance, so that a camera that really moved has little influence.
    """
    reach = float(np.median(np.linalg.norm(new.positions - np.nanmedian(points_new, axis=0), axis=1)))
    here, there = (
        np.concatenate([transform(se3_inverse(c.camera_from_world), reach * MARKS) for c in rig]) for rig in (new, old)
    )
    weight, motion = np.ones(len(new)), np.eye(4)
    for _ in range(30):
        motion, _ = procrustes(here, there, np.repeat(weight, len(MARKS)))
        squared = ((transform(motion, here) - there) ** 2).sum(1).reshape(len(new), -1)
        weight = 1 / np.maximum(np.sqrt(squared.mean(1)), 1e-3 * reach)
    return motion


def changes(old: CameraRig, new: CameraRig, points_world: Array) -> tuple[CameraChange, ...]:
    """Compute the change of each camera between two rigs of the same world.

    old, new: the rigs, with the same cameras in the same order.
    points_world: (N, 3) points of the person, m.
    Returns: one per camera: rotation, displacement, focal factor, and movement of the points in the image.
    """
    p = points_world[np.isfinite(points_world).all(1)]
    shifts = [
        np.linalg.norm(a.project_pinhole(p) - b.project_pinhole(p), axis=1) for a, b in zip(old, new, strict=True)
    ]
    return tuple(
        CameraChange(
            a.name,
            float(np.degrees(np.linalg.norm(change_from(a, b)[:3]))),
            float(np.linalg.norm(a.position - b.position)),
            float(b.K[0, 0] / a.K[0, 0]),
            float(np.nanmedian(shift)) if len(p) else float("nan"),
        )
        for a, b, shift in zip(old, new, shifts, strict=True)
    )


def scale_rig(rig: CameraRig, factor: float) -> CameraRig:
    """Multiply all lengths of a rig by a factor."""
    return CameraRig(tuple(rescaled(c, factor) for c in rig))


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
    radial: the first distortion coefficient is an unknown.
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
        self.hold, self.count = np.array(pull) ** -2.0, len(pull)
        self.turns = np.tile(np.arange(self.count) < 3, len(rig))
        self.free = np.repeat(np.ones(len(rig), dtype=bool) if free is None else free, self.count)

    def change(self, index: int, camera: Camera) -> Array:
        """Compute the difference (P,) of a camera from the start."""
        start = self.start[index]
        x = change_from(start, camera)[: 6 + self.focal]
        return np.r_[x, camera.distortion[0] - start.distortion[0]] if self.radial else x

    def held(self, cameras: Sequence[Camera]) -> tuple[Array, float]:
        """Compute the differences (C, P) of cameras from the start, and the cost of the prior."""
        x = np.stack([self.change(c, camera) for c, camera in enumerate(cameras)])
        return x, 0.5 * float((self.hold * x**2).sum())


@dataclass(frozen=True)
class PointAdjustment:
    """The result of `adjust`.

    rig: the refined cameras; the world frame is fixed by a weak prior on the start cameras (`HOLD`).
    points: (N, 3) key points, m; NaN where fewer than two views see the point.
    median_px: median reprojection error, px, over the detections used.
    radial_sd: (C,) standard deviation of the first distortion coefficient; 0 unless it was estimated.
    """

    rig: CameraRig
    points: Array
    median_px: float
    radial_sd: Array


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

    rig: cameras without distortion.
    pixels: (C, N, 2) undistorted px of the rig; with `radial` those of the pictures.
    confidence: (C, N); 0 where not seen.
    free: (C,) cameras that may move; None for all.
    focal: estimate focal lengths as well.
    radial: estimate the first distortion coefficient of each camera as well.
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
    bundle = PointBundle(uv[:, keep], w[:, keep], default_scale(uv, w), CameraUnknowns(rig, focal, free, radial, hold))
    start = triangulate(rig, uv[:, keep], w[:, keep])[0]
    lost = ~np.isfinite(start).all(1)
    start[lost] = np.nanmedian(start[~lost], axis=0)
    found = bundle.solve((list(rig), se3(np.eye(3), start)), iterations, Rule(damping=1e-3, least=1e-7, gain=1e-6))
    cameras, groups = found.state
    median = float(np.median(np.linalg.norm(bundle.residuals(cameras, groups), axis=1)))
    points, sd = np.full((uv.shape[1], 3), np.nan), np.zeros(len(rig))
    points[keep] = groups[:, :3, 3]
    if radial:
        variance = np.linalg.pinv(found.equations.reduced().hessian).diagonal()
        sd = np.sqrt(np.maximum(variance, 0)).reshape(len(rig), -1)[:, -1]
    return PointAdjustment(CameraRig(tuple(cameras)), points, median, sd)


def default_scale(pixels: Array, confidence: Array) -> float:
    """Estimate the standard deviation of a detection, px: 0.8 % of the person's size in the median view.

    The size is taken as four standard deviations of the points (C, N, 2) with confidence (C, N) above 0.
    """
    spread = [np.std(p[c > 0], axis=0).max() * 4 for p, c in zip(pixels, confidence, strict=True) if (c > 0).sum() > 9]
    return max(0.008 * float(np.median(spread)) if spread else 2.0, 0.5)


class PointBundle(Bundle):
    """Least-squares problem of `adjust`.

    pixels: (C, N, 2) px of points that at least two views see.
    confidence: (C, N).
    scale: standard deviation of a detection, px.
    unknowns: unknowns of the cameras.
    """

    own = 3

    def __init__(self, pixels: Array, confidence: Array, scale: float, unknowns: CameraUnknowns) -> None:
        camera, point = np.nonzero(confidence > 0)
        self.unknowns = unknowns
        seen = Observations(camera, point, np.zeros_like(point), pixels[camera, point])
        weight, scales = 4 * confidence[camera, point], np.full(len(camera), 2 * scale)
        super().__init__(seen, np.zeros((1, 3)), weight, scales, lorentzian, unknowns.count, unknowns.free)
        self.limited, self.largest = unknowns.turns, 0.2

    def lens(self, camera: Camera) -> Array:
        """Compute the derivatives (L, 4 + k) of the intrinsics by the focal factor and the radial term."""
        rows = np.zeros((2, 4 + len(camera.distortion)))
        rows[0, :2], rows[1, 4] = camera.K[[0, 1], [0, 1]], 1.0
        return rows[np.array([self.unknowns.focal, self.unknowns.radial])]

    def prior(self, index: int, camera: Camera) -> tuple[Array, Array]:
        """Compute the camera's change from the start, in standard deviations, and the derivatives (P, P)."""
        root = np.sqrt(self.unknowns.hold)
        return root * self.unknowns.change(index, camera), np.diag(root)


def point_residual(
    rig: CameraRig, pixels: Array, confidence: Array, *, min_confidence: float = 0.5, left_out: bool = False
) -> Array:
    """Compute the distances between detections and the triangulation of all views.

    Points are triangulated from detections with a confidence above 0.3.

    pixels: (C, N, 2) undistorted px.
    confidence: (C, N).
    min_confidence: detections above this are judged.
    left_out: each camera is judged by the triangulation of all other cameras.
    Returns: (C, N) px; NaN where there is none.
    """
    out = np.full(confidence.shape, np.nan)
    used = np.where(confidence > 0.3, confidence, 0.0)
    by, points = list(range(len(rig))), triangulate(rig, pixels, used)[0]
    for c, camera in enumerate(rig):
        if left_out and len(rig) > 1:
            by = [k for k in range(len(rig)) if k != c]
            points, _ = triangulate(CameraRig(tuple(rig[k] for k in by)), pixels[by], used[by])
        out[c] = np.linalg.norm(camera.project_pinhole(points) - pixels[c], axis=-1)
    return np.where(confidence > min_confidence, out, np.nan)

"""Bundle adjustment of cameras and board poses: minimises robust reprojection errors of all corners in all pictures.

The method is Levenberg-Marquardt with analytic derivatives on the normal equations. The boards' poses are eliminated
with the Schur complement (Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1). The equations are
accumulated per camera and board, so a step takes milliseconds where a general sparse solver iterates. Weak prior
knowledge about lenses (principal point near the middle, square pixels, small coefficients) enters as measurements: it
decides where the boards give no information and has hardly any effect where they do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.calibration.boards import Board, BoardDetection, IntArray
from hypose.calibration.views import positions
from hypose.cameras.camera import Camera
from hypose.compute.linear import SharedEquations
from hypose.compute.losses import huber
from hypose.errors import CalibrationError, SolverError
from hypose.fitting.problem import Rule, SharedProblem
from hypose.geometry import Array, se3, skew, so3_exp

_State = tuple[list[Camera], Array]
"""Cameras, and world_from_board (F, 4, 4)."""

NOISE_PX = 0.3
"""Assumed standard deviation of a corner's coordinate, px."""
_ITERATIONS = 50


@dataclass(frozen=True)
class Observations:
    """M corners observed in pictures, in the order of the cameras, and of the frames of each camera.

    camera, frame, corner: (M,) indices of the camera, of the board's pose and of the board's corner.
    pixels: (M, 2) px.
    """

    camera: IntArray
    frame: IntArray
    corner: IntArray
    pixels: Array

    def __len__(self) -> int:
        return len(self.camera)


@dataclass(frozen=True)
class LensPrior:
    """Prior standard deviations of lens parameters.

    centre: standard deviation of the principal point, whose mean is the picture's middle, as a share of its width.
    aspect: standard deviation of the ratio fx / fy, whose mean is 1.
    radial, tangential: standard deviations of the radial coefficients k1 k2 (and the fisheye's four), and of the
        tangential coefficients p1 p2, whose means are 0.
    k3: standard deviation of the third radial coefficient, whose mean is 0.
    """

    centre: float = 0.05
    aspect: float = 0.01
    radial: float = 1.0
    tangential: float = 0.01
    k3: float = 0.3


@dataclass(frozen=True)
class Refined:
    """The result of `bundle_adjust`.

    cameras: refined cameras.
    frames: (F, 4, 4) refined world_from_board.
    residuals: (M, 2) measured minus projected, px.
    rms_px: root mean square per coordinate, px.
    focal_sd: (C,) standard deviation of the focal length, px; NaN where it was fixed.
    position_sd: (C,) standard deviation of the position relative to the first camera, m; NaN where it was fixed.
    """

    cameras: tuple[Camera, ...]
    frames: Array
    residuals: Array
    rms_px: float
    focal_sd: Array
    position_sd: Array


def project_with_derivatives(camera: Camera, points_camera: Array) -> tuple[Array, Array, Array]:
    """Project points with lens distortion, and compute the derivatives.

    points_camera: (M, 3) in the camera's frame, m.
    Returns: (M, 2) px; derivative with respect to the point (M, 2, 3), and to the intrinsics (M, 2, 4 + k) in the order
        fx, fy, cx, cy, distortion.
    """
    zero = np.zeros(3)
    points = np.ascontiguousarray(points_camera, dtype=np.float64)[:, None]
    if camera.fisheye:
        uv, j = cv2.fisheye.projectPoints(points, zero, zero, camera.K, camera.distortion[:4])
        by_point, by_lens = slice(11, 14), slice(8)
    else:
        uv, j = cv2.projectPoints(points, zero, zero, camera.K, camera.distortion)
        by_point, by_lens = slice(3, 6), slice(6, 10 + len(camera.distortion))
    j = np.asarray(j, dtype=np.float64).reshape(len(points), 2, -1)
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2), j[..., by_point], j[..., by_lens]


def bundle_adjust(
    cameras: Sequence[Camera],
    frames: Array,
    board_points: Array,
    observations: Observations,
    *,
    free_intrinsics: bool | NDArray[np.bool_] = True,
    fixed_frames: NDArray[np.bool_] | None = None,
    prior: LensPrior | None = None,
    noise_px: float | Array = NOISE_PX,
    robust_px: float = 1.0,
) -> Refined:
    """Refine cameras and board poses so that they fit the observed corners best.

    The first camera stays where it is, unless boards are fixed.

    frames: (F, 4, 4) world_from_board at the start.
    board_points: (N, 3) m.
    free_intrinsics: whether to change K and distortion, per camera (C,) or for all.
    fixed_frames: (F,) boards whose poses are known (measured points).
    prior: standard deviations of the lens parameters.
    noise_px: standard deviation of a corner's coordinate, for all or each (M,), px.
    robust_px: errors above this get less weight (Huber), px; the threshold grows with `noise_px`.
    Raises: SolverError where a corner lies behind its camera at the start.
    """
    problem = _Problem(cameras, board_points, observations, prior, noise_px, robust_px, free_intrinsics, fixed_frames)
    rule = Rule(1e-3, least=1e-9, most=1e9, tries=8, gain=1e-9)
    start = list(cameras), np.array(frames, dtype=np.float64)
    try:
        found = problem.solve(start, _ITERATIONS, rule)
    except SolverError as error:
        raise SolverError(
            "The calibration cannot be refined from this start: a corner lies behind its camera. Remove the pictures "
            "with the worst boards and calibrate again."
        ) from error
    cams, poses = found.state
    residuals = problem.residuals(cams, poses)
    rms = float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float("nan")
    focal, position = problem.deviations(cams, found.equations)
    factor = problem.noise_factor(residuals)
    return Refined(tuple(cams), poses, residuals, rms, factor * focal, factor * position)


class _Problem(SharedProblem[list[Camera]]):
    """Cost and normal equations of `bundle_adjust`.

    Unknowns of a camera: rotation (3, multiplied from the left), translation (3), intrinsics. Unknowns of a board:
        rotation (3, multiplied from the left), translation (3).
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        points: Array,
        observations: Observations,
        prior: LensPrior | None,
        noise: float | Array,
        robust: float,
        free: bool | NDArray[np.bool_],
        fixed: NDArray[np.bool_] | None,
    ) -> None:
        self.o, self.points, self.prior = observations, points, prior or LensPrior()
        self.robust = robust / NOISE_PX
        self.noise = np.broadcast_to(np.asarray(noise, dtype=np.float64), (len(observations),))
        c = len(cameras)
        self.p = 6 + 4 + max(len(camera.distortion) for camera in cameras)
        self.slices = [slice(*np.searchsorted(observations.camera, [i, i + 1])) for i in range(c)]
        self.free_lens = np.broadcast_to(np.asarray(free, dtype=bool), (c,))
        self.fixed_frames = fixed
        free_of = np.zeros((c, self.p), bool)
        for i, camera in enumerate(cameras):
            free_of[i, :6] = i > 0 or (fixed is not None and bool(fixed.any()))
            free_of[i, 6 : 10 + _lens_size(camera)] = self.free_lens[i]
        self.free = free_of.ravel()

    def _at(self, camera: Camera, frames: Array, s: slice) -> tuple[Array, Array]:
        """Transform corners: rotated by the board's pose only (M, 3), and in the camera's frame (M, 3)."""
        pose = frames[self.o.frame[s]]
        turned = np.einsum("mij,mj->mi", pose[:, :3, :3], self.points[self.o.corner[s]])
        world = turned + pose[:, :3, 3]
        return turned, world @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]

    def _errors(self, camera: Camera, frames: Array, s: slice) -> Array:
        """Compute the residuals of one camera.

        frames: (F, 4, 4) world_from_board.
        s: the camera's observations.
        Returns: (M, 2) measured minus projected, px; all infinite where a corner lies behind the camera.
        """
        _, x = self._at(camera, frames, s)
        if len(x) == 0:
            return np.zeros((0, 2))
        if (x[:, 2] <= 1e-6).any():
            return np.full((len(x), 2), np.inf)
        return self.o.pixels[s] - project_with_derivatives(camera, x)[0]

    def residuals(self, cameras: Sequence[Camera], frames: Array) -> Array:
        """Compute the residuals (M, 2), px, in the order of the observations."""
        return np.concatenate([self._errors(c, frames, s) for c, s in zip(cameras, self.slices, strict=True)])

    def cost(self, cameras: Sequence[Camera], frames: Array) -> float:
        """Compute the robust cost of all observations, with the lens prior; infinite where a corner lies behind a
        camera.

        frames: (F, 4, 4) world_from_board.
        """
        total = 0.0
        for camera, s, free in zip(cameras, self.slices, self.free_lens, strict=True):
            e = np.linalg.norm(self._errors(camera, frames, s), axis=1) / self.noise[s] / self.robust
            with np.errstate(over="ignore", invalid="ignore"):
                total += self.robust**2 * float(huber(e**2)[0].sum())
            if free:
                r, _ = self._prior(camera)
                total += float(r @ r)
        return total if np.isfinite(total) else float("inf")

    def _prior(self, camera: Camera) -> tuple[Array, Array]:
        """Compute the residuals (n,) of the lens prior and their derivatives (n, 4 + k) with respect to the
        intrinsics.
        """
        k, p = camera.K, self.prior
        w, h = camera.size
        n = _lens_size(camera)
        d = camera.distortion
        sd = np.full(n, p.radial)
        if not camera.fisheye:
            sd[2:4] = p.tangential
            sd[4:] = p.k3
        centre = p.centre * w
        j = np.zeros((3 + n, 4 + n))
        j[0, 2] = j[1, 3] = 1 / centre
        j[2, 0], j[2, 1] = 1 / k[1, 1] / p.aspect, -k[0, 0] / k[1, 1] ** 2 / p.aspect
        j[3:, 4:] = np.diag(1 / sd)
        middle = np.array([(w - 1) / 2, (h - 1) / 2])
        r = np.concatenate([(k[:2, 2] - middle) / centre, [(k[0, 0] / k[1, 1] - 1) / p.aspect], d[:n] / sd])
        return r, j

    def equations(self, cameras: Sequence[Camera], frames: Array) -> SharedEquations:
        """Assemble the normal equations: shared unknowns (C p,) of the cameras, own unknowns (F, 6) of the boards."""
        c, f, p = len(cameras), len(frames), self.p
        a, ga = np.zeros((c, p, c, p)), np.zeros((c, p))
        b, gb = np.zeros((f, 6, 6)), np.zeros((f, 6))
        w = np.zeros((f, 6, c, p))
        for i, (camera, s) in enumerate(zip(cameras, self.slices, strict=True)):
            if s.start < s.stop:
                jc, jb, e = self._derivatives(camera, frames, s)
                a[i, :, i], ga[i] = np.einsum("mkp,mkq->pq", jc, jc), -np.einsum("mkp,mk->p", jc, e)
                numbers, first = np.unique(self.o.frame[s], return_index=True)
                w[numbers, :, i] = np.add.reduceat(np.einsum("mkp,mkq->mqp", jc, jb), first)
                b[numbers] += np.add.reduceat(np.einsum("mkp,mkq->mpq", jb, jb), first)
                gb[numbers] -= np.add.reduceat(np.einsum("mkp,mk->mp", jb, e), first)
            if self.free_lens[i]:
                r, j = self._prior(camera)
                n = j.shape[1]
                a[i, 6 : 6 + n, i, 6 : 6 + n] += j.T @ j
                ga[i, 6 : 6 + n] += j.T @ r
        return SharedEquations(a.reshape(c * p, c * p), ga.ravel(), b, gb, w.reshape(f, 6, c * p))

    def _derivatives(self, camera: Camera, frames: Array, s: slice) -> tuple[Array, Array, Array]:
        """Compute weighted derivatives and errors of one camera.

        frames: (F, 4, 4) world_from_board.
        s: the camera's observations.
        Returns: derivatives with respect to the camera (M, 2, p) and to the board (M, 2, 6), and errors (M, 2), all
            multiplied by the root of the robust weight and divided by the noise.
        """
        turned, x = self._at(camera, frames, s)
        uv, by_point, by_lens = project_with_derivatives(camera, x)
        noise = self.noise[s][:, None]
        e = (self.o.pixels[s] - uv) / noise
        weight = np.sqrt(huber((e**2).sum(1) / self.robust**2)[1])[:, None]
        scale = (weight / noise)[..., None]
        by_point, by_lens = by_point * scale, by_lens * scale
        r, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        jc = np.zeros((len(x), 2, self.p))
        jc[..., :3] = -by_point @ skew(x - t)
        jc[..., 3:6] = by_point
        jc[..., 6 : 6 + by_lens.shape[2]] = by_lens
        by_world = by_point @ r
        jb = np.concatenate([-by_world @ skew(turned), by_world], -1)
        if self.fixed_frames is not None:
            jb = np.where(self.fixed_frames[self.o.frame[s]][:, None, None], 0.0, jb)
        return jc, jb, e * weight

    def evaluate(self, state: _State) -> tuple[float, Callable[[], SharedEquations]]:
        return self.cost(*state), partial(self.equations, *state)

    def moved(self, state: _State, step: Array, own: Array) -> tuple[_State, float]:
        """Apply a step; changes of focal lengths are limited, so that a camera stays possible.

        state: cameras and world_from_board (F, 4, 4).
        step: (C p,) step of the cameras.
        own: (F, 6) step of the boards.
        Returns: the new state, and infinity, because the descent does not stop by the size of a step.
        """
        cameras, frames = state
        out = []
        for camera, d, free in zip(cameras, step.reshape(-1, self.p), self.free_lens, strict=True):
            pose = camera.camera_from_world
            pose = se3(so3_exp(d[:3]) @ pose[:3, :3], pose[:3, 3] + d[3:6])
            k, distortion = camera.K, camera.distortion
            if free:
                # limit large steps, so that the camera stays possible
                f = np.exp(np.clip(d[6:8] / np.diag(k)[:2], -0.5, 0.5)) * np.diag(k)[:2]
                k = np.array([[f[0], 0, k[0, 2] + d[8]], [0, f[1], k[1, 2] + d[9]], [0, 0, 1.0]])
                n = _lens_size(camera)
                distortion = np.concatenate([distortion[:n] + d[10 : 10 + n], distortion[n:]])
            out.append(replace(camera, K=k, distortion=distortion, camera_from_world=pose))
        poses = se3(so3_exp(own[:, :3]) @ frames[:, :3, :3], frames[:, :3, 3] + own[:, 3:])
        return (out, poses), np.inf

    def noise_factor(self, residuals: Array) -> float:
        """Estimate the ratio of the observed noise of corners to the assumed noise; 1 where there are too few corners.

        Why: it is at least 1/3, because errors that all corners have in common do not show in the residuals.
        """
        fixed = 0 if self.fixed_frames is None else int(self.fixed_frames.sum())
        freedom = 2 * len(self.o) - int(self.free.sum()) - 6 * (len(np.unique(self.o.frame)) - fixed)
        if freedom < 60:
            return 1.0
        share = np.minimum(
            np.linalg.norm(residuals, axis=1) / self.noise, self.robust
        )  # outliers do not count as noise
        return max(float(np.sqrt((share**2).sum() / freedom)), 1 / 3)

    def deviations(self, cameras: Sequence[Camera], equations: SharedEquations) -> tuple[Array, Array]:
        """Compute the standard deviations of focal lengths (C,), px, and of camera positions (C,), m."""
        c, p, free = len(cameras), self.p, self.free
        focal, position = np.full(c, np.nan), np.full(c, np.nan)
        if not free.any():
            return focal, position
        s = equations.reduced().hessian[np.ix_(free, free)]
        covariance = np.linalg.pinv(s, hermitian=True)
        where = np.full(c * p, -1)
        where[free] = np.arange(len(s))
        where = where.reshape(c, p)
        for i, camera in enumerate(cameras):
            if where[i, 6] >= 0:
                focal[i] = np.sqrt(max(covariance[where[i, 6], where[i, 6]], 0.0))
            if where[i, 0] >= 0:
                block = covariance[np.ix_(where[i, :6], where[i, :6])]
                r, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
                # position = -R't; R <- exp(w) R: d position = -R' (dt - w x t) = -R' (dt + skew(t) w)
                j = -r.T @ np.concatenate([skew(t), np.eye(3)], 1)
                position[i] = np.sqrt(max(np.trace(j @ block @ j.T), 0.0))
        return focal, position


def _lens_size(camera: Camera) -> int:
    """Count the distortion coefficients that are refined: those of the lens, not of a tilted sensor."""
    return min(len(camera.distortion), 4 if camera.fisheye else 5)


# ---- intrinsics ------------------------------------------------------------------------------------------------------
# A camera's lens from pictures of a board: Zhang's closed form and OpenCV's refinement to start with, then the joint
# refinement of `bundle` with its weak prior, without the pictures that do not fit.


MAX_VIEWS = 40
_MIN_VIEWS = 4
_DISTINCT = 0.03  # of the picture's width: boards nearer to each other than this give the same information
FOCAL_SD = 0.03
"""Relative standard deviation above which a focal length counts as undetermined."""


@dataclass(frozen=True)
class CalibratedLens:
    """The lens of one camera.

    camera: the lens; its pose is the identity.
    rms_px: root mean square error per coordinate, px.
    given: it was read from a file, not calibrated.
    """

    camera: Camera
    rms_px: float
    given: bool = False


def calibrate_lens(
    name: str,
    sightings: Mapping[int, BoardDetection],
    board: Board,
    size: tuple[int, int],
    *,
    fisheye: bool = False,
) -> CalibratedLens:
    """Calibrate K and distortion (k1 k2 p1 p2 k3, or four fisheye coefficients) of one camera from its board pictures.

    name: name of the camera.
    sightings: detected boards by frame number.
    size: width and height of the pictures, px.
    Returns: the lens, also where its focal length stays uncertain, because boards that other cameras saw as well may
        determine it.
    Raises: CalibrationError where pictures are missing or contradict each other.
    """
    chosen = spread_out(sightings, size, MAX_VIEWS)
    different = len(spread_out(sightings, size, MAX_VIEWS, _DISTINCT))
    if different < _MIN_VIEWS:
        raise CalibrationError(
            f"Camera {name}: the board was seen in {len(sightings)} pictures, in {different} different positions; its "
            f"lens needs at least {_MIN_VIEWS}, better 15: film the board tilted, near and far, in all corners of the "
            "picture, or give a calibration file with --intrinsics."
        )
    start = (
        _first_fisheye(name, chosen, sightings, board, size)
        if fisheye
        else _first(name, chosen, sightings, board, size)
    )
    result: Refined | None = None
    for attempt in range(3):
        poses = [board_poses(start, sightings[f], board.points)[0] for f in chosen]
        # bad start poses (a board nearly edge-on) would only be dropped later
        good = [k for k, (pose, _) in enumerate(poses) if pose[2, 3] > 0]
        chosen, poses = [chosen[k] for k in good], [poses[k] for k in good]
        if len(chosen) < 3:
            break
        observations = collect_observations({0: {f: sightings[f] for f in chosen}}, chosen)
        result = bundle_adjust([start], np.stack([p for p, _ in poses]), board.points, observations)
        start = result.cameras[0]
        error = np.sqrt(
            np.bincount(observations.frame, (result.residuals**2).sum(1)) / (2 * np.bincount(observations.frame))
        )
        limit = max(3 * float(np.median(error)), 0.5)
        if (error <= limit).all() or attempt == 2:
            break
        chosen = [f for f, e in zip(chosen, error, strict=True) if e <= limit]
    if result is None or len(chosen) < 3:
        raise CalibrationError(
            f"Camera {name}: the boards found in its pictures contradict each other; check the pattern size and that "
            "the board is flat and stiff."
        )
    return CalibratedLens(start, result.rms_px)


def spread_out(
    sightings: Mapping[int, BoardDetection], size: tuple[int, int], count: int, apart: float = 0.0
) -> list[int]:
    """Choose frames whose boards lie as differently as possible (farthest-point sampling).

    sightings: detected boards by frame number.
    size: width and height of the pictures, px.
    count: largest number of frames.
    apart: smallest difference between two boards, as a share of the picture's width.
    Returns: frame numbers in increasing order.
    """
    frames = list(sightings)
    if not frames:
        return []
    where = positions(sightings, size) * [1, 1, 3, 0.1]  # a board's size matters as well
    most = int(np.argmax([len(s.ids) for s in sightings.values()]))
    picked, distance = [most], np.linalg.norm(where - where[most], axis=1)
    while len(picked) < min(count, len(frames)):
        far = int(distance.argmax())
        if distance[far] <= apart:
            break
        picked.append(far)
        distance = np.minimum(distance, np.linalg.norm(where - where[far], axis=1))
    return sorted(frames[i] for i in picked)


def collect_observations(sightings: Mapping[int, Mapping[int, BoardDetection]], frames: Sequence[int]) -> Observations:
    """Collect the corners of some frames of all cameras as arrays.

    sightings: detected boards by camera index and frame number.
    frames: frame numbers; their positions in this list are the frame indices in the result.
    """
    place = {f: k for k, f in enumerate(frames)}
    parts = [
        (np.full(len(s.ids), c), np.full(len(s.ids), place[f]), s.ids, s.pixels)
        for c, seen in sorted(sightings.items())
        for f, s in sorted(seen.items(), key=lambda item: place.get(item[0], -1))
        if f in place
    ]
    if not parts:
        empty = np.zeros(0, np.int64)
        return Observations(empty, empty, empty, np.zeros((0, 2)))
    c, f, i, p = (np.concatenate(v) for v in zip(*parts, strict=True))
    return Observations(c, f, i, p)


def board_poses(camera: Camera, sighting: BoardDetection, points: Array) -> list[tuple[Array, float]]:
    """Compute the two poses of a board that explain its picture (Collins and Bartoli 2014, infinitesimal plane-based
    pose).

    sighting: the detected board.
    points: (N, 3) corners of the board, m.
    Returns: camera_from_board (4, 4) and rms error, px, of each pose, the better one first.
    """
    flat = np.linalg.inv(camera.K)
    u = camera.undistort_points(sighting.pixels)
    normal = np.concatenate([u, np.ones((len(u), 1))], 1) @ flat.T
    seen = points[sighting.ids]
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            seen, normal[:, :2].copy(), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return [(se3(np.eye(3), [0, 0, -1.0]), float("inf"))]
    out = []
    for r, t in zip(rotations, translations, strict=True):
        pose = se3(cv2.Rodrigues(r)[0], np.ravel(t))
        error = replace(camera, camera_from_world=pose).project(seen) - sighting.pixels
        rms = float(np.sqrt(np.mean(error**2)))
        out.append((pose, rms if np.isfinite(rms) else float("inf")))
    return sorted(out, key=lambda p: p[1])


def _first(
    name: str, frames: Sequence[int], sightings: Mapping[int, BoardDetection], board: Board, size: tuple[int, int]
) -> Camera:
    """Calibrate the lens roughly, as a start: OpenCV's closed form and refinement; without distortion where that fails.

    name: name of the camera.
    frames: frame numbers to use.
    sightings: detected boards by frame number.
    size: width and height of the pictures, px.
    Returns: the camera; its pose is the identity.
    """
    objects = [board.points[sightings[f].ids].astype(np.float32) for f in frames]
    images = [sightings[f].pixels.astype(np.float32) for f in frames]
    k = np.asarray(cv2.initCameraMatrix2D(objects, images, size, 1.0), dtype=np.float64)
    f = float(k[0, 0])
    if not 0.2 * max(size) < f < 20 * max(size):
        f = 1.0 * max(size)
    k = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        _, found, lens = cv2.calibrateCamera(objects, images, size, k.copy(), np.zeros(5), flags=flags)[:3]
        found, lens = np.asarray(found, np.float64), np.ravel(lens)[:5].astype(np.float64)
        middle = np.abs(found[:2, 2] - k[:2, 2]).max()
        if 0.2 * max(size) < found[0, 0] < 20 * max(size) and middle < 0.3 * max(size) and np.abs(lens).max() < 3:
            return Camera(name, found, lens, np.eye(4), size)
    except cv2.error:
        pass
    return Camera(name, k, np.zeros(5), np.eye(4), size)


def _first_fisheye(
    name: str, frames: Sequence[int], sightings: Mapping[int, BoardDetection], board: Board, size: tuple[int, int]
) -> Camera:
    """Choose the start focal length of a fisheye lens, from those of 60 to 220 degrees of view, by the fit of board
    poses.

    name, frames, sightings, size: as in `_first`.
    Returns: the camera without distortion; its pose is the identity.
    Why: the equidistant model r = f angle is near enough for a start; OpenCV's own start fails on boards near the edge.
    """
    best = (float("inf"), 0.0)
    for view in np.deg2rad(np.geomspace(60, 220, 12)):
        f = max(size) / view
        camera = _fisheye(name, f, size)
        errors = [board_poses(camera, sightings[i], board.points)[0][1] for i in frames]
        best = min(best, (float(np.median(errors)), f))
    return _fisheye(name, best[1] or max(size) / 2.0, size)


def _fisheye(name: str, f: float, size: tuple[int, int]) -> Camera:
    k = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    return Camera(name, k, np.zeros(4), np.eye(4), size, True)

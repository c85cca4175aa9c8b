"""Bundle adjustment: cameras, and board poses or points, that minimise robust reprojection errors.

The method is Levenberg-Marquardt with analytic derivatives on the normal equations. The unknowns of boards and points
are eliminated with the Schur complement (Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1).
The equations are accumulated per camera and group, so a step takes milliseconds where a general sparse solver iterates.
Weak prior knowledge about the cameras enters as measurements: it decides where pictures give no information and has
hardly any effect where they do.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute.linear import SharedEquations
from hypose.compute.losses import huber
from hypose.fitting.problem import Rule, SharedProblem
from hypose.geometry import Array, se3, skew, so3_exp, transform

_State = tuple[list[Camera], Array]
"""Cameras, and world_from_group (G, 4, 4)."""

NOISE_PX = 0.3
"""Assumed standard deviation of a corner's coordinate, px."""
_ITERATIONS = 50
_BEHIND_PX, _FAR = 1e4, 1e6  # error of a point that lies behind its camera, and largest one in squared scales


@dataclass(frozen=True)
class Observations:
    """M points observed in pictures, in the order of the cameras, and of the groups of each camera.

    camera, group, point: (M,) indices of the camera, of the group (a board's pose), and of the point in its group.
    pixels: (M, 2) px.
    """

    camera: NDArray[np.int64]
    group: NDArray[np.int64]
    point: NDArray[np.int64]
    pixels: Array


def trial_lenses(name: str, size: tuple[int, int], factors: Array, fisheye: bool = False) -> list[Camera]:
    """Make cameras without distortion, whose focal lengths are factors of the longer side of the picture (size, px)."""
    middle, none = (np.array(size) - 1)[:, None] / 2, np.zeros(4 if fisheye else 5)
    lenses = [np.r_[np.c_[f * max(size) * np.eye(2), middle], [[0.0, 0.0, 1.0]]] for f in factors]
    return [Camera(name, k, none, np.eye(4), size, fisheye) for k in lenses]


def apply_parameters(camera: Camera, x: Array) -> Camera:
    """Change a camera by its parameters.

    x: (6,) rotation vector (rad) and translation (m) in the camera's frame; optionally (7,) with the logarithm of the
        focal factor.
    """
    motion = se3(so3_exp(x[:3]), x[3:6])
    k = camera.K
    if len(x) > 6 and x[6] != 0:
        k = k.copy()
        k[:2, :2] *= np.exp(x[6])
    return replace(camera, K=k, camera_from_world=motion @ camera.camera_from_world)


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


class Bundle(SharedProblem[list[Camera]]):
    """Least-squares problem over cameras and groups of points, each of which moves as a whole.

    Unknowns of a camera: the 6 of `apply_parameters`, then those of its lens. Unknowns of a group: rotation (3,
    multiplied from the left) and translation (3); of a single point the translation alone. The cost is the sum of
    1/2 weight loss(|error|^2 / scale^2), and 1/2 |residual|^2 of the prior.

    observations: M points in the pictures.
    points: (N, 3) points in the frame of their group, m.
    weight, scale: (M,) weights, and robust scales, px.
    loss: a loss of `hypose.compute.losses`.
    count: P, largest number of unknowns of a camera.
    free: (C P,) unknowns of the cameras that may change.
    """

    own = 6
    fixed: NDArray[np.bool_] | None = None
    """(G,) groups whose poses are known."""

    def __init__(
        self,
        observations: Observations,
        points: Array,
        weight: Array,
        scale: Array,
        loss: Callable[[Any], Any],
        count: int,
        free: NDArray[np.bool_],
    ) -> None:
        self.o, self.points, self.weight, self.scale, self.loss = observations, points, weight, scale, loss
        self.count, self.free = count, free
        ends = np.searchsorted(observations.camera, np.arange(len(free) // count + 1))
        self.slices = [slice(*pair) for pair in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]

    @abstractmethod
    def lens(self, camera: Camera) -> Array:
        """Compute the derivatives (L, 4 + k) of fx, fy, cx, cy and the distortion by the lens unknowns."""

    @abstractmethod
    def prior(self, index: int, camera: Camera) -> tuple[Array, Array]:
        """Compute the residuals (n,) of the prior on a camera, and their derivatives (n, P)."""

    def _at(self, camera: Camera, groups: Array, s: slice) -> tuple[Array, Array]:
        """Transform points: rotated by the pose of their group only (M, 3), and in the camera's frame (M, 3)."""
        pose = groups[self.o.group[s]]
        turned = np.einsum("mij,mj->mi", pose[:, :3, :3], self.points[self.o.point[s]])
        return turned, transform(camera.camera_from_world, turned + pose[:, :3, 3])

    def residuals(self, cameras: Sequence[Camera], groups: Array) -> Array:
        """Compute the residuals (M, 2), projected minus measured, px; 1e4 for points behind the camera."""
        out = np.full(self.o.pixels.shape, _BEHIND_PX)
        for camera, s in zip(cameras, self.slices, strict=True):
            x = self._at(camera, groups, s)[1]
            front = x[:, 2] > 1e-6
            x = x[front]
            out[s][front] = camera.through_lens(x[:, :2] / x[:, 2:]) - self.o.pixels[s][front]
        return out

    def derivatives(self, camera: Camera, groups: Array, s: slice) -> tuple[Array, Array, Array, Array]:
        """Compute derivatives and residuals of one camera.

        groups: (G, 4, 4) world_from_group.
        s: the camera's observations.
        Returns: derivatives with respect to the camera (M, 2, P) and to the group (M, 2, n), and residuals (M, 2), all
            multiplied by the roots (M,) of the robust weights, which are the last; 0 for points behind the camera.
        """
        turned, x = self._at(camera, groups, s)
        front = x[:, 2] > 1e-6
        x = np.where(front[:, None], x, [0.0, 0.0, 1.0])
        uv, by_point, by_lens = project_with_derivatives(camera, x)
        e = np.where(front[:, None], uv - self.o.pixels[s], 0.0)
        root = np.sqrt((front * self.weight[s] / self.scale[s] ** 2) * self.loss((e**2).sum(1) / self.scale[s] ** 2)[1])
        by_point, by_lens = by_point * root[:, None, None], by_lens * root[:, None, None]
        lens = self.lens(camera)
        jc = np.zeros((len(x), 2, self.count))
        jc[..., :3], jc[..., 3:6] = np.cross(x[:, None], by_point), by_point
        jc[..., 6 : 6 + len(lens)] = by_lens @ lens.T
        by_world = by_point @ camera.camera_from_world[:3, :3]
        jg = by_world if self.own == 3 else np.concatenate([-by_world @ skew(turned), by_world], -1)
        if self.fixed is not None:
            jg = np.where(self.fixed[self.o.group[s]][:, None, None], 0.0, jg)
        return jc, jg, e * root[:, None], root

    def evaluate(self, state: _State) -> tuple[float, Callable[[], SharedEquations]]:
        """Compute the cost, and return it with a function that computes the equations."""
        squared = np.minimum((self.residuals(*state) ** 2).sum(1) / self.scale**2, _FAR)
        cost = float((self.weight * self.loss(squared)[0]).sum())
        cost += sum(float((self.prior(i, camera)[0] ** 2).sum()) for i, camera in enumerate(state[0]))
        return 0.5 * cost, partial(self.equations, *state)

    def equations(self, cameras: Sequence[Camera], groups: Array) -> SharedEquations:
        """Assemble the normal equations: shared unknowns (C P,) of the cameras, own unknowns (G, n) of the groups."""
        c, g, p, n = len(cameras), len(groups), self.count, self.own
        a, ga = np.zeros((c, p, c, p)), np.zeros((c, p))
        b, gb = np.zeros((g, n, n)), np.zeros((g, n))
        w = np.zeros((g, n, c, p))
        for i, (camera, s) in enumerate(zip(cameras, self.slices, strict=True)):
            if s.start < s.stop:
                jc, jg, e, _ = self.derivatives(camera, groups, s)
                a[i, :, i], ga[i] = np.einsum("mkp,mkq->pq", jc, jc), np.einsum("mkp,mk->p", jc, e)
                numbers, first = np.unique(self.o.group[s], return_index=True)
                w[numbers, :, i] = np.add.reduceat(np.einsum("mkp,mkq->mqp", jc, jg), first)
                b[numbers] += np.add.reduceat(np.einsum("mkp,mkq->mpq", jg, jg), first)
                gb[numbers] += np.add.reduceat(np.einsum("mkp,mk->mp", jg, e), first)
            r, j = self.prior(i, camera)
            a[i, :, i] += j.T @ j
            ga[i] += j.T @ r
        return SharedEquations(a.reshape(c * p, c * p), ga.ravel(), b, gb, w.reshape(g, n, c * p))

    def moved(self, state: _State, step: Array, own: Array) -> tuple[_State, float]:
        """Apply a step; changes of focal lengths are limited, so that a camera stays possible.

        state: cameras and world_from_group (G, 4, 4).
        step: (C P,) step of the cameras.
        own: (G, n) step of the groups.
        Returns: the new state, and the largest change of an unknown of a camera.
        """
        cameras, groups = state
        out = []
        for camera, x in zip(cameras, step.reshape(-1, self.count), strict=True):
            lens = self.lens(camera)
            change = x[6 : 6 + len(lens)] @ lens
            k, f = camera.K.copy(), camera.K[[0, 1], [0, 1]]
            k[[0, 1], [0, 1]] = f * np.exp(np.clip(change[:2] / f, -0.5, 0.5))
            k[:2, 2] += change[2:4]
            out.append(apply_parameters(replace(camera, K=k, distortion=camera.distortion + change[4:]), x[:6]))
        groups = groups.copy()
        groups[:, :3, 3] += own[:, -3:]
        if self.own == 6:
            groups[:, :3, :3] = so3_exp(own[:, :3]) @ groups[:, :3, :3]
        return (out, groups), float(np.abs(step).max())


# ---- boards ----------------------------------------------------------------------------------------------------------


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
    residuals: (M, 2) projected minus measured, px.
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
    """
    problem = _BoardBundle(
        cameras,
        board_points,
        observations,
        prior or LensPrior(),
        noise_px,
        robust_px / NOISE_PX,
        np.broadcast_to(np.asarray(free_intrinsics, dtype=bool), len(cameras)),
        fixed_frames,
    )
    found = problem.solve(
        (list(cameras), np.array(frames, dtype=np.float64)),
        _ITERATIONS,
        Rule(1e-3, least=1e-9, most=1e9, tries=8, gain=1e-9),
    )
    residuals = problem.residuals(*found.state)
    rms = float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float("nan")
    focal, position = problem.deviations(found.equations)
    factor = problem.noise_factor(residuals)
    return Refined(tuple(found.state[0]), found.state[1], residuals, rms, factor * focal, factor * position)


class _BoardBundle(Bundle):
    """Least-squares problem of `bundle_adjust`; lens unknowns are fx, fy, cx, cy and the distortion, px and 1."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        points: Array,
        observations: Observations,
        prior: LensPrior,
        noise: float | Array,
        robust: float,
        free_lens: NDArray[np.bool_],
        fixed: NDArray[np.bool_] | None,
    ) -> None:
        count = 10 + max(len(camera.distortion) for camera in cameras)
        free = np.zeros((len(cameras), count), bool)
        for i, camera in enumerate(cameras):
            free[i, :6] = i > 0 or (fixed is not None and bool(fixed.any()))
            free[i, 6 : 10 + _lens_size(camera)] = free_lens[i]
        self.lens_prior, self.free_lens, self.fixed, self.robust = prior, free_lens, fixed, robust
        self.noise = np.broadcast_to(np.asarray(noise, dtype=np.float64), len(observations.camera))
        weight = np.full(len(observations.camera), robust**2)
        super().__init__(observations, points, weight, robust * self.noise, huber, count, free.ravel())

    def lens(self, camera: Camera) -> Array:
        return np.eye(4 + _lens_size(camera), 4 + len(camera.distortion))

    def prior(self, index: int, camera: Camera) -> tuple[Array, Array]:
        if not self.free_lens[index]:
            return np.zeros(0), np.zeros((0, self.count))
        k, p = camera.K, self.lens_prior
        n = _lens_size(camera)
        sd = np.array([p.radial] * 4 if camera.fisheye else [p.radial, p.radial, p.tangential, p.tangential, p.k3])[:n]
        centre = p.centre * camera.size[0]
        j = np.zeros((3 + n, self.count))
        j[0, 8] = j[1, 9] = 1 / centre
        j[2, 6], j[2, 7] = 1 / k[1, 1] / p.aspect, -k[0, 0] / k[1, 1] ** 2 / p.aspect
        j[3:, 10 : 10 + n] = np.diag(1 / sd)
        middle = (np.array(camera.size) - 1) / 2
        aspect = (k[0, 0] / k[1, 1] - 1) / p.aspect
        return np.concatenate([(k[:2, 2] - middle) / centre, [aspect], camera.distortion[:n] / sd]), j

    def noise_factor(self, residuals: Array) -> float:
        """Estimate the ratio of the observed noise of corners to the assumed noise; 1 where there are too few corners.

        Why: it is at least 1/3, because errors that all corners have in common do not show in the residuals.
        """
        fixed = 0 if self.fixed is None else int(self.fixed.sum())
        freedom = self.o.pixels.size - int(self.free.sum()) - 6 * (len(np.unique(self.o.group)) - fixed)
        if freedom < 60:
            return 1.0
        # outliers do not count as noise
        share = np.minimum(np.linalg.norm(residuals, axis=1) / self.noise, self.robust)
        return max(float(np.sqrt((share**2).sum() / freedom)), 1 / 3)

    def deviations(self, equations: SharedEquations) -> tuple[Array, Array]:
        """Compute the standard deviations of focal lengths (C,), px, and of camera positions (C,), m."""
        free, variance = self.free, np.full(len(self.free), np.nan)
        if free.any():
            covariance = np.linalg.pinv(equations.reduced().hessian[np.ix_(free, free)], hermitian=True)
            variance[free] = np.maximum(covariance.diagonal(), 0.0)
        by_camera = variance.reshape(-1, self.count)
        # a translation moves the centre by as much, a rotation about it does not
        return np.sqrt(by_camera[:, 6]), np.sqrt(by_camera[:, 3:6].sum(1))


def _lens_size(camera: Camera) -> int:
    """Count the distortion coefficients that are refined: those of the lens, not of a tilted sensor."""
    return min(len(camera.distortion), 4 if camera.fisheye else 5)

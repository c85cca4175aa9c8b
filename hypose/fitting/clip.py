"""Fitting a whole clip at once: all frames coupled by a penalty on acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, solveh_banded

from hypose import compute
from hypose.body.body import Body
from hypose.compute.terms import PriorArrays
from hypose.errors import SolverError
from hypose.fitting.articulated import (
    ContourTerm,
    KeypointTerm,
    PointTerm,
    Quadratic,
    SolveOptions,
    contour_arrays,
    keypoint_arrays,
    point_arrays,
    prior_arrays,
    workspace_for,
)
from hypose.geometry import Array, nearest_branch

LARGEST_TURN = 0.35


def default_acceleration(dof: int, strength: float = 1.0) -> Array:
    """(D,) weights on squared second differences per frame: 1 rad and 1/300 m per frame^2 count alike."""
    return strength * np.r_[np.full(3, 300.0), np.ones(dof - 3)] ** 2


def fit_clip(
    body: Body,
    starts: ArrayLike,
    *,
    points: Sequence[PointTerm | None] | None = None,
    keypoints: Sequence[KeypointTerm | None] | None = None,
    contours: Sequence[ContourTerm | None] | None = None,
    acceleration: float | ArrayLike = 1.0,
    priors: Sequence[Quadratic] = (),
    options: SolveOptions | None = None,
) -> Array:
    """Poses (T, D) of a clip from starts (T, D): the frames' evidence plus 1/2 sum_d a_d (q_{t-1} - 2 q_t +
    q_{t+1})_d^2.

    points, keypoints, contours: one term (or None) per frame. acceleration: strength a (times
    `default_acceleration`), or (D,) weights. priors act on every frame. Damped Gauss-Newton on all frames together:
    the matrix is block-pentadiagonal and solved as a banded Cholesky, so the cost is linear in T. Joint limits are
    kept by cutting the step off. A SolverError when a frame's cost at the start is not finite."""
    q = _continuous(np.array(starts, dtype=np.float64))
    n_frames, dof = q.shape
    o = options or SolveOptions(iterations=15, coarse_iterations=0)
    weights = np.asarray(acceleration, dtype=np.float64)
    if weights.ndim == 0:
        weights = default_acceleration(dof, float(weights))
    problem = _Clip(body, n_frames, points, keypoints, contours, priors, weights)
    lower, upper = body.skeleton.lower, body.skeleton.upper
    q = np.clip(q, lower, upper)
    coarse = o.coarse_iterations > 0 and problem.has_contours
    cost, gradient, hessian = problem.evaluate(q, coarse)
    if not np.isfinite(cost):
        raise SolverError("The clip's cost at the start is not finite; check the start poses and the evidence for NaN.")
    damping = o.damping
    for iteration in range(o.iterations):
        if coarse and iteration == o.coarse_iterations:
            coarse = False
            cost, gradient, hessian = problem.evaluate(q, coarse)
        accepted, moved = False, np.inf
        for _ in range(5):
            step = problem.step(gradient, hessian, q, lower, upper, damping)
            if step is not None:
                step *= min(1.0, LARGEST_TURN / max(float(np.abs(step[:, 3:]).max()), 1e-9))
                trial = np.clip(q + step, lower, upper)
                new = problem.evaluate(trial, coarse)
                if np.isfinite(new[0]) and new[0] < cost * (1.002 if problem.has_contours else 1.0):
                    accepted = True
                    moved = float((np.abs(trial - q) * np.r_[[2.0] * 3, np.ones(dof - 3)]).max())
                    q, (cost, gradient, hessian) = trial, new
                    break
            damping = min(damping * 6, 1e6)
        damping = max(damping / 4, 1e-6)
        if (not accepted or moved < o.tolerance) and not coarse:
            break
    return q


def _continuous(q: Array) -> Array:
    for t in range(1, len(q)):
        q[t, 3:6] = nearest_branch(q[t, 3:6], q[t - 1, 3:6])
    return q


class _Clip:
    """Evidence of all frames as flat arrays; cost, gradient (T, D) and diagonal blocks (T, D, D) of the whole clip."""

    def __init__(
        self,
        body: Body,
        n_frames: int,
        points: Sequence[PointTerm | None] | None,
        keypoints: Sequence[KeypointTerm | None] | None,
        contours: Sequence[ContourTerm | None] | None,
        priors: Sequence[Quadratic],
        acceleration: Array,
    ) -> None:
        for name, terms in (("points", points), ("keypoints", keypoints), ("contours", contours)):
            if terms is not None and len(terms) != n_frames:
                raise SolverError(f"fit_clip needs one entry of {name} per frame: {n_frames}, got {len(terms)}.")
        joints = len(body.skeleton.parents)
        none = [None] * n_frames
        self.tree, self.mesh = body.skeleton.tree, body.coarse.arrays
        self.points = [point_arrays(t, joints) for t in points or none]
        self.keypoints = [keypoint_arrays(t, joints) for t in keypoints or none]
        self.contours = [contour_arrays(t) for t in contours or none]
        self.has_contours = any(len(c.sdf) for c in self.contours)
        self.centre, self.weight = prior_arrays(priors, body.skeleton.dof)
        self.lower = np.ascontiguousarray(body.skeleton.lower, dtype=np.float64)
        self.upper = np.ascontiguousarray(body.skeleton.upper, dtype=np.float64)
        self.acceleration = acceleration
        largest = max((t for t in contours or none if t is not None), key=lambda t: t.sizes.max(0).prod(), default=None)
        self.ws = workspace_for(body, largest)
        d2 = np.diff(np.eye(n_frames), 2, axis=0) if n_frames > 2 else np.zeros((0, n_frames))
        # bands of the second-difference operator's square: (T, T) only through its three diagonals
        self.bands = [
            np.einsum("ki,ki->i", d2[:, : n_frames - s], d2[:, s:]) if s < n_frames else np.zeros(0) for s in range(3)
        ]

    def evaluate(self, q: Array, coarse: bool) -> tuple[float, Array, Array]:
        cost, (t, d) = 0.0, q.shape
        gradient, hessian = np.empty((t, d)), np.empty((t, d, d))
        for k in range(t):
            centre = self.centre.copy()
            centre[:, 3:6] = nearest_branch(centre[:, 3:6], q[k, 3:6])
            e = compute.evaluate(
                q[k],
                self.tree,
                self.mesh,
                self.contours[k],
                self.keypoints[k],
                self.points[k],
                PriorArrays(centre, self.weight, self.lower, self.upper),
                self.ws,
                coarse=coarse,
            )
            cost += e.cost
            gradient[k], hessian[k] = e.gradient, e.hessian
        if t > 2:
            a = q[:-2] - 2 * q[1:-1] + q[2:]
            cost += 0.5 * float((self.acceleration * a**2).sum())
            pull = self.acceleration * a
            gradient[:-2] += pull
            gradient[1:-1] -= 2 * pull
            gradient[2:] += pull
        return cost, gradient, hessian

    def step(
        self, gradient: Array, hessian: Array, q: Array, lower: Array, upper: Array, damping: float
    ) -> Array | None:
        """Damped Newton step (T, D) with the dof that push against a limit held; None when not positive definite."""
        t, d = q.shape
        held = ((q <= lower + 1e-9) & (gradient > 0)) | ((q >= upper - 1e-9) & (gradient < 0))
        keep = ~held
        bands = np.zeros((3 * d, t * d))
        index = np.arange(t * d).reshape(t, d)
        for k in range(d):  # lower diagonals inside the blocks
            rows = np.arange(d - k)
            value = hessian[:, rows + k, rows] * keep[:, rows + k] * keep[:, rows]
            bands[k, index[:, rows].ravel()] = value.ravel()
        for s in range(3):
            if s < t:
                value = self.bands[s][:, None] * self.acceleration * keep[: t - s] * keep[s:]
                bands[s * d, index[: t - s].ravel()] += value.ravel()
        bands[0] += damping * np.maximum(bands[0], 1.0)
        try:
            return -solveh_banded(bands, (gradient * keep).ravel(), lower=True).reshape(t, d)
        except LinAlgError:
            return None

"""Linear algebra of least squares: normal equations of rows, elimination of unknowns, and coupled frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.geometry import Array

_DAMPING_SHARE = 1e-12
"""Share of its diagonal (of 1 at least) that is added to a group of unknowns, which may be undetermined."""


@kernel
def _weighted_squares(jacobian, weight, residual, hessian, gradient):
    """Add J^T w J to hessian (D, D) and J^T w r to gradient (D,), in a fixed order of the sums (threaded libraries have
    none).

    jacobian, weight, residual: (R, D), (R,) and (R,) of the rows.
    """
    rows, n = jacobian.shape
    whole = rows - rows % 4
    for r in range(0, whole, 4):  # four at once: the matrix is read and written a quarter as often
        a, b, c, d = jacobian[r], jacobian[r + 1], jacobian[r + 2], jacobian[r + 3]
        u, v, x, y = weight[r], weight[r + 1], weight[r + 2], weight[r + 3]
        for i in range(n):
            p, q, s, t = u * a[i], v * b[i], x * c[i], y * d[i]
            line = hessian[i]
            for k in range(i + 1):
                line[k] += (p * a[k] + q * b[k]) + (s * c[k] + t * d[k])
            gradient[i] += (p * residual[r] + q * residual[r + 1]) + (s * residual[r + 2] + t * residual[r + 3])
    for r in range(whole, rows):
        a = jacobian[r]
        for i in range(n):
            p = weight[r] * a[i]
            line = hessian[i]
            for k in range(i + 1):
                line[k] += p * a[k]
            gradient[i] += p * residual[r]
    for i in range(n):
        for k in range(i):
            hessian[k, i] = hessian[i, k]


def weighted_squares(jacobian: ArrayLike, weight: ArrayLike, residual: ArrayLike) -> tuple[Array, Array]:
    """Compute the normal equations J^T w J (D, D) and J^T w r (D,) of weighted residuals.

    jacobian, weight, residual: J (R, D), w (R,) and r (R,).
    """
    j, w, r = (plain(x, np.float64) for x in (jacobian, weight, residual))
    hessian, gradient = np.zeros((j.shape[1], j.shape[1])), np.zeros(j.shape[1])
    _weighted_squares(j, w, r, hessian, gradient)
    return hessian, gradient


@dataclass(frozen=True)
class SharedEquations:
    """Normal equations of S unknowns shared by all (a body's shape, cameras) and N groups of n unknowns (a frame's
    pose, a point) that are not coupled to each other.

    hessian, gradient: (S, S) and (S,) of the shared unknowns.
    own, own_gradient: (N, n, n) and (N, n) of the groups.
    cross: (N, n, S) between groups and shared unknowns.
    """

    hessian: Array
    gradient: Array
    own: Array
    own_gradient: Array
    cross: Array

    def reduced(self, damping: float = 0.0) -> Reduced:
        """Eliminate the groups' unknowns, so that equations of the shared unknowns remain (Schur complement).

        damping: factor of the diagonal (whose entries count as at least 1) that is added to the matrices.
        Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1.
        """
        own = self.own.copy()
        diagonal = np.einsum("kii->ki", own)  # a view
        diagonal += max(damping, _DAMPING_SHARE) * np.maximum(diagonal, 1.0)
        factor = np.linalg.cholesky(own)
        inner = np.linalg.solve(factor, np.concatenate([self.cross, self.own_gradient[..., None]], 2))
        cross, pull = inner[..., :-1], inner[..., -1]
        taken, shift = weighted_squares(cross.reshape(-1, len(self.gradient)), np.ones(pull.size), pull.ravel())
        hessian = self.hessian - taken
        hessian[np.diag_indices_from(hessian)] += damping * np.maximum(hessian.diagonal(), 1.0)
        return Reduced(hessian, self.gradient - shift, factor, pull, cross)


@dataclass(frozen=True)
class Reduced:
    """Reduced system of the S shared unknowns, and the factored groups.

    hessian, gradient: (S, S) and (S,) equations of the shared unknowns.
    factor: (N, n, n) Cholesky factors L of the groups' matrices.
    own_gradient: (N, n) L^-1 times the groups' gradients.
    cross: (N, n, S) L^-1 times the coupling.
    """

    hessian: Array
    gradient: Array
    factor: Array
    own_gradient: Array
    cross: Array

    def step(self, free: NDArray[np.bool_] | None = None) -> Array | None:
        """Solve for the step (S,) of the shared unknowns, 0 for those that are not free (S,); None where they are
        undetermined.
        """
        use = np.ones(len(self.gradient), np.bool_) if free is None else free
        hessian = self.hessian[np.ix_(use, use)]
        if not (hessian.diagonal() > 0).all():
            return None
        scale = np.sqrt(hessian.diagonal())  # unknowns have units
        scaled = hessian / np.outer(scale, scale) + _DAMPING_SHARE * np.eye(len(scale))
        if not _is_positive(scaled):
            return None
        x = np.zeros(len(use))
        x[use] = np.linalg.solve(scaled, -self.gradient[use] / scale) / scale
        return x

    def own_steps(self, shared: Array) -> Array:
        """Compute the steps (N, n) of the groups for a step `shared` (S,) of the shared unknowns."""
        pull = self.own_gradient + np.einsum("kns,s->kn", self.cross, shared)
        return np.linalg.solve(np.swapaxes(self.factor, 1, 2), -pull[..., None])[..., 0]


def solve_coupled(own: ArrayLike, bands: ArrayLike, right: ArrayLike) -> Array | None:
    """Solve M x = right for T coupled frames, in time linear in T.

    own: (T, D, D) symmetric blocks of the frames.
    bands: (3, T, D) diagonal weights of every frame with itself and with the frames one and two later (those beyond the
        last frame are ignored).
    right: (T, D).
    Returns: x (T, D); None where M is not positive definite.
    """
    b = np.asarray(right, dtype=np.float64)
    found = _eliminated(np.asarray(own, dtype=np.float64), np.asarray(bands, dtype=np.float64))
    if found is None:
        return None
    inverses, joins = found
    x = np.zeros((len(inverses) + 1, 2 * b.shape[1]))
    x.reshape(-1, b.shape[1])[: len(b)] = b
    for p, inverse in enumerate(inverses):
        x[p + 1] -= joins[p].T @ (inverse @ x[p])
    x[-1] = 0.0
    for p in range(len(inverses) - 1, -1, -1):
        x[p] = inverses[p] @ (x[p] - joins[p] @ x[p + 1])
    return x.reshape(-1, b.shape[1])[: len(b)]


def frame_covariances(own: ArrayLike, bands: ArrayLike) -> Array | None:
    """Compute the diagonal blocks (T, D, D) of the inverse of the matrix of `solve_coupled`.

    Returns: None where it is not positive definite. Where `own` is each frame's information and `bands` couple the
        frames, these are the covariances of the frames; a frame without information is determined by its neighbours
        only, and less the farther they are.
    """
    o = np.asarray(own, dtype=np.float64)
    found = _eliminated(o, np.asarray(bands, dtype=np.float64))
    if found is None:
        return None
    (t, d), (inverses, joins) = o.shape[:2], found
    out = np.zeros((len(inverses) + 1, 2 * d, 2 * d))
    for p in range(len(inverses) - 1, -1, -1):
        back = _product(inverses[p], joins[p])
        out[p] = inverses[p] + _product(_product(back, out[p + 1]), back.T)
    frames = np.stack([out[:-1, :d, :d], out[:-1, d:, d:]], 1).reshape(-1, d, d)[:t]
    return (frames + np.swapaxes(frames, 1, 2)) / 2


def _eliminated(own: Array, bands: Array) -> tuple[list[Array], Array] | None:
    """Eliminate pairs of frames one after the other.

    own, bands: as in `solve_coupled`.
    Returns: the inverse of each pair's remaining block (2 D, 2 D), and the coupling to the next pair (P, 2 D, 2 D);
        None where not positive definite.
    Why pairs: a frame is coupled to the next two, so that the matrix of pairs is block-tridiagonal. Blocks of this size
    are inverted by one thread; banded solvers use several, which takes a hundred times as long on a busy machine.
    """
    blocks, joins = _in_pairs(own, bands)
    inverses = list[Array]()
    for p, block in enumerate(blocks):
        left = block - _product(joins[p - 1].T, _product(inverses[-1], joins[p - 1])) if p else block
        if not _is_positive(left):
            return None
        inverses.append(np.linalg.inv(left))
    return inverses, joins


def _is_positive(matrix: Array) -> bool:
    """Return whether a symmetric matrix is finite and positive definite."""
    try:
        return bool(np.isfinite(np.linalg.cholesky(matrix)).all())
    except np.linalg.LinAlgError:
        return False


def _product(a: Array, b: Array) -> Array:
    """Compute a @ b of square matrices, in halves that are small enough for BLAS to use one thread."""
    return (np.ascontiguousarray(a).reshape(2, -1, len(a)) @ b).reshape(a.shape)


def _in_pairs(own: Array, bands: Array) -> tuple[Array, Array]:
    """Build blocks (P, 2 D, 2 D) of two frames each, and the coupling of each pair to the next (P, 2 D, 2 D).

    own, bands: as in `solve_coupled`.

    Of an odd number of frames the last one gets a partner that is coupled to nothing.
    """
    t, d = own.shape[:2]
    pairs, on = (t + 1) // 2, np.arange(d)
    weights = np.zeros((3, 2 * pairs, d))
    for s in range(3):
        weights[s, : max(t - s, 0)] = bands[s, : max(t - s, 0)]
    blocks, joins = np.zeros((pairs, 2 * d, 2 * d)), np.zeros((pairs, 2 * d, 2 * d))
    blocks[:, :d, :d], blocks[: t // 2, d:, d:] = own[::2], own[1::2]
    blocks[:, on, on] += weights[0, ::2]
    blocks[:, d + on, d + on] += weights[0, 1::2]
    blocks[:, on, d + on] = blocks[:, d + on, on] = weights[1, ::2]
    joins[:, d + on, on] = weights[1, 1::2]
    joins[:, on, on], joins[:, d + on, d + on] = weights[2, ::2], weights[2, 1::2]
    if t % 2:
        blocks[-1, d + on, d + on] = 1.0
    return blocks, joins

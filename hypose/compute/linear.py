"""Linear algebra of least squares: rows to normal equations, unknowns eliminated from them, and coupled frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.geometry import Array

_DAMPING_SHARE = 1e-12
"""Share of its diagonal (of 1 at least) that is added to a group of unknowns, of which nothing may be known"""


@kernel
def _weighted_squares(jacobian, weight, residual, hessian, gradient):
    """hessian (D, D) += J^T w J, gradient (D,) += J^T w r of rows jacobian (R, D), weight (R,), residual (R,): in a
    fixed order, which those of threaded libraries are not."""
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
    """J^T w J (D, D) and J^T w r (D,) of rows: jacobian (R, D), weight (R,), residual (R,)."""
    j, w, r = (plain(x, np.float64) for x in (jacobian, weight, residual))
    hessian, gradient = np.zeros((j.shape[1], j.shape[1])), np.zeros(j.shape[1])
    _weighted_squares(j, w, r, hessian, gradient)
    return hessian, gradient


@dataclass(frozen=True)
class SharedEquations:
    """Normal equations of S unknowns that all share (a body's shape, cameras) and N groups of n (a frame's pose, a
    point) that meet no other group: hessian (S, S), gradient (S,), own (N, n, n), own_gradient (N, n), cross (N, n, S).
    """

    hessian: Array
    gradient: Array
    own: Array
    own_gradient: Array
    cross: Array

    def reduced(self, damping: float = 0.0) -> Reduced:
        """Return the groups eliminated (Schur complement); damping is relative to the diagonal (at least 1).

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
    """The reduced system of the shared unknowns, hessian (S, S) and gradient (S,), and the groups' solution: factor
    (N, n, n) L of their matrices, and L^-1 of their gradient (N, n) and of cross (N, n, S)."""

    hessian: Array
    gradient: Array
    factor: Array
    own_gradient: Array
    cross: Array

    def step(self, free: NDArray[np.bool_] | None = None) -> Array | None:
        """Return (S,) the shared unknowns' step, 0 for those that are not free (S,); None when nothing holds them."""
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
        """Return (N, n) the groups' steps when the shared unknowns step by `shared` (S,)."""
        pull = self.own_gradient + np.einsum("kns,s->kn", self.cross, shared)
        return np.linalg.solve(np.swapaxes(self.factor, 1, 2), -pull[..., None])[..., 0]


def solve_coupled(own: ArrayLike, bands: ArrayLike, right: ArrayLike) -> Array | None:
    """x (T, D) with M x = right (T, D), in time linear in T; None when M is not positive definite.

    own (T, D, D): the frames' symmetric blocks.
    bands (3, T, D): diagonal weights of every frame with itself and with the frames one and two later (what would reach
        beyond the last frame is ignored).
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
    """Return (T, D, D) the diagonal blocks of the inverse of the same matrix; None when it is not positive definite.

    When own holds each frame's information and bands couple them, these are the covariances of the frames: one of which
    nothing is known is known through its neighbours alone, the less the farther those are.
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
    """Of pairs of frames: the inverse of the rest of their block (2 D, 2 D) after all before them are eliminated,
    and what joins them to the next pair (P, 2 D, 2 D); None: not positive definite.

    Pairs, because a frame is coupled to the next two: so the matrix is block-tridiagonal. Blocks of this size are
    inverted by one thread; banded solvers use several, which takes a hundred times as long on a busy machine."""
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
    """a @ b of square matrices, in halves that are small enough for BLAS to use one thread."""
    return (np.ascontiguousarray(a).reshape(2, -1, len(a)) @ b).reshape(a.shape)


def _in_pairs(own: Array, bands: Array) -> tuple[Array, Array]:
    """Blocks (P, 2 D, 2 D) of two frames each, and what joins one to the next (P, 2 D, 2 D): of an odd number of frames
    the last one has a neighbour that is joined to nothing."""
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

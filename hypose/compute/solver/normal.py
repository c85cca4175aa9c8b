"""Steps of least squares from their normal equations: the same on every machine and for any number of threads.

LAPACK behind numpy and scipy is as fast for matrices of this size, but adds up in an order that depends on its threads,
which moreover get into each other's way on a busy machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native, plain

Array = NDArray[np.float64]


def weighted_squares(jacobian: ArrayLike, weight: ArrayLike, residual: ArrayLike) -> tuple[Array, Array]:
    """J^T w J (D, D) and J^T w r (D,) of rows: jacobian (R, D), weight (R,), residual (R,)."""
    j, w, r = (plain(x, np.float64) for x in (jacobian, weight, residual))
    hessian, gradient = np.zeros((j.shape[1], j.shape[1])), np.zeros(j.shape[1])
    native("solver.normal").weighted_squares(j, w, r, hessian, gradient)
    return hessian, gradient


def bounded_step(
    hessian: ArrayLike, gradient: ArrayLike, at: ArrayLike, lower: ArrayLike, upper: ArrayLike, damping: float
) -> Array | None:
    """The step (D,) from `at` that minimises 1/2 s' (H + damping max(diag H, 1)) s + g' s within lower <= at + s <=
    upper; None when the matrix is not positive definite."""
    h, g, q, low, high = (plain(x, np.float64) for x in (hessian, gradient, at, lower, upper))
    step = np.empty(len(q))
    found = native("solver.solver").bounded_step(h, g, q, low, high, float(damping), step)
    return step if found else None


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
        """The groups eliminated; damping is relative to the diagonal (at least 1)."""
        hessian, own = self.hessian.copy(), self.own.copy()
        diagonal = np.einsum("kii->ki", own)  # a view
        diagonal += damping * np.maximum(diagonal, 1.0)
        found = Reduced(hessian, self.gradient.copy(), own, self.own_gradient.copy(), np.array(self.cross, order="C"))
        native("solver.normal").eliminate(found.factor, found.own_gradient, found.cross, hessian, found.gradient)
        hessian[np.diag_indices_from(hessian)] += damping * np.maximum(hessian.diagonal(), 1.0)
        return found


@dataclass(frozen=True)
class Reduced:
    """What is left for the shared unknowns, hessian (S, S) and gradient (S,), and what gives the groups back."""

    hessian: Array
    gradient: Array
    factor: Array
    own_gradient: Array
    cross: Array

    def step(self, free: NDArray[np.bool_] | None = None) -> Array | None:
        """(S,) the shared unknowns' step, 0 for those that are not free (S,); None when nothing holds them."""
        use = np.ones(len(self.gradient), np.bool_) if free is None else free
        x, part = np.zeros(len(use)), -self.gradient[use]
        if not native("solver.normal").solve_scaled(np.ascontiguousarray(self.hessian[np.ix_(use, use)]), part):
            return None
        x[use] = part
        return x

    def own_steps(self, shared: Array) -> Array:
        """(N, n) the groups' steps when the shared unknowns step by `shared` (S,)."""
        out = np.empty_like(self.own_gradient)
        native("solver.normal").substitute(self.factor, self.own_gradient, self.cross, plain(shared, np.float64), out)
        return out

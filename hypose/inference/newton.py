"""Bounded damped Newton on any cost: Newton with the full Hessian, Gauss-Newton with the approximate one.

The step solves the damped quadratic model within the box by an active set: coordinates on a bound that the
gradient pushes outwards are pinned, those that a step would carry across are stopped at the bound and the
rest solved again. Source: Sminchisescu & Triggs 2001, section 4.1, (H + lambda W) step = -gradient with
joint limits as hard constraints; damping rule after Marquardt 1963, W the diagonal of |H|.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from hypose.errors import SolverError
from hypose.inference.hypotheses import FloatArray
from hypose.inference.robust import Quadratic, Robust

Cost = Callable[[FloatArray], tuple[float, FloatArray, FloatArray]]
Residuals = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class Minimum:
    """Where a search ended: x (D,), its cost, gradient (D,) and Hessian (D, D); active (D,) True where a
    bound holds it.

    reason: 'gradient' (stationary), 'cost' (no step would lower the cost noticeably), 'step' (steps below
    resolution), 'stalled' (no step is accepted any more), 'iterations'. converged is True for the first
    three.
    """

    x: FloatArray
    cost: float
    gradient: FloatArray
    hessian: FloatArray
    active: NDArray[np.bool_]
    iterations: int
    converged: bool
    reason: str


def minimise(
    cost: Cost,
    start: ArrayLike,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    *,
    max_iterations: int = 100,
    gradient_tolerance: float = 1e-10,
    cost_tolerance: float = 1e-12,
    step_tolerance: float = 1e-10,
    damping: float = 1e-3,
) -> Minimum:
    """The local minimum of a cost over the box lower <= x <= upper, from a start (D,) (clamped into the
    box).

    cost(x) returns (value, gradient (D,), symmetric Hessian (D, D)); the Hessian may be indefinite or
    approximate. A trial point with anything non-finite is refused and the damping raised, so the result is
    never worse than the start. gradient_tolerance bounds the free gradient in units of the cost: max |g_i|
    / sqrt(H_ii), relative to sqrt(1 + cost). Raises SolverError when the cost at the start is not finite,
    shapes disagree, or a lower bound is above its upper.
    """
    x = np.array(start, dtype=np.float64)
    low, high = _bounds(lower, upper, x)
    x = np.clip(x, low, high)
    value, gradient, hessian = _checked_start(cost, x)

    for iteration in range(max_iterations + 1):
        pinned = _pinned(x, gradient, low, high)
        scaling = _scaling(hessian)
        slope = np.max(np.abs(gradient[~pinned]) / np.sqrt(scaling[~pinned]), initial=0.0)
        if slope <= gradient_tolerance * np.sqrt(1.0 + abs(value)):
            return Minimum(x, value, gradient, hessian, pinned, iteration, True, "gradient")
        if iteration == max_iterations:
            break
        reason, accepted, growth = "", None, 2.0
        while accepted is None and not reason:
            step = _bounded_step(x, gradient, hessian, damping * scaling, pinned, low, high)
            if step is not None:
                target = np.clip(x + step, low, high)
                predicted = -float(gradient @ step + 0.5 * step @ hessian @ step)
                trial = _evaluate(cost, target)
                gain = value - trial[0] if trial is not None else -np.inf
                accepted = trial if gain > 0 else None
                if max(abs(predicted), abs(gain)) <= cost_tolerance * abs(value):
                    reason = "cost"
                elif np.all(np.abs(step) <= step_tolerance * (step_tolerance + np.abs(x))):
                    reason = "step"
                if accepted is not None:
                    ratio = gain / predicted if predicted > 0 else 0.5
                    damping = max(damping * max(1 / 9, 1 - (2 * min(ratio, 1.0) - 1) ** 3), 1e-12)
                    x = target
            if accepted is None:
                # a step shrunk by heavy damping says nothing about being at a minimum
                reason = "stalled" if damping > 1e3 and (reason or damping > 1e18) else reason
                damping, growth = max(damping, 1e-6) * growth, 2 * growth
        if accepted is not None:
            value, gradient, hessian = accepted
        if reason:
            pinned = _pinned(x, gradient, low, high)
            return Minimum(x, value, gradient, hessian, pinned, iteration + 1, reason != "stalled", reason)
    pinned = _pinned(x, gradient, low, high)
    return Minimum(x, value, gradient, hessian, pinned, max_iterations, False, "iterations")


def least_squares(residuals: Residuals, robust: Robust | None = None) -> Cost:
    """A cost for ``minimise`` out of residuals: sum rho(r_i), gradient J^T (w r), Gauss-Newton Hessian J^T
    diag(w) J.

    residuals(x) returns r (M,) and its Jacobian J (M, D). The weights w = rho'(r) / r stand in for rho''
    (reweighted least squares), which keeps the Hessian positive where outliers would make it negative.
    """
    loss = Quadratic() if robust is None else robust

    def cost(x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        r, jacobian = residuals(x)
        weight = loss.weight(r)
        # einsum, not @: a threaded BLAS adds up in an order that depends on the number of threads
        weighted = weight[:, None] * jacobian
        gradient, hessian = np.einsum("md,m->d", weighted, r), np.einsum("md,me->de", weighted, jacobian)
        return float(np.sum(loss.rho(r))), gradient, hessian

    return cost


def _bounds(lower: ArrayLike | None, upper: ArrayLike | None, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    if x.ndim != 1 or x.size == 0:
        raise SolverError(f"a search starts from a vector of at least one unknown, got the shape {x.shape}")
    try:
        low = np.broadcast_to(np.asarray(-np.inf if lower is None else lower, np.float64), x.shape)
        high = np.broadcast_to(np.asarray(np.inf if upper is None else upper, np.float64), x.shape)
    except ValueError as problem:
        raise SolverError(f"the bounds must have the shape of the start, {x.shape}; check their length") from problem
    wrong = np.flatnonzero(~(low <= high))
    if wrong.size:
        i = int(wrong[0])
        raise SolverError(f"the bounds of unknown {i} leave no room: {low[i]} to {high[i]}; give lower <= upper")
    return low, high


def _checked_start(cost: Cost, x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    if not np.all(np.isfinite(x)):
        raise SolverError(f"the search cannot start: unknown {int(np.flatnonzero(~np.isfinite(x))[0])} is not finite")
    value, gradient, hessian = cost(x)
    if not np.isfinite(value):
        raise SolverError(f"the search cannot start: the cost there is {value}; choose another start")
    gradient, hessian = np.asarray(gradient, np.float64), np.asarray(hessian, np.float64)
    if gradient.shape != x.shape or hessian.shape != (x.size, x.size):
        raise SolverError(
            f"{x.size} unknowns need a gradient {x.shape} and a Hessian {(x.size, x.size)}, "
            f"the cost returned {gradient.shape} and {hessian.shape}"
        )
    if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(hessian))):
        raise SolverError("the search cannot start: the gradient or Hessian there is not finite; choose another start")
    return float(value), gradient, hessian


def _evaluate(cost: Cost, x: FloatArray) -> tuple[float, FloatArray, FloatArray] | None:
    """The cost at a trial point, None where it cannot be used."""
    value, gradient, hessian = cost(x)
    if np.isfinite(value) and np.all(np.isfinite(gradient)) and np.all(np.isfinite(hessian)):
        return float(value), np.asarray(gradient, np.float64), np.asarray(hessian, np.float64)
    return None


def _pinned(x: FloatArray, gradient: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """Coordinates that a bound holds: descent would leave the box."""
    return ((x <= low) & (gradient >= 0)) | ((x >= high) & (gradient <= 0))


def _scaling(hessian: FloatArray) -> FloatArray:
    """Positive curvature per coordinate; one that the cost ignores gets a small share of the largest."""
    diagonal = np.abs(np.diagonal(hessian))
    return np.maximum(diagonal, max(1e-8 * float(diagonal.max()), 1e-30))


def _bounded_step(
    x: FloatArray,
    gradient: FloatArray,
    hessian: FloatArray,
    damping: FloatArray,
    pinned: NDArray[np.bool_],
    low: FloatArray,
    high: FloatArray,
) -> FloatArray | None:
    """The minimum of the damped model within the box (D,), or None where the damped Hessian is not positive
    definite.

    Coordinates that would cross a bound are stopped there and the rest is solved again, at most D times.
    This need not be the exact minimum of the boxed model; the caller's damping makes it one of descent
    where it is not.
    """
    damped = hessian + np.diag(damping)
    step = np.zeros_like(x)
    free = ~pinned
    while free.any():
        right = -(gradient[free] + damped[np.ix_(free, ~free)] @ step[~free])
        try:
            step[free] = cho_solve(cho_factor(damped[np.ix_(free, free)]), right)
        except LinAlgError:
            return None
        outside = free & ((x + step < low) | (x + step > high))
        if not outside.any():
            return step
        step[outside] = np.clip(x + step, low, high)[outside] - x[outside]
        free &= ~outside
    return step

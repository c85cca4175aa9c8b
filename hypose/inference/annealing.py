"""Turn energies into weights, and choose how strongly a layer selects (the annealing rate beta).

Two choices of beta are offered: a fixed exponent, as in the papers, and the exponent at which a set share of the
hypotheses survives (default).
Why: energies of silhouettes are so flat (the effective sample size is 97 % of N) that a fixed exponent beta <= 1 hardly
selects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses

Energy = Callable[[Hypotheses, Any], ArrayLike]
"""Function (hypotheses, frame) that computes the cost (*B, N) of each hypothesis in a frame: dimensionless, low is
good; a non-finite cost means a failed measurement."""


def solve_annealing_rate(energies: ArrayLike, target: float, iterations: int = 56) -> FloatArray:
    """Solve for the exponent beta at which the survival rate equals a target, by bisection in log beta.

    energies: (*B, N) costs of the hypotheses.
    target: wanted survival rate, 0..1.
    iterations: number of bisections.
    Returns: (*B,) exponents, always finite. Where the target is above the reachable rates: 0. Where it is below them: a
        beta at which only the hypotheses tied at the minimum survive. Where all energies are equal: 1, because every
        beta does the same.

    The rate falls from the share of finite energies (beta = 0) to the share tied at the minimum (beta -> infinity).
    """
    excess, usable = _excess(np.asarray(energies, np.float64))
    positive = usable & (excess > 0)
    smallest = np.where(positive, excess, np.inf).min(axis=-1)
    largest = np.where(positive, excess, 0.0).max(axis=-1)
    flat = ~positive.any(axis=-1)
    # from nothing selected (largest exponent 1e-7) to all but the ties at weight 0 (smallest exponent 800)
    low = np.log(1e-7) - np.log(np.where(flat, 1.0, largest))
    high = np.minimum(np.log(800.0) - np.log(np.where(flat, 1.0, smallest)), 700.0)
    wanted = target * excess.shape[-1]
    away = np.where(usable, -excess, -np.inf)
    for _ in range(iterations):
        middle = 0.5 * (low + high)
        with np.errstate(over="ignore"):
            weights = np.exp(np.exp(middle)[..., None] * away)
        total = weights.sum(axis=-1)
        # a set without any usable energy has total 0, and any answer will do
        selects_too_little = total * total > wanted * np.einsum("...n,...n->...", weights, weights)
        low, high = np.where(selects_too_little, middle, low), np.where(selects_too_little, high, middle)
    unreachable = usable.mean(axis=-1) <= target
    return np.where(flat, 1.0, np.where(unreachable, 0.0, np.exp(0.5 * (low + high))))


@dataclass(frozen=True)
class SmoothedWeight:
    """Weighing function that turns an energy E into log-weights -beta (E - min E).

    energy: cost of each hypothesis; non-finite costs get weight 0 (log-weight -inf).
    survival: share of the set that survives, for which beta is solved (Deutscher & Reid 2005).
    beta: fixed exponent, as in the papers; None: that of the survival rate.
    Raises: ValueError where the survival rate is not in (0, 1].
    Source: Alcoverro 2014, eqs. (2.8) and (2.9).
    Why: the minimum is subtracted because weights count only up to a factor, and a large beta would otherwise remove
    the digits in which energies differ.
    """

    energy: Energy
    survival: float = 0.15
    beta: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.survival <= 1:
            raise ValueError(f"a survival rate lies in (0, 1], got {self.survival}")

    def __call__(self, h: Hypotheses, frame: Any, /) -> FloatArray:
        """Compute the log-weights (*B, N), at most 0."""
        energies = np.asarray(self.energy(h, frame), dtype=np.float64)
        fixed = self.beta is not None
        beta = np.full(energies.shape[:-1], self.beta) if fixed else solve_annealing_rate(energies, self.survival)
        excess, usable = _excess(energies)
        return np.where(usable, -beta[..., None] * excess, -np.inf)


def _excess(energies: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Subtract the minimum of each set from its energies (0 where not finite), and mark the finite ones."""
    usable = np.isfinite(energies)
    minimum = np.where(usable, energies, np.inf).min(axis=-1, keepdims=True)
    base = np.where(np.isfinite(minimum), minimum, 0.0)
    with np.errstate(over="ignore"):
        return np.minimum(np.where(usable, energies, base) - base, 1e300), usable

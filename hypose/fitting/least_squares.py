"""The one loop of damped Gauss-Newton (Levenberg-Marquardt) above the compiled ones of single frames.

A problem says what a state costs, what its normal equations are, and which step they propose; the loop decides how far
to trust them. Steps come from `compute`: bounded and dense, Schur complement of shared unknowns, banded clips.
Source: Levenberg 1944, Marquardt 1963; damping relative to the diagonal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from hypose.errors import SolverError

State = TypeVar("State")
Equations = TypeVar("Equations")


@dataclass(frozen=True)
class Rule:
    """How a descent is damped and when it ends.

    damping: at the start; harder, easier: factors after a refused and a taken step; least, most: its bounds; tries: of
    one iteration; slack: a step may raise the cost by this factor (contour costs jump when the outline changes); moved:
    it ends with a step that moves less; gain: or lowers the cost by a smaller share."""

    damping: float = 1e-2
    harder: float = 6.0
    easier: float = 4.0
    least: float = 1e-4
    most: float = 1e4
    tries: int = 4
    slack: float = 1.0
    moved: float = 0.0
    gain: float = 0.0


@dataclass(frozen=True)
class Descent(Generic[State, Equations]):
    """Where a descent ended: state, its cost and equations, the damping there, iterations, evaluations of the cost, and
    whether it converged (it did not run out of iterations)."""

    state: State
    cost: float
    equations: Equations
    damping: float
    iterations: int
    evaluations: int
    converged: bool


def descend(
    start: State,
    evaluate: Callable[[State], tuple[float, Callable[[], Equations]]],
    propose: Callable[[State, Equations, float], tuple[State, float] | None],
    iterations: int,
    rule: Rule | None = None,
) -> Descent[State, Equations]:
    """Descends from a state.

    evaluate(state): its cost, and a function that makes its equations, called where they are needed. propose(state,
    equations, damping): another state and how far that is in the units of rule.moved, or None when the equations are
    not positive definite. A SolverError when the cost at the start is not finite."""
    rule = rule or Rule()
    state, (cost, make) = start, evaluate(start)
    if not math.isfinite(cost):
        raise SolverError("The cost at the start is not finite; check the start and the evidence for NaN.")
    equations, damping, evaluations, converged, n = make(), rule.damping, 1, False, 0
    while n < iterations and not converged:
        n += 1
        moved, gain, accepted = math.inf, math.inf, False
        for _ in range(rule.tries):
            proposed = propose(state, equations, damping)
            if proposed is not None:
                trial, moved = proposed
                new, make = evaluate(trial)
                evaluations += 1
                if math.isfinite(new) and new < cost * rule.slack:
                    accepted, gain = True, abs(cost - new) / max(cost, 1e-300)
                    state, cost, equations = trial, new, make()
                    damping = max(damping / rule.easier, rule.least)
                    break
                if moved < rule.moved:
                    break
            damping = min(damping * rule.harder, rule.most)
        converged = not accepted or moved < rule.moved or gain < rule.gain
    return Descent(state, cost, equations, damping, n, evaluations, converged)

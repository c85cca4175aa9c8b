"""Rows of one's own: any residual of points on the body, from a Python function, in the solver beside all other cues.

A user says what is measured of points in the world; the derivative by the pose is the solver's affair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose import compute
from hypose.compute import TreeArrays, bounded_step, lorentzian
from hypose.errors import InputError
from hypose.fitting.problem import Problem, Rule
from hypose.geometry import Array

LARGEST_TURN = 0.35
"""rad: steps that turn a joint further are shortened, as in the compiled solve"""
Residuals = Callable[[Array], tuple[ArrayLike, ArrayLike]]


@dataclass(frozen=True)
class RowTerm:
    """Residuals of points of one frame. Cauchy (Lorentzian) cost of each point's residuals together, 2 w log(1 +
    |r|^2 / 4) with r in standard deviations, as for key points.

    joint (P,), offset (P, 3) m in the joint's frame (default: its centre); residuals(points (P, 3) m, world) returns
    r (P, R) in sd, and its derivative by the point (P, R, 3) in sd per m; weight (P,): factors on the points' costs, 0
    for one that is not seen (default 1)."""

    joint: NDArray[np.int64]
    residuals: Residuals
    offset: Array | None = None
    weight: Array | None = None

    def __post_init__(self) -> None:
        n = np.shape(self.joint)
        given = np.shape(self.offset) if self.offset is not None else (*n, 3)
        weights = np.shape(self.weight) if self.weight is not None else n
        if len(n) != 1 or given != (*n, 3) or weights != n:
            raise InputError(
                f"RowTerm needs joint (P,), offset (P, 3) and weight (P,), got {n}, {given} and {weights}."
            )


@dataclass(frozen=True)
class Sums:
    """Cost of rows, its gradient (D,) and Gauss-Newton matrix (D, D), and how many points there were."""

    cost: float
    gradient: Array
    hessian: Array
    count: int


def row_sums(pose: Array, tree: TreeArrays, rows: Sequence[RowTerm]) -> Sums:
    """Cost and derivatives of rows at a pose (D,). An InputError names residuals of the wrong shape."""
    rotations, centres = (x[0] for x in compute.forward_kinematics(pose[None], tree))
    cost, count = 0.0, 0
    gradient, hessian = np.zeros(len(pose)), np.zeros((len(pose), len(pose)))
    for term in rows:
        joint = np.asarray(term.joint, dtype=np.int64)
        offset = np.zeros((len(joint), 3)) if term.offset is None else np.asarray(term.offset, dtype=np.float64)
        points = centres[joint] + np.einsum("pab,pb->pa", rotations[joint], offset)
        r, slope = (np.asarray(x, dtype=np.float64) for x in term.residuals(points))
        if r.ndim != 2 or len(r) != len(joint) or slope.shape != (*r.shape, 3):
            raise InputError(
                f"The residuals of {len(joint)} points must have the shape (P, R) and their derivatives (P, R, 3), got "
                f"{r.shape} and {slope.shape}."
            )
        weight = np.ones(len(joint)) if term.weight is None else np.asarray(term.weight, dtype=np.float64)
        seen = (weight > 0) & np.isfinite(r).all(1) & np.isfinite(slope).all((1, 2))
        weight, r, slope = np.where(seen, weight, 0.0), np.where(seen[:, None], r, 0.0), slope.copy()
        slope[~seen] = 0.0
        rho, pull, _ = lorentzian(0.25 * (r**2).sum(1), weight)
        cost += 2 * float((weight * rho).sum())
        count += int(seen.sum())
        more = compute.row_sums(pose, tree, joint, offset, pull, r, slope)
        gradient += more[0]
        hessian += more[1]
    return Sums(cost, gradient, hessian, count)


class FrameProblem(Problem[Array, compute.Evaluation]):
    """The compiled solve's steps, one by one, for an evaluation that needs Python: evaluation(pose, coarse)."""

    def __init__(self, evaluation: Callable[[Array, bool], compute.Evaluation], lower: Array, upper: Array) -> None:
        self.evaluation, self.lower, self.upper, self.coarse = evaluation, lower, upper, False

    def evaluate(self, state: Array) -> tuple[float, Callable[[], compute.Evaluation]]:
        """Cost and equations at once."""
        e = self.evaluation(state, self.coarse)
        return e.cost, lambda: e

    def propose(self, state: Array, equations: compute.Evaluation, damping: float) -> tuple[Array, float] | None:
        """The bounded step, no joint turning further than LARGEST_TURN."""
        step = bounded_step(equations.hessian, equations.gradient, state, self.lower, self.upper, damping)
        if step is None:
            return None
        step *= min(1.0, LARGEST_TURN / max(float(np.abs(step[3:]).max()), 1e-9))
        moved = max(2 * float(np.abs(step[:3]).max()), float(np.abs(step[3:]).max()))
        return np.clip(state + step, self.lower, self.upper), moved

    def solution(self, start: Array, iterations: tuple[int, int], rule: Rule) -> compute.Solution:
        """Solve with so many coarse and fine iterations."""
        found, used, evaluations = None, 0, 0
        q = np.clip(start, self.lower, self.upper)
        for self.coarse, n in zip((True, False), iterations, strict=True):
            if n or not self.coarse:
                found = self.solve(q, n, rule)
                q, rule = found.state, replace(rule, damping=found.damping)
                used, evaluations = used + found.iterations, evaluations + found.evaluations
        assert found is not None
        return compute.Solution(q, found.equations, used, evaluations, found.converged)

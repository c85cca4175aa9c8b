"""Fit a pose to contours, key points and 3D points: bounded damped Gauss-Newton on robust rows.

Every cue is a sum of rows (point, direction, residual, weight, joint). Rows become 6 x 6 sums per joint that are folded
up the joint tree (hypose.compute.rows, hypose.compute.solver), so that a whole solve is one compiled call without the
GIL. The cost is F(q) = 1/2 sum of weighted robust squares + 1/2 sum of the priors' quadratics; gradient and
(Gauss-Newton) Hessian of the result are those of F. Where weights are inverse variances, the inverse Hessian is the
covariance of the pose.

Sources: two-way contour distances with a robust weight as in the silhouette trackers of Alcoverro 2014, chapter 4, and
    Gall et al. 2009; Geman & McClure 1985; the spatial (wrench) form of the sums follows Featherstone 2008, chapter 6.
Deviation: outlines are associated by the nearest point of the visible outline, not along normals.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.body import Body
from hypose.compute import solver
from hypose.compute.arrays import (
    NO_CONTOURS,
    NO_KEYPOINTS,
    NO_POINTS,
    Cues,
    DepthArrays,
    PointArrays,
    PriorArrays,
    SolveSettings,
    Workspace,
    plain,
    tidy,
)
from hypose.compute.linear import weighted_squares
from hypose.compute.losses import lorentzian
from hypose.compute.solver import Evaluation, Solution, bounded_step, solve, workspace
from hypose.compute.threads import in_threads
from hypose.errors import InputError, SolverError
from hypose.evidence.terms import ContourTerm, DepthTerm, KeypointTerm, PointTerm, RowTerm, Term, checked_joints
from hypose.fitting.problem import Problem, Quadratic, Rule
from hypose.geometry import Array, nearest_branch, so3_turns

LARGEST_TURN = 0.35
"""rad; steps that turn a joint further are shortened, as in the compiled solve."""


@dataclass(frozen=True)
class PoseFit:
    """Result of the solve of one pose.

    pose: (D,), the root's rotation vector on the branch of the start.
    solved: (D,) the same pose on the branch on which it was solved.
    cost: F, half the weighted sum of robust squared residuals, plus the priors.
    hessian: (D, D) Gauss-Newton Hessian of F in the coordinates of `solved`.
    gradient: (D,) of F in the same coordinates.
    iterations: number of iterations.
    converged: whether the last step was below the tolerance.
    rows: number of rows of evidence (0: only the priors determine the pose).
    """

    pose: Array
    solved: Array
    cost: float
    hessian: Array
    gradient: Array
    iterations: int
    converged: bool
    rows: int

    @cached_property
    def information(self) -> Array:
        """Inverse covariance (D, D) of the pose: the Hessian with the root's rotation as a small turn in the world,
        which is the same for every branch of its rotation vector.
        """
        return turned(self.hessian, so3_turns(self.solved[3:6]).T)


def turned(matrices: Array, turns: Array) -> Array:
    """Change the root's rotation in symmetric matrices (..., D, D) of poses to other coordinates.

    turns: (..., 3, 3) T of the root in T M T^T. `so3_turns` of its rotation vector, transposed, gives a Hessian by a
        small turn in the world; `so3_left_jacobian` gives the covariance of such a turn.
    Why: inverse covariances of poses are kept in this form, because one rotation has two rotation vectors but only one
        turn.
    """
    out = matrices.copy()
    out[..., 3:6, :] = turns @ out[..., 3:6, :]
    out[..., 3:6] = out[..., 3:6] @ np.swapaxes(turns, -1, -2)
    return out


def cues_of(body: Body, evidence: Sequence[Term]) -> tuple[Cues, tuple[RowTerm, ...]]:
    """Convert terms of evidence to the flat arrays of the compiled solve.

    Returns: the arrays; the terms whose residuals are Python functions, which the compiled solve cannot use.
    Raises: InputError where there are two terms of a kind that a frame has once, or a joint is not one of the
        body's.
    """
    once: dict[type[Term], Term] = {}
    for term in evidence:
        if isinstance(term, ContourTerm | KeypointTerm | DepthTerm) and once.setdefault(type(term), term) is not term:
            raise InputError(f"A frame has one {type(term).__name__} of all its views; combine the two.")
    contours, points, depth = (once.get(kind) for kind in (ContourTerm, KeypointTerm, DepthTerm))
    places = [term.arrays(body) for term in evidence if isinstance(term, PointTerm)]
    rows = tuple(term for term in evidence if isinstance(term, RowTerm))
    for term in rows:
        checked_joints(term, body)
    keypoints = NO_KEYPOINTS
    if isinstance(points, KeypointTerm):
        seen, cameras, offset = (plain(a, np.float64) for a in (points.points, points.projections, points.offset))
        scales = float(points.scale_px), float(points.min_confidence)
        keypoints = KeypointTerm(seen, cameras, checked_joints(points, body), offset, *scales)
    cues = Cues(
        tidy(contours) if isinstance(contours, ContourTerm) else NO_CONTOURS,
        keypoints,
        PointArrays._make(map(np.concatenate, zip(*places, strict=True))) if places else NO_POINTS,
        # without points a sensor says nothing
        DepthArrays(tidy(depth), *body.coarse.rings) if isinstance(depth, DepthTerm) and len(depth.points) else None,
    )
    return cues, rows


def fit_pose(
    body: Body,
    start: ArrayLike,
    evidence: Sequence[Term],
    *,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings | None = None,
) -> PoseFit:
    """Find the pose near a start that explains the evidence best, within the joint limits.

    body: the body.
    start: (D,) pose.
    evidence: terms of one frame.
    priors: quadratic costs on the pose.
    options: settings of the solve.
    Returns: the pose with cost, Hessian and counts.
    Raises: SolverError where the start has the wrong size or its cost is not finite.

    A step is accepted where its cost is finite and at most 0.2 % higher (contour costs jump when the outline changes);
    no joint turns more than 0.35 rad per step.
    """
    return fit_poses(body, [start], evidence, priors=priors, options=options)[0]


def fit_poses(
    body: Body,
    starts: Sequence[ArrayLike] | Array,
    evidence: Sequence[Term],
    *,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings | None = None,
) -> list[PoseFit]:
    """Fit poses from several starts (N, D) to the same evidence, in parallel threads; each fit is done as by
    `fit_pose`.

    priors: quadratic costs on the pose; options: settings of the solve.
    Returns: one result per start, the same for any number of threads.
    """
    cost, settings = PoseCost(body, evidence, priors), options or SolveSettings()
    return in_threads(lambda start: cost.fit(start, settings), list(starts))


_OWN = threading.local()


def workspace_for(body: Body, cues: Cues) -> Workspace:
    """Return this thread's scratch memory for fits of this body to images of this size.

    Why: allocating it and touching its pages takes as long as two evaluations.
    """
    (w, h), mesh, tree = cues.contours.sizes.max(0, initial=2), body.coarse.arrays, body.skeleton.tree
    known: Workspace | None = getattr(_OWN, "workspace", None)
    counts = len(mesh.vertices), len(mesh.faces), len(mesh.edges), len(tree.parents), len(tree.axes)
    if known is not None and known.difference.shape[0] > h and known.difference.shape[1] >= w:
        kept = known.vertices, known.front, known.start, known.centres, known.twists
        if counts == tuple(map(len, kept)):
            return known
    _OWN.workspace = made = workspace(tree, mesh, h, w)
    return made


class PoseCost:
    """Cost of a pose on the evidence of one frame and on priors, as flat arrays of the kernels, made once for any
    number of starts.
    """

    def __init__(self, body: Body, evidence: Sequence[Term], priors: Sequence[Quadratic]) -> None:
        self.body, (self.cues, self.rows) = body, cues_of(body, evidence)
        self.tree, self.mesh, s = body.skeleton.tree, body.coarse.arrays, body.skeleton
        self.centre = np.array([p.centre for p in priors], np.float64).reshape(-1, s.dof)
        self.weight = np.array([p.weight for p in priors], np.float64).reshape(-1, s.dof)
        self.lower, self.upper = (np.ascontiguousarray(x, dtype=np.float64) for x in (s.lower, s.upper))

    def evaluate(self, pose: Array, priors: PriorArrays, coarse: bool = False) -> Evaluation:
        """Compute cost and derivatives at a pose (D,); priors: as `priors` returns them near the pose."""
        ws = workspace_for(self.body, self.cues)
        known = solver.evaluate(pose, self.tree, self.mesh, self.cues, priors, ws, coarse=coarse)
        return with_rows(known, pose, self.body, self.rows) if self.rows else known

    def start(self, start: ArrayLike) -> Array:
        """Check a start pose, and move its root's rotation vector inside +-pi, where the exponential map is far from
        singular.
        """
        q = np.array(start, dtype=np.float64)
        if q.shape != (self.body.skeleton.dof,):
            raise SolverError(f"A start pose of this body has {self.body.skeleton.dof} numbers, got shape {q.shape}.")
        if not np.isfinite(q).all():
            bad = self.body.skeleton.dof_names[int(np.argmin(np.isfinite(q)))]
            raise SolverError(f"The start pose is not finite in {bad}; start from another pose.")
        q[3:6] = nearest_branch(q[3:6], np.zeros(3))
        return q

    def priors(self, start: Array) -> PriorArrays:
        """Return the priors with their centres on the branch nearest to a start pose (D,)."""
        centre = self.centre.copy()
        centre[:, 3:6] = nearest_branch(centre[:, 3:6], start[3:6])
        return PriorArrays(centre, self.weight, self.lower, self.upper)

    def fit(self, start: ArrayLike, settings: SolveSettings) -> PoseFit:
        """Solve from a start pose (D,), compiled, or step by step where a term needs Python; the result is on the
        branch of the start.
        """
        q = self.start(start)
        priors = self.priors(q)
        if self.rows:
            out = FrameProblem(self, priors).solution(q, settings)
        else:
            ws = workspace_for(self.body, self.cues)
            out = solve(q, self.tree, self.mesh, self.cues, priors, settings, ws)
        pose, e = out.pose.copy(), out.evaluation
        pose[3:6] = nearest_branch(pose[3:6], np.asarray(start, dtype=np.float64)[3:6])
        counts = int(e.counts.sum())
        return PoseFit(pose, out.pose, e.cost, e.hessian, e.gradient, out.iterations, out.converged, counts)


def with_rows(known: Evaluation, pose: Array, body: Body, rows: Sequence[RowTerm]) -> Evaluation:
    """Add the cost and derivatives of row terms to an evaluation.

    known: evaluation of the other evidence at the pose.
    pose: (D,) pose vector, rad and m.
    rows: the row terms.
    Returns: the new evaluation; its counts get one more line with the number of points.
    Raises: InputError where residuals have the wrong shape.
    """
    twists, moves = body.skeleton.world_twists(pose), body.skeleton.moves
    cost, gradient, hessian, count = known.cost, known.gradient.copy(), known.hessian.copy(), 0
    for term in rows:
        joint = np.asarray(term.joint, dtype=np.int64)
        offset = np.zeros((len(joint), 3)) if term.offset is None else np.asarray(term.offset, dtype=np.float64)
        points = body.skeleton.points(joint, offset, pose)
        r, slope = (np.asarray(x, dtype=np.float64) for x in term.residuals(points))
        if r.ndim != 2 or len(r) != len(joint) or slope.shape != (*r.shape, 3):
            raise InputError(
                f"The residuals of {len(joint)} points must have the shape (P, R) and their derivatives (P, R, 3), got "
                f"{r.shape} and {slope.shape}."
            )
        weight = np.ones(len(joint)) if term.weight is None else np.asarray(term.weight, dtype=np.float64)
        seen = (weight > 0) & np.isfinite(r).all(1) & np.isfinite(slope).all((1, 2))
        joint, (weight, r, slope, points) = joint[seen], (x[seen] for x in (weight, r, slope, points))
        rho, pull, _ = lorentzian(0.25 * (r**2).sum(1), weight)
        wrench = np.concatenate([np.cross(points[:, None], slope), slope], -1)
        jacobian = ((wrench @ twists.T) * moves.T[joint][:, None]).reshape(-1, len(pose))
        more = weighted_squares(jacobian, np.repeat(pull, r.shape[1]), r.ravel())
        cost += 2 * float((weight * rho).sum())
        count += len(joint)
        hessian += more[0]
        gradient += more[1]
    return Evaluation(cost, gradient, hessian, np.concatenate([known.counts, [[count, 0]]]))


class FrameProblem(Problem[Array, Evaluation]):
    """Least-squares problem of one frame's pose for evidence whose residuals are Python functions; the steps are
    those of the compiled solve.

    cost: the cost of the pose; priors: on the branch of the start.
    """

    def __init__(self, cost: PoseCost, priors: PriorArrays) -> None:
        self.cost, self.priors, self.coarse = cost, priors, False

    def evaluate(self, state: Array) -> tuple[float, Callable[[], Evaluation]]:
        """Compute the cost of a pose, and a function that returns its gradient and Hessian (here already computed)."""
        e = self.cost.evaluate(state, self.priors, self.coarse)
        return e.cost, lambda: e

    def propose(self, state: Array, equations: Evaluation, damping: float) -> tuple[Array, float] | None:
        """Compute the bounded step from a state, in which no joint turns further than LARGEST_TURN; see `Problem`.

        equations: cost and derivatives at the state; damping: relative to the diagonal of the Hessian.
        """
        lower, upper = self.cost.lower, self.cost.upper
        step = bounded_step(equations.hessian, equations.gradient, state, lower, upper, damping)
        if step is None:
            return None
        step *= min(1.0, LARGEST_TURN / max(float(np.abs(step[3:]).max()), 1e-9))
        moved = max(2 * float(np.abs(step[:3]).max()), float(np.abs(step[3:]).max()))
        return np.clip(state + step, lower, upper), moved

    def solution(self, start: Array, settings: SolveSettings) -> Solution:
        """Solve from a start pose (D,), first with the coarse and then with the fine scale."""
        found, used, o = None, 0, settings
        coarse = min(o.coarse_iterations, o.iterations) if len(self.cost.cues.contours.sdf) else 0
        q, rule = np.clip(start, self.cost.lower, self.cost.upper), Rule(o.damping, slack=1.002, moved=o.tolerance)
        for self.coarse, n in ((True, coarse), (False, o.iterations - coarse)):
            if n or not self.coarse:
                found = self.solve(q, n, rule)
                q, rule = found.state, replace(rule, damping=found.damping)
                used += found.iterations
        assert found is not None
        return Solution(q, found.equations, used, found.converged)

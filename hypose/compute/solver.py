"""Solve the pose of one frame by bounded damped Gauss-Newton on an articulated body."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import (
    RIM,
    Cues,
    MeshArrays,
    PriorArrays,
    SolveSettings,
    TreeArrays,
    Workspace,
    plain,
)
from hypose.compute.compiled import kernel
from hypose.compute.contours import contour_rows
from hypose.compute.coverage import VIEWS, contours_of_any, front_views, project_views, row_stride
from hypose.compute.depth_rows import depth_rows
from hypose.compute.kinematics import joint_frames, skin_about_root
from hypose.compute.rows import form_rows, keypoint_rows, point_rows, sum_rows
from hypose.errors import SolverError
from hypose.geometry import Array

_LARGEST_TURN = 0.35
"""rad; steps that turn a joint further are shortened."""
ACCEPT = 1.002
"""A step may raise the cost by this factor, because contour costs jump when the outline changes."""
_ROWS, _VIEWS, _FORMED = 0, 1, 2


@kernel
def fold(tree, twists, wrench_hessian, wrench_gradient, hessian, gradient):
    """Convert the normal equations per joint to the gradient (D,) and Gauss-Newton matrix (D, D) of a pose.

    tree: joint tree of the body.
    twists: (D, 6) motion of the body per unit of each dof, as `joint_frames` fills it.
    hessian, gradient: get the results.
    wrench_hessian, wrench_gradient: (J, 21) and (J, 6) sums per joint.

    Sums are folded from child to parent; then H_de = S_d . B_j S_e for each dof d of joint j and each dof e of j and
    its ancestors.
    """
    n_joints, n_dof = tree.parents.shape[0], twists.shape[0]
    block = np.empty((n_joints, 6, 6))
    pull = np.empty((n_joints, 6))
    for j in range(n_joints):
        k = 0
        for r in range(6):
            pull[j, r] = wrench_gradient[j, r]
            for c in range(r + 1):
                block[j, r, c] = wrench_hessian[j, k]
                block[j, c, r] = wrench_hessian[j, k]
                k += 1
    for j in range(n_joints - 1, 0, -1):
        a = tree.parents[j]
        for r in range(6):
            pull[a, r] += pull[j, r]
            for c in range(6):
                block[a, r, c] += block[j, r, c]
    hessian[:] = 0.0
    force = np.empty(6)
    for d in range(n_dof):
        j = tree.joint_of_dof[d]
        s = 0.0
        for r in range(6):
            s += twists[d, r] * pull[j, r]
            f = 0.0
            for c in range(6):
                f += block[j, r, c] * twists[d, c]
            force[r] = f
        gradient[d] = s
        a = j
        while a >= 0:
            first, last = tree.dof_start[a], tree.dof_start[a] + tree.dof_count[a]
            if a == 0:
                first = 0  # the root's three translations too
            for e in range(first, last):
                s = 0.0
                for r in range(6):
                    s += twists[e, r] * force[r]
                hessian[d, e] = s
                hessian[e, d] = s
            a = tree.parents[a]


@kernel
def bounded_step_kernel(hessian, gradient, q, lower, upper, damping, step):
    """Minimise 1/2 s'(H + damping D)s + g's subject to lower <= q + s <= upper, into step.

    hessian, gradient: H (D, D) and g (D,); D here is the damping's diagonal, max(diag H, 1).
    q, lower, upper: (D,) the point and its bounds.
    step: (D,) gets s.
    Returns: False where the matrix is not finite and positive.

    An active set that only grows is used (at most six rounds; then values still outside are clipped).
    """
    n_dof = q.shape[0]
    free = np.empty(n_dof, np.int64)
    fixed = np.zeros(n_dof, np.uint8)
    for d in range(n_dof):
        step[d] = 0.0
        if (q[d] <= lower[d] + 1e-9 and gradient[d] > 0) or (q[d] >= upper[d] - 1e-9 and gradient[d] < 0):
            fixed[d] = 1
    for _ in range(6):
        n = 0
        for d in range(n_dof):
            if not fixed[d]:
                free[n] = d
                n += 1
        a, x, sound = np.empty((n, n)), np.empty(n), True
        for i in range(n):
            d = free[i]
            s = -gradient[d]
            for e in range(n_dof):
                if fixed[e]:
                    s -= hessian[d, e] * step[e]
            x[i] = s
            for j in range(n):
                a[i, j] = hessian[d, free[j]]
            a[i, i] += damping * max(hessian[d, d], 1.0)
            sound &= a[i, i] > 0 and math.isfinite(a[i].sum() + s)
        if not sound:
            return False
        x = np.linalg.solve(a, x)
        outside = 0
        for i in range(n):
            d = free[i]
            step[d] = x[i]
            if q[d] + x[i] > upper[d]:
                step[d] = upper[d] - q[d]
                fixed[d] = 1
                outside += 1
            elif q[d] + x[i] < lower[d]:
                step[d] = lower[d] - q[d]
                fixed[d] = 1
                outside += 1
        if outside == 0:
            break
    return True


def bounded_step(
    hessian: ArrayLike, gradient: ArrayLike, at: ArrayLike, lower: ArrayLike, upper: ArrayLike, damping: float
) -> Array | None:
    """Compute the step (D,) from `at` that minimises 1/2 s' (H + damping max(diag H, 1)) s + g' s within lower <= at +
    s <= upper.

    hessian, gradient: H (D, D) and g (D,).
    lower, upper: (D,) bounds.
    damping: factor of the diagonal that is added to H.
    Returns: step (D,); None where the matrix is not positive definite.
    """
    h, g, q, low, high = (plain(x, np.float64) for x in (hessian, gradient, at, lower, upper))
    step = np.empty(len(q))
    try:
        return step if bounded_step_kernel(h, g, q, low, high, float(damping), step) else None
    except np.linalg.LinAlgError:  # singular
        return None


@kernel
def form_found(found_of, mesh, ws):
    """Make a row (residual with its derivatives) of each found contour point that has none yet.

    found_of: state that `cost_at` fills.

    mesh, ws: mesh of the body, and scratch memory with the found points.
    """
    cameras, first, state = found_of
    for c in range(state[_FORMED], state[_VIEWS]):
        n_rows, n_points = state[_ROWS], first[c + 1] - first[c]
        if n_rows + 2 * mesh.skin_index.shape[1] * n_points > ws.rows.shape[0]:
            sum_rows(n_rows, ws.rows, ws.row_joints, ws.lanes, ws.place, ws.wrench_hessian, ws.wrench_gradient)
            n_rows = 0
        ends, found, p = ws.ends, ws.found, cameras[c]
        state[_ROWS] = form_rows(
            *(first[c], first[c + 1], ends, found, ws.work, n_rows, ws.vertices, mesh, p, ws.rows, ws.row_joints)
        )
    state[_FORMED] = state[_VIEWS]


@kernel
def cost_at(q, tree, mesh, contours, scale, keypoints, points, depth, priors, ws, found_of, counts):
    """Compute the cost of all evidence and priors at pose q (D,).

    tree, mesh: joint tree and mesh of the body.
    contours, keypoints, points, priors: evidence and priors (ContourTerm, KeypointTerm, PointArrays,
        PriorArrays).
    scale: robust scale of the contours, px.
    ws: scratch memory.
    depth: DepthArrays; None: no depth, compiled separately without the code for depth.
    counts: (C + 3, 2) gets forward and reverse rows of each view, then the key points, the points, and those of
        depth.
    found_of: gets what waits in the workspace for `normal_equations`: cameras (C + VIEWS, 3, 4) f4 about the root,
        first (C + 1,) found point of each view, and state (3,): rows, views computed, views whose rows are made.
    """
    cameras, first, state = found_of
    joint_frames(q, tree, ws.rotations, ws.centres, ws.twists)
    ws.wrench_hessian[:] = 0.0
    ws.wrench_gradient[:] = 0.0
    n_views = contours.sdf.shape[0]
    counts[n_views:] = 0
    cost, n_found, n_union = 0.0, 0, 0
    state[:] = 0
    first[0] = 0
    if n_views > 0 or depth is not None:
        skin_about_root(ws.rotations, ws.centres, tree, mesh, ws.vertices)
    for c in range(n_views):
        k = c % VIEWS
        if k == 0:
            p = cameras[c : c + VIEWS]
            project_views(ws.vertices, contours.projections, c, q, p, ws.turned, ws.uv, ws.bounds)
            front_views(mesh.faces, ws.uv, ws.front)
            n_union = contours_of_any(mesh.edges, ws.front, ws.union)
        counts[c, 0] = 0
        counts[c, 1] = 0
        if contours.usable[c]:
            if n_found + RIM + contours.outline.shape[1] > ws.found.shape[1]:
                form_found(found_of, mesh, ws)
                n_found = 0
                first[c] = 0
            view_cost, n_found = contour_rows(c, k, n_union, ws.bounds, mesh, contours, scale, ws, n_found, counts[c])
            cost += view_cost
        first[c + 1] = n_found
        state[_VIEWS] = c + 1
    cost += keypoint_rows(
        q, keypoints, ws.rotations, ws.centres, ws.wrench_hessian, ws.wrench_gradient, counts[n_views]
    )
    cost += point_rows(q, points, ws.rotations, ws.centres, ws.wrench_hessian, ws.wrench_gradient, counts[n_views + 1])
    if depth is not None:
        form_found(found_of, mesh, ws)
        factor = scale / contours.scale_px
        cost += depth_rows(q, mesh, depth, factor, ws, state, counts[n_views + 2])
    for i in range(priors.centre.shape[0]):
        for d in range(q.shape[0]):
            w = priors.weight[i, d]
            if w > 0:  # a centre without weight may be anything, NaN included
                e = q[d] - priors.centre[i, d]
                cost += 0.5 * w * e * e
    return cost


@kernel
def normal_equations(q, found_of, tree, mesh, priors, ws, hessian, gradient):
    """Compute the Gauss-Newton matrix and the gradient of the cost that `cost_at` has just computed at q.

    hessian, gradient: (D, D) and (D,), overwritten with the result.

    q: (D,) pose.
    tree, mesh, priors: joint tree, mesh and priors with which `cost_at` was called.
    ws: scratch memory.
    found_of: state that `cost_at` has filled.
    """
    form_found(found_of, mesh, ws)
    rows = found_of[2][_ROWS]
    sum_rows(rows, ws.rows, ws.row_joints, ws.lanes, ws.place, ws.wrench_hessian, ws.wrench_gradient)
    fold(tree, ws.twists, ws.wrench_hessian, ws.wrench_gradient, hessian, gradient)
    for i in range(priors.centre.shape[0]):
        for d in range(q.shape[0]):
            w = priors.weight[i, d]
            if w > 0:
                gradient[d] += w * (q[d] - priors.centre[i, d])
                hessian[d, d] += w


@kernel
def _solve(q, tree, mesh, contours, keypoints, points, depth, priors, settings, ws, hessian, gradient, counts, info):
    """Solve by bounded Levenberg-Marquardt from pose q (D,) within its bounds; q is overwritten, hessian and gradient
    get those at the result.

    tree, mesh, contours, keypoints, points, depth, priors, ws, counts: as in `cost_at`.
    settings: SolveSettings.
    Without iterations: compute the cost at q, the coarse one where coarse iterations were asked for.
    info: (4,), zero before, gets cost, iterations, evaluations, converged (1 where the last step was below the
        tolerance); the cost alone where it is not finite at the start.

    The first coarse_iterations use the coarse contour scale. A step that raises the cost is retried with 6 times the
    damping, `tries` times in all. Near the end the cost jitters with the outline, so that a rejected step below the
    tolerance stops.
    """
    n = q.shape[0]
    step, trial = np.empty(n), np.empty(n)
    new_counts, n_views = np.empty_like(counts), contours.sdf.shape[0]
    found_of = (np.empty((n_views + VIEWS, 3, 4), np.float32), np.empty(n_views + 1, np.int64), np.empty(3, np.int64))
    damping = settings.damping
    coarse = settings.coarse_iterations if n_views > 0 else 0
    scale, evaluated = contours.coarse_scale_px if coarse > 0 else contours.scale_px, False
    cost, evaluations, done, used, converged = 0.0, 0, 0, 0, 0.0
    while True:
        ends = done >= settings.iterations
        # a fine cost is reported all the same where only coarse iterations were asked for
        if coarse > 0 and done > 0 and (ends or done >= coarse):
            coarse, scale, evaluated = 0, contours.scale_px, False
        if not evaluated:
            cost = cost_at(q, tree, mesh, contours, scale, keypoints, points, depth, priors, ws, found_of, counts)
            normal_equations(q, found_of, tree, mesh, priors, ws, hessian, gradient)
            evaluations += 1
            evaluated = True
            if evaluations == 1 and not math.isfinite(cost):
                info[0] = cost
                return
        if ends:
            break
        accepted = False
        moved = 0.0
        for _ in range(settings.tries):
            if not bounded_step_kernel(hessian, gradient, q, priors.lower, priors.upper, damping, step):
                damping *= 6
                continue
            turn = 0.0
            for d in range(3, n):
                turn = max(turn, abs(step[d]))
            shorten = min(1.0, _LARGEST_TURN / max(turn, 1e-9))
            moved = 0.0
            for d in range(n):
                trial[d] = min(max(q[d] + shorten * step[d], priors.lower[d]), priors.upper[d])
                moved = max(moved, abs(shorten * step[d]) * (1.0 if d > 2 else 2.0))
            new_cost = cost_at(
                trial, tree, mesh, contours, scale, keypoints, points, depth, priors, ws, found_of, new_counts
            )
            evaluations += 1
            if math.isfinite(new_cost) and new_cost < cost * ACCEPT:
                accepted = True
                cost = new_cost
                normal_equations(trial, found_of, tree, mesh, priors, ws, hessian, gradient)
                break
            damping = min(damping * 6, 1e4)
            if coarse == 0 and moved < settings.tolerance:
                break
        done += 1
        used += 1
        if accepted:
            for d in range(n):  # array assignments would compile numba's error texts too: 2 s
                q[d] = trial[d]
            for r in range(counts.shape[0]):
                counts[r, 0] = new_counts[r, 0]
                counts[r, 1] = new_counts[r, 1]
            damping = max(damping / 4, 1e-4)
        if moved < settings.tolerance or not accepted:
            if coarse == 0:
                converged = 1.0 if moved < settings.tolerance else 0.0
                break
            done = coarse
    info[0], info[1], info[2], info[3] = cost, used, evaluations, converged


MOST_FOUND = 3072
"""Largest number of contour rows of one view: the body's outline has up to 2032, a mask's up to 1000."""


def workspace(tree: TreeArrays, mesh: MeshArrays, height: int, width: int) -> Workspace:
    """Make scratch memory for `solve` and `evaluate` on images up to (height, width); one per thread.

    tree, mesh: joint tree and mesh of the body.
    """
    v, f, e, j, d = len(mesh.vertices), len(mesh.faces), len(mesh.edges), len(tree.parents), len(tree.axes)
    f4, i4 = np.float32, np.int32
    line = int(row_stride(width))
    rows, views, lanes, rim = 2 * mesh.skin_index.shape[1] * MOST_FOUND, 4, 16, 2048
    return Workspace(
        np.zeros((v, 3), f4),
        np.zeros((12, views), f4),
        np.zeros((v, 2, views), f4),
        np.zeros((5, views), f4),
        np.zeros(f, np.uint8),
        np.zeros(e, i4),
        np.zeros(e, i4),
        np.zeros(e, i4),
        np.zeros((5, e), f4),
        np.zeros((height + 1, line), np.int8),
        np.zeros(height * line // 8, np.uint8),
        np.zeros((3, rim), f4),
        np.zeros(rim, i4),
        np.zeros(9 * lanes, f4),
        np.zeros(lanes, i4),
        np.zeros((2, rim), f4),
        np.zeros(rim, i4),
        np.zeros(65, np.int64),
        np.zeros((j, 3, 3)),
        np.zeros((j, 3)),
        np.zeros((d, 6)),
        np.zeros((j, 21)),
        np.zeros((j, 6)),
        np.empty((2, 2 * MOST_FOUND), i4),
        np.empty((5, 2 * MOST_FOUND), f4),
        np.empty((rows, 8)),
        np.empty(rows, i4),
        np.empty((9, rows + 24)),  # padding: else all of a row would fall on few sets of the processor's cache
        np.empty(j + 1, np.int64),
    )


class Evaluation(NamedTuple):
    """Cost at one pose and its derivatives.

    cost: half the weighted sum of robust squared residuals.
    gradient: (D,) gradient of the cost.
    hessian: (D, D) Gauss-Newton approximation.
    counts: (C + 3, 2) number of rows per cue. Lines 0 to C - 1, views: forward and reverse contour rows. Line C, 2D key
        points, and line C + 1, 3D points: rows, 0. Line C + 2, depth: rows of surface points, rows of body in front of
        the measured surface. One more line where further terms are used.
    """

    cost: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


def evaluate(
    pose: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    cues: Cues,
    priors: PriorArrays,
    ws: Workspace,
    *,
    coarse: bool = False,
) -> Evaluation:
    """Compute cost and derivatives of all evidence at one pose (D,).

    tree, mesh: joint tree and mesh of the body.
    cues, priors: evidence and priors of the frame.
    ws: scratch memory.
    coarse: whether to use the coarse scale of the contours.
    """
    evidence = tree, mesh, *cues, priors
    return _solved(np.array(pose, dtype=np.float64), evidence, SolveSettings(0, int(coarse), 0.0, 0.0, 0), ws)[0]


class Solution(NamedTuple):
    """Solved pose.

    pose: (D,) solved pose, rad and m.
    evaluation: cost and derivatives at the pose.
    iterations: number of iterations.
    converged: whether the last step was below the tolerance.
    """

    pose: Array
    evaluation: Evaluation
    iterations: int
    converged: bool


def solve(
    start: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    cues: Cues,
    priors: PriorArrays,
    settings: SolveSettings,
    ws: Workspace,
) -> Solution:
    """Solve the pose of one frame by bounded damped Gauss-Newton; releases the GIL.

    tree, mesh: joint tree and mesh of the body.
    start: (D,) start pose, rad and m.
    cues, priors: evidence and priors of the frame.
    settings: number of iterations, tolerance and damping.
    ws: scratch memory.
    Raises: SolverError where the cost at the start is not finite.
    """
    q = np.minimum(np.maximum(np.asarray(start, dtype=np.float64), priors.lower), priors.upper)  # faster than np.clip
    evaluation, info = _solved(q, (tree, mesh, *cues, priors), settings, ws)
    if info[2] == 0:
        raise SolverError(
            "The cost at the start pose is not finite; check the start pose, the key points and the masks for NaN."
        )
    return Solution(q, evaluation, int(info[1]), bool(info[3]))


def _solved(q: Array, evidence: tuple[Any, ...], settings: SolveSettings, ws: Workspace) -> tuple[Evaluation, Array]:
    """Run the solver from pose q, which it changes; return the evaluation and its info (4,).

    evidence: tree, mesh, the four cues and the priors.
    settings, ws: limits of the solve, and scratch memory.
    """
    d = len(q)
    gradient, hessian, info = np.zeros(d), np.zeros((d, d)), np.zeros(4)
    counts = np.zeros((len(evidence[2].sdf) + 3, 2), dtype=np.int64)
    _solve(q, *evidence, settings, ws, hessian, gradient, counts, info)
    return Evaluation(float(info[0]), gradient, hessian, counts), info

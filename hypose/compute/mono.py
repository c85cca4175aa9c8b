"""Monocular tracking: prepare flat arrays, search for poses, score samples.

The terms are defined in mono_rows.py; their use is in hypose.tracking.monocular.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays, plain
from hypose.compute.compiled import kernel
from hypose.compute.mono_nodes import contour_nodes, draw_still, fill_depth, inner_nodes, pose_mesh
from hypose.compute.mono_rows import (
    edge_terms,
    floor_terms,
    flow_terms,
    mark_terms,
    mask_terms,
    sphere_terms,
    sum_vertex_rows,
)
from hypose.compute.mono_terms import (
    LECLERC,
    LORENTZIAN,
    EdgeArrays,
    FloorArrays,
    FlowArrays,
    MarkArrays,
    MaskArrays,
    MonoModel,
    MonoPriors,
    MonoProblem,
    MonoWorkspace,
    SphereArrays,
)
from hypose.compute.solver import bounded_step_kernel
from hypose.errors import SolverError
from hypose.geometry import Array

MOST_NODES, MOST_INNER = 3000, 3000


def model(
    tree: TreeArrays, mesh: MeshArrays, moves: NDArray[np.bool_], active: ArrayLike, projection: Array
) -> MonoModel:
    """Make the model of the estimated degrees of freedom of a body.

    tree, mesh: of the body.
    moves: (D, J) which joints each dof carries.
    active: (A,) indices of the estimated dof.
    projection: (3, 4) pinhole.
    """
    dofs = np.array(active, dtype=np.int64)
    slot = np.full(len(tree.axes), -1, dtype=np.int64)
    slot[dofs] = np.arange(len(dofs))
    carried = moves[dofs].any(0)
    share = (mesh.skin_weight * carried[mesh.skin_index]).sum(1)
    moving = (share > 0.01)[mesh.faces].any(1)
    return MonoModel(
        tree,
        mesh,
        dofs,
        slot,
        np.flatnonzero(moving).astype(np.int32),
        np.flatnonzero(~moving).astype(np.int32),
        share > 0.5,
        plain(projection, np.float64),
    )


def workspace(m: MonoModel, height: int, width: int) -> MonoWorkspace:
    """Make scratch memory for pictures of (height, width); one per thread."""
    f4, i4 = np.float32, np.int32
    v, f, j, d = len(m.mesh.vertices), len(m.mesh.faces), len(m.tree.parents), len(m.tree.axes)
    rows = 2 * MOST_NODES + 2 * MOST_INNER
    return MonoWorkspace(
        np.zeros((j, 3, 3)),
        np.zeros((j, 3)),
        np.zeros((d, 6)),
        np.zeros((v, 3), f4),
        np.zeros((v, 3), f4),
        np.zeros(v, f4),
        np.zeros(f, np.uint8),
        np.zeros((height, width), f4),
        np.zeros((height, width), f4),
        np.zeros((MOST_NODES, 2), i4),
        np.zeros((MOST_NODES, 8)),
        np.zeros((MOST_INNER, 3), i4),
        np.zeros((MOST_INNER, 5)),
        np.zeros((rows, 3), i4),
        np.zeros((rows, 8)),
        np.zeros((j, 6)),
        np.zeros(j, np.uint8),
        np.zeros(8, np.int64),
    )


class MonoSolution(NamedTuple):
    """Pose at a minimum of the cost.

    pose: (D,).
    cost: full cost.
    evidence: cost without flow, by which hypotheses are ranked.
    gradient: (A,) of the full cost.
    hessian: (A, A) of evidence, flow and rest posture.
    counts: as in MonoWorkspace.
    """

    pose: Array
    cost: float
    evidence: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


def newton_descent(
    start: ArrayLike, before: ArrayLike, problem: MonoProblem, coarse: int, iterations: int, ws: MonoWorkspace
) -> MonoSolution:
    """Search for the pose of least cost by damped Newton steps; releases the GIL.

    start: (D,) pose.
    before: (D,) pose in the previous picture, from which the inner nodes of the flow come.
    problem: evidence and priors.
    coarse, iterations: number of iterations with the coarse and with the fine scale of the edges.
    ws: scratch memory.
    Returns: the solution.
    Raises: SolverError where the cost at the start is not finite.
    """
    q, a = np.array(start, dtype=np.float64), len(problem.model.active)
    hessian, gradient, info = np.empty((a, a)), np.empty(a), np.zeros(3)
    ok = _search(q, plain(before, np.float64), problem, int(coarse), int(iterations), ws, hessian, gradient, info)
    if not ok:
        raise SolverError("The cost at the start pose is not finite; check the start pose and the picture for NaN.")
    counts = ws.counts.copy()
    counts[5] = int(info[2])
    return MonoSolution(q, float(info[0]), float(info[1]), gradient, hessian, counts)


def score(poses: ArrayLike, problem: MonoProblem, ws: MonoWorkspace) -> Array:
    """Compute the costs (N,) of poses (N, D) without flow; releases the GIL.

    problem, ws: evidence and priors, and scratch memory.
    """
    q = plain(poses, np.float64)
    costs = np.empty(len(q))
    _score(q, problem, ws, costs)
    return costs


@kernel
def image_cost(q, problem, sigma, n_flow, want, ws, hessian, gradient):
    """Compute the cost of all evidence at pose q (D,).

    sigma: scale of the edges, px.
    n_flow: number of inner nodes (0: without flow).
    want: whether to compute derivatives.
    hessian, gradient: (A, A) and (A,) get the derivatives by the active dof.
    """
    model, a = problem.model, gradient.shape[0]
    for i in range(a):
        gradient[i] = 0.0
        for k in range(a):
            hessian[i, k] = 0.0
    for k in range(7):
        ws.counts[k] = 0
    ws.counts[7] += 1
    pose_mesh(q, model, ws)
    cost, n_rows = 0.0, 0
    if problem.edges.weight > 0 or problem.mask.height > 0:
        fill_depth(model, ws)
        n = contour_nodes(model, problem.edges.spacing, ws)
        if problem.edges.weight > 0:
            part, n_rows = edge_terms(n, problem, sigma, want, ws, n_rows)
            cost += part
        part, n_rows = mask_terms(n, problem, want, ws, n_rows)
        cost += part
    part, n_rows = flow_terms(q, n_flow, problem, want, ws, n_rows)
    cost += part
    if want:
        sum_vertex_rows(n_rows, model, ws, hessian, gradient)
    cost += mark_terms(q, model, problem.marks, problem.second_order, ws, hessian, gradient)
    cost += sphere_terms(model, problem.spheres, ws, hessian, gradient)
    cost += floor_terms(q, model, problem.floor, problem.second_order, ws, hessian, gradient)
    for i in range(a):
        for k in range(i):
            s = hessian[i, k] + hessian[k, i]
            hessian[i, k] = s
            hessian[k, i] = s
    for f in range(ws.front.shape[0]):
        ws.counts[4] += 1 - ws.front[f]
    ws.counts[5], ws.counts[6] = n_flow, n_rows
    return cost


@kernel
def prior_cost(q, priors, active, hessian, gradient):
    """Compute the quadratics of the prediction and of the rest posture; their derivatives are added to hessian and
    gradient.
    """
    cost = 0.0
    for i in range(priors.centre.shape[0]):
        for k in range(active.shape[0]):
            w = priors.weight[i, k]
            if w > 0:
                e = q[active[k]] - priors.centre[i, k]
                cost += 0.5 * w * e * e
                gradient[k] += w * e
                hessian[k, k] += w
    return cost


@kernel
def full_cost(q, problem, sigma, n_flow, ws, hessian, gradient):
    """Compute the cost of evidence and priors: equations (6) and (10) of Sminchisescu & Triggs 2001.

    Deviation: the evidence is not divided by N nu; masks, 2D points, interpenetration and the floor are added.
    """
    cost = image_cost(q, problem, sigma, n_flow, True, ws, hessian, gradient)
    return cost + prior_cost(q, problem.priors, problem.model.active, hessian, gradient)


@kernel
def rank_cost(q, problem, ws, hessian, gradient):
    """Compute the cost by which hypotheses are ranked: all but flow, whose targets differ between hypotheses.

    hessian, gradient: scratch.
    Source: Sminchisescu & Triggs 2001, section 4.2. Deviation: the printed cost is the edge term alone; here priors,
        interpenetration and, where given, masks, 2D points and the floor are included.
    """
    cost = image_cost(q, problem, problem.edges.sigma, 0, False, ws, hessian, gradient)
    return cost + prior_cost(q, problem.priors, problem.model.active, hessian, gradient)


@kernel
def expected_gain(hessian, gradient, step, scale):
    """Compute the decrease of the quadratic model along scale * step."""
    slope, bend = 0.0, 0.0
    for i in range(step.shape[0]):
        s = 0.0
        for k in range(step.shape[0]):
            s += hessian[i, k] * step[k]
        slope += gradient[i] * step[i]
        bend += s * step[i]
    return -scale * slope - 0.5 * scale * scale * bend


@kernel
def _descend(q, problem, sigma, n_flow, iterations, ws, hessian, gradient):
    """Descend by damped Newton within the limits from pose q (D,), which is overwritten; return the cost.

    sigma: scale of the edges, px.
    n_flow: number of inner nodes.
    iterations: largest number of steps.
    hessian, gradient: get the derivatives at the result.
    Source: Sminchisescu & Triggs 2001, equation (11): (H + lambda W) step = -g, W the diagonal of H (at least 1), with
        an active set of limits (section 4.1).

    A step is cut to the trusted reach (1: priors.longest). A step that does not lower the cost is tried again, shorter
    and with more damping, at most four times. The descent ends when no step is expected to lower the cost by _GAIN.
    """
    priors, active = problem.priors, problem.model.active
    n, dof = active.shape[0], q.shape[0]
    new_hessian, new_gradient = np.empty((n, n)), np.empty(n)
    step, at, trial = np.empty(n), np.empty(n), np.empty(dof)
    damping, reach = 1e-2, 1.0
    cost = full_cost(q, problem, sigma, n_flow, ws, hessian, gradient)
    for _ in range(iterations):
        for k in range(n):
            at[k] = q[active[k]]
        accepted = False
        for _ in range(4):
            if not bounded_step_kernel(hessian, gradient, at, priors.lower, priors.upper, damping, step):
                damping *= 8
                continue
            length = 1e-12
            for k in range(n):
                length = max(length, abs(step[k]) / priors.longest[k])
            scale = min(1.0, reach / length)
            if expected_gain(hessian, gradient, step, scale) < _GAIN:
                break
            for d in range(dof):
                trial[d] = q[d]
            for k in range(n):
                trial[active[k]] = min(max(at[k] + scale * step[k], priors.lower[k]), priors.upper[k])
            new_cost = full_cost(trial, problem, sigma, n_flow, ws, new_hessian, new_gradient)
            if new_cost < cost:
                accepted, cost = True, new_cost
                break
            damping *= 6
            reach = 0.35 * min(reach, length)
        if not accepted:
            break
        for d in range(dof):
            q[d] = trial[d]
        for i in range(n):
            gradient[i] = new_gradient[i]
            for k in range(n):
                hessian[i, k] = new_hessian[i, k]
        damping, reach = max(damping / 6, 1e-4), min(1.0, 2 * reach)
    return cost


@kernel
def _search(q, before, problem, coarse, iterations, ws, hessian, gradient, info):
    """Search one hypothesis in one frame: a coarse and a fine descent from q (D,), which is overwritten.

    before: (D,) pose in the previous picture, from which the inner nodes come.
    coarse, iterations: number of iterations of the two descents.
    hessian: (A, A) gets that of the evidence and the rest posture at the result, without the prediction.
    gradient: (A,) gets that of the full cost.
    info: (3,) gets full cost, cost without flow, number of inner nodes.
    Returns: False where the cost is not finite.
    """
    model, priors = problem.model, problem.priors
    for k in range(model.active.shape[0]):
        d = model.active[k]
        q[d] = min(max(q[d], priors.lower[k]), priors.upper[k])
    n_flow = 0
    if problem.flow.flow.shape[0] > 1:
        draw_still(before, model, ws)
        pose_mesh(before, model, ws)
        fill_depth(model, ws)
        n_flow = inner_nodes(model, problem.flow, ws)
    draw_still(q, model, ws)
    ws.counts[7] = 0
    if coarse > 0:
        _descend(q, problem, problem.edges.coarse_sigma, n_flow, coarse, ws, hessian, gradient)
    cost = _descend(q, problem, problem.edges.sigma, n_flow, iterations, ws, hessian, gradient)
    info[0] = cost
    for k in range(model.active.shape[0]):
        hessian[k, k] -= priors.weight[0, k]
    unused_h, unused_g = np.empty_like(hessian), np.empty_like(gradient)
    info[1] = rank_cost(q, problem, ws, unused_h, unused_g)
    info[2] = n_flow
    return math.isfinite(cost)


@kernel
def _score(poses, problem, ws, costs):
    """Compute the costs (N,) of poses (N, D) without flow, by which samples are ranked."""
    a = problem.model.active.shape[0]
    hessian, gradient = np.empty((a, a)), np.empty(a)
    if poses.shape[0] > 0:
        draw_still(poses[0], problem.model, ws)
    for n in range(poses.shape[0]):
        costs[n] = rank_cost(poses[n], problem, ws, hessian, gradient)


def warm_up(tree: TreeArrays, mesh: MeshArrays, pose: Array, projection: Array) -> None:
    """Compile (or load from the cache) every kernel of monocular tracking on a toy body at pose (D,), before a pinhole
    (3, 4) of 32 x 32 px.
    """
    d, j = len(pose), len(tree.parents)
    still = np.zeros((32, 32, 2), np.float32)
    field, error = still, np.zeros((32, 32), np.float32)
    pixels, places, joint = np.full((1, 2), 16.0), np.zeros((2, 3)), np.zeros(2, dtype=np.int64)
    bounds = np.full(d, np.inf)
    problem = MonoProblem(
        model(tree, mesh, np.ones((d, j), dtype=np.bool_), np.arange(d), projection),
        EdgeArrays(field, 1.0, LECLERC, 3.0, 6.0, 5.0, 8.0, 4, 6.0, 0.08, 0.8, 0.8),
        FlowArrays(still, error, np.zeros(2, dtype=np.int64), LORENTZIAN, 1.2, 0.1, 14.0, 8.0, 1.0),
        MaskArrays(error, pixels.astype(np.float32), 1.0, 1.0, LORENTZIAN, 4.0, 8.0),
        MarkArrays(pixels, np.ones(1), joint[:1], places[:1], np.ones(1), LORENTZIAN),
        SphereArrays(joint, places, np.array([[0, 1]]), np.ones(1), 1.0),
        FloorArrays(joint, places, 0.0, 1.0, 1.0),
        MonoPriors(np.zeros((2, d)), np.ones((2, d)), -bounds, bounds, np.ones(d)),
        True,
    )
    ws = workspace(problem.model, 32, 32)
    found = newton_descent(pose, pose, problem, 1, 1, ws)
    score(found.pose[None], problem, ws)


_GAIN = 0.02
"""A descent ends when no step is expected to lower the cost by more."""

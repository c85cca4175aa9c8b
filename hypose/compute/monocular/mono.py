"""Monocular tracking: preparing flat arrays, searching for poses, scoring samples (numba kernels on either back end).

Definitions of the terms: cpu_mono_cues.py and cpu_mono_rows.py; what they are for: hypose.tracking.monocular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.monocular.mono_terms import (
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
from hypose.compute.native import native, plain
from hypose.errors import SolverError

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
MOST_NODES, MOST_INNER = 3000, 3000


def model(
    tree: TreeArrays, mesh: MeshArrays, moves: NDArray[np.bool_], active: ArrayLike, projection: Array
) -> MonoModel:
    """What the active dof (A,) move of a body whose moves (D, J) tell which joints each dof carries."""
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
    """Scratch memory for pictures of (height, width); one per thread."""
    f4, i4 = np.float32, np.int32
    v, f, j, d = len(m.mesh.vertices), len(m.mesh.faces), len(m.tree.parents), len(m.tree.axes)
    rows = 2 * MOST_NODES + 2 * MOST_INNER
    return MonoWorkspace(
        np.zeros((j, 3, 3)),
        np.zeros((j, 3)),
        np.zeros((d, 6)),
        np.zeros((v, 3), f4),
        np.zeros((v, 3), f4),
        np.zeros(f, np.uint8),
        np.full((height, width), 1e9, f4),
        np.full((height, width), 1e9, f4),
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


class MonoCost(NamedTuple):
    """Cost at a pose, its gradient (A,) and Hessian (A, A) over the active dof; counts as in MonoWorkspace."""

    cost: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


def evaluate(pose: ArrayLike, problem: MonoProblem, ws: MonoWorkspace, *, coarse: bool = False) -> MonoCost:
    """Cost of the evidence (without flow) and of the priors at one pose (D,), with derivatives."""
    q, a = plain(pose, np.float64), len(problem.model.active)
    hessian, gradient = np.empty((a, a)), np.empty(a)
    sigma = problem.edges.coarse_sigma if coarse else problem.edges.sigma
    kernels = native("monocular.mono_search")
    kernels.draw_still(q, problem.model, ws)
    cost = kernels.full_cost(q, problem, sigma, 0, ws, hessian, gradient)
    return MonoCost(float(cost), gradient, hessian, ws.counts.copy())


class MonoSolution(NamedTuple):
    """A pose (D,) at a minimum; cost of everything; evidence: cost without flow, by which hypotheses are ranked;
    gradient (A,) of the cost; hessian (A, A) of evidence, flow and rest posture; counts as in MonoWorkspace."""

    pose: Array
    cost: float
    evidence: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


def search(
    start: ArrayLike, before: ArrayLike, problem: MonoProblem, coarse: int, iterations: int, ws: MonoWorkspace
) -> MonoSolution:
    """Damped Newton from pose start (D,); inner nodes come from pose before (D,). Releases the GIL."""
    q, a = np.array(start, dtype=np.float64), len(problem.model.active)
    hessian, gradient, info = np.empty((a, a)), np.empty(a), np.zeros(3)
    ok = native("monocular.mono_search").search(
        q, plain(before, np.float64), problem, int(coarse), int(iterations), ws, hessian, gradient, info
    )
    if not ok:
        raise SolverError("The cost at the start pose is not finite; check the start pose and the picture for NaN.")
    counts = ws.counts.copy()
    counts[5] = int(info[2])
    return MonoSolution(q, float(info[0]), float(info[1]), gradient, hessian, counts)


def score(poses: ArrayLike, problem: MonoProblem, ws: MonoWorkspace) -> Array:
    """Costs (N,) without flow at poses (N, D). Releases the GIL."""
    q = plain(poses, np.float64)
    costs = np.empty(len(q))
    native("monocular.mono_search").score(q, problem, ws, costs)
    return costs


def eigen(matrix: ArrayLike) -> tuple[Array, Array]:
    """Eigenvalues (N,), ascending, and eigenvectors (N, N) in columns of a symmetric matrix, without BLAS."""
    a = np.array(matrix, dtype=np.float64)
    vectors = np.empty_like(a)
    native("monocular.mono_search").symmetric_eigen(a, vectors)
    values = np.diagonal(a)
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def strongest_gradient(image: ArrayLike) -> tuple[Floats, Floats]:
    """Scharr gradient (h, w, 2) per px of the channel of image (h, w, C) in which it is largest, and its length."""
    i = plain(image, np.float32)
    field, size = np.empty((*i.shape[:2], 2), np.float32), np.empty(i.shape[:2], np.float32)
    native("monocular.mono_images").strongest_gradient(i, field, size)
    return field, size


def saturate(field: Floats, size: Floats, full: float) -> None:
    """Divide field (h, w, 2) by max(full, size (h, w)), in place."""
    native("monocular.mono_images").saturate(field, size, np.float32(full))


def weigh(field: Floats, boundaries: Floats, corner: tuple[int, int], floor: float) -> Floats:
    """field (h, w, 2) times floor + (1 - floor) boundaries, which lie at corner (x, y) and count 0 elsewhere."""
    out = np.empty_like(field)
    native("monocular.mono_images").weigh(field, boundaries, int(corner[0]), int(corner[1]), np.float32(floor), out)
    return out


def flow_error(there: Floats, back: Floats) -> Floats:
    """Forward-backward error (h, w) px of a flow (h, w, 2) and the flow back."""
    out = np.empty(there.shape[:2], np.float32)
    native("monocular.mono_images").flow_error(plain(there, np.float32), plain(back, np.float32), out)
    return out


def boundary_map(back: Floats, error: Floats, steep: float, wrong: float) -> Floats:
    """Unsmoothed motion boundaries (h, w), 0 to 2: slope of the flow over `steep` and its error over `wrong`."""
    out = np.empty(error.shape, np.float32)
    kernels = native("monocular.mono_images")
    kernels.boundary_map(plain(back, np.float32), error, np.float32(steep), np.float32(wrong), out)
    return out


def warm_up(tree: TreeArrays, mesh: MeshArrays, pose: Array, projection: Array) -> None:
    """Compile (or load from disk) every kernel of monocular tracking on a toy body at pose (D,) before a pinhole (3, 4)
    of 32 x 32 px."""
    d, j = len(pose), len(tree.parents)
    field, size = strongest_gradient(np.zeros((32, 32, 3), np.float32))
    saturate(field, size, 1.0)
    still = np.zeros((32, 32, 2), np.float32)
    error = flow_error(still, still)
    field = weigh(field, boundary_map(still, error, 1.0, 1.0), (0, 0), 0.1)
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
    found = search(pose, pose, problem, 1, 1, ws)
    evaluate(found.pose, problem, ws)
    score(found.pose[None], problem, ws)
    eigen(found.hessian)

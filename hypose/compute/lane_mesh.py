"""Mesh layout of the block-wise silhouette scorer (only the wanted faces, weights without zeros), and its scratch
memory per thread.

Why the scratch memory is kept: touching the pages of new memory in every call takes as long as scoring a dozen poses.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.coverage import LANES, row_stride


class LaneMesh(NamedTuple):
    """Mesh, or some faces of one, for scorer.py.

    vertices: (V, 3) m, only those of the faces.
    faces: (F, 3).
    edges: (E, 4) vertices a, b, the faces left and right; F where the face is not among the wanted ones.
    start: (V + 1,) first influence of each vertex in joint and weight.
    joint: (K,) joints of the influences.
    weight: (K,) weights of the influences.
    needed: (J,) joints that move these vertices, and those above them.
    one_sided: whether only front faces are drawn, also where the near plane opens the mesh.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    start: NDArray[np.int64]
    joint: NDArray[np.int32]
    weight: NDArray[np.float32]
    needed: NDArray[np.bool_]
    one_sided: bool


class _Plan(NamedTuple):
    """Layout of a mesh, kept for the next call.

    edges_of, weights_of, wanted: the mesh's arrays and its faces for which it was made.
    used: indices of the vertices in it.
    mesh: the layout, without vertices.
    """

    edges_of: NDArray[np.int32]  # the array itself: its identity is the key
    weights_of: NDArray[np.float32]
    wanted: bytes | None
    used: NDArray[np.int64]
    mesh: LaneMesh


_plans: list[_Plan] = []
_lock = threading.Lock()
_KEPT = 24  # two bodies with ten layers of parts each


def prepare_lanes(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None) -> LaneMesh:
    """Convert a mesh, or its faces where faces (F,) is True, for the scorer.

    Values that depend on topology and weights are kept for the next call; vertices are read again.
    """
    wanted = None if faces is None else faces.tobytes()
    with _lock:
        for k, plan in enumerate(_plans):
            if plan.edges_of is mesh.edges and plan.weights_of is mesh.skin_weight and plan.wanted == wanted:
                _plans.insert(0, _plans.pop(k))
                return _with_vertices(plan, mesh)
    plan = _plan(mesh, tree, faces, wanted)
    with _lock:
        _plans.insert(0, plan)
        del _plans[_KEPT:]
    return _with_vertices(plan, mesh)


def _with_vertices(plan: _Plan, mesh: MeshArrays) -> LaneMesh:
    """Complete a kept layout with the vertices of a mesh."""
    return plan.mesh._replace(vertices=np.asarray(mesh.vertices.take(plan.used, axis=0), dtype=np.float32))


def _plan(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None, wanted: bytes | None) -> _Plan:
    """Make the layout of a mesh, or of its faces where faces (F,) is True; wanted: the faces as bytes, its key."""
    chosen = np.ones(len(mesh.faces), dtype=bool) if faces is None else faces
    kept = mesh.faces[chosen]
    new_face = np.full(len(mesh.faces), len(kept), dtype=np.int32)
    new_face[chosen] = np.arange(len(kept), dtype=np.int32)
    edges = mesh.edges[(chosen[mesh.edges[:, 2]] | chosen[mesh.edges[:, 3]])]
    used = np.unique(kept)
    new_vertex = np.zeros(len(mesh.vertices), dtype=np.int32)
    new_vertex[used] = np.arange(len(used), dtype=np.int32)
    count = mesh.skin_count[used]
    own = np.arange(mesh.skin_index.shape[1]) < count[:, None]
    joint = np.ascontiguousarray(mesh.skin_index[used][own])
    return _Plan(
        mesh.edges,
        mesh.skin_weight,
        wanted,
        used,
        LaneMesh(
            mesh.vertices[:0],
            np.ascontiguousarray(new_vertex[kept]),
            np.ascontiguousarray(np.concatenate([new_vertex[edges[:, :2]], new_face[edges[:, 2:]]], 1)),
            np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
            joint,
            np.ascontiguousarray(mesh.skin_weight[used][own]),
            _with_ancestors(joint, tree.parents),
            faces is not None,
        ),
    )


def _with_ancestors(joints: NDArray[np.int32], parents: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark joints, given by their indices, and all above them in the tree: (J,) bool."""
    needed = np.zeros(len(parents), dtype=bool)
    needed[joints] = True
    for j in range(len(parents) - 1, 0, -1):
        needed[parents[j]] |= needed[j]
    return needed


class MovingParts(NamedTuple):
    """Parts of a mesh that move when some joints turn.

    moved: (F,) faces with a corner carried by such a joint or by one below it.
    standing: (F,) the other faces.
    corners: (K, 3) corners of the standing faces.
    turning: (J,) such joints, and those below them.
    vertices: (M,) corners of the moved faces.
    """

    moved: NDArray[np.bool_]
    standing: NDArray[np.bool_]
    corners: NDArray[np.int32]
    turning: NDArray[np.bool_]
    vertices: NDArray[np.int64]


_moving: list[tuple[NDArray[np.int32], bytes, MovingParts]] = []


def moving_parts(mesh: MeshArrays, tree: TreeArrays, moving: NDArray[np.bool_]) -> MovingParts:
    """Find the parts of a mesh that move when the joints `moving` (J,) turn; they are kept for the next call."""
    wanted = moving.tobytes()
    with _lock:
        for index_of, key, parts in _moving:
            if index_of is mesh.skin_index and key == wanted:
                return parts
    below = moving.copy()
    for j, parent in enumerate(tree.parents):
        below[j] |= parent >= 0 and below[parent]
    own = np.arange(mesh.skin_index.shape[1]) < mesh.skin_count[:, None]
    moved = np.asarray((below[mesh.skin_index] & own).any(1)[mesh.faces].any(1))
    vertices = np.unique(mesh.faces[moved]).astype(np.int64)
    made = MovingParts(moved, ~moved, np.ascontiguousarray(mesh.faces[~moved]), below, vertices)
    with _lock:
        _moving.insert(0, (mesh.skin_index, wanted, made))
        del _moving[_KEPT:]
    return made


_KEPT_SCRATCH = 8  # two bodies with four limbs each
_OWN = threading.local()


def lane_scratch(mesh: LaneMesh, image: tuple[int, int]) -> tuple[Any, ...]:
    """Return this thread's scratch arrays for scoring a mesh on images of (rows, columns)."""
    known: dict[tuple[int, ...], tuple[Any, ...]] = _OWN.__dict__.setdefault("scratch", {})
    key = (len(mesh.needed), len(mesh.vertices), len(mesh.faces), len(mesh.edges), *image)
    if key not in known:
        if len(known) == _KEPT_SCRATCH:
            known.clear()
        known[key] = _make(*key)
    return known[key]


def _make(j: int, v: int, f: int, e: int, rows: int, columns: int) -> tuple[Any, ...]:
    """Make the scratch arrays of LANES poses: 12 for placing and projecting, 8 for drawing; the difference image is
    zero between calls.

    j, v, f, e: numbers of joints, vertices, faces and edges.
    rows, columns: size of the images, px.
    """
    f4, i4, lanes = np.float32, np.int32, LANES
    return (
        *(np.empty((j + 1, 9, lanes)), np.empty((j, 3, lanes)), np.empty((3, lanes)), np.empty((9, lanes))),
        *(np.empty((j, 12, lanes), f4), np.empty((v, 3, lanes), f4), np.empty((v, lanes), f4)),
        *(np.empty((v, lanes), f4), np.empty((12, lanes), f4), np.empty((5, lanes), f4)),
        *(np.zeros((5, lanes), f4), np.zeros((lanes, 4), np.int64)),
        *(np.empty(f + 1, np.uint16), np.empty(e + 1, i4), np.empty((4, lanes), f4), np.empty(lanes, i4)),
        # an outline crosses a column about 5 times each way; memory that is not touched costs nothing
        *(np.empty((2 * lanes, 16 * columns + 1024), i4), np.zeros(2 * lanes, np.int64)),
        # a window begins at a multiple of 8
        *(np.zeros((rows + 1) * row_stride(columns + 8) + 8, np.int8), np.zeros(2, np.int64)),
    )

"""Mesh layout of the block-wise silhouette scorer (only the wanted faces, weights without zeros), and its scratch
memory per thread.

Why the scratch memory is kept: touching the pages of new memory in every call takes as long as scoring a dozen poses.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

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
    needed: indices of the joints that move these vertices, and of those above them, parents first.
    one_sided: whether only front faces are drawn, also where the near plane opens the mesh.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    start: NDArray[np.int64]
    joint: NDArray[np.int32]
    weight: NDArray[np.float32]
    needed: NDArray[np.int64]
    one_sided: bool


_Made = TypeVar("_Made")
_lock = threading.Lock()
_KEPT = 24  # two bodies with ten layers of parts each


def _kept(known: list[tuple[Any, ...]], of: Any, wanted: bytes | None, make: Callable[[], _Made]) -> _Made:
    """Return what was made before for this very array `of` and these wanted faces or joints, or make and keep it."""
    with _lock:
        for k, (array, key, made) in enumerate(known):
            if array is of and key == wanted:
                known.insert(0, known.pop(k))
                return made
    made = make()
    with _lock:
        known.insert(0, (of, wanted, made))
        del known[_KEPT:]
    return made


_plans: list[tuple[Any, ...]] = []


def prepare_lanes(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None) -> LaneMesh:
    """Convert a mesh, or its faces where faces (F,) is True, for the scorer.

    Values that depend on topology and weights are kept for the next call; vertices are read again.
    """
    wanted = None if faces is None else faces.tobytes()
    used, made = _kept(_plans, mesh.skin_weight, wanted, lambda: _plan(mesh, tree, faces))
    return made._replace(vertices=np.asarray(mesh.vertices.take(used, axis=0), dtype=np.float32))


def _plan(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None) -> tuple[NDArray[np.int64], LaneMesh]:
    """Make the layout of a mesh, or of its faces where faces (F,) is True.

    Returns: indices of the vertices in it; the layout without vertices.
    """
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
    needed = np.isin(np.arange(len(tree.parents)), joint)
    for j in range(len(needed) - 1, 0, -1):
        needed[tree.parents[j]] |= needed[j]
    return used, LaneMesh(
        mesh.vertices[:0],
        np.ascontiguousarray(new_vertex[kept]),
        np.ascontiguousarray(np.concatenate([new_vertex[edges[:, :2]], new_face[edges[:, 2:]]], 1)),
        np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
        joint,
        np.ascontiguousarray(mesh.skin_weight[used][own]),
        np.flatnonzero(needed),
        faces is not None,
    )


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


_moving: list[tuple[Any, ...]] = []


def moving_parts(mesh: MeshArrays, tree: TreeArrays, moving: NDArray[np.bool_]) -> MovingParts:
    """Find the parts of a mesh that move when the joints `moving` (J,) turn; they are kept for the next call."""

    def make() -> MovingParts:
        below = moving.copy()
        for j, parent in enumerate(tree.parents):
            below[j] |= parent >= 0 and below[parent]
        own = np.arange(mesh.skin_index.shape[1]) < mesh.skin_count[:, None]
        moved = np.asarray((below[mesh.skin_index] & own).any(1)[mesh.faces].any(1))
        vertices = np.unique(mesh.faces[moved]).astype(np.int64)
        return MovingParts(moved, ~moved, np.ascontiguousarray(mesh.faces[~moved]), below, vertices)

    return _kept(_moving, mesh.skin_index, moving.tobytes(), make)


_KEPT_SCRATCH = 8  # two bodies with four limbs each
_OWN = threading.local()


def lane_scratch(mesh: LaneMesh, joints: int, image: tuple[int, int]) -> tuple[Any, ...]:
    """Return this thread's scratch arrays for scoring a mesh of a body with so many joints on images of (rows,
    columns).
    """
    known: dict[tuple[int, ...], tuple[Any, ...]] = _OWN.__dict__.setdefault("scratch", {})
    key = (joints, len(mesh.vertices), len(mesh.faces), len(mesh.edges), *image)
    if key not in known:
        if len(known) == _KEPT_SCRATCH:
            known.clear()
        known[key] = _make(*key)
    return known[key]


def _make(j: int, v: int, f: int, e: int, rows: int, columns: int) -> tuple[Any, ...]:
    """Make the scratch arrays of LANES poses: 10 for placing and projecting, 8 for drawing; the difference image is
    zero between calls.

    j, v, f, e: numbers of joints, vertices, faces and edges.
    rows, columns: size of the images, px.
    """
    f4, i4, lanes = np.float32, np.int32, LANES
    return (
        *(np.empty((lanes, j, 3, 3)), np.empty((lanes, j, 3))),
        *(np.empty((j, 12, lanes), f4), np.empty((v, 3, lanes), f4), np.empty((v, lanes), f4)),
        *(np.empty((v, lanes), f4), np.empty((12, lanes), f4), np.empty((5, lanes), f4)),
        *(np.zeros((5, lanes), f4), np.zeros((lanes, 4), np.int64)),
        *(np.empty(f + 1, np.uint16), np.empty(e + 1, i4), np.empty((4, lanes), f4), np.empty(lanes, i4)),
        # an outline crosses a column about 5 times each way; memory that is not touched costs nothing
        *(np.empty((2 * lanes, 16 * columns + 1024), i4), np.zeros(2 * lanes, np.int64)),
        # a window begins at a multiple of 8
        *(np.zeros((rows + 1) * row_stride(columns + 8) + 8, np.int8), np.zeros(2, np.int64)),
    )

"""The mesh as the block-wise silhouette scorer reads it: only the faces asked for, weights without the zeros."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays


class LaneMesh(NamedTuple):
    """A mesh, or some faces of one, for cpu_lanes.py."""

    vertices: NDArray[np.float32]
    """(V, 3) m, only those of the faces."""
    faces: NDArray[np.int32]
    """(F, 3)"""
    edges: NDArray[np.int32]
    """(E, 4): vertices a, b, the faces left and right; F where the face is not among those asked for."""
    start: NDArray[np.int64]
    """(V + 1,) first influence of each vertex in joint and weight."""
    joint: NDArray[np.int32]
    """(K,)"""
    weight: NDArray[np.float32]
    """(K,)"""
    needed: NDArray[np.bool_]
    """(J,) the joints that move these vertices, and those above them"""
    one_sided: bool
    """Only front faces are drawn, also where the near plane opens the mesh."""


class _Plan(NamedTuple):
    edges_of: NDArray[np.int32]  # the array itself: its identity is the key
    weights_of: NDArray[np.float32]
    wanted: bytes | None
    used: NDArray[np.int64]
    mesh: LaneMesh


_plans: list[_Plan] = []
_lock = threading.Lock()
_KEPT = 24  # two bodies with ten layers of parts each


def prepare(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None) -> LaneMesh:
    """The mesh, or its faces where faces (F,) is True. What depends on topology and weights is kept for the next call;
    vertices are read anew."""
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
    return plan.mesh._replace(vertices=np.asarray(mesh.vertices.take(plan.used, axis=0), dtype=np.float32))


def _plan(mesh: MeshArrays, tree: TreeArrays, faces: NDArray[np.bool_] | None, wanted: bytes | None) -> _Plan:
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
    needed = np.zeros(len(parents), dtype=bool)
    needed[joints] = True
    for j in range(len(parents) - 1, 0, -1):
        needed[parents[j]] |= needed[j]
    return needed


class MovingParts(NamedTuple):
    """What of a mesh, or of the faces asked for, moves when some joints turn."""

    moved: NDArray[np.bool_]
    """(F,) the faces with a corner that hangs on such a joint or on one below it"""
    standing: NDArray[np.bool_]
    """(F,) the others"""
    corners: NDArray[np.int32]
    """(K, 3) the others"""
    turning: NDArray[np.bool_]
    """(J,) such joints, and those below them"""


_moving: list[tuple[NDArray[np.int32], bytes, MovingParts]] = []


def moving_parts(
    mesh: MeshArrays, tree: TreeArrays, moving: NDArray[np.bool_], faces: NDArray[np.bool_] | None
) -> MovingParts:
    """The parts when the joints `moving` (J,) turn, of the faces (F,) asked for; kept for the next call."""
    wanted = moving.tobytes() + (b"" if faces is None else faces.tobytes())
    with _lock:
        for index_of, key, parts in _moving:
            if index_of is mesh.skin_index and key == wanted:
                return parts
    below = moving.copy()
    for j, parent in enumerate(tree.parents):
        below[j] |= parent >= 0 and below[parent]
    own = np.arange(mesh.skin_index.shape[1]) < mesh.skin_count[:, None]
    moved = np.asarray((below[mesh.skin_index] & own).any(1)[mesh.faces].any(1))
    chosen = np.ones_like(moved) if faces is None else faces
    standing = chosen & ~moved
    made = MovingParts(chosen & moved, standing, np.ascontiguousarray(mesh.faces[standing]), below)
    with _lock:
        _moving.insert(0, (mesh.skin_index, wanted, made))
        del _moving[_KEPT:]
    return made

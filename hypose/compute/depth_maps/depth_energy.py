"""How far posed bodies lie from what depth cameras saw: the difference of depth over the pixels that both show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.native import native, plain, tidy
from hypose.compute.selection import over_chunks


class SeenDepth(NamedTuple):
    """What sensors C saw of a person, small, so that many bodies can be compared."""

    maps: NDArray[np.float32]
    """(C, h, w) m along the optical axis at the person's pixels, 0 elsewhere"""
    sizes: NDArray[np.int64]
    """(C, 2) width, height of each"""
    projections: NDArray[np.float64]
    """(C, 3, 4) of these pixels, the last row of unit length"""
    counts: NDArray[np.int64]
    """(C,) pixels of the person"""


def depth_energy(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    seen: SeenDepth,
    most_m: float,
    moving: ArrayLike | None = None,
    rough: bool = False,
    threads: int | None = None,
) -> NDArray[np.float64]:
    """(N, C) of poses (N, D): sum over the pixels that show the person and the drawn body of min(|z - z'|, most_m) /
    most_m, over the person's pixels; what only one of both shows is the silhouettes' affair. 0 for a view without the
    person. moving (J,) bool: only these joints turn, everything else stands as in the last pose; rough: what turns
    is then not drawn, each of its faces counts at its middle, which takes a third of the time. The same for any number
    of threads, and for a pose alone or among others."""
    q = plain(poses, np.float64)
    if moving is not None:
        q = plain(np.where(np.asarray(moving, dtype=np.bool_)[tree.joint_of_dof], q, q[-1:]), np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    kernels, t, m = native("depth_maps.depth_energy"), tidy(tree), tidy(mesh)

    against = seen.maps, seen.projections, seen.sizes, np.float32(most_m)
    parts = None if moving is None else _parts(tree, mesh, moving)

    def score(first: int, last: int) -> None:
        if parts is None:
            kernels.energies(q, first, last, t, m, *against, out)
        else:
            kernels.limb_energies(q, first, last, t, m, *parts, *against, rough, out)

    if len(q):
        over_chunks(score, len(q), threads, 16 if not rough else 96)
    return out / np.maximum(seen.counts, 1)


_Indices = NDArray[np.int64]
_Parts = tuple[_Indices, _Indices, _Indices, _Indices, _Indices]
_KEPT: dict[tuple[int, bytes], tuple[MeshArrays, _Parts]] = {}


def _parts(tree: TreeArrays, mesh: MeshArrays, moving: ArrayLike) -> _Parts:
    """The joints that turn with the moving ones (J,), the faces that turn and their vertices; those that stand and
    theirs. Kept for the last meshes."""
    turning = np.array(moving, dtype=np.bool_)
    key = id(mesh), turning.tobytes()
    kept = _KEPT.get(key)
    if kept is not None and kept[0] is mesh:
        return kept[1]
    for j, parent in enumerate(tree.parents.tolist()):
        turning[j] |= parent >= 0 and turning[parent]
    carried = (turning[mesh.skin_index] & (mesh.skin_weight > 0)).any(1)
    turns = carried[mesh.faces].any(1)
    faces = np.flatnonzero(turns), np.flatnonzero(~turns)
    vertices = [np.unique(mesh.faces[f]).astype(np.int64) for f in faces]
    while len(_KEPT) > 63:
        _KEPT.pop(next(iter(_KEPT)))
    found = [a.astype(np.int64) for a in (np.flatnonzero(turning), faces[0], vertices[0], faces[1], vertices[1])]
    parts: _Parts = (found[0], found[1], found[2], found[3], found[4])
    _KEPT[key] = mesh, parts
    return parts

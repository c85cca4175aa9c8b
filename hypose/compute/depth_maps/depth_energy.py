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


class StandingDepth(NamedTuple):
    """What of a body stands still while a limb is searched, drawn once."""

    pose: NDArray[np.float64]
    """(D,)"""
    rotations: NDArray[np.float64]
    """(J, 3, 3) of all joints at this pose"""
    centres: NDArray[np.float64]
    """(J, 3) m, from the root's position"""
    joints: NDArray[np.int64]
    """those that turn, in the tree's order"""
    faces: NDArray[np.int64]
    """those that turn"""
    vertices: NDArray[np.int64]
    """theirs"""
    drawn: NDArray[np.float32]
    """(C, h, w) m: the faces that stand"""
    cost: NDArray[np.float64]
    """(C,) pixels: theirs"""


def depth_energy(
    poses: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, threads: int | None = None
) -> NDArray[np.float64]:
    """(N, C) of poses (N, D): sum over the pixels that show the person and the drawn body of min(|z - z'|, most_m) /
    most_m, over the person's pixels; what only one of both shows is the silhouettes' affair. 0 for a view without the
    person. The same for any number of threads, and for a pose alone or among others."""
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    score, given = native("depth_maps.depth_energy").energies, (tidy(tree), tidy(mesh), *_against(seen, most_m))
    if len(q):
        over_chunks(lambda first, last: score(q, first, last, *given, out), len(q), threads, 16)
    return out / np.maximum(seen.counts, 1)


def standing_depth(
    pose: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, moving: ArrayLike
) -> StandingDepth:
    """What the joints `moving` (J,) bool, and those below them, do not move of a body at a pose (D,)."""
    q = plain(pose, np.float64)
    n = len(tree.parents)
    joints, faces, vertices, still = _parts(tree, mesh, moving)
    rotations, centres = np.empty((n, 3, 3)), np.empty((n, 3))
    drawn, cost = np.empty(seen.maps.shape, np.float32), np.zeros(len(seen.maps))
    against = _against(seen, most_m)
    draw = native("depth_maps.depth_energy").stand
    draw(q, tidy(tree), tidy(mesh), still, *against, rotations, centres, drawn, cost)
    return StandingDepth(q, rotations, centres, joints, faces, vertices, drawn, cost)


def limb_depth_energy(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    seen: SeenDepth,
    most_m: float,
    standing: StandingDepth,
    rough: bool = False,
    threads: int | None = None,
) -> NDArray[np.float64]:
    """`depth_energy` of poses that differ in a limb alone from what stands. rough: the limb is not drawn, each of its
    faces counts at its middle, which takes half the time."""
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    score, given = native("depth_maps.depth_energy").limb_energies, (tidy(tree), tidy(mesh), standing)
    against = _against(seen, most_m)
    if len(q):
        work = lambda first, last: score(q, first, last, *given, *against, rough, out)  # noqa: E731
        over_chunks(work, len(q), threads, 96 if rough else 16)
    return out / np.maximum(seen.counts, 1)


def limb_shown(
    tree: TreeArrays,
    mesh: MeshArrays,
    seen: SeenDepth,
    standing: StandingDepth,
    centre: ArrayLike,
    reach_m: float,
    apart_m: float,
) -> NDArray[np.float64]:
    """(C, 3) m^2, at the distance of a centre (3,) m, world, of the limb that was left out of what stands, in the pose
    that this was drawn at: what of it is in sight; what of that lies within apart_m of what the sensor saw; and what
    the sensor saw, no further than reach_m from the centre, that lies more than apart_m before all of the body, or
    beside it."""
    out = np.zeros((len(seen.maps), 3))
    maps, projections, sizes, apart = _against(seen, apart_m)
    at = plain(np.asarray(centre, dtype=np.float64) - standing.pose[:3], np.float64)
    show = native("depth_maps.depth_energy").limb_shown
    show(tidy(tree), tidy(mesh), standing, maps, projections, sizes, at, float(reach_m), apart, out)
    return out


def _against(
    seen: SeenDepth, most_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int64], np.float32]:
    return seen.maps, seen.projections, seen.sizes, np.float32(most_m)


_Indices = NDArray[np.int64]
_Parts = tuple[_Indices, _Indices, _Indices, _Indices]
_KEPT: dict[tuple[int, bytes], tuple[MeshArrays, _Parts]] = {}


def _parts(tree: TreeArrays, mesh: MeshArrays, moving: ArrayLike) -> _Parts:
    """The joints that turn with the moving ones (J,), the faces that turn, their vertices, and the faces that stand.
    Kept for the last meshes."""
    turning = np.array(moving, dtype=np.bool_)
    key = id(mesh), turning.tobytes()
    kept = _KEPT.get(key)
    if kept is not None and kept[0] is mesh:
        return kept[1]
    for j, parent in enumerate(tree.parents.tolist()):
        turning[j] |= parent >= 0 and turning[parent]
    carried = (turning[mesh.skin_index] & (mesh.skin_weight > 0)).any(1)
    turns = carried[mesh.faces].any(1)
    faces = np.flatnonzero(turns)
    while len(_KEPT) > 63:
        _KEPT.pop(next(iter(_KEPT)))
    found = np.flatnonzero(turning), faces, np.unique(mesh.faces[faces]).astype(np.int64), np.flatnonzero(~turns)
    _KEPT[key] = mesh, found
    return found

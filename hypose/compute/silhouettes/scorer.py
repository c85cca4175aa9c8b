"""Silhouettes of many poses against the masks of a frame: choice of the back end and of what has to be drawn."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import reference, selection
from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.native import native, plain, tidy
from hypose.compute.selection import over_chunks
from hypose.compute.silhouettes import lane_mesh, reach
from hypose.compute.silhouettes.lane_scratch import lane_scratch
from hypose.compute.solver.terms import PreparedMasks, Standing
from hypose.errors import InputError, SolverError

Array = NDArray[np.float64]


def silhouette_xor(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    boxes: ArrayLike | None = None,
    threads: int | None = None,
    faces: ArrayLike | None = None,
    moving: ArrayLike | None = None,
    rest: Standing | None = None,
) -> NDArray[np.int64]:
    """Silhouettes of the mesh at poses (N, D) against the frame's masks: (N, C, 3) = (xor, model, intersection) pixels.

    boxes (C, 4) = x0, x1, y0, y1 (half open, px) restricts the counting; default: each view's whole image. faces (F,)
    bool: only these triangles of the mesh, as seen from outside (body parts, where a hierarchical search has not placed
    the rest yet). moving (J,) bool: only these joints turn, everything else stands as in the last pose, and what they
    do not move is drawn once; rest: that drawing, where `reach.standing` has made it (then without boxes and faces).
    Views that are not usable give zeros. The same counts for any number of threads, and for a pose alone or among
    others. Exact up to 1-2 pixels of a silhouette whose edge passes through a pixel's centre.
    Parts nearer than 0.05 m to a camera's plane, or behind it, are cut off. A SolverError for poses that are not
    finite.
    """
    q = _finite(poses)
    n, c = len(q), len(prepared.masks)
    b = reach.whole_images(prepared)
    if boxes is not None:
        whole, b = b, np.array(boxes, dtype=np.int64)
        if b.shape != (c, 4):
            raise InputError(f"boxes needs one row x0, x1, y0, y1 per view: shape {(c, 4)}, got {b.shape}.")
        b = np.ascontiguousarray(np.clip(b, 0, whole[:, [1, 1, 3, 3]]))
        b[:, 1::2] = np.maximum(b[:, 1::2], b[:, ::2])
    wanted = None if faces is None else plain(faces, np.bool_)
    if wanted is not None and wanted.shape != (len(mesh.faces),):
        raise InputError(f"faces needs a truth value per face: shape {(len(mesh.faces),)}, got {wanted.shape}.")
    turning = None if moving is None else plain(moving, np.bool_)
    if turning is not None:
        q = np.where(turning[tree.joint_of_dof], q, q[-1:])
    if selection.backend() == "numpy":
        return reference.silhouette_xor(q, tree, mesh, prepared, b, wanted)
    t, prepared = tidy(tree), tidy(prepared)
    areas = prepared.areas
    if boxes is not None:
        areas = np.empty(c, dtype=np.int64)
        native("silhouettes.silhouettes").areas_in_boxes(prepared.masks, b, areas)
    drawn, drawn_counts, turned = _nothing(prepared.bits.shape), np.zeros((c, 2), dtype=np.int64), None
    if turning is not None and n:
        wanted, standing, corners, turned = lane_mesh.moving_parts(mesh, tree, turning, wanted)
        if rest is not None:
            drawn, drawn_counts = rest
        else:
            drawn = np.zeros_like(prepared.bits)
            native("silhouettes.standing").draw_standing(
                q[-1], t, tidy(mesh), corners, standing, prepared, b, drawn, drawn_counts
            )
            reach.hide(prepared, drawn, drawn_counts)
    elif prepared.hidden.size:
        drawn = prepared.hidden  # one more standing part, of somebody else: it counts nowhere
    m = lane_mesh.prepare(mesh, tree, wanted)
    turned = m.needed if turned is None else m.needed & turned
    kernels = native("silhouettes.lanes")
    out = np.zeros((n, c, 3), dtype=np.int64)

    def score(first: int, last: int) -> None:
        scratch = lane_scratch(m, prepared.masks.shape[1:], kernels.LANES, kernels.STRIP)
        kernels.silhouette_xor(
            *(q, first, last, t, m, m.needed, turned),
            *(prepared, prepared.usable, b, areas, drawn, drawn_counts, scratch, out),
        )

    over_chunks(score, -(-n // kernels.LANES), threads)
    return out


def limb_energies(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    moving: ArrayLike,
    rest: Standing | None = None,
    slack: float = 1.0,
    more: float = 0.0,
) -> Array:
    """(N,) energies (eq. 2.8) of poses (N, D) in which only the joints `moving` (J,) turn; infinite where they are
    certainly above `slack` times the energy of the first pose, and `more`. moving, rest: as for `silhouette_xor`.

    Most poses of a limb are worse than the one that it is in, and a view or two tell: a limb cannot explain more of a
    mask than what lies uncovered in its window. The others have the energies that `silhouette_xor` gives them.
    """
    use = prepared.usable
    if selection.backend() == "numpy":
        counts = silhouette_xor(poses, tree, mesh, prepared, moving=moving, rest=rest)
        return (counts[:, use, 0] / prepared.norm[use]).sum(1)
    q, turning = _finite(poses), plain(moving, np.bool_)
    q = np.where(turning[tree.joint_of_dof], q, q[-1:])
    prepared = tidy(prepared)
    drawn, drawn_counts = reach.standing(q[-1], tree, mesh, prepared, turning) if rest is None else rest
    parts = lane_mesh.moving_parts(mesh, tree, turning, None)
    m = lane_mesh.prepare(mesh, tree, parts.moved)
    lanes, limbs = native("silhouettes.lanes"), native("silhouettes.limbs")
    scratch = lane_scratch(m, prepared.masks.shape[1:], lanes.LANES, lanes.STRIP)
    cells = np.zeros((len(use), -(-drawn.shape[1] // limbs.CELL) + 1, drawn.shape[2] + 1), dtype=np.int32)
    counts, told = np.zeros((len(q), len(use), 3), dtype=np.int64), np.zeros(len(q), dtype=np.bool_)
    given = tidy(tree), m, m.needed & parts.turning, prepared, reach.whole_images(prepared), drawn, drawn_counts
    limbs.limb_energies(q, float(slack), float(more), *given, cells, scratch, counts, told)
    return np.where(told, (counts[:, use, 0] / prepared.norm[use]).sum(1), np.inf)


def _finite(poses: ArrayLike) -> Array:
    q = plain(poses, np.float64)
    if q.size and not np.abs(q).max() < 1e6:
        bad = int(np.argmax(~(np.abs(q).max(1) < 1e6)))
        raise SolverError(f"Pose {bad} of {len(q)} is not finite; check the motion model that made it.")
    return q


@lru_cache(4)
def _nothing(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    return np.zeros(shape, dtype=np.uint8)

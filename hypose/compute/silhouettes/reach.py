"""Limbs as a few points against masks: which of many poses of a limb lie where the rest of the body explains nothing.

Definition (numpy) and choice of the back end. The standing rest of the body is drawn once, and may be given to the
silhouette scorer again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import reference, selection
from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.native import native, plain, tidy
from hypose.compute.silhouettes import lane_mesh
from hypose.compute.solver.terms import PreparedMasks, Standing

Array = NDArray[np.float64]
_NEAR = 0.05  # as in cpu_reach.py, which must not be imported without numba


def standing(
    pose: ArrayLike, tree: TreeArrays, mesh: MeshArrays, prepared: PreparedMasks, moving: ArrayLike
) -> Standing:
    """The silhouettes at a pose (D,) of what the joints `moving` (J,) bool, and those below them, do not move."""
    q, turning = plain(pose, np.float64), plain(moving, np.bool_)
    parts = lane_mesh.moving_parts(mesh, tree, turning, None)
    bits, counts = np.zeros_like(prepared.bits), np.zeros((len(prepared.masks), 2), dtype=np.int64)
    if selection.backend() == "numpy":
        vertices = reference.skin(*reference.forward_kinematics(q[None], tree), tree, mesh)[0]
        for c in np.flatnonzero(prepared.usable):
            w, h = prepared.sizes[c].tolist()
            drawn = reference.rasterize(vertices, parts.corners, prepared.projections[c], (w, h), one_sided=True)
            packed = np.packbits(drawn, axis=1, bitorder="little")
            bits[c, :h, : packed.shape[1]] = packed
            counts[c] = drawn.sum(), (drawn & (prepared.masks[c, :h, :w] != 0)).sum()
        hide(prepared, bits, counts)
        return Standing(bits, counts)
    masks, boxes = tidy(prepared), whole_images(prepared)
    native("silhouettes.standing").draw_standing(
        q, tidy(tree), tidy(mesh), parts.corners, parts.standing, masks, boxes, bits, counts
    )
    hide(prepared, bits, counts)
    return Standing(bits, counts)


def whole_images(prepared: PreparedMasks) -> NDArray[np.int64]:
    """(C, 4) the boxes x0, x1, y0, y1 of whole views."""
    boxes = np.zeros((len(prepared.sizes), 4), dtype=np.int64)
    boxes[:, 1::2] = prepared.sizes
    return boxes


def hide(prepared: PreparedMasks, bits: NDArray[np.uint8], counts: NDArray[np.int64]) -> None:
    """Adds the pixels that say nothing to what stands (bits (C, h, B), counts (C, 2)), in place: they are drawn, so
    that nothing else counts there, and count themselves for nothing."""
    if prepared.hidden.size:
        counts[:, 0] -= np.bitwise_count(bits & prepared.hidden).sum((1, 2), dtype=np.int64)
        np.bitwise_or(bits, prepared.hidden, out=bits)


def score_points(
    points: ArrayLike,
    weights: ArrayLike,
    rotation: ArrayLike,
    centre: ArrayLike,
    prepared: PreparedMasks,
    rest: Standing,
    cutoff: float = np.inf,
) -> Array:
    """(N,) how badly points (N, P, 3) m lie, as a joint sees them that is turned by rotation (3, 3) and lies at centre
    (3,), world: the sum over usable views and points of weights (P,), plus where there is no mask, minus in the mask
    where the standing rest of the body is not; 0 on the rest, outside the image, and nearer than 0.05 m. Above the
    cutoff a score says no more than that it lies above it."""
    p, w = plain(points, np.float64), plain(weights, np.float64)
    r, c = plain(rotation, np.float64), plain(centre, np.float64)
    if selection.backend() == "numpy":
        return _reference(p, w, r, c, prepared, rest)
    out, masks, limit = np.empty(len(p)), tidy(prepared), float(cutoff)
    score = native("silhouettes.reach").score_points
    selection.over_chunks(
        lambda first, last: score(p[first:last], w, r, c, masks, rest.bits, limit, out[first:last]), len(p), None, 256
    )
    return out


def _reference(p: Array, w: Array, r: Array, c: Array, prepared: PreparedMasks, rest: Standing) -> Array:
    world = np.concatenate([p @ r.T + c, np.ones((*p.shape[:2], 1))], -1)
    out = np.zeros(len(p))
    for k in np.flatnonzero(prepared.usable):
        x = world @ prepared.projections[k].T
        front = x[..., 2] >= _NEAR
        at = np.floor(x[..., :2] / np.where(front, x[..., 2], 1.0)[..., None] + 0.5)
        seen = front & (at >= 0).all(-1) & (at < prepared.sizes[k]).all(-1)
        u, v = (np.where(seen, at[..., i], 0).astype(np.int64) for i in (0, 1))
        mask = prepared.open_masks[k, v, u] != 0
        drawn = (rest.bits[k, v, u >> 3] >> (u & 7).astype(np.uint8)) & 1 > 0
        out += (seen * w * np.where(mask, np.where(drawn, 0.0, -1.0), 1.0)).sum(1)
    return out

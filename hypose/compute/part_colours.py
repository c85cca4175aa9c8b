"""Which part of a body is in front in each pixel of the views, and how well the colours there are those of the part."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import PreparedMasks, plain
from hypose.compute.compiled import kernel
from hypose.compute.parts import projected
from hypose.compute.threads import over_chunks
from hypose.compute.zbuffer import draw_faces, draw_nearest, inverse_depth
from hypose.geometry import Array

_LIMB = 32
"""Labels of one limb; there are at most so many parts."""
_ENOUGH = 1500
"""Pixels of a person that tell as much as all."""
_STRONG = 3.0
"""Times of what colours usually change within a person that is a strong edge."""


def shown_parts(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    projection: ArrayLike,
    shape: tuple[int, int],
) -> tuple[NDArray[np.uint8], tuple[slice, slice]]:
    """Return (h, w) = shape: 1 + the part (F,) of the face in front, 0 where there is no body; and the rows and columns
    that the body is in. vertices (V, 3) m, projection (3, 4)."""
    out, (uv, z, reach) = np.zeros(shape, np.uint8), projected(vertices, projection)
    x0, y0 = (int(np.clip(np.ceil(reach[k, 0]), 0, shape[1 - k])) for k in range(2))
    x1, y1 = (int(np.clip(np.floor(reach[k, 1]) + 1, n, shape[1 - k])) for k, n in enumerate((x0, y0)))
    box = slice(y0, y1), slice(x0, x1)
    face = np.full((y1 - y0, x1 - x0), -1, np.int32)
    draw_faces(uv - (x0, y0), inverse_depth(z), faces, np.zeros(face.shape, np.float32), face, cull=True)
    out[box] = np.where(face >= 0, part[face] + 1, 0)
    return out, box


def _step(area: float) -> int:
    """Of a mask of this area every so many-th row and column is looked at."""
    return max(1, round(math.sqrt(area / _ENOUGH)))


def rim_edges(masks: PreparedMasks, edges: NDArray[np.uint8] | None) -> tuple[NDArray[np.float32], ...]:
    """For `colour_sums`: per view (2, h, w), at the pixels that it looks at, by how much the colours change more than
    within the mask on average, in times of what they usually change, at most 1. edges (C, 2, h, w); None: zeros."""
    out = list[NDArray[np.float32]]()
    for c, (w, h) in enumerate(masks.sizes.tolist()):
        step = _step(masks.areas[c])
        mask = masks.masks[c, :h:step, :w:step] > 0
        found = np.zeros((2, *mask.shape), np.float32)
        if edges is not None and masks.usable[c] and mask.any():
            near = np.ones((step, step), np.uint8)
            for k in range(2):
                seen = cv2.dilate(edges[c, k, :h, :w], near)[::step, ::step].astype(np.float32)
                seen = np.minimum(seen / (_STRONG * max(float(np.median(seen[mask])), 1.0)), 1.0)
                found[k] = seen - seen[mask].mean()
        out.append(found)
    return tuple(out)


def colour_sums(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    masks: PreparedMasks,
    codes: NDArray[np.uint16],
    table: NDArray[np.float32],
    limb: NDArray[np.uint8] | None = None,
    edges: tuple[NDArray[np.float32], ...] | None = None,
) -> tuple[Array, Array]:
    """Return (N, C): the sum of table (C, P, K), by part and colour, over the pixels of each view's mask in which a
    body with vertices (N, V, 3) m shows a part (F,); codes (C, h, w): the colours. And (N, C): the sum of edges
    (`rim_edges`) along the rims of limbs (F,) before others. 0 in views that are not usable. Of large masks every
    second pixel or so stands for those around it."""
    v = plain(vertices, np.float64)
    out, rims = np.zeros((2, len(masks.usable), len(v)))
    use, f = np.flatnonzero(masks.usable), plain(faces, np.int32)
    label = part if limb is None else (part + _LIMB * limb).astype(np.uint8)
    edges = rim_edges(masks, None) if edges is None else edges

    def work(first: int, last: int) -> None:
        for k in use[first:last].tolist():
            w, h = masks.sizes[k].tolist()
            step = _step(masks.areas[k])
            mask, colour = (np.ascontiguousarray(a[k, :h:step, :w:step]) for a in (masks.masks, codes))
            projection = plain(masks.projections[k] / [[step], [step], [1]], np.float64)
            seen = np.einsum("nvc,rc->nrv", v, projection[:, :3]) + projection[:, 3:]
            inverse = inverse_depth(seen[:, 2])
            uv = np.ascontiguousarray(seen[:, :2] * inverse[:, None])
            _colour_sums(uv, inverse, f, label, mask, colour, table[k], edges[k], out[k], rims[k])
            out[k] *= step * step
            rims[k] *= step

    over_chunks(work, len(use), None)
    return out.T, rims.T


GAP = 0.04
"""m: who lies so far before another has a rim."""


@kernel
def _colour_sums(uv, inverse, faces, part, mask, codes, table, edges, out, rims):
    """out (N,): sum of table (P, K), by part and colour, over the pixels of the mask (h, w) that show a part of bodies
    with vertices at uv (N, 2, V) px and inverse (N, V) 1/m; rims (N,): sum of edges (2, h, w) where one limb begins
    before another. part (F,): _LIMB times the limb, and the part."""
    h, w = mask.shape
    nearest, face, every = np.empty((h, w), np.float32), np.empty((h, w), np.int32), np.arange(faces.shape[0])
    for n in range(uv.shape[0]):
        nearest[:] = np.float32(0.0)
        face[:] = -1
        draw_nearest(uv[n, 0], uv[n, 1], inverse[n], faces, every, True, nearest, face)
        total, rim = 0.0, 0.0
        for r in range(h):
            for x in range(w):
                if face[r, x] < 0 or mask[r, x] == 0:
                    continue
                label = part[face[r, x]]
                total += table[label % _LIMB, codes[r, x]]
                for k in range(2):
                    s, y = r + k, x + 1 - k
                    if s < h and y < w and face[s, y] >= 0 and mask[s, y] != 0:
                        if label // _LIMB != part[face[s, y]] // _LIMB:
                            if abs(1.0 / nearest[r, x] - 1.0 / nearest[s, y]) > GAP:
                                rim += edges[k, r, x]
        out[n], rims[n] = total, rim

"""Which part of a body is in front in each pixel of the views, and how well the colours there are those of the part."""

from __future__ import annotations

import math
import threading

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native, plain
from hypose.compute.selection import over_chunks
from hypose.compute.solver.terms import PreparedMasks

Array = NDArray[np.float64]
_OWN = threading.local()
_SHAPES = 16
_ENOUGH = 1500
"""Pixels of a person that tell as much as all."""
_STRONG = 3.0
"""Times of what colours usually change within a person that is a strong edge."""
_LIMB = 32
"""As the kernel's LIMB."""


def _scratch(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """This thread's empty pictures (h, w), left empty again: made anew, their pages take longer than the drawing."""
    known: dict[tuple[int, ...], tuple[NDArray[np.float32], NDArray[np.uint8]]] = _OWN.__dict__.setdefault("known", {})
    if shape not in known:
        if len(known) > _SHAPES:
            known.clear()
        known[shape] = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    return known[shape]


def shown_parts(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    projection: ArrayLike,
    shape: tuple[int, int],
) -> tuple[NDArray[np.uint8], tuple[slice, slice]]:
    """(h, w) = shape: 1 + the part (F,) of the face in front, 0 where there is no body; and the rows and columns that
    the body is in. vertices (V, 3) m, projection (3, 4)."""
    out, box = np.zeros(shape, np.uint8), np.empty(4, np.int64)
    v, p, depth = plain(vertices, np.float64), plain(projection, np.float64), _scratch(shape)[0]
    kernels = native("pictures.shown_parts")
    kernels.draw_front(v, plain(faces, np.int32), part, p, depth, out, box)
    kernels.clear(depth, box)
    y0, y1, x0, x1 = (int(n) for n in box)
    return out, (slice(y0, max(y0, y1)), slice(x0, max(x0, x1)))


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
    """(N, C): the sum of table (C, P, K), by part and colour, over the pixels of each view's mask in which a body with
    vertices (N, V, 3) m shows a part (F,); codes (C, h, w): the colours. And (N, C): the sum of edges (`rim_edges`)
    along the rims of limbs (F,) before others. 0 in views that are not usable. Of large masks every second pixel or so
    stands for those around it."""
    v = plain(vertices, np.float64)
    out, rims = np.zeros((2, len(masks.usable), len(v)))
    use, f = np.flatnonzero(masks.usable), plain(faces, np.int32)
    sums = native("pictures.shown_parts").colour_sums
    label = part if limb is None else (part + _LIMB * limb).astype(np.uint8)
    edges = rim_edges(masks, None) if edges is None else edges

    def work(first: int, last: int) -> None:
        for k in use[first:last].tolist():
            w, h = masks.sizes[k].tolist()
            step = _step(masks.areas[k])
            mask, colour = (np.ascontiguousarray(a[k, :h:step, :w:step]) for a in (masks.masks, codes))
            projection = plain(masks.projections[k] / [[step], [step], [1]], np.float64)
            depth, shown = _scratch(mask.shape)
            sums(v, f, label, projection, mask, colour, table[k], edges[k], depth, shown, out[k], rims[k])
            out[k] *= step * step
            rims[k] *= step

    over_chunks(work, len(use), None)
    return out.T, rims.T

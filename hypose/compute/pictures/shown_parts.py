"""Which part of a body is in front in each pixel of the views, and how well the colours there are those of the part."""

from __future__ import annotations

import math
import threading

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


def colour_sums(
    vertices: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    masks: PreparedMasks,
    codes: NDArray[np.uint16],
    table: NDArray[np.float32],
) -> Array:
    """(N, C): the sum of table (C, P, K), by part and colour, over the pixels of each view's mask in which a body with
    vertices (N, V, 3) m shows a part (F,); codes (C, h, w): the colours; 0 in views that are not usable. Of large masks
    every second pixel or so stands for those around it."""
    v = plain(vertices, np.float64)
    out = np.zeros((len(masks.usable), len(v)))
    use, f = np.flatnonzero(masks.usable), plain(faces, np.int32)
    sums = native("pictures.shown_parts").colour_sums

    def work(first: int, last: int) -> None:
        for k in use[first:last].tolist():
            w, h = masks.sizes[k].tolist()
            step = max(1, round(math.sqrt(masks.areas[k] / _ENOUGH)))
            mask, colour = (np.ascontiguousarray(a[k, :h:step, :w:step]) for a in (masks.masks, codes))
            projection = plain(masks.projections[k] / [[step], [step], [1]], np.float64)
            depth, shown = _scratch(mask.shape)
            sums(v, f, part, projection, mask, colour, table[k], depth, shown, out[k])
            out[k] *= step * step

    over_chunks(work, len(use), None)
    return out.T

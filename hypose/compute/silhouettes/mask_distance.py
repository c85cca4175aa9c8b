"""Signed distance of masks: a chamfer transform inside the box that matters; and masks by half pixels smaller."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native, plain


def signed_distance(masks: ArrayLike, sizes: ArrayLike, margin: int | None = None) -> NDArray[np.float32]:
    """Signed distance to the edge of each mask, px, negative inside; 0 between the last inside and first outside pixel.

    masks (C, h, w) uint8, non-zero = person; sizes (C, 2) own width and height of each view. Returns (C, h, w)
    float32, zero in the padding. margin: px around the mask inside which the distance is a true one (default: a sixth
    of the mask's larger side, at least 32); further out the rows and columns to that box are added, a continuous
    upper bound. An empty (full) mask gives the image's diagonal (minus it) everywhere. Distances are those of a 5 x 5
    chamfer mask (within 2 % of Euclid, cpu_chamfer)."""
    m = np.asarray(masks)
    m = m if m.dtype == np.uint8 else (m != 0).view(np.uint8)
    out = np.empty(m.shape, dtype=np.float32)
    for c, (w, h) in enumerate(np.asarray(sizes, dtype=np.int64).tolist()):
        out[c, h:] = 0
        out[c, :, w:] = 0
        view = m[c, :h, :w]
        x, y, bw, bh = cv2.boundingRect(view)
        if bw == 0 or (bw * bh == w * h and cv2.countNonZero(view) == w * h):
            diagonal = float(np.hypot(w, h))
            out[c, :h, :w] = diagonal if bw == 0 else -diagonal
            continue
        pad = max(32, max(bw, bh) // 6) if margin is None else margin
        x0, x1, y0, y1 = max(x - pad, 0), min(x + bw + pad, w), max(y - pad, 0), min(y + bh + pad, h)
        box = plain(view[y0:y1, x0:x1], np.uint8)
        # the inside needs the mask's own box only, and one background pixel around it where there is one
        own_x, own_y = max(x - 1 - x0, 0), max(y - 1 - y0, 0)
        own_w, own_h = min(x + bw + 1, x1) - x0 - own_x, min(y + bh + 1, y1) - y0 - own_y
        if selection.backend() == "numpy":
            out[c, :h, :w] = _spread(_signed(box), (x0, y0), (w, h))
        else:
            native("silhouettes.chamfer").signed_distance(box, x0, y0, own_x, own_y, own_w, own_h, out[c, :h, :w])
    return out


def shrink_mask(mask: NDArray[np.uint8], halves: int) -> NDArray[np.uint8]:
    """(2 h / halves, 2 w / halves) of a mask (h, w), non-zero = person, whose sides are multiples of halves: of each
    block of halves x halves pixels 2 x 2 are made, set where at least half of their area is."""
    h, w = mask.shape
    out = np.empty((2 * (h // halves), 2 * (w // halves)), np.uint8)
    native("silhouettes.chamfer").shrink_mask(np.ascontiguousarray(mask), halves, out)
    return out


def _signed(box: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The definition of cpu_chamfer.signed_distance in a box."""
    outside, inside = _distances(box != 0), _distances(box == 0)
    fifth, half = np.float32(0.2), np.float32(0.5)
    return np.where(inside > 0, half - fifth * inside, fifth * outside - half)


def _distances(target: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The definition of cpu_chamfer.distances: down over the rows, then up."""
    kernels = native("silhouettes.chamfer")
    a, b, c, far = kernels.STRAIGHT, kernels.DIAGONAL, kernels.KNIGHT, kernels.FAR
    h, w = target.shape
    d = np.full((h + 4, w + 4), far, np.int64)
    d[2:-2, 2:-2][target] = 0
    along = a * np.arange(w)
    for step in (-1, 1):
        for y in range(2, h + 2)[::-step]:
            near, after = d[y + step], d[y + 2 * step]
            line = np.minimum.reduce(
                [d[y, 2:-2], near[2:-2] + a, near[1:-3] + b, near[3:-1] + b, near[:-4] + c, near[4:] + c]
                + [after[1:-3] + c, after[3:-1] + c]
            )[::-step]
            d[y, 2:-2] = (np.minimum.accumulate(line - along) + along)[::-step]
    return d[2:-2, 2:-2].astype(np.float32)


def _spread(distance: NDArray[np.float32], corner: tuple[int, int], size: tuple[int, int]) -> NDArray[np.float32]:
    """Distances in a box at a corner (x, y), and beyond it in an image of size (w, h)."""
    (x0, y0), (w, h) = corner, size
    x1, y1 = x0 + distance.shape[1], y0 + distance.shape[0]
    full = np.pad(distance, ((y0, h - y1), (x0, w - x1)), mode="edge")
    columns, rows = np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32)
    full += np.maximum(np.maximum(x0 - columns, columns - (x1 - 1)), 0)
    full += np.maximum(np.maximum(y0 - rows, rows - (y1 - 1)), 0)[:, None]
    return full

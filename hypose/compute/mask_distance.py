"""Compute the signed distance of masks by a chamfer transform in whole numbers, the same on every processor; shrink
masks by half pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.simd import at_most, cast, lane, load, ramp, shuffle, splat, store

f4 = np.float32
i2 = np.int16
STRAIGHT, DIAGONAL, KNIGHT = 5, 7, 11
"""Lengths of the steps to the next pixel, across a corner and by a knight's move, in fifths of a pixel.

Source: Borgefors, G. (1986). Distance transformations in digital images. CVGIP 34 (within 2 % of Euclid).
"""
_FARTHEST = 16000
"""Fifths of a pixel (3200 px); larger distances count as this."""


STEPS = 32
"""Number of int16 values of a row that are compared at once."""
_backwards = shuffle(range(STEPS - 1, -1, -1))
_on_1, _on_2, _on_4, _on_8, _on_16 = (shuffle(range(STEPS - k, 2 * STEPS - k)) for k in (1, 2, 4, 8, 16))
"""Functions (x, y) that shift the lanes of y by so many, with the last lanes of x before them."""


@kernel
def nearest_from(line, step, far, right):
    """Compute the distance transform along a row in one direction, in place, several numbers at a time.

    line: (n,) i2; the n // STEPS * STEPS numbers at its left end (or right end, where `right`) get the least of line[k]
        + step |i - k| over all k on that side, and themselves.
    far: value beyond the end. All numbers fit into 16 bits.
    """
    n, step, beyond = line.shape[0], i2(step), splat(i2(far), STEPS)
    carry, away = i2(far), (cast(ramp(STEPS), i2) + i2(1)) * step
    for first in range(0, n // STEPS * STEPS, STEPS):
        at = n - STEPS - first if right else first
        value = load(line, at, STEPS)
        value = _backwards(value, value) if right else value
        value = at_most(value, _on_1(beyond, value) + step)
        value = at_most(value, _on_2(beyond, value) + i2(2 * step))
        value = at_most(value, _on_4(beyond, value) + i2(4 * step))
        value = at_most(value, _on_8(beyond, value) + i2(8 * step))
        value = at_most(value, _on_16(beyond, value) + i2(16 * step))
        value = at_most(value, away + carry)
        carry = lane(value, STEPS - 1)
        store(line, at, _backwards(value, value) if right else value)


@kernel
def _by_other_rows(line, near, far):
    """Shorten the distances of a row (w,) i2 by steps from the next row and the one after (w + 4,), which begin two
    pixels to the left.

    line: (w,) i2 fifths of a pixel.
    near, far: (w + 4,) i2 the next row, and the one after.
    """
    w = line.shape[0]
    for x in range(w):
        d = min(line[x], i2(near[x + 2] + i2(STRAIGHT)))
        d = min(d, i2(near[x + 1] + i2(DIAGONAL)))
        d = min(d, i2(near[x + 3] + i2(DIAGONAL)))
        d = min(d, i2(near[x] + i2(KNIGHT)))
        d = min(d, i2(near[x + 4] + i2(KNIGHT)))
        d = min(d, i2(far[x + 1] + i2(KNIGHT)))
        line[x] = min(d, i2(far[x + 3] + i2(KNIGHT)))


@kernel
def _along(line, first, last):
    """Shorten the distances first..last of a row (w,) i2 by steps from its pixels on the left."""
    d = line[first - 1] if first > 0 else i2(_FARTHEST)
    for x in range(first, last):
        d = min(line[x], i2(d + i2(STRAIGHT)))
        line[x] = d


@kernel
def _distances(mask, target, out):
    """Compute the distance of each pixel of the mask (h, w) to the nearest pixel that is (target 1) or is not (0) set.

    out: (h, w + 4) i2, gets fifths of a pixel from column 2 on; _FARTHEST where there is none.
    """
    h, w = mask.shape
    beyond = np.full(w + 4, _FARTHEST, np.int16)
    for y in range(h):
        row, inside, m = out[y], out[y, 2 : w + 2], mask[y]
        row[0], row[1], row[w + 2], row[w + 3] = i2(_FARTHEST), i2(_FARTHEST), i2(_FARTHEST), i2(_FARTHEST)
        for x in range(w):
            inside[x] = i2(0) if (m[x] != 0) == (target != 0) else i2(_FARTHEST)
        _by_other_rows(inside, out[y - 1] if y > 0 else beyond, out[y - 2] if y > 1 else beyond)
        nearest_from(inside, STRAIGHT, _FARTHEST, False)
        _along(inside, w // STEPS * STEPS, w)
    for y in range(h - 1, -1, -1):
        inside = out[y, 2 : w + 2]
        _by_other_rows(inside, out[y + 1] if y < h - 1 else beyond, out[y + 2] if y < h - 2 else beyond)
        nearest_from(inside, STRAIGHT, _FARTHEST, True)
        _along(inside[::-1], w // STEPS * STEPS, w)


@kernel
def _signed_distance(box, x0, y0, own_x, own_y, own_w, own_h, out):
    """Compute the signed distance to the edge of a mask, px, into out (h, w) f4.

    box: (bh, bw) u1, part of the mask at (x0, y0). Outside of it, rows and columns to the box are added.
    own_x, own_y, own_w, own_h: rectangle in the box that holds all of the mask, and a rim of background where there is
        one.
    """
    h, w = out.shape
    bh, bw = box.shape
    outside = np.empty((bh, bw + 4), np.int16)
    inside = np.empty((own_h, own_w + 4), np.int16)
    _distances(box, 1, outside)
    _distances(box[own_y : own_y + own_h, own_x : own_x + own_w], 0, inside)
    for y in range(bh):
        line, made = outside[y, 2 : bw + 2], out[y0 + y, x0 : x0 + bw]
        for x in range(bw):  # the edge lies half a pixel from the centres on both sides
            made[x] = f4(0.2) * f4(line[x]) - f4(0.5)
        if own_y <= y < own_y + own_h:
            line, made = inside[y - own_y, 2 : own_w + 2], out[y0 + y, x0 + own_x : x0 + own_x + own_w]
            for x in range(own_w):
                made[x] = f4(0.5) - f4(0.2) * f4(line[x]) if line[x] > 0 else made[x]
        made = out[y0 + y]
        edge = made[x0]
        for x in range(x0):
            made[x] = edge + f4(x0 - x)
        edge = made[x0 + bw - 1]
        for x in range(x0 + bw, w):
            made[x] = edge + f4(x - x0 - bw + 1)
    for y in range(y0):
        made, line = out[y], out[y0]
        for x in range(w):
            made[x] = line[x] + f4(y0 - y)
    for y in range(y0 + bh, h):
        made, line = out[y], out[y0 + bh - 1]
        for x in range(w):
            made[x] = line[x] + f4(y - y0 - bh + 1)


@kernel
def _shrink_mask(mask, halves, out):
    """Shrink a mask (h, w) to out (2 h / halves, 2 w / halves) u1: 1 where at least half of the pixel's area is set.

    Areas are counted in quarters of a pixel, of which each new pixel has halves x halves.
    """
    whole, middle = halves // 2, halves & 1
    sums = np.empty(mask.shape[1], np.uint16)
    for r in range(out.shape[0]):
        first = (r >> 1) * halves + (whole + middle) * (r & 1)
        sums[:] = 0
        for y in range(first, first + whole):
            row = mask[y]
            for x in range(sums.shape[0]):
                sums[x] = np.uint16(sums[x] + np.uint16(2) * np.uint16(row[x] != 0))
        if middle:  # is shared by two rows
            row = mask[(r >> 1) * halves + whole]
            for x in range(sums.shape[0]):
                sums[x] = np.uint16(sums[x] + np.uint16(row[x] != 0))
        line = out[r]
        if halves == 3:  # by far the most frequent, and it vectorises
            for b in range(line.shape[0] // 2):
                shared = 2 * sums[3 * b + 1]
                line[2 * b] = np.uint8(np.uint16(4 * sums[3 * b] + shared) >= np.uint16(9))
                line[2 * b + 1] = np.uint8(np.uint16(4 * sums[3 * b + 2] + shared) >= np.uint16(9))
            continue
        for b in range(line.shape[0] // 2):
            left, right = 0, 0
            for k in range(whole):
                left += 2 * sums[b * halves + k]
                right += 2 * sums[b * halves + halves - 1 - k]
            shared = sums[b * halves + whole] if middle else 0
            line[2 * b] = np.uint8(2 * (left + shared) >= halves * halves)
            line[2 * b + 1] = np.uint8(2 * (right + shared) >= halves * halves)


def signed_distance(masks: ArrayLike, sizes: ArrayLike, margin: int | None = None) -> NDArray[np.float32]:
    """Compute the signed distance to the edge of each mask, px, negative inside.

    masks: (C, h, w) uint8, non-zero = person.
    sizes: (C, 2) width and height of each view.
    margin: px around the mask within which the distance is exact; None: a sixth of the mask's larger side, at least 32.
        Farther out the rows and columns to that box are added: a continuous upper bound.
    Returns: (C, h, w) float32, zero in the padding. The zero lies between the last inside and the first outside pixel.
        An empty (full) mask gives the image's diagonal (minus it) everywhere.

    Distances are those of a 5 x 5 chamfer mask (within 2 % of Euclid).
    """
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
        _signed_distance(box, x0, y0, own_x, own_y, own_w, own_h, out[c, :h, :w])
    return out


def shrink_mask(mask: NDArray[np.uint8], halves: int) -> NDArray[np.uint8]:
    """Shrink a mask: of each block of halves x halves pixels, 2 x 2 are made, set where at least half of their area is
    set.

    mask: (h, w), non-zero = person; both sides are multiples of halves.
    Returns: (2 h / halves, 2 w / halves).
    """
    h, w = mask.shape
    out = np.empty((2 * (h // halves), 2 * (w // halves)), np.uint8)
    _shrink_mask(np.ascontiguousarray(mask), halves, out)
    return out

"""numba: decoded picture -> working size -> what is not the room. The plain definitions in picture_to_mask.py give the
same bytes."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.pictures.cpu_mask_bits import close_to, opened
from hypose.compute.pictures.cpu_pixels import (
    GROUP,
    STRIP,
    blended_row,
    darker,
    outside,
    weighted_row,
    weighted_rows,
)

f4 = np.float32
u2 = np.uint16
u8 = np.uint64


@kernel
def shrink(image, columns, column_weights, rows, row_weights, rounding, y0, y1, x0, x1, out, begin, stride):
    """Area average of image (H, W, 3) u1 for y0 <= y < y1, x0 <= x < x1: pixel (y, x) is three bytes of out (u1) from
    begin + stride y + 3 x on. See picture_to_mask.Lens; the byte after each row becomes 0."""
    taps, lines = column_weights.shape[1], row_weights.shape[1]
    first, last = columns[x0], columns[x1 - 1] + taps
    width, line = 3 * (last - first), 3 * image.shape[1]
    half, shift = rounding[0], rounding[1]
    picture, down, right = image.reshape(-1), row_weights.reshape(-1), column_weights.reshape(-1)
    sums = np.empty(width + 2, np.uint16)
    for y in range(y0, y1):
        at = rows[y] * line + 3 * first
        if width >= STRIP:
            weighted_rows(picture, at, line, down, y * lines, lines, half, shift, width, sums)
        else:
            for i in range(width):
                total = u2(half)
                for k in range(lines):
                    total = u2(total + row_weights[y, k] * picture[at + k * line + i])
                sums[i] = total >> u2(shift)
        to = begin + stride * y + 3 * x0
        weighted_row(sums, columns, first, right, taps, rounding[2], rounding[3], rounding[4], x0, x1, out, to)


@kernel
def remap(small, corner, part, shares, y0, y1, x0, x1, out):
    """out (3 h w + 1,) u1, pixels in the box = those of the flat picture small (h + 3, w + 3) u1 at corner (h, w) and
    beside it, with shares[part (h, w)] (K, 4) in 1024ths."""
    w = corner.shape[1]
    corners, parts, four, step = corner.reshape(-1), part.reshape(-1), shares.reshape(-1), 3 * (w + 3)
    for y in range(y0, y1):
        n = y * w + x0
        blended_row(small, step, corners, parts, four, n, x1 - x0, out, 3 * n)


@kernel
def differ(image, low, high, mean, shadow, darkest, lightest, chroma, y0, y1, x0, x1, block, bits):
    """bits (words, h) u8, zero before: the pixels in the box where image (h, w, 3) u1 is not the room, and not in its
    shadow either. See picture_to_mask.not_the_room; block: the spans of 3 x 3 pixels. It has GROUP pixels at least."""
    h, w = image.shape[:2]
    picture, least, most, room = image.reshape(-1), low.reshape(-1), high.reshape(-1), mean.reshape(-1)
    last = h * w - GROUP
    for y in range(y0, y1):
        for x in range(x0 // GROUP * GROUP, x1, GROUP):  # and what comes after the row, if anything
            n = y * w + x
            at = min(n, last)
            bits[x >> 6, y] |= (outside(picture, least, most, 3 * at) >> u8(n - at)) << u8(x & 63)
    box = np.empty(4, np.int64)
    box[0], box[1], box[2], box[3] = y0, y1, x0, x1
    close_to(bits, box)
    if not shadow:
        return
    dark, some = np.zeros_like(bits), u8(0)
    for y in range(y0, y1):
        for k in range(x0 >> 6, (x1 + 63) >> 6):
            for first in range(0, 64, GROUP):
                if (bits[k, y] >> u8(first)) & u8(0xFFFF) == 0:
                    continue
                n = y * w + 64 * k + first
                at = min(n, last)
                shade = darker(picture, room, 3 * at, darkest, lightest, chroma) >> u8(n - at)
                dark[k, y] |= shade << u8(first)
            dark[k, y] &= bits[k, y]
            some |= dark[k, y]
    if some != 0:
        shadows = np.empty_like(dark)
        opened(dark, block, box, shadows)
        for k in range(x0 >> 6, (x1 + 63) >> 6):
            for y in range(y0, y1):
                bits[k, y] &= ~shadows[k, y]


@kernel
def order_statistic(stack, hidden, rank, out):
    """out (P, 3) u1 of stack (N, P, 3) u1: see picture_to_mask.order_statistic; hidden (N or 0, P) bool, rank (P,) u2.

    The value is found bit by bit: how many are smaller than it would be with this bit? All in vector lanes."""
    n, pixels = stack.shape[0], stack.shape[1]
    block = 128
    guess, found, below = np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint16)
    wanted = np.empty(3 * block, np.uint16)
    flat = stack.reshape(n, 3 * pixels)
    free = np.empty((n, 3 * block), np.uint8)
    result = out.reshape(-1)
    for first in range(0, pixels, block):
        size = 3 * min(block, pixels - first)
        for i in range(size):
            wanted[i] = rank[first + i // 3]
            found[i] = 0
        for k in range(hidden.shape[0]):
            for i in range(size):
                free[k, i] = 1 - hidden[k, first + i // 3]
        for bit in range(7, -1, -1):
            for i in range(size):
                guess[i] = found[i] | np.uint8(1 << bit)
                below[i] = 0
            for k in range(n):
                line = flat[k, 3 * first : 3 * first + size]
                if hidden.shape[0] > 0:
                    seen = free[k]
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16((line[i] < guess[i]) & seen[i]))
                else:
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16(line[i] < guess[i]))
            for i in range(size):
                if below[i] <= wanted[i]:
                    found[i] = guess[i]
        for i in range(size):
            result[3 * first + i] = found[i]

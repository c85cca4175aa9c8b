"""Masks as bits, cleaned, and as runs of pixels.

Bits (words, h) u8 hold 64 pixels of a row in a word, lowest bit first, zero beyond the mask's width; the words of a
column lie next to each other, so that work on all rows is vectorised. A box (4,) is y0, y1, x0, x1, half open, px.
Spans (n, 4) describe a structuring element: rows first..last relative to a pixel, and in each the columns left..right,
all inclusive.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.simd import lowest_bit, popcount
from hypose.geometry import Mask

Bits = NDArray[np.uint64]
"""(words, h) of a mask (h, w): 64 pixels of a row in a word, lowest bit first, zero beyond the width."""


class Cleaning(NamedTuple):
    """Settings of how a mask is cleaned, in this order.

    open_px: side of the square of the opening (0, 1: none).
    close_px: diameter of the disc of the closing (0, 1: none).
    hole_px: holes up to this area are filled (background connected over edges only).
    keep_share: besides the largest region (connected over corners too), regions of at least this share of its area are
        kept (1: none).
    keep_gap: largest distance of the box of such a region from the box of the largest, in longer sides of that.
    """

    open_px: int = 0
    close_px: int = 0
    hole_px: int = 0
    keep_share: float = 0.0
    keep_gap: float = 1e9


class MaskRuns(NamedTuple):
    """Mask as the runs of set pixels of its rows, in a few thousand bytes.

    code: (n, 3) row, first column and column after the last one of each run, from the top left to the bottom right.
    shape: (h, w) shape of the mask.
    box: y0, y1, x0, x1 around the mask (zeros where it is empty).
    area: px.
    """

    code: NDArray[np.uint16]
    shape: tuple[int, int]
    box: tuple[int, int, int, int]
    area: int


def no_bits(h: int, w: int) -> Bits:
    """Allocate the packed bits (64-bit words, h) of an empty mask of h rows and w columns."""
    return np.zeros(((w + 63) // 64, h), np.uint64)


def bits_of(mask: Mask) -> Bits:
    """Pack a mask (h, w), non-zero = set, to one bit per pixel."""
    bits = no_bits(*mask.shape)
    _bits_of(plain(mask, np.uint8), bits)
    return bits


def mask_of(bits: Bits, width: int) -> Mask:
    """Convert packed bits, one per pixel, to a mask (h, width) of 0 and 1."""
    rows = np.ascontiguousarray(bits.T).view(np.uint8)
    return np.unpackbits(rows, axis=1, count=width, bitorder="little")


def clean(bits: Bits, shape: tuple[int, int], how: Cleaning) -> MaskRuns:
    """Clean a mask.

    bits: the mask, packed to one bit per pixel (`bits_of`); they are changed.
    shape: (h, w) shape of the mask.
    how: settings.
    Returns: the cleaned mask as runs.
    """
    about = np.zeros(5, np.int64)
    spans = element_spans(how.open_px), element_spans(how.close_px, True)
    rules = how.close_px + 1, int(how.hole_px), float(how.keep_share), float(min(how.keep_gap, 1e9))
    code = _clean(bits, shape[1], *spans, *rules, about)
    y0, y1, x0, x1, area = about.tolist()
    return MaskRuns(code, shape, (y0, y1, x0, x1), area)


def runs_of(mask: Mask) -> MaskRuns:
    """Convert a mask (h, w), non-zero = set, to runs without cleaning it."""
    return clean(bits_of(mask), (mask.shape[0], mask.shape[1]), Cleaning())


def draw(runs: MaskRuns, out: Mask | None = None, corner: tuple[int, int] = (0, 0)) -> Mask:
    """Draw runs as a mask.

    runs: runs of the mask.
    out: picture in which pixels are set, whose first pixel is the corner (y, x) of the mask; None: a new mask (h, w).
    Returns: that picture.
    """
    made = np.zeros(runs.shape, np.uint8) if out is None else out
    _draw(runs.code, made, *corner)
    return made


def disc(size: int) -> Mask:
    """Make OpenCV's disc (size, size), 1 inside; size: diameter, px."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


@lru_cache(maxsize=256)
def element_spans(size: int, round_: bool = False) -> NDArray[np.int64]:
    """Convert a structuring element to spans (n, 4), as the module describes them.

    size: side of a square or diameter of OpenCV's disc, px; below 2 there are no spans, and nothing changes.
    round_: a disc, not a square.
    Successive rows with the same columns are one span; the centre is at size // 2, as in OpenCV.
    """
    element, spans = disc(size) if round_ and size > 1 else np.ones((size, size)), list[list[int]]()
    for y, row in enumerate(element if size > 1 else ()):
        x = np.flatnonzero(row) - size // 2
        if spans and spans[-1][2:] == [x[0], x[-1]]:
            spans[-1][1] += 1
        else:
            spans.append([y - size // 2, y - size // 2, x[0], x[-1]])
    return np.array(spans, dtype=np.int64).reshape(-1, 4)


def warm_up() -> None:
    """Compile (or load from the cache) every kernel of this module on a toy mask."""
    mask = np.ones((4, 5), np.uint8)
    draw(clean(bits_of(mask), (4, 5), Cleaning(3, 3, 1, 0.5, 1.0)))


u8 = np.uint64
ALL = u8(0xFFFFFFFFFFFFFFFF)


@kernel(inline=True)
def word_of(eights, k):
    """Pack 64 pixels of a row into one 64-bit word.

    eights: (8 words,) uint64, eight pixels each, one byte (0 or 1) per pixel.
    k: index of the word.
    """
    word = u8(0)
    for i in range(8):  # the lowest bits of eight bytes, times this, become the highest byte
        word |= ((eights[8 * k + i] * u8(0x0102040810204080)) >> u8(56)) << u8(8 * i)
    return word


@kernel
def _bits_of(mask, bits):
    """Write bits (words, h) u8 of a mask (h, w) u1, non-zero = set."""
    h, w = mask.shape
    padded = np.zeros(64 * bits.shape[0], np.uint8)
    eights = padded.view(np.uint64)
    for y in range(h):
        row = mask[y]
        for x in range(w):
            padded[x] = row[x] != 0
        for k in range(bits.shape[0]):
            bits[k, y] = word_of(eights, k)


@kernel
def _within(box, k):
    """Make the word whose set bits are the columns of word k that lie in the box (4,)."""
    low, high = max(box[2] - 64 * k, 0), min(box[3] - 64 * k, 64)
    if low >= high:
        return u8(0)
    return (ALL << u8(low)) & (ALL >> u8(64 - high))


@kernel
def close_to(bits, box):
    """Clear the pixels that lie in the rows of a box but outside its columns.

    bits: (words, h) packed mask.
    box: rows and columns.
    """
    for k in range(bits.shape[0]):
        inside, column = _within(box, k), bits[k, box[0] : box[1]]
        for i in range(column.shape[0]):
            column[i] &= inside


@kernel
def grown(bits, spans, box, flip, out):
    """Dilate a packed mask by a structuring element, within a box.

    spans: (n, 4) the structuring element (`element_spans`).
    flip: 0; or ALL: the unset pixels are dilated, and out gets the rest (erosion).
    out: gets the result in the box.
    """
    begin, words, n = box[2] >> 6, ((box[3] + 63) >> 6) - (box[2] >> 6), box[1] - box[0]
    union = np.zeros((words + 2, n), np.uint64)  # of the rows of a span; a word more on both sides
    for k in range(words):
        out[begin + k, box[0] : box[1]] = 0
    for s in range(spans.shape[0]):
        left, right = spans[s, 2], spans[s, 3]
        for k in range(words):
            inside, column, made = _within(box, begin + k), bits[begin + k, box[0] : box[1]], union[k + 1]
            made[:] = 0
            for d in range(spans[s, 0], spans[s, 1] + 1):
                for i in range(max(-d, 0), n - max(d, 0)):
                    made[i] |= (column[i + d] ^ flip) & inside
        for k in range(words):
            before, here, after = union[k], union[k + 1], union[k + 2]
            made = out[begin + k, box[0] : box[1]]
            if left <= 0 <= right:
                for i in range(n):
                    made[i] |= here[i]
            for d in range(max(left, 1), right + 1):
                for i in range(n):
                    made[i] |= (here[i] >> u8(d)) | (after[i] << u8(64 - d))
            for d in range(max(-right, 1), 1 - left):
                for i in range(n):
                    made[i] |= (here[i] << u8(d)) | (before[i] >> u8(64 - d))
    for k in range(words):
        inside, made = _within(box, begin + k), out[begin + k, box[0] : box[1]]
        for i in range(n):
            made[i] = (made[i] ^ flip) & inside


@kernel
def opened(bits, spans, box, out):
    """Compute the morphological opening of a packed mask within a box, into out.

    spans: (n, 4) the structuring element (`element_spans`). Pixels beyond the box count as set for the erosion, and
        as unset for the dilation.
    """
    less = np.zeros_like(bits)
    grown(bits, spans, box, ALL, less)
    grown(less, spans, box, u8(0), out)


@kernel
def _bounds(bits, box):
    """Find the box around the set pixels.

    bits: bits of the mask.
    box: (4,) gets y0, y1, x0, x1.
    Returns: False for an empty mask.
    """
    words, h = bits.shape
    rows, columns = np.zeros(h, np.uint64), np.zeros((words, 1), np.uint64)
    for k in range(words):
        column = bits[k]
        for y in range(h):
            rows[y] |= column[y]
        some = u8(0)
        for y in range(h):
            some |= column[y]
        columns[k, 0] = some
    box[0], box[1], box[2], box[3] = 0, h, _next(columns, 0, 0, 64 * words, u8(0)), 64 * words
    if box[2] == box[3]:
        return False
    while rows[box[0]] == 0:
        box[0] += 1
    while rows[box[1] - 1] == 0:
        box[1] -= 1
    while (columns[(box[3] - 1) >> 6, 0] >> u8((box[3] - 1) & 63)) & u8(1) == 0:
        box[3] -= 1
    return True


@kernel
def _next(bits, y, x, end, flip):
    """Find the first column from x on whose bit is set in row y of bits ^ flip; `end` where there is none before."""
    if x >= end:
        return end
    k = x >> 6
    word = (bits[k, y] ^ flip) & (ALL << u8(x & 63))
    while word == 0:
        k += 1
        if 64 * k >= end:
            return end
        word = bits[k, y] ^ flip
    return min(64 * k + lowest_bit(word), end)


@kernel
def _fill(bits, y, x0, x1):
    """Set the pixels x0 to x1 (not included) of row y in bits (words, h)."""
    for k in range(x0 >> 6, (x1 + 63) >> 6):
        low, high = max(x0 - 64 * k, 0), min(x1 - 64 * k, 64)
        bits[k, y] |= (ALL << u8(low)) & (ALL >> u8(64 - high))


@kernel
def _root(parent, i):
    """Find the first run of the region of run i, and shorten the path to it in `parent` (n,)."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _label(bits, box, flip, reach, runs, parent):
    """Find the runs of the pixels set in bits ^ flip in the box, and join them to regions.

    reach: 1: regions are connected over corners too; 0: over edges only.
    runs: (n, 3) gets row, start, end.
    parent: (n,) gets the first run of the region.
    Returns: number of runs.
    """
    n = 0
    before = 0  # first run of the row above
    for y in range(box[0], box[1]):
        begin, other = n, before
        x = _next(bits, y, box[2], box[3], flip)
        while x < box[3]:
            end = _next(bits, y, x, box[3], ~flip)
            runs[n, 0], runs[n, 1], runs[n, 2], parent[n] = y, x, end, n
            while other < begin and runs[other, 2] + reach <= x:
                other += 1
            k = other
            while k < begin and runs[k, 1] < end + reach:
                a, b = _root(parent, k), _root(parent, n)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
                k += 1
            n += 1
            x = _next(bits, y, end, box[3], flip)
        before = begin
    return n


@kernel
def _most_runs(bits, box):
    """Compute an upper bound of the number of runs, of set or of unset pixels, in the box (4,) of bits (words, h)."""
    total = box[1] - box[0]
    for k in range(bits.shape[0]):
        for y in range(box[0], box[1]):
            before = bits[k - 1, y] >> u8(63) if k > 0 else u8(0)
            total += popcount(bits[k, y] & ~((bits[k, y] << u8(1)) | before))
    return total


@kernel
def _fill_holes(bits, box, most, runs, parent):
    """Set the small regions of unset pixels in the box, connected over edges only.

    bits: bits of the mask.
    box: (4,).
    most: largest area that is filled, px.
    runs, parent: scratch of `_label`.
    """
    n = _label(bits, box, ALL, 0, runs, parent)
    area = np.zeros(n, np.int64)
    for i in range(n):
        area[_root(parent, i)] += runs[i, 2] - runs[i, 1]
    for i in range(n):
        if area[_root(parent, i)] <= most:
            _fill(bits, runs[i, 0], runs[i, 1], runs[i, 2])


@kernel
def _regions_near(n, runs, parent, keep_share, keep_gap, kept, about):
    """Choose the largest region and those near it.

    n, runs, parent: number of runs, the runs, and the first run of each one's region, of `_label`.
    keep_share, keep_gap: as in Cleaning.
    kept: (n,) gets whether a run belongs to one of them.
    about: (5,) gets their box and area.
    """
    area, box = np.zeros(n, np.int64), np.empty((n, 4), np.int64)
    main = 0
    for i in range(n):
        k = _root(parent, i)
        y, left, right = runs[i, 0], runs[i, 1], runs[i, 2]
        if k == i:
            box[k, 0], box[k, 1], box[k, 2], box[k, 3] = y, y + 1, left, right
        area[k] += right - left
        box[k, 1] = y + 1
        box[k, 2] = min(box[k, 2], left)
        box[k, 3] = max(box[k, 3], right)
    for i in range(n):
        if area[i] > area[main]:
            main = i
    side = max(box[main, 1] - box[main, 0], box[main, 3] - box[main, 2])
    for i in range(4):  # one by one: a tuple at once takes half a second to compile
        about[i] = box[main, i]
    about[4] = 0
    for i in range(n):
        k = _root(parent, i)
        if k == i:
            gap = max(box[k, 2] - box[main, 3], box[main, 2] - box[k, 3])
            gap = max(gap, max(box[k, 0] - box[main, 1], box[main, 0] - box[k, 1]))
            far = keep_share >= 1 or area[k] < keep_share * area[main] or gap > keep_gap * side
            kept[k] = k == main or not far
            if kept[k]:
                about[0], about[1] = min(about[0], box[k, 0]), max(about[1], box[k, 1])
                about[2], about[3] = min(about[2], box[k, 2]), max(about[3], box[k, 3])
                about[4] += area[k]
        kept[i] = kept[k]


@kernel
def _clean(bits, width, opening, closing, margin, hole_px, keep_share, keep_gap, about):
    """Clean the bits (words, h) of a mask (h, width), which are changed: open, close, fill holes, keep the largest
    region and those near it; see `clean`.

    hole_px, keep_share, keep_gap: as in Cleaning.
    opening, closing: spans.
    margin: px around the mask within which this is done.
    about: (5,) gets the box around the kept regions and their area.
    Returns: code of the runs.
    """
    box = np.zeros(4, np.int64)
    if not _bounds(bits, box):
        about[:] = 0
        return np.zeros((0, 3), np.uint16)
    box[0], box[1] = max(box[0] - margin, 0), min(box[1] + margin, bits.shape[1])
    box[2], box[3] = max(box[2] - margin, 0), min(box[3] + margin, width)
    if opening.shape[0] > 0:
        done = np.zeros_like(bits)
        opened(bits, opening, box, done)
        bits = done
    if closing.shape[0] > 0:
        more, done = np.zeros_like(bits), np.zeros_like(bits)
        grown(bits, closing, box, u8(0), more)
        grown(more, closing, box, ALL, done)
        bits = done
    most = _most_runs(bits, box)
    runs, parent = np.empty((most, 3), np.int32), np.empty(most, np.int32)
    if hole_px > 0:
        _fill_holes(bits, box, hole_px, runs, parent)
    n = _label(bits, box, u8(0), 1, runs, parent)
    if n == 0:
        about[:] = 0
        return np.zeros((0, 3), np.uint16)
    kept = np.zeros(n, np.bool_)
    _regions_near(n, runs, parent, keep_share, keep_gap, kept, about)
    return runs[:n][kept].astype(np.uint16)


@kernel
def _draw(code, out, top, left):
    """Set the pixels of the runs `code` (n, 3) in out (h, w) u1, whose first pixel is (top, left) of the mask."""
    h, w = out.shape
    for i in range(code.shape[0]):
        y, start, end = np.int64(code[i, 0]) - top, np.int64(code[i, 1]) - left, np.int64(code[i, 2]) - left
        if 0 <= y < h:
            row = out[y]
            for x in range(max(start, 0), min(end, w)):
                row[x] = 1

"""Masks as bits, cleaned, and as runs of pixels.

The numpy (and OpenCV) versions here are the definitions; cpu_mask_bits.py does the same on 64 pixels at once. A box is
(y0, y1, x0, x1), half open, px.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute import selection
from hypose.compute.native import native, plain

Mask = NDArray[np.uint8]
Bits = NDArray[np.uint64]
"""(words, h) of a mask (h, w): 64 pixels of a row in a word, lowest bit first, zero beyond the width"""


class Cleaning(NamedTuple):
    """How a mask is cleaned: opened by a square of open_px and closed by a disc of close_px (0, 1: not at all), holes
    of at most hole_px filled (background connected over edges only), then only the biggest region kept (connected over
    corners too) and those of at least keep_share times its area (1: none) whose boxes are not farther from its box than
    keep_gap times the longer side of that."""

    open_px: int = 0
    close_px: int = 0
    hole_px: int = 0
    keep_share: float = 0.0
    keep_gap: float = 1e9


class MaskRuns(NamedTuple):
    """A mask (h, w) = shape as the runs of its rows, in about a thousand bytes (cpu_mask_bits.draw): the box around it
    (zeros when it is empty) and its area in px are known."""

    code: NDArray[np.uint8]
    shape: tuple[int, int]
    box: tuple[int, int, int, int]
    area: int


def no_bits(h: int, w: int) -> Bits:
    """Of an empty mask (h, w)."""
    return np.zeros(((w + 63) // 64, h), np.uint64)


def bits_of(mask: Mask) -> Bits:
    """Of a mask (h, w), non-zero = set."""
    bits = no_bits(*mask.shape)
    if selection.backend() == "numpy":
        wide = np.pad(mask, ((0, 0), (0, 64 * len(bits) - mask.shape[1])))
        bits[:] = np.ascontiguousarray(np.packbits(wide, axis=1, bitorder="little")).view(np.uint64).T
        return bits
    native("pictures.mask_bits").bits_of(plain(mask, np.uint8), bits)
    return bits


def mask_of(bits: Bits, width: int) -> Mask:
    """The mask (h, width) of bits, 0 and 1."""
    rows = np.ascontiguousarray(bits.T).view(np.uint8)
    return np.unpackbits(rows, axis=1, count=width, bitorder="little")


def clean(bits: Bits, shape: tuple[int, int], how: Cleaning) -> MaskRuns:
    """The mask (h, w) = shape of bits (which are changed), cleaned, as runs."""
    if selection.backend() == "numpy" and how != Cleaning():
        return runs_of(_cleaned(mask_of(bits, shape[1]), how))
    about = np.zeros(5, np.int64)
    spans = square_spans(how.open_px), disc_spans(how.close_px)
    rules = how.close_px + 1, int(how.hole_px), float(how.keep_share), float(min(how.keep_gap, 1e9))
    code = native("pictures.mask_bits").clean(bits, shape[1], *spans, *rules, about)
    y0, y1, x0, x1, area = about.tolist()
    return MaskRuns(code, shape, (y0, y1, x0, x1), area)


def runs_of(mask: Mask) -> MaskRuns:
    """Of a mask (h, w), non-zero = set, as it is."""
    return clean(bits_of(mask), (mask.shape[0], mask.shape[1]), Cleaning())


def draw(runs: MaskRuns, out: Mask | None = None, corner: tuple[int, int] = (0, 0)) -> Mask:
    """The mask (h, w) again; or set where it is in out, whose first pixel is the corner (y, x) of the mask."""
    made = np.zeros(runs.shape, np.uint8) if out is None else out
    y0, y1, x0, _ = runs.box
    native("pictures.mask_bits").draw(runs.code, y0, y1, x0, made, *corner)
    return made


@lru_cache(maxsize=256)
def square_spans(size: int) -> NDArray[np.int64]:
    """(n, 4) spans (cpu_mask_bits) of a square; none for a size below 2, which changes nothing."""
    return _spans(np.ones((size, size), np.uint8))


@lru_cache(maxsize=256)
def disc_spans(size: int) -> NDArray[np.int64]:
    """The same of OpenCV's disc."""
    return _spans(disc(size)) if size > 1 else _spans(np.ones((size, size), np.uint8))


def disc(size: int) -> Mask:
    """(size, size) OpenCV's disc, 1 where it is."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def _spans(element: Mask) -> NDArray[np.int64]:
    """Rows of an element with the same columns are one span; OpenCV's middle of n is n // 2."""
    size, spans = len(element), list[list[int]]()
    for y, row in enumerate(element if size > 1 else ()):
        x = np.flatnonzero(row) - size // 2
        if spans and spans[-1][2:] == [x[0], x[-1]]:
            spans[-1][1] += 1
        else:
            spans.append([y - size // 2, y - size // 2, x[0], x[-1]])
    return np.array(spans, dtype=np.int64).reshape(-1, 4)


def _cleaned(mask: Mask, how: Cleaning) -> Mask:
    """The definition of `clean`."""
    out, margin = np.zeros_like(mask), how.close_px + 1
    x, y, w, h = cv2.boundingRect(mask)
    if w == 0:
        return out
    part = np.s_[max(y - margin, 0) : y + h + margin, max(x - margin, 0) : x + w + margin]
    made = mask[part].copy()
    if how.open_px > 1:
        square = np.ones((how.open_px, how.open_px), np.uint8)
        made = np.asarray(cv2.morphologyEx(made, cv2.MORPH_OPEN, square), dtype=np.uint8)
    if how.close_px > 1:
        made = np.asarray(cv2.morphologyEx(made, cv2.MORPH_CLOSE, disc(how.close_px)), dtype=np.uint8)
    out[part] = _regions(made, how)
    return out


def _regions(part: Mask, how: Cleaning) -> Mask:
    if how.hole_px:
        _, label, stats, _ = cv2.connectedComponentsWithStats(1 - part, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] <= how.hole_px
        small[0] = False  # label 0 is the foreground here
        part |= small[np.asarray(label, dtype=np.int64)].astype(np.uint8)
    count, label, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=8)
    if count < 2:
        return part
    area = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    area[0] = 0
    main = int(area.argmax())
    keep = (area >= max(how.keep_share * area[main], 1)) & (area > 0)
    if how.keep_share >= 1:
        keep = np.arange(count) == main
    start = stats[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]].astype(np.int64)
    size = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].astype(np.int64)
    gap = np.maximum(np.maximum(start - (start + size)[main], start[main] - (start + size)), 0).max(1)
    keep &= gap <= how.keep_gap * size[main].max()
    return keep[np.asarray(label, dtype=np.int64)].astype(np.uint8)


def warm_up() -> None:
    """Compile (or load from disk) every kernel of this module on a toy mask."""
    mask = np.ones((4, 5), np.uint8)
    draw(clean(bits_of(mask), (4, 5), Cleaning(3, 3, 1, 0.5, 1.0)))

"""Masks packed to one bit per pixel inside a box, and their clean-up (OpenCV).

A box (4,) is y0, y1, x0, x1, half open, px.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Mask


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


class BitMask(NamedTuple):
    """Mask that is stored in a few thousand bytes.

    bits: (rows, bytes) pixels in the box, one bit per pixel, lowest bit first.
    shape: (h, w) shape of the mask.
    box: y0, y1, x0, x1 around the set pixels (zeros where there are none).
    area: number of set pixels.
    """

    bits: NDArray[np.uint8]
    shape: tuple[int, int]
    box: tuple[int, int, int, int]
    area: int


def pack(mask: Mask) -> BitMask:
    """Pack a mask (h, w), non-zero = set."""
    return _packed(mask, (0, 0), (mask.shape[0], mask.shape[1]))


def _packed(part: Mask, corner: tuple[int, int], shape: tuple[int, int]) -> BitMask:
    """Pack a mask of the given shape (h, w), all of whose set pixels lie in a part of it, at a corner (y, x)."""
    x, y, w, h = cv2.boundingRect(part)
    own = part[y : y + h, x : x + w]
    top, left = (corner[0] + y, corner[1] + x) if w else (0, 0)
    bits = np.packbits(own, axis=1, bitorder="little")
    return BitMask(bits, shape, (top, top + h, left, left + w), int(np.count_nonzero(own)))


def draw(packed: BitMask, out: Mask | None = None, corner: tuple[int, int] = (0, 0)) -> Mask:
    """Draw a packed mask.

    packed: the mask.
    out: picture in which pixels are set, whose first pixel is the corner (y, x) of the mask; None: a new mask (h, w).
    Returns: that picture.
    """
    made = np.zeros(packed.shape, np.uint8) if out is None else out
    y0, y1, x0, x1 = packed.box
    part = np.unpackbits(packed.bits, axis=1, count=x1 - x0, bitorder="little")
    top, left = y0 - corner[0], x0 - corner[1]
    inside = made[max(top, 0) : max(y1 - corner[0], 0), max(left, 0) : max(x1 - corner[1], 0)]
    inside |= part[max(-top, 0) :, max(-left, 0) :][: inside.shape[0], : inside.shape[1]]
    return made


def clean(mask: Mask, how: Cleaning) -> BitMask:
    """Clean a mask (h, w), non-zero = set: open, close, fill holes, keep the largest region and those near it; and pack
    it.
    """
    shape = mask.shape[0], mask.shape[1]
    x, y, w, h = cv2.boundingRect(mask)
    margin = how.close_px + 1
    top, left = max(y - margin, 0), max(x - margin, 0)
    part = np.not_equal(mask[top : y + h + margin, left : x + w + margin], 0).view(np.uint8)
    if w and how.open_px > 1:
        square = np.ones((how.open_px, how.open_px), np.uint8)
        part = np.asarray(cv2.morphologyEx(part, cv2.MORPH_OPEN, square), dtype=np.uint8)
    if w and how.close_px > 1:
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (how.close_px, how.close_px))
        part = np.asarray(cv2.morphologyEx(part, cv2.MORPH_CLOSE, disc), dtype=np.uint8)
    if w and how.hole_px:
        _, label, stats, _ = cv2.connectedComponentsWithStats(1 - part, connectivity=4, ltype=_labels(part))
        small = stats[:, cv2.CC_STAT_AREA] <= how.hole_px
        small[0] = False  # label 0 is the foreground here
        if small.any():
            part |= small.view(np.uint8)[np.asarray(label)]
    return _packed(_regions_near(part, how) if w else part, (top, left), shape)


def _regions_near(part: Mask, how: Cleaning) -> Mask:
    """Keep the largest region of a mask, and the regions near it that are large enough (`Cleaning`)."""
    count, label, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=8, ltype=_labels(part))
    if count < 3:  # the background and one region
        return part
    area, start = stats[1:, cv2.CC_STAT_AREA].astype(np.int64), stats[1:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP]]
    size = stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    main, end = int(area.argmax()), start + size
    gap = np.maximum(start - end[main], start[main] - end).max(1)
    kept = (area >= how.keep_share * area[main]) & (gap <= how.keep_gap * size[main].max())
    if how.keep_share >= 1:
        kept[:] = False
    kept[main] = True
    return np.r_[False, kept].view(np.uint8)[np.asarray(label)]


def _labels(part: Mask) -> int:
    """Return the number type of labels: 16 bits, which are faster, where they suffice for all regions of a picture."""
    return cv2.CV_16U if part.size < 2**16 else cv2.CV_32S

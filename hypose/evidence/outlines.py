"""Compute outlines of masks: signed distances and points on the edge. `hypose.evidence.prefetch` caches those of a
frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import packed_masks
from hypose.compute.arrays import NOT_KNOWN
from hypose.compute.mask_distance import signed_distance
from hypose.compute.packed_masks import BitMask
from hypose.compute.rows import outline_points
from hypose.geometry import Array, Mask

OUTLINE_POINTS = 130
"""Default number of points per view: two pixels apart on a person 260 px tall is enough."""
SMALLEST = 8
"""px: masks no longer than this get no outline"""
WORKING_HEIGHT = 170
"""px: height of a person that is enough for tracking; larger masks may be shrunk by 1.5, 2, 2.5..."""


@dataclass(frozen=True)
class ViewOutline:
    """Outline of one mask; all zero for a mask that is too small.

    distance: (h, w) float32 px to the edge, negative inside (`signed_distance`), of the part of the image at `corner`.
    points: (K, 2) float32 px on the edge, away from the image border (`outline_points`).
    found: number of edge pixels.
    extent: longer side of the mask's box in its own pixels.
    shrunk: factor, a multiple of 1/2, by which the mask was shrunk before; distance and points are in shrunk pixels.
    corner: (x, y) where the part of the image begins.
    working_height: as requested.
    """

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: int
    extent: int
    shrunk: float = 1.0
    corner: tuple[int, int] = (0, 0)
    working_height: int | None = None


@dataclass(frozen=True)
class Outlines:
    """Outlines of the masks of all views of a frame; zero for views that are not usable.

    distance: (C, h, w), each view in its own size (sizes (C, 2)) at its corner (corners (C, 2)).
    points: (C, K, 2).
    found, extent, shrunk: (C,).
    """

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: NDArray[np.int64]
    extent: NDArray[np.int64]
    shrunk: Array
    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]


def bounding_box(mask: ArrayLike, margin: int = 0) -> tuple[int, int, int, int] | None:
    """Compute the box (y0, y1, x0, x1), half open, around the non-zero pixels of a mask (h, w), plus a margin in px.

    Returns: None where all pixels are zero.
    """
    m = np.asarray(mask)
    h, w = m.shape
    x, y, width, height = cv2.boundingRect(m if m.dtype == np.uint8 else (m != 0).astype(np.uint8))
    if width == 0:
        return None
    return max(y - margin, 0), min(y + height + margin, h), max(x - margin, 0), min(x + width + margin, w)


def view_outline(mask: Mask, count: int = OUTLINE_POINTS, working_height: int | None = None) -> ViewOutline:
    """Compute the outline of a mask (h, w) without padding, in its own size.

    count: number of outline points.
    working_height: for tracking: a mask taller than this is shrunk, px; None: it is not shrunk.
    """
    box = bounding_box(mask) or (0, 0, 0, 0)
    if working_height is not None:
        return outline_in_box(mask[box[0] : box[1], box[2] : box[3]], box, mask.shape, count, working_height)
    extent = max(box[1] - box[0], box[3] - box[2])
    if extent <= SMALLEST:
        return _no_outline(mask.shape, count, extent, None)
    size = (mask.shape[1], mask.shape[0])
    distance = signed_distance(mask[None], np.array([size]))[0]
    points, found = outline_points(distance, size, count)
    return ViewOutline(distance, points, found, extent)


def outline_in_box(
    part: Mask, box: tuple[int, int, int, int], shape: tuple[int, ...], count: int, working_height: int
) -> ViewOutline:
    """Compute the outline of a mask for tracking, given only its part in a box.

    count: number of outline points.
    part: the mask in box (y0, y1, x0, x1); all other pixels of the mask (h, w) = shape are zero.
    A mask taller than working_height px is shrunk by the largest multiple of 1/2 that leaves it at least as tall.
    Distances are computed around the person only (a sixth of its size, at least 32 px), because rows further away have
    no weight.
    """

    def put(mask: Mask, corner: tuple[int, int]) -> None:
        y, x = box[0] - corner[0], box[2] - corner[1]
        part_in = part[: mask.shape[0] - y, : mask.shape[1] - x]
        mask[y : y + part_in.shape[0], x : x + part_in.shape[1]] = part_in

    return _outline_around(put, box, shape, count, working_height)


def outline_of_runs(runs: BitMask, count: int, working_height: int) -> ViewOutline:
    """Compute the outline of a packed mask for tracking.

    count: number of outline points.
    working_height: a mask taller than this is shrunk before, px.
    """
    draw = partial(packed_masks.draw, runs)
    return _outline_around(draw, runs.box, runs.shape, count, working_height)


def _outline_around(
    put: Callable[[Mask, tuple[int, int]], object],
    box: tuple[int, int, int, int],
    shape: tuple[int, ...],
    count: int,
    working_height: int,
) -> ViewOutline:
    """Compute the outline of a person whom the function put(mask, corner (y, x)) draws into an empty part of the mask.

    box: y0, y1, x0, x1 around the person.
    shape: (h, w) shape of the whole mask.
    count: number of outline points.
    working_height: px, see `outline_in_box`.
    """
    extent = max(box[1] - box[0], box[3] - box[2])
    halves = _halves(extent, working_height)
    y0, y1, x0, x1 = _around(box, shape, halves)
    if extent <= SMALLEST or box[0] >= y1 or box[2] >= x1:  # only in rows or columns outside whole blocks
        return _no_outline((2, 2), count, extent, working_height)
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    put(mask, (y0, x0))
    small = _shrink(mask, halves) if halves > 2 else mask
    size = (small.shape[1], small.shape[0])
    distance = signed_distance(small[None], np.array([size]), max(size))[0]
    points, found = outline_points(distance, size, count)
    corner = (2 * x0 // halves, 2 * y0 // halves)
    points += np.array(corner, np.float32)
    return ViewOutline(distance, points, found, extent, halves / 2, corner, working_height)


def _around(box: tuple[int, ...], shape: tuple[int, ...], halves: int) -> tuple[int, int, int, int]:
    """Compute the region (y0, y1, x0, x1), px, for the distances around a person's box, in whole blocks of `halves`
    pixels.
    """
    h, w = (side // halves * halves for side in shape)
    margin = max(16 * halves, max(box[1] - box[0], box[3] - box[2]) // 6)
    y0, x0 = (max(box[k] - margin, 0) // halves * halves for k in (0, 2))
    return y0, min(box[1] + margin, h), x0, min(box[3] + margin, w)


def _no_outline(shape: tuple[int, ...], count: int, extent: int, working_height: int | None) -> ViewOutline:
    """Build the outline of a mask that is too small: all zero, in the shape of the mask part, with `count` points.

    extent: longer side of the mask's box, px.
    working_height: as requested.
    """
    nothing = np.zeros(shape, np.float32), np.zeros((count, 2), np.float32)
    return ViewOutline(*nothing, 0, extent, working_height=working_height)


KNOWN_PX = 0.75
"""px: largest difference of a distance with and without the ignored pixels at which it counts as known."""
_FEW_POINTS, _NEARBY = 8, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


def shared_outline(
    mask: Mask, ignored: Mask, box: ArrayLike, count: int = OUTLINE_POINTS, working_height: int | None = None
) -> ViewOutline:
    """Compute the outline of one person's mask, in which other people may hide parts.

    mask, ignored: (h, w) the mask, and the pixels without information.
    box: where the person is expected, (y0, y1, x0, x1) px.

    count: number of outline points. An outline of zeros is returned where too little of the person is known.
    working_height: a mask taller than this is shrunk before, px; None: it is not shrunk.
    Returns: the outline; distances that depend on ignored pixels are NOT_KNOWN, and outline points next to them are set
        to -1e6, because the outline there may be another person's.
    """
    whose = tuple(int(n) for n in np.asarray(box))
    extent = max(whose[1] - whose[0], whose[3] - whose[2])
    nothing = _no_outline((2, 2), count, extent, working_height)
    halves, left, top = _halves(extent, working_height), 0, 0
    if working_height is not None:
        top, bottom, left, right = _around(whose, mask.shape, halves)
        mask, ignored = mask[top:bottom, left:right], ignored[top:bottom, left:right]
    if 2 * min(mask.shape) <= SMALLEST * halves or extent <= SMALLEST:
        return nothing
    least, most = np.greater(mask, ignored).view(np.uint8), mask | ignored
    if halves > 2:
        least, most = _shrink(least, halves), _shrink(most, halves)
    size = (least.shape[1], least.shape[0])
    reach = None if working_height is None else max(size)
    low = signed_distance(least[None], np.array([size]), reach)[0]
    points, found = outline_points(low, size, count)
    if not found:
        return nothing
    open_pixels = most - least
    corner = (2 * left // halves, 2 * top // halves)
    if not cv2.countNonZero(open_pixels):  # no ignored pixels are near the person
        points += np.array(corner, np.float32)
        return ViewOutline(low, points, found, extent, halves / 2, corner, working_height)
    high = signed_distance(most[None], np.array([size]), reach)[0]
    distance = np.where(low - high > KNOWN_PX, np.float32(NOT_KNOWN), low)  # true in all open pixels
    nearby = cv2.dilate(open_pixels, _NEARBY)
    at = np.clip(np.rint(points), 0, np.array(size) - 1).astype(int)
    own = nearby[at[:, 1], at[:, 0]] == 0
    if own.sum() < _FEW_POINTS:
        return nothing
    points = np.where(own[:, None], points + np.array(corner, np.float32), np.float32(-1e6))
    return ViewOutline(distance, points, found, extent, halves / 2, corner, working_height)


def _halves(extent: int, working_height: int | None) -> int:
    """Compute twice the factor by which to shrink: so many pixels become 2.

    extent: longer side of the box, px.
    working_height: wanted height, px, None: nothing is shrunk (2 is returned).
    """
    return 2 if working_height is None else max(2, 2 * extent // working_height)


def _shrink(mask: Mask, halves: int) -> Mask:
    """Shrink a mask: each block of halves x halves pixels becomes 2 x 2; a pixel is set when at least half of its
    area is.
    """
    h, w = 2 * (mask.shape[0] // halves), 2 * (mask.shape[1] // halves)
    whole = mask[: h * halves // 2, : w * halves // 2] * np.uint8(254)
    share = cv2.resize(whole, (w, h), interpolation=cv2.INTER_AREA)
    return np.asarray(share >= 127).view(np.uint8)


def shrunk_projection(projection: Array, factor: float) -> Array:
    """Scale a pinhole projection (3, 4) to pixels `factor` times as large; pixel centres are at integer coordinates."""
    shift = 0.5 / factor - 0.5
    return np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]]) @ projection


def stack_outlines(views: Sequence[ViewOutline | None], count: int = OUTLINE_POINTS) -> Outlines:
    """Stack the outlines of all views of a frame, with `count` points each; None: a view that is not usable."""
    shapes = [v.distance.shape for v in views if v is not None]
    rows, columns = (max([shape[a] for shape in shapes], default=2) for a in (0, 1))
    n = len(views)
    distance = np.empty((n, rows, columns), dtype=np.float32)
    points = np.zeros((n, count, 2), dtype=np.float32)
    found, extent, shrunk = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.ones(n)
    sizes, corners = np.zeros((n, 2), dtype=np.int64), np.zeros((n, 2), dtype=np.int64)
    for c, view in enumerate(views):
        h, w = (0, 0) if view is None else view.distance.shape
        distance[c, h:], distance[c, :h, w:] = 0, 0
        if view is not None:
            distance[c, :h, :w], points[c], found[c], extent[c] = view.distance, view.points, view.found, view.extent
            shrunk[c], sizes[c], corners[c] = view.shrunk, (w, h), view.corner
    return Outlines(distance, points, found, extent, shrunk, sizes, corners)

"""Compute outlines of masks: signed distances and points on the edge. `hypose.evidence.frame.Silhouettes` keeps
those of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import packed_masks
from hypose.compute.arrays import NOT_KNOWN, OUTLINE_POINTS
from hypose.compute.mask_distance import signed_distance
from hypose.compute.packed_masks import BitMask
from hypose.compute.rows import outline_points
from hypose.geometry import Array, Mask

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
    """

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: int
    extent: int
    shrunk: float = 1.0
    corner: tuple[int, int] = (0, 0)


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


KNOWN_PX = 0.75
"""px: largest difference of a distance with and without the ignored pixels at which it counts as known."""
_FEW_POINTS, _NEARBY = 8, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


def view_outline(
    mask: Mask | BitMask,
    count: int = OUTLINE_POINTS,
    working_height: int | None = None,
    ignored: Mask | None = None,
    expected: ArrayLike | None = None,
) -> ViewOutline:
    """Compute the outline of a mask without padding; one of zeros where the mask is too small, or too little is known.

    mask: (h, w), packed or not.
    count: number of outline points.
    working_height: for tracking, px: a mask taller than this is shrunk by the largest multiple of 1/2 that leaves it at
        least as tall, and distances are computed around the person only (a sixth of its size, at least 32 px), because
        rows further away have no weight. None: distances in the whole picture.
    ignored: (h, w) pixels without information, in which other people may hide this person; the mask is not packed then.
        Distances that depend on them are NOT_KNOWN, and outline points next to them are set to -1e6, because the
        outline there may be another person's.
    expected: where the person is expected, (y0, y1, x0, x1) px; None: the mask's own box.
    """
    if expected is None:
        expected = mask.box if isinstance(mask, BitMask) else bounding_box(mask) or (0, 0, 0, 0)
    (h, w), (y0, y1, x0, x1) = mask.shape, np.asarray(expected).tolist()
    extent, halves, top, bottom, left, right = max(y1 - y0, x1 - x0), 2, 0, h, 0, w
    if working_height is not None:  # each block of halves x halves pixels becomes 2 x 2
        halves = max(2, 2 * extent // working_height)
        margin = max(16 * halves, extent // 6)
        top, left = (max(first - margin, 0) // halves * halves for first in (y0, x0))
        bottom, right = min(y1 + margin, h // halves * halves), min(x1 + margin, w // halves * halves)
    nothing = ViewOutline(np.zeros((2, 2), np.float32), np.zeros((count, 2), np.float32), 0, extent)
    if extent <= SMALLEST or y0 >= bottom or x0 >= right:
        return nothing
    if isinstance(mask, BitMask):
        own = packed_masks.draw(mask, np.zeros((bottom - top, right - left), np.uint8), (top, left))
    else:
        own = mask[top:bottom, left:right]
    hidden = own[:0] if ignored is None else ignored[top:bottom, left:right]
    least = _shrunk(np.greater(own, hidden).view(np.uint8) if len(hidden) else own, halves)
    distance, size = signed_distance(least), (least.shape[1], least.shape[0])
    points, found = outline_points(distance, size, count)
    corner = (2 * left // halves, 2 * top // halves)
    moved = points + np.array(corner, np.float32)
    if found and hidden.any():
        most = _shrunk(own | hidden, halves)
        distance = np.where(distance - signed_distance(most) > KNOWN_PX, np.float32(NOT_KNOWN), distance)
        u, v = np.clip(np.rint(points), 0, np.array(size) - 1).astype(int).T
        known = cv2.dilate(most - least, _NEARBY)[v, u] == 0
        moved, found = np.where(known[:, None], moved, np.float32(-1e6)), found if known.sum() >= _FEW_POINTS else 0
    return ViewOutline(distance, moved, found, extent, halves / 2, corner) if found else nothing


def _shrunk(mask: Mask, halves: int) -> Mask:
    """Shrink a mask (h, w), each block of halves x halves pixels to 2 x 2; a pixel is set when half of its area is."""
    if halves == 2:
        return mask
    h, w = 2 * (mask.shape[0] // halves), 2 * (mask.shape[1] // halves)
    whole = mask[: h * halves // 2, : w * halves // 2] * np.uint8(254)
    return np.asarray(cv2.resize(whole, (w, h), interpolation=cv2.INTER_AREA) >= 127).view(np.uint8)


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

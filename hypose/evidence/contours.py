"""Outlines of masks: signed distances and points on the edge, which can be made ahead by other threads.

They depend on the masks alone, so whoever makes the masks may make these too, while the frame before is being tracked:
`make_ahead` tells where they are, and `outlines` takes them from there or makes them.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.silhouettes import Mask, bounding_box
from hypose.geometry import Array

OUTLINE_POINTS = 130
"""Points per view, unless told otherwise: two pixels apart on a person 260 px tall are enough."""
SMALLEST = 8
"""px: masks no longer than this have no outline worth following"""
WORKING_HEIGHT = 170
"""px: a person this tall is outlined well enough for tracking; larger masks may be shrunk by a whole factor"""


@dataclass(frozen=True)
class ViewOutline:
    """Of one mask: distance (h, w) float32 px to its edge, negative inside (compute.signed_distance), in the part of
    the image that begins at corner (x, y); points (K, 2) float32 px on the edge, away from the image border
    (compute.outline_points); found: how many edge pixels there are; shrunk: the whole factor by which the mask was
    shrunk before, so that all these are in shrunk pixels; extent: longer side of the mask's box in its own pixels;
    working_height: as asked for. A mask that is too small has no outline: zeros."""

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: int
    extent: int
    shrunk: int = 1
    corner: tuple[int, int] = (0, 0)
    working_height: int | None = None


@dataclass(frozen=True)
class Outlines:
    """Of all views: distance (C, h, w) with own sizes (C, 2) and corners (C, 2), points (C, K, 2), found (C,), extent
    (C,), shrunk (C,); zeros for views that are not usable. See ViewOutline."""

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: NDArray[np.int64]
    extent: NDArray[np.int64]
    shrunk: NDArray[np.int64]
    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]


def view_outline(mask: Mask, count: int = OUTLINE_POINTS, working_height: int | None = None) -> ViewOutline:
    """Outline of a mask (h, w), in its own size, without padding. working_height px: for tracking; a taller mask is
    shrunk by the largest whole factor that leaves it at least as tall, and distances are made around the person only
    (a sixth of its size, at least 32 px): further out rows weigh nothing."""
    box = bounding_box(mask)
    extent = 0 if box is None else max(box[1] - box[0], box[3] - box[2])
    factor = _factor(extent, working_height)
    if extent <= SMALLEST:
        return ViewOutline(
            np.zeros(mask.shape, np.float32), np.zeros((count, 2), np.float32), 0, extent, 1, (0, 0), working_height
        )
    x0 = y0 = 0
    if working_height is not None and box is not None:
        h, w = (side // factor * factor for side in mask.shape)
        margin = max(32 * factor, extent // 6)
        y0, x0 = (max(box[k] - margin, 0) // factor * factor for k in (0, 2))
        mask = mask[y0 : min(box[1] + margin, h), x0 : min(box[3] + margin, w)]
    small = _shrink(mask, factor) if factor > 1 else mask
    size = (small.shape[1], small.shape[0])
    distance = compute.signed_distance(small[None], np.array([size]), None if working_height is None else max(size))[0]
    points, found = compute.outline_points(distance, size, count)
    corner = (x0 // factor, y0 // factor)
    return ViewOutline(distance, points + np.array(corner, np.float32), found, extent, factor, corner, working_height)


def _factor(extent: int, working_height: int | None) -> int:
    return 1 if working_height is None else max(1, extent // working_height)


def _shrink(mask: Mask, factor: int) -> Mask:
    """Mask in blocks of factor x factor pixels: a pixel is set when at least half of its block is."""
    h, w = mask.shape[0] // factor, mask.shape[1] // factor
    share = cv2.resize(mask[: h * factor, : w * factor] * np.uint8(254), (w, h), interpolation=cv2.INTER_AREA)
    return np.asarray(share >= 127).view(np.uint8)


def shrunk_projection(projection: Array, factor: float) -> Array:
    """A pinhole projection (3, 4) for pixels that are `factor` times as large; pixel centres at integer coordinates."""
    shift = 0.5 / factor - 0.5
    return np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]]) @ projection


def outlines(silhouettes: Silhouettes, count: int = OUTLINE_POINTS, working_height: int | None = None) -> Outlines:
    """The outlines of a frame's usable views, with `count` points each; working_height as for `view_outline`."""
    known = _AHEAD.get(id(silhouettes))
    ready = None if known is None or known[0]() is not silhouettes else known[1]()
    made: list[ViewOutline | None] = []
    for c, (w, h) in enumerate(silhouettes.rig.sizes.tolist()):
        view = None if ready is None or not silhouettes.usable[c] else ready[c]
        if silhouettes.usable[c] and not (view and (len(view.points), view.working_height) == (count, working_height)):
            view = view_outline(silhouettes.masks[c, :h, :w], count, working_height)
        made.append(view)
    rows, columns = (max([v.distance.shape[a] for v in made if v is not None], default=2) for a in (0, 1))
    views = len(made)
    distance = np.zeros((views, rows, columns), dtype=np.float32)
    points = np.zeros((views, count, 2), dtype=np.float32)
    found, extent, shrunk = np.zeros(views, dtype=np.int64), np.zeros(views, dtype=np.int64), np.ones(views, np.int64)
    sizes, corners = np.zeros((views, 2), dtype=np.int64), np.zeros((views, 2), dtype=np.int64)
    for c, view in enumerate(made):
        if view is not None:
            h, w = view.distance.shape
            distance[c, :h, :w], points[c], found[c], extent[c] = view.distance, view.points, view.found, view.extent
            shrunk[c], sizes[c], corners[c] = view.shrunk, (w, h), view.corner
    return Outlines(distance, points, found, extent, shrunk, sizes, corners)


Ready = Callable[[], list[ViewOutline | None] | None]
_AHEAD: dict[int, tuple[weakref.ref[Silhouettes], Ready]] = {}  # by identity, as long as the silhouettes live


def make_ahead(silhouettes: Silhouettes, ready: Ready) -> None:
    """Tell that the outlines of these silhouettes are being made: `ready` waits for them and returns one per view, or
    None where there is none. They are forgotten with the silhouettes."""
    key = id(silhouettes)
    _AHEAD[key] = weakref.ref(silhouettes, lambda _: _AHEAD.pop(key, None)), ready


def look_ahead(frames: Iterable[Frame], count: int = 2) -> Iterator[Frame]:
    """The same frames, the outlines for tracking of the next `count` being made by another thread meanwhile: for frames
    whose silhouettes are at hand (a FrameStream does so by itself)."""
    waiting: deque[Frame] = deque()
    with ThreadPoolExecutor(1, thread_name_prefix="outlines") as pool:
        for frame in frames:
            if frame.silhouettes is not None:
                made = pool.submit(_view_outlines, frame.silhouettes)
                make_ahead(frame.silhouettes, made.result)
            waiting.append(frame)
            if len(waiting) > count:
                yield waiting.popleft()
        yield from waiting


def _view_outlines(silhouettes: Silhouettes) -> list[ViewOutline | None]:
    sizes = silhouettes.rig.sizes.tolist()
    return [
        view_outline(mask[:h, :w], working_height=WORKING_HEIGHT) if usable else None
        for mask, usable, (w, h) in zip(silhouettes.masks, silhouettes.usable, sizes, strict=True)
    ]

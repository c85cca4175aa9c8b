"""Outlines of masks: signed distances and points on the edge, which can be made ahead by other threads.

They depend on the masks alone, so whoever makes the masks may make these too, while the frame before is being tracked:
`make_ahead` tells where they are, and `outlines` takes them from there or makes them.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.evidence.frame import Silhouettes
from hypose.evidence.silhouettes import Mask, bounding_box

OUTLINE_POINTS = 130
"""Points per view, unless told otherwise: two pixels apart on a person 260 px tall are enough."""
SMALLEST = 8
"""px: masks no longer than this have no outline worth following"""


@dataclass(frozen=True)
class ViewOutline:
    """Of one mask: distance (h, w) float32 px to its edge, negative inside (compute.signed_distance); points (K, 2)
    float32 px on the edge, away from the image border (compute.outline_points); found: how many edge pixels there are;
    extent: longer side of its box, px. A mask that is too small has no outline: zeros."""

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: int
    extent: int


@dataclass(frozen=True)
class Outlines:
    """Of all views: distance (C, h, w), points (C, K, 2), found (C,), extent (C,); zeros for views that are not
    usable. See ViewOutline."""

    distance: NDArray[np.float32]
    points: NDArray[np.float32]
    found: NDArray[np.int64]
    extent: NDArray[np.int64]


def view_outline(mask: Mask, count: int = OUTLINE_POINTS) -> ViewOutline:
    """Outline of a mask (h, w), in its own size, without padding."""
    box = bounding_box(mask)
    extent = 0 if box is None else max(box[1] - box[0], box[3] - box[2])
    if extent <= SMALLEST:
        return ViewOutline(np.zeros(mask.shape, np.float32), np.zeros((count, 2), np.float32), 0, extent)
    size = (mask.shape[1], mask.shape[0])
    distance = compute.signed_distance(mask[None], np.array([size]))[0]
    points, found = compute.outline_points(distance, size, count)
    return ViewOutline(distance, points, found, extent)


def outlines(silhouettes: Silhouettes, count: int = OUTLINE_POINTS) -> Outlines:
    """The outlines of a frame's usable views, with `count` points each."""
    known = _AHEAD.get(id(silhouettes))
    ready = None if known is None or known[0]() is not silhouettes else known[1]()
    views = len(silhouettes.masks)
    distance = np.zeros(silhouettes.masks.shape, dtype=np.float32)
    points = np.zeros((views, count, 2), dtype=np.float32)
    found, extent = np.zeros(views, dtype=np.int64), np.zeros(views, dtype=np.int64)
    for c, (w, h) in enumerate(silhouettes.rig.sizes.tolist()):
        if not silhouettes.usable[c]:
            continue
        view = None if ready is None else ready[c]
        if view is None or len(view.points) != count:
            view = view_outline(silhouettes.masks[c, :h, :w], count)
        distance[c, :h, :w], points[c], found[c], extent[c] = view.distance, view.points, view.found, view.extent
    return Outlines(distance, points, found, extent)


Ready = Callable[[], list[ViewOutline | None] | None]
_AHEAD: dict[int, tuple[weakref.ref[Silhouettes], Ready]] = {}  # by identity, as long as the silhouettes live


def make_ahead(silhouettes: Silhouettes, ready: Ready) -> None:
    """Tell that the outlines of these silhouettes are being made: `ready` waits for them and returns one per view, or
    None where there is none. They are forgotten with the silhouettes."""
    key = id(silhouettes)
    _AHEAD[key] = weakref.ref(silhouettes, lambda _: _AHEAD.pop(key, None)), ready

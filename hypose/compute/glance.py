"""Find the part of a stored picture that differs from the empty room, before any of it is shrunk and undistorted.

Only every fourth pixel of the working size is read, because the person is a small part of most pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.picture_to_mask import BackgroundLevels, Box
from hypose.geometry import Image

STEP = 4
"""px of the working size between the pixels that are read."""
MARGIN = 24
"""px of the working size around the differing pixels."""
AMONG = 3
"""A pixel counts where so many of the nine around it, itself included, differ from the room: noise is isolated."""
_AROUND = np.ones((3, 3), np.uint8)


class Glance(NamedTuple):
    """Grey levels of the empty room at the pixels that are read.

    low, high: (m, n, 3) uint8, range of the room there and one pixel of the working size around it, because a sharp
        edge lies elsewhere in every 2 x 2 pixels.
    """

    low: Image
    high: Image


class StoredPlaces(NamedTuple):
    """Places of a stored picture that are read, one for each pixel of the grid.

    x, y: (m, n) px, in the middle of 2 x 2 stored pixels.
    outside: (m, n) True where the place lies outside the picture, and nothing is read.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    outside: NDArray[np.bool_]


def glance_at(room: BackgroundLevels) -> Glance:
    """Extract the pixels that are read from the background levels of a room."""
    low, high = cv2.erode(room.low, _AROUND), cv2.dilate(room.high, _AROUND)
    return Glance(*(np.array(a[::STEP, ::STEP], dtype=np.uint8) for a in (low, high)))


def stored_places(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> StoredPlaces:
    """Compute which place of a stored picture to read for each pixel of the grid.

    stored: (width, height) size of the stored picture.
    map_x, map_y: (h, w) maps of `picture_to_mask.make_lens`.
    """
    mx, my = (np.asarray(m, dtype=np.float64) for m in (map_x, map_y))
    h, w = mx.shape
    x = np.floor((mx[::STEP, ::STEP] + 0.5) * stored[0] / w - 0.5)
    y = np.floor((my[::STEP, ::STEP] + 0.5) * stored[1] / h - 0.5)
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= stored[0] - 2) & (y <= stored[1] - 2)
    return StoredPlaces(*(np.where(inside, a, 0).astype(np.float32) + np.float32(0.5) for a in (x, y)), ~inside)


def differing_box(image: Image, places: StoredPlaces, glance: Glance, size: tuple[int, int]) -> Box | None:
    """Find the box of the working size that holds the foreground of a stored picture, with a margin.

    image: (H, W, 3) uint8 stored picture.
    places: where it is read, by `stored_places`.
    glance: range of the room at these places, by `glance_at`.
    size: (width, height) size of the working size.
    Returns: (y0, y1, x0, x1), px; None where nothing differs.
    """
    mean = cv2.remap(image, places.x, places.y, cv2.INTER_LINEAR)  # of the 2 x 2 pixels
    differs = ((cv2.inRange(mean, glance.low, glance.high) == 0) & ~places.outside).view(np.uint8)
    among = cv2.boxFilter(differs, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    x, y, w, h = cv2.boundingRect(((among >= AMONG) & (differs > 0)).view(np.uint8))
    if h == 0:
        return None
    return (
        max(STEP * y - MARGIN, 0),
        min(STEP * (y + h) + MARGIN, size[1]),
        max(STEP * x - MARGIN, 0),
        min(STEP * (x + w) + MARGIN, size[0]),
    )

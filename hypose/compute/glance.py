"""Find the part of a stored picture that differs from the empty room, before any of it is shrunk and undistorted.

Only every fourth pixel of the working size is read, because the person is a small part of most pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.picture_to_mask import BackgroundLevels, Box, mean_outside
from hypose.geometry import Image

STEP = 4
"""px of the working size between the pixels that are read."""
MARGIN = 24
"""px of the working size around the differing pixels."""
AMONG = 3
"""A pixel counts where so many of the nine around it, itself included, differ from the room: noise is isolated."""


class Glance(NamedTuple):
    """Grey levels of the empty room at the pixels that are read.

    low, high: (m, n, 4) uint8, range of the room there and one pixel of the working size around it, because a sharp
        edge lies elsewhere in every 2 x 2 pixels; the fourth number is unused.
    """

    low: Image
    high: Image


def glance_at(room: BackgroundLevels) -> Glance:
    """Extract the pixels that are read from the background levels of a room."""
    around = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(room.low, around), cv2.dilate(room.high, around)
    return Glance(*(np.pad(a[::STEP, ::STEP], ((0, 0), (0, 0), (0, 1))) for a in (low, high)))


def stored_pixels(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> NDArray[np.int32]:
    """Compute which pixel of a stored picture to read for each pixel of the grid.

    stored: (width, height) of the stored picture.
    map_x, map_y: (h, w) maps of `picture_to_mask.make_lens`.
    Returns: (m, n) number of the stored pixel up and left of the place; -1 outside the picture.
    """
    mx, my = (np.asarray(m, dtype=np.float64) for m in (map_x, map_y))
    h, w = mx.shape
    x = np.floor((mx[::STEP, ::STEP] + 0.5) * stored[0] / w - 0.5)
    y = np.floor((my[::STEP, ::STEP] + 0.5) * stored[1] / h - 0.5)
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= stored[0] - 2) & (y <= stored[1] - 2)
    return np.where(inside, np.nan_to_num(y) * stored[0] + np.nan_to_num(x), -1).astype(np.int32)


def differing_box(image: Image, at: NDArray[np.int32], glance: Glance, size: tuple[int, int]) -> Box | None:
    """Find the box of the working size that holds the foreground of a stored picture, with a margin.

    image: (H, W, 3) stored picture.
    at: of `stored_pixels`.
    glance: of `glance_at`.
    size: (width, height) of the working size.
    Returns: (y0, y1, x0, x1), px; None where nothing differs.
    """
    found = np.zeros(4, np.int64)
    _differing_box(plain(image, np.uint8), at, *glance, AMONG, found)
    y0, y1, x0, x1 = found.tolist()
    if y1 == 0:
        return None
    return (
        max(STEP * y0 - MARGIN, 0),
        min(STEP * y1 + MARGIN, size[1]),
        max(STEP * x0 - MARGIN, 0),
        min(STEP * x1 + MARGIN, size[0]),
    )


def warm_up() -> None:
    """Compile (or load from the cache) the kernel."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    low = np.zeros((12, 15, 3), np.uint8)
    room = BackgroundLevels(low, low, low.astype(np.float32), False, 0.5, 0.9, 100.0)
    differing_box(picture, stored_pixels((30, 24), x, y), glance_at(room), (15, 12))


@kernel
def _differing_box(image, at, low, high, among, box):
    """Find the box of the read pixels that differ from the room in company.

    image: (H, W, 3) u1.
    at: (m, n) i4, number of the first of the 2 x 2 pixels to read; negative: none.
    low, high: (m, n, 4) u1, range of the mean of these pixels in the room.
    among: number of the nine pixels around one, itself included, that must differ.
    box: (4,) gets y0, y1, x0, x1 in read pixels; zeros without any.
    """
    m, n = at.shape
    picture, least, most, below = image.reshape(-1), low.reshape(-1), high.reshape(-1), 3 * image.shape[1]
    found = np.zeros((m + 2, n + 2), np.uint8)
    for y in range(m):
        row, line = at[y], found[y + 1]
        for x in range(n):
            if row[x] >= 0:
                line[x + 1] = mean_outside(picture, 3 * row[x], below, least, most, 4 * (y * n + x))
    box[:] = m, 0, n, 0
    for y in range(m):
        line = found[y + 1]
        for x in range(n):
            if line[x + 1] != 0:
                count = 0
                for i in range(3):
                    for j in range(3):
                        count += found[y + i, x + j]
                if count >= among:
                    box[0], box[1] = min(box[0], y), y + 1
                    box[2], box[3] = min(box[2], x), max(box[3], x + 1)
    if box[1] == 0:
        box[:] = 0

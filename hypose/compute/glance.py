"""Where in a stored picture is something that is not the room? A look at every fourth pixel of the working size, before
any of it is shrunk and undistorted: the person is a small part of most pictures.
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
"""px of the working size between the pixels looked at"""
MARGIN = 24
"""px of the working size around what was found"""
AMONG = 3
"""a pixel counts when so many of the nine around it, itself included, are not the room: noise is alone"""


class Glance(NamedTuple):
    """What the pixels looked at should be. low, high (m, n, 4) u1: the grey levels that are still the room there, or
    one pixel of the working size next to it, for a sharp edge in the room lies elsewhere in every 2 x 2 pixels; the
    fourth number says nothing."""

    low: Image
    high: Image


def glance_at(room: BackgroundLevels) -> Glance:
    """Return the pixels of a room that are looked at."""
    around = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(room.low, around), cv2.dilate(room.high, around)
    return Glance(*(np.pad(a[::STEP, ::STEP], ((0, 0), (0, 0), (0, 1))) for a in (low, high)))


def stored_pixels(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> NDArray[np.int32]:
    """Return (m, n) number of the pixel of a stored picture (width, height), up and left of where each pixel looked at
    lies, from the maps (h, w) of `picture_to_mask.make_lens`; -1 where that is outside the picture."""
    mx, my = (np.asarray(m, dtype=np.float64) for m in (map_x, map_y))
    h, w = mx.shape
    x = np.floor((mx[::STEP, ::STEP] + 0.5) * stored[0] / w - 0.5)
    y = np.floor((my[::STEP, ::STEP] + 0.5) * stored[1] / h - 0.5)
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= stored[0] - 2) & (y <= stored[1] - 2)
    return np.where(inside, np.nan_to_num(y) * stored[0] + np.nan_to_num(x), -1).astype(np.int32)


def differing_box(image: Image, at: NDArray[np.int32], glance: Glance, size: tuple[int, int]) -> Box | None:
    """Return the box (y0, y1, x0, x1) of the working size (width, height) that holds the foreground in a stored picture
    (H, W, 3), with a margin; None when there is nothing. at: of `stored_pixels`."""
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
    """Compile (or load from disk) the kernel."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    low = np.zeros((12, 15, 3), np.uint8)
    room = BackgroundLevels(low, low, low.astype(np.float32), False, 0.5, 0.9, 100.0)
    differing_box(picture, stored_pixels((30, 24), x, y), glance_at(room), (15, 12))


@kernel
def _differing_box(image, at, low, high, among, box):
    """Fills box (4,): y0, y1, x0, x1 of the pixels looked at, at (m, n) i4, that differ in company; zeros without any.

    One differs where the mean of the 2 x 2 pixels of image (H, W, 3) u1 from pixel number `at` on lies in some colour
    outside low..high (m, n, 4) u1, and `at` is not negative; and does so in company where `among` of the nine around
    it, itself included, differ."""
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

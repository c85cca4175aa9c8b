"""Where in a stored picture is something that is not the room? A look at every fourth pixel of the working size, before
any of it is shrunk and undistorted: the person is a small part of most pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native, plain
from hypose.compute.pictures.picture_to_mask import Box, Image, Room

STEP = 4
"""px of the working size between the pixels looked at"""
MARGIN = 24
"""px of the working size around what was found"""
AMONG = 3
"""a pixel counts when so many of the nine around it, itself included, are not the room: noise is alone"""


class Glance(NamedTuple):
    """What the pixels looked at should be. low, high (m, n, 4) u1: the grey levels that are still the room there, or
    one pixel of the working size beside it, for a sharp edge in the room lies elsewhere in every 2 x 2 pixels; the
    fourth number says nothing."""

    low: Image
    high: Image


def glance_at(room: Room) -> Glance:
    """The pixels of a room that are looked at."""
    around = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(room.low, around), cv2.dilate(room.high, around)
    return Glance(*(np.pad(a[::STEP, ::STEP], ((0, 0), (0, 0), (0, 1))) for a in (low, high)))


def stored_pixels(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> NDArray[np.int32]:
    """(m, n) number of the pixel of a stored picture (width, height), up and left of where each pixel looked at lies,
    from the maps (h, w) of `picture_to_mask.make_lens`; -1 where that is outside the picture."""
    mx, my = (np.asarray(m, dtype=np.float64) for m in (map_x, map_y))
    h, w = mx.shape
    x = np.floor((mx[::STEP, ::STEP] + 0.5) * stored[0] / w - 0.5)
    y = np.floor((my[::STEP, ::STEP] + 0.5) * stored[1] / h - 0.5)
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (y >= 0) & (x <= stored[0] - 2) & (y <= stored[1] - 2)
    return np.where(inside, np.nan_to_num(y) * stored[0] + np.nan_to_num(x), -1).astype(np.int32)


def differing_box(image: Image, at: NDArray[np.int32], glance: Glance, size: tuple[int, int]) -> Box | None:
    """The box (y0, y1, x0, x1) of the working size (width, height) that holds what is not the room in a stored picture
    (H, W, 3), with a margin; None when there is nothing. at: of `stored_pixels`."""
    if selection.backend() == "numpy":
        found = _differ_sparsely(image, at, glance)
        company = cv2.boxFilter(found, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        x, y, w, h = cv2.boundingRect((found & (company >= AMONG)).astype(np.uint8))
        y0, y1, x0, x1 = y, y + h, x, x + w
    else:
        box = np.zeros(4, np.int64)
        native("silhouettes.glance").differing_box(plain(image, np.uint8), at, *glance, AMONG, box)
        y0, y1, x0, x1 = box.tolist()
    if y1 == 0:
        return None
    return (
        max(STEP * y0 - MARGIN, 0),
        min(STEP * y1 + MARGIN, size[1]),
        max(STEP * x0 - MARGIN, 0),
        min(STEP * x1 + MARGIN, size[0]),
    )


def _differ_sparsely(image: Image, at: NDArray[np.int32], glance: Glance) -> Image:
    first = np.maximum(at, 0)
    y, x = first // image.shape[1], first % image.shape[1]
    total = sum(image[y + i, x + j].astype(np.uint32) for i in (0, 1) for j in (0, 1))
    value = (total + np.uint32(2)) >> np.uint32(2)
    other = ((value < glance.low[..., :3]) | (value > glance.high[..., :3])).any(2)
    return (other & (at >= 0)).astype(np.uint8)


def warm_up() -> None:
    """Compile (or load from disk) the kernel."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    low = np.zeros((12, 15, 3), np.uint8)
    room = Room(low, low, low.astype(np.float32), False, 0.5, 0.9, 100.0)
    differing_box(picture, stored_pixels((30, 24), x, y), glance_at(room), (15, 12))

"""Convert a decoded picture to its foreground: shrink and undistort it, and compare it with the room, shadows excluded.

Images are BGR uint8; a box is (y0, y1, x0, x1), half open, px. The functions keep no state, so that each camera can
have its own thread.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.errors import InputError
from hypose.geometry import Image, Mask

f4 = np.float32
Box = tuple[int, int, int, int]
_NINE = np.ones((3, 3), np.uint8)


class Undistortion(NamedTuple):
    """Maps that convert stored pictures of one camera to undistorted ones (h, w) of the working size.

    stored: (width, height) size of the stored pictures, which are first shrunk by area to the working size.
    x, y: (h, w) float32 place of each undistorted pixel in the shrunk picture, as for cv2.remap.
    straight: whether the shrunk picture is the undistorted one.
    """

    stored: tuple[int, int]
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    straight: bool


class BackgroundLevels(NamedTuple):
    """Colours of the empty room.

    low, high: (h, w, 3) uint8, range of the grey levels of the room.
    mean: (h, w, 3) float32, for the shadow test.
    shadow: whether the shadow test is made.
    darkest, lightest: brightness of a shadow relative to the lit room.
    chroma: largest squared colour distance of a shadow, grey levels^2.
    """

    low: Image
    high: Image
    mean: NDArray[np.float32]
    shadow: bool
    darkest: float
    lightest: float
    chroma: float


def make_lens(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> Undistortion:
    """Make the undistortion of stored pictures (width, height).

    map_x, map_y: (h, w) place of each undistorted pixel in a picture shrunk to the working size, as for cv2.remap; NaN
        where the camera does not see.
    Raises: InputError where a picture would be enlarged.
    """
    x, y = (np.nan_to_num(np.asarray(m, dtype=np.float32), nan=-10.0) for m in (map_x, map_y))
    h, w = x.shape
    if stored[0] < w or stored[1] < h:
        raise InputError(f"A picture of {stored} px cannot be enlarged to {(w, h)} px; choose a smaller working size.")
    column, row = np.meshgrid(np.arange(w), np.arange(h))
    return Undistortion(stored, x, y, bool(max(np.abs(x - column).max(), np.abs(y - row).max()) < 1 / 64))


def shrink_undistort(image: Image, lens: Undistortion, box: Box | None = None, out: Image | None = None) -> Image:
    """Shrink and undistort a stored picture (H, W, 3).

    lens: maps of the camera.
    box: part of the working size to compute; None: all.
    out: (h, w, 3) memory that is used; None: new memory.
    Returns: (h, w, 3) of the working size, black where the camera does not see, undefined outside the box.
    Raises: InputError where the picture has another size.
    """
    h, w = lens.x.shape
    if image.shape != (lens.stored[1], lens.stored[0], 3) or image.dtype != np.uint8:
        raise InputError(f"A picture of {image.shape[1::-1]} px was given where {lens.stored} px are stored.")
    made = np.zeros((h, w, 3), np.uint8) if out is None else out
    y0, y1, x0, x1 = box or (0, h, 0, w)
    if y1 <= y0 or x1 <= x0:
        return made
    x, y = lens.x[y0:y1, x0:x1], lens.y[y0:y1, x0:x1]
    across, down = _source(x, lens.stored[0], w), _source(y, lens.stored[1], h)
    part = image[down[2] : down[3], across[2] : across[3]]
    small = cv2.resize(part, (across[1] - across[0], down[1] - down[0]), interpolation=cv2.INTER_AREA)
    if lens.straight:
        made[y0:y1, x0:x1] = small[y0 - down[0] : y1 - down[0], x0 - across[0] : x1 - across[0]]
    else:
        made[y0:y1, x0:x1] = cv2.remap(small, x - f4(across[0]), y - f4(down[0]), cv2.INTER_LINEAR)
    return made


def _source(places: NDArray[np.float32], stored: int, size: int) -> tuple[int, int, int, int]:
    """Compute which part of a picture is needed for given places along one axis.

    places: (h, w) px of the shrunk picture.
    stored, size: px of the stored and of the shrunk picture.
    Returns: first and end of the part, px of the shrunk picture; the same in the stored one, where they are whole
        pixels too.
    """
    step = size // math.gcd(size, stored)
    first = min(max(int(places.min()) - 1, 0), size - 1) // step * step
    end = min(-(-(max(int(places.max()) + 3, first + 1)) // step) * step, size)
    return first, end, first * stored // size, end * stored // size


def not_the_room(image: Image, room: BackgroundLevels, box: Box | None = None) -> Mask:
    """Segment the person in an undistorted picture: pixels that are neither the room nor its shadow.

    image: (h, w, 3).
    room: colours of the empty room.
    box: part of the picture; None: all.
    Returns: mask (h, w) of 0 and 1. A shadow has the same colour but is darker, and is an area: single pixels along the
        edge of dark clothing before a bright wall are mixed colours, so that shadows are opened by 3 x 3.
    """
    h, w = image.shape[:2]
    other, dark = np.zeros((h, w), np.uint8), np.zeros((h, w), np.uint8)
    y0, y1, x0, x1 = box or (0, h, 0, w)
    limits = (f4(room.darkest), f4(room.lightest), f4(room.chroma))
    _compare(plain(image, np.uint8), *room[:3], bool(room.shadow), *limits, y0, y1, x0, x1, other, dark)
    if room.shadow and y0 < y1 and x0 < x1:
        part = slice(y0, y1), slice(x0, x1)
        other[part] -= np.asarray(cv2.morphologyEx(dark[part], cv2.MORPH_OPEN, _NINE), dtype=np.uint8)
    return other


def order_statistic(stack: NDArray[np.uint8], hidden: NDArray[np.bool_] | None, rank: NDArray[np.int64]) -> Image:
    """Compute per pixel and channel the value of a given rank over the frames.

    stack: (N, P, 3) uint8.
    hidden: (N, P) frames that do not count, or None.
    rank: (P,) number of smaller values (0: the smallest).
    Returns: (P, 3) uint8; 255 where the rank is not below the number of frames.
    """
    found, wanted = np.zeros(stack.shape[1:], np.uint8), rank[:, None]
    for bit in range(7, -1, -1):  # by counting the values that are smaller than with this bit
        guess, below = found | np.uint8(1 << bit), np.zeros(stack.shape[1:], np.uint16)
        for k, frame in enumerate(stack):
            smaller = frame < guess
            below += smaller if hidden is None else smaller & ~hidden[k, :, None]
        found = np.where(below <= wanted, guess, found)
    return found


def warm_up() -> None:
    """Compile (or load from the cache) the kernel of this module on a toy picture."""
    picture = np.zeros((4, 4, 3), np.uint8)
    not_the_room(picture, BackgroundLevels(picture, picture, picture.astype(np.float32), True, 0.5, 0.9, 100.0))


@kernel
def _compare(image, low, high, mean, shadow, darkest, lightest, chroma, y0, y1, x0, x1, other, dark):
    """Mark the pixels of a picture (h, w, 3) in a box that differ from the room, and those of them that show it in
    shadow.

    low, high, mean, shadow, darkest, lightest, chroma: as in `BackgroundLevels`.
    y0, y1, x0, x1: the box, half open, px.
    other, dark: (h, w) u1, zero before, get 1 at these pixels.

    The colour of a shadow is s times the room's, s = colour . room / room . room between darkest and lightest, with a
    rest whose square is below chroma. For a black room the product room . room counts as 1.
    """
    for y in range(y0, y1):
        colour, least, most, room, found = image[y], low[y], high[y], mean[y], other[y]
        for x in range(x0, x1):
            found[x] = (
                ((colour[x, 0] < least[x, 0]) | (colour[x, 0] > most[x, 0]))
                | ((colour[x, 1] < least[x, 1]) | (colour[x, 1] > most[x, 1]))
                | ((colour[x, 2] < least[x, 2]) | (colour[x, 2] > most[x, 2]))
            )
        for x in range(x0, x1 if shadow else x0):
            if found[x]:
                b, g, r = f4(colour[x, 0]), f4(colour[x, 1]), f4(colour[x, 2])
                u, v, w = room[x, 0], room[x, 1], room[x, 2]
                s = (b * u + g * v + r * w) / max(u * u + v * v + w * w, f4(1))
                b, g, r = b - s * u, g - s * v, r - s * w
                dark[y, x] = (s > darkest) & (s < lightest) & (b * b + g * g + r * r < chroma)

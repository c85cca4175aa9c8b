"""From a decoded picture to what is not the room: shrink and undistort, difference from the room with the shadow cone.

The numpy (and OpenCV) versions here are the definitions; cpu_images.py does the same in one pass each, inside a box.
Images are BGR uint8, a box is (y0, y1, x0, x1), half open, px. The functions release the GIL and keep no state, so each
camera can have its own thread.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native, plain
from hypose.compute.pictures.mask_runs import Bits, bits_of, no_bits, square_spans
from hypose.errors import InputError

Image = NDArray[np.uint8]
Box = tuple[int, int, int, int]
_LEAST = 16
"""Pixels that the kernels compare at once"""


class Lens(NamedTuple):
    """How stored pictures of one camera become undistorted ones (h, w) of the working size.

    stored: (width, height) of the stored pictures. First they are shrunk by area: working row y is the sum over k of
    row_weights[y, k] (h, L) u2 times stored row rows[y] + k, and columns likewise after, with column_weights (w, K) i4;
    rounding (5,): half and shift of rows, factor, half and shift of columns. corner (h, w): number of the pixel up and
    left of the undistorted one in the shrunk picture, in rows with one pixel of black on the left and two on the right
    (one above, two below); part (h, w) u2: further right, and 32 times further down, in 32nds of a pixel. row_reach
    (h, 2), column_reach (w, 2): first and last shrunk row (column) that the corners of an undistorted row (column) lie
    in. straight: the shrunk picture is the undistorted one.
    """

    stored: tuple[int, int]
    columns: NDArray[np.int64]
    column_weights: NDArray[np.int32]
    rows: NDArray[np.int64]
    row_weights: NDArray[np.uint16]
    rounding: NDArray[np.int64]
    corner: NDArray[np.int32]
    part: NDArray[np.uint16]
    row_reach: NDArray[np.int64]
    column_reach: NDArray[np.int64]
    straight: bool


_FX, _FY = np.meshgrid(np.arange(32), np.arange(32))
_SHARES = np.stack([(32 - _FX) * (32 - _FY), _FX * (32 - _FY), (32 - _FX) * _FY, _FX * _FY], -1).reshape(-1, 4)
_SHARES = _SHARES.astype(np.uint16)
"""(1024, 4): of a pixel, the one on its right, and the two below, in 1024ths, by Lens.part"""


class Room(NamedTuple):
    """What the empty room looks like: low, high (h, w, 3) u1, the grey levels that are still the room; mean (h, w, 3)
    f4, for the shadow test; shadow: whether that is made; darkest, lightest: brightness of a shadow relative to the lit
    room; chroma: squared colour distance a shadow may have, grey levels."""

    low: Image
    high: Image
    mean: NDArray[np.float32]
    shadow: bool
    darkest: float
    lightest: float
    chroma: float


def make_lens(stored: tuple[int, int], map_x: ArrayLike, map_y: ArrayLike) -> Lens:
    """Lens for stored pictures (width, height) from maps (h, w) in pixels of the working size: where in a picture
    shrunk to that size each undistorted pixel lies (as for cv2.remap). Pictures are never enlarged: an InputError."""
    mx, my = np.asarray(map_x), np.asarray(map_y)
    h, w = mx.shape
    if stored[0] < w or stored[1] < h:
        raise InputError(f"A picture of {stored} px cannot be enlarged to {(w, h)} px; choose a smaller working size.")
    columns, column_weights = _averages(stored[0], w)
    rows, row_weights = _averages(stored[1], h)
    rounding = (8, 4, 1, 2048, 12)  # weights are 256ths, and what is between rows and columns 16ths
    n = stored[0] // w * (stored[1] // h)
    if stored[0] % w == 0 and stored[1] % h == 0 and n <= 257:  # of whole blocks all pixels weigh the same
        column_weights, row_weights = np.ones_like(column_weights), np.ones_like(row_weights)
        rounding = (0, 0, (16777216 + n // 2) // n, 8388608, 24)
    i, j = _parts(mx, 32 * w), _parts(my, 32 * h)
    column, row = (i >> 5) + 1, (j >> 5) + 1
    return Lens(
        stored,
        columns,
        column_weights.astype(np.int32),
        rows,
        row_weights.astype(np.uint16),
        np.array(rounding),
        row * np.int32(w + 3) + column,
        ((i & 31) | ((j & 31) << 5)).astype(np.uint16),
        _reach(row, 1),
        _reach(column, 0),
        bool((i == 32 * np.arange(w)).all() and (j == 32 * np.arange(h)[:, None]).all()),
    )


def _parts(at: NDArray[np.floating], most: int) -> NDArray[np.int32]:
    """32nds of pixels; what is not seen lies beyond the picture."""
    return np.clip(np.nan_to_num(np.rint(32 * at), nan=-32), -32, most).astype(np.int32)


def _reach(at: NDArray[np.int32], axis: int) -> NDArray[np.int64]:
    return np.stack([at.min(axis), at.max(axis)], -1, dtype=np.int64)


def _averages(source: int, target: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First source pixel and weights (sum 256) of each of `target` boxes."""
    step = source / target
    begin, end = np.arange(target)[:, None] * step, (np.arange(target)[:, None] + 1) * step
    first = np.floor(begin[:, 0] + 1e-9).astype(np.int64)
    taps = int((np.ceil(end[:, 0] - 1e-9).astype(np.int64) - first).max())
    first = np.minimum(first, source - taps)
    edges = np.clip(first[:, None] + np.arange(taps + 1), begin, end)
    cumulative = np.rint(256 * (edges - edges[:, :1]) / step).astype(np.int64)
    return first, np.diff(cumulative, axis=1)


def shrink_undistort(image: Image, lens: Lens, box: Box | None = None, out: Image | None = None) -> Image:
    """Stored picture (H, W, 3) -> undistorted (h, w, 3) of the working size, black where the camera does not see, and
    outside `box` (default: everywhere) undefined. out: of `new_picture`, to be used for it."""
    h, w = lens.corner.shape
    if image.shape != (lens.stored[1], lens.stored[0], 3) or image.dtype != np.uint8:
        raise InputError(f"A picture of {image.shape[1::-1]} px was given where {lens.stored} px are stored.")
    y0, y1, x0, x1 = box or (0, h, 0, w)
    if y1 <= y0 or x1 <= x0:
        return np.zeros((h, w, 3), np.uint8)
    if selection.backend() == "numpy":
        small = np.zeros((h + 3, w + 3, 3), np.uint8)
        small[1 : h + 1, 1 : w + 1] = _shrink(image, lens)
        return small[1 : h + 1, 1 : w + 1].copy() if lens.straight else _remap(small, lens)
    kernels, image = native("pictures.images"), plain(image, np.uint8)
    made = new_picture(h, w) if out is None else out
    flat = made.base
    weights = lens.columns, lens.column_weights, lens.rows, lens.row_weights, lens.rounding
    if lens.straight:
        kernels.shrink(image, *weights, y0, y1, x0, x1, flat, 0, 3 * w)
        return made
    small = _scratch(h + 3, w + 3)
    a0, a1, b0, b1 = _needed(lens, box)
    if a1 > a0 and b1 > b0:
        kernels.shrink(image, *weights, a0, a1, b0, b1, small, 3 * (w + 4), 3 * (w + 3))
    kernels.remap(small, lens.corner, lens.part, _SHARES, y0, y1, x0, x1, flat)
    return made


def new_picture(h: int, w: int) -> Image:
    """Memory for a picture (h, w, 3), in memory (its base) that is a byte longer: pixels are written as four bytes."""
    return np.empty(3 * h * w + 1, np.uint8)[: 3 * h * w].reshape(h, w, 3)


_OWN = threading.local()


def _scratch(h: int, w: int) -> NDArray[np.uint8]:
    """This thread's memory for a shrunk picture, its rim black: new memory of this size costs as much as the shrinking.
    Two bytes longer, for pixels are read as eight bytes in twos."""
    known = getattr(_OWN, "small", None)
    if known is None or known[0] != (h, w):
        known = _OWN.small = (h, w), np.zeros(3 * h * w + 2, np.uint8)
    return known[1]


def _needed(lens: Lens, box: Box | None) -> Box:
    """A part of the shrunk picture that holds all that undistorted pixels in the box are made of."""
    h, w = lens.corner.shape
    if box is None:
        return 0, h, 0, w
    rows, columns = lens.row_reach[box[0] : box[1]], lens.column_reach[box[2] : box[3]]
    return (
        max(int(rows[:, 0].min()) - 1, 0),
        min(int(rows[:, 1].max()) + 1, h),
        max(int(columns[:, 0].min()) - 1, 0),
        min(int(columns[:, 1].max()) + 1, w),
    )


def _shrink(image: Image, lens: Lens) -> Image:
    half, shift, factor, last_half, last_shift = lens.rounding.astype(np.uint64)
    h, w = lens.corner.shape
    lines = np.zeros((h, image.shape[1], 3), np.uint64)
    for k in range(lens.row_weights.shape[1]):
        lines += lens.row_weights[:, k, None, None] * image[lens.rows + k].astype(np.uint64)
    lines = (lines + half) >> shift
    total = np.zeros((h, w, 3), np.uint64)
    for k in range(lens.column_weights.shape[1]):
        total += lens.column_weights[:, k, None].astype(np.uint64) * lines[:, lens.columns + k]
    return ((total * factor + last_half) >> last_shift).astype(np.uint8)


def _remap(small: Image, lens: Lens) -> Image:
    flat, step = small.reshape(-1, 3).astype(np.int32), small.shape[1]
    at, shares = lens.corner, _SHARES[lens.part].astype(np.int32)
    total = sum(shares[..., k, None] * flat[at + beside] for k, beside in enumerate((0, 1, step, step + 1)))
    return ((total + 512) >> 10).astype(np.uint8)


def not_the_room(image: Image, room: Room, box: Box | None = None) -> Bits:
    """Bits (mask_runs.bits_of) of the person in an undistorted picture (h, w, 3), in the box (default: everywhere):
    what is neither the room nor its shadow, the same colour but darker. A shadow is an area: single pixels along the
    edge of dark clothing before a bright wall are mixed colours, so shadows are opened 3 x 3."""
    h, w = image.shape[:2]
    y0, y1, x0, x1 = box or (0, h, 0, w)
    limits = (np.float32(room.darkest), np.float32(room.lightest), np.float32(room.chroma))
    if selection.backend() != "numpy" and h * w >= _LEAST:
        image, bits = plain(image, np.uint8), no_bits(h, w)
        kernels = native("pictures.images")
        kernels.differ(image, *room[:3], bool(room.shadow), *limits, y0, y1, x0, x1, square_spans(3), bits)
        return bits
    s = np.s_[y0:y1, x0:x1]
    other = ((image[s] < room.low[s]) | (image[s] > room.high[s])).any(2).astype(np.uint8)
    if room.shadow:
        colour, mean = np.moveaxis(image[s].astype(np.float32), 2, 0), np.moveaxis(room.mean[s], 2, 0)
        brightness = _sum_of_three(colour * mean) / np.maximum(_sum_of_three(mean * mean), np.float32(1))
        rest = _sum_of_three((colour - brightness * mean) ** 2)
        dark = (brightness > limits[0]) & (brightness < limits[1]) & (rest < limits[2])
        other -= cv2.morphologyEx(other * dark, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    mask = np.zeros((h, w), np.uint8)
    mask[s] = other
    return bits_of(mask)


def _sum_of_three(a: NDArray[np.float32]) -> NDArray[np.float32]:
    return a[0] + a[1] + a[2]  # in this order, with which the last digits change


def order_statistic(stack: NDArray[np.uint8], hidden: NDArray[np.bool_] | None, rank: NDArray[np.int64]) -> Image:
    """Of stack (N, P, 3) u1, per pixel and channel the value with `rank` (P,) values below it in order (0: the
    smallest), over the frames that are not hidden (N, P): (P, 3) u1; 255 where the rank is not below their number."""
    n, p, _ = stack.shape
    if selection.backend() != "numpy":
        out = np.empty((p, 3), np.uint8)
        none = np.zeros((0, p), np.bool_)
        seen = none if hidden is None else np.require(hidden, np.bool_, ["C", "W"])
        native("pictures.images").order_statistic(
            np.require(stack, np.uint8, ["C", "W"]), seen, rank.astype(np.uint16), out
        )
        return out
    values = stack.astype(np.int16)
    if hidden is not None:
        values = np.where(hidden[..., None], np.int16(255), values)
    picked = np.take_along_axis(np.sort(values, 0), np.minimum(rank, n - 1)[None, :, None], 0)[0]
    count = np.full(p, n) if hidden is None else (~hidden).sum(0)
    return np.where((rank >= count)[:, None], 255, picked).astype(np.uint8)


def warm_up_masks() -> None:
    """Compile (or load from disk) what masks from files need on a toy mask."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    shrink_undistort(picture, make_lens((30, 24), x, y))


def warm_up() -> None:
    """Compile (or load from disk) every kernel of this module on a toy picture."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    for lens in (make_lens((30, 24), x, y), make_lens((30, 24), x + 0.3, y)):
        small = shrink_undistort(picture, lens)
        mean = small.astype(np.float32)
        not_the_room(small, Room(small, small, mean, True, 0.5, 0.9, 100.0))
    order_statistic(picture, None, np.zeros(30, np.int64))
    order_statistic(picture, np.zeros((24, 30), np.bool_), np.zeros(30, np.int64))

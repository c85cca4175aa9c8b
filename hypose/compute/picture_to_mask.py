"""Convert a decoded picture to its foreground: shrink and undistort it, and compare it with the room, shadows excluded.

Images are BGR uint8; a box is (y0, y1, x0, x1), half open, px. The functions release the GIL and keep no state, so that
each camera can have its own thread. The inner steps are explicit vectors, because the compiler does not recognise that
the three colours of a pixel lie next to each other. Every lane computes the same bits: whole numbers, and floating
point that is never fused. There pictures are flat, (3 n,) u1: blue, green and red of one pixel after the other.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.mask_runs import Bits, close_to, element_spans, no_bits, opened
from hypose.compute.simd import at_least, bits, cast, load, ramp, shuffle, splat, store, where
from hypose.errors import InputError
from hypose.geometry import Image

f4, u1, i2, u2, i4, u4, u8 = np.float32, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.uint64
Box = tuple[int, int, int, int]
_LANES = 16
"""Number of pixels that the kernels compare at once."""


class Undistortion(NamedTuple):
    """Tables that convert stored pictures of one camera to undistorted ones (h, w) of the working size.

    stored: (width, height) size of the stored pictures, which are first shrunk by area.
    columns, column_weights: (w,) and (w, K) int32: working column x is the sum over k of column_weights[x, k] times
        stored column columns[x] + k, after the rows.
    rows, row_weights: (h,) and (h, L) uint16, the same of rows.
    rounding: (5,) half and shift of rows; factor, half and shift of columns.
    corner: (h, w) number of the pixel up and left of the undistorted one in the shrunk picture, which has one column of
        black on the left and two on the right (rows: one above, two below).
    part: (h, w) uint16, offset to the right, and 32 times the offset down, in 32nds of a pixel.
    row_reach, column_reach: (h, 2) and (w, 2): first and last shrunk row (column) in which the corners of an
        undistorted row (column) lie.
    straight: whether the shrunk picture is the undistorted one.
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
"""(1024, 4) shares of a pixel, the one on its right, and the two below, in 1024ths, by Undistortion.part."""


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

    map_x, map_y: (h, w) place of each undistorted pixel in a picture shrunk to the working size, as for cv2.remap.
    Raises: InputError where a picture would be enlarged, or the working size is too small.
    """
    mx, my = np.asarray(map_x), np.asarray(map_y)
    h, w = mx.shape
    if stored[0] < w or stored[1] < h:
        raise InputError(f"A picture of {stored} px cannot be enlarged to {(w, h)} px; choose a smaller working size.")
    if h * w < _LANES:
        raise InputError(f"Pictures of {(w, h)} px are too small; choose a working size of {_LANES} pixels at least.")
    columns, column_weights = _averages(stored[0], w)
    rows, row_weights = _averages(stored[1], h)
    rounding = (8, 4, 1, 2048, 12)  # weights are 256ths, and values between rows and columns 16ths
    n = stored[0] // w * (stored[1] // h)
    if stored[0] % w == 0 and stored[1] % h == 0 and n <= 257:  # of whole blocks all pixels weigh the same
        column_weights, row_weights = np.ones_like(column_weights), np.ones_like(row_weights)
        rounding = (0, 0, (16777216 + n // 2) // n, 8388608, 24)
    i, j = _parts(mx, 32 * w), _parts(my, 32 * h)
    column, row = (i >> 5) + 1, (j >> 5) + 1
    return Undistortion(
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
    """Convert places to 32nds of pixels; unseen places lie outside the picture.

    at: (h, w) places, px; NaN: not seen.
    most: largest number of 32nds.
    """
    return np.clip(np.nan_to_num(np.rint(32 * at), nan=-32), -32, most).astype(np.int32)


def _reach(at: NDArray[np.int32], axis: int) -> NDArray[np.int64]:
    """Compute the smallest and the largest number of pixels `at` (h, w) along an axis: (n, 2)."""
    return np.stack([at.min(axis), at.max(axis)], -1, dtype=np.int64)


def _averages(source: int, target: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Compute the first source pixel and the weights (sum 256) of each of `target` boxes.

    source, target: number of source pixels and of boxes.
    Returns: (target,) and (target, K).
    """
    step = source / target
    begin, end = np.arange(target)[:, None] * step, (np.arange(target)[:, None] + 1) * step
    first = np.floor(begin[:, 0] + 1e-9).astype(np.int64)
    taps = int((np.ceil(end[:, 0] - 1e-9).astype(np.int64) - first).max())
    first = np.minimum(first, source - taps)
    edges = np.clip(first[:, None] + np.arange(taps + 1), begin, end)
    cumulative = np.rint(256 * (edges - edges[:, :1]) / step).astype(np.int64)
    return first, np.diff(cumulative, axis=1)


def shrink_undistort(image: Image, lens: Undistortion, box: Box | None = None, out: Image | None = None) -> Image:
    """Shrink and undistort a stored picture (H, W, 3).

    lens: lens parameters of the camera.
    box: part of the working size to compute; None: all.
    out: memory of `new_picture` to be used; None: new memory.
    Returns: (h, w, 3) of the working size, black where the camera does not see, undefined outside the box.
    Raises: InputError where the picture has another size.
    """
    h, w = lens.corner.shape
    if image.shape != (lens.stored[1], lens.stored[0], 3) or image.dtype != np.uint8:
        raise InputError(f"A picture of {image.shape[1::-1]} px was given where {lens.stored} px are stored.")
    y0, y1, x0, x1 = box or (0, h, 0, w)
    if y1 <= y0 or x1 <= x0:
        return np.zeros((h, w, 3), np.uint8)
    image = plain(image, np.uint8)
    made = new_picture(h, w) if out is None else out
    flat = made.base
    weights = lens.columns, lens.column_weights, lens.rows, lens.row_weights, lens.rounding
    if lens.straight:
        _shrink(image, *weights, y0, y1, x0, x1, flat, 0, 3 * w)
        return made
    small = _scratch(h + 3, w + 3)
    a0, a1, b0, b1 = _needed(lens, box)
    if a1 > a0 and b1 > b0:
        _shrink(image, *weights, a0, a1, b0, b1, small, 3 * (w + 4), 3 * (w + 3))
    _remap(small, lens.corner, lens.part, _SHARES, y0, y1, x0, x1, flat)
    return made


def new_picture(h: int, w: int) -> Image:
    """Allocate a picture (h, w, 3) whose memory (its base) is one byte longer, because pixels are written as four
    bytes.
    """
    return np.empty(3 * h * w + 1, np.uint8)[: 3 * h * w].reshape(h, w, 3)


_OWN = threading.local()


def _scratch(h: int, w: int) -> NDArray[np.uint8]:
    """Return this thread's memory for a shrunk picture with a black rim, two bytes longer because pixels are read in
    pairs as eight bytes.

    h, w: height and width with the rim, px.
    Why kept: new memory of this size costs as much as the shrinking.
    """
    known = getattr(_OWN, "small", None)
    if known is None or known[0] != (h, w):
        known = _OWN.small = (h, w), np.zeros(3 * h * w + 2, np.uint8)
    return known[1]


def _needed(lens: Undistortion, box: Box | None) -> Box:
    """Compute the part of the shrunk picture from which the undistorted pixels in the box are made.

    lens: lens parameters of the camera.
    box: in the undistorted picture; None: all of it.
    Returns: y0, y1, x0, x1, half open, px of the shrunk picture.
    """
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


def not_the_room(image: Image, room: BackgroundLevels, box: Box | None = None) -> Bits:
    """Segment the person in an undistorted picture: pixels that are neither the room nor its shadow.

    image: (h, w, 3).
    room: colours of the empty room.
    box: part of the picture; None: all.
    Returns: mask packed to one bit per pixel, as by `mask_runs.bits_of`. A shadow has the same colour but is darker,
        and is an area: single pixels along the edge of dark clothing before a bright wall are mixed colours, so that
        shadows are opened by 3 x 3.
    """
    h, w = image.shape[:2]
    y0, y1, x0, x1 = box or (0, h, 0, w)
    limits = (np.float32(room.darkest), np.float32(room.lightest), np.float32(room.chroma))
    bits = no_bits(h, w)
    _differ(plain(image, np.uint8), *room[:3], bool(room.shadow), *limits, y0, y1, x0, x1, element_spans(3), bits)
    return bits


def order_statistic(stack: NDArray[np.uint8], hidden: NDArray[np.bool_] | None, rank: NDArray[np.int64]) -> Image:
    """Compute per pixel and channel the value of a given rank over the frames.

    stack: (N, P, 3) uint8.
    hidden: (N, P) frames that do not count, or None.
    rank: (P,) number of smaller values (0: the smallest).
    Returns: (P, 3) uint8; 255 where the rank is not below the number of frames.
    """
    p = stack.shape[1]
    out = np.empty((p, 3), np.uint8)
    seen = np.zeros((0, p), np.bool_) if hidden is None else plain(hidden, np.bool_)
    _order_statistic(plain(stack, np.uint8), seen, rank.astype(np.uint16), out)
    return out


def warm_up_masks() -> None:
    """Compile (or load from the cache) the kernels that masks from files need, on a toy picture."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    shrink_undistort(picture, make_lens((30, 24), x, y))


def warm_up() -> None:
    """Compile (or load from the cache) every kernel of this module on a toy picture."""
    picture, (x, y) = np.zeros((24, 30, 3), np.uint8), np.meshgrid(np.arange(15.0), np.arange(12.0))
    for lens in (make_lens((30, 24), x, y), make_lens((30, 24), x + 0.3, y)):
        small = shrink_undistort(picture, lens)
        mean = small.astype(np.float32)
        not_the_room(small, BackgroundLevels(small, small, mean, True, 0.5, 0.9, 100.0))
    order_statistic(picture, None, np.zeros(30, np.int64))
    order_statistic(picture, np.zeros((24, 30), np.bool_), np.zeros(30, np.int64))


@kernel
def _shrink(image, columns, column_weights, rows, row_weights, rounding, y0, y1, x0, x1, out, begin, stride):
    """Shrink image (H, W, 3) u1 by area average for y0 <= y < y1, x0 <= x < x1; tables as in `Undistortion`.

    columns, column_weights, rows, row_weights, rounding: tables of `Undistortion`.
    out: u1, pixel (y, x) is written to three bytes from begin + stride y + 3 x on; the byte after each row becomes 0.
    """
    taps, lines = column_weights.shape[1], row_weights.shape[1]
    first, last = columns[x0], columns[x1 - 1] + taps
    width, line = 3 * (last - first), 3 * image.shape[1]
    half, shift = rounding[0], rounding[1]
    picture, down, right = image.reshape(-1), row_weights.reshape(-1), column_weights.reshape(-1)
    sums = np.empty(width + 2, np.uint16)
    for y in range(y0, y1):
        at = rows[y] * line + 3 * first
        if width >= STRIP:
            weighted_rows(picture, at, line, down, y * lines, lines, half, shift, width, sums)
        else:
            for i in range(width):
                total = u2(half)
                for k in range(lines):
                    total = u2(total + row_weights[y, k] * picture[at + k * line + i])
                sums[i] = total >> u2(shift)
        to = begin + stride * y + 3 * x0
        weighted_row(sums, columns, first, right, taps, rounding[2], rounding[3], rounding[4], x0, x1, out, to)


@kernel
def _remap(small, corner, part, shares, y0, y1, x0, x1, out):
    """Undistort the pixels in the box, into out (3 h w + 1,) u1.

    y0, y1, x0, x1: the box, half open, px.
    small: flat picture (h + 3, w + 3) u1.
    corner: (h, w) number of the first pixel.
    shares: (K, 4) in 1024ths, of this pixel and its neighbours, chosen by part (h, w).
    """
    w = corner.shape[1]
    corners, parts, four, step = corner.reshape(-1), part.reshape(-1), shares.reshape(-1), 3 * (w + 3)
    for y in range(y0, y1):
        n = y * w + x0
        blended_row(small, step, corners, parts, four, n, x1 - x0, out, 3 * n)


@kernel
def _differ(image, low, high, mean, shadow, darkest, lightest, chroma, y0, y1, x0, x1, block, bits):
    """Mark the pixels in the box where image (h, w, 3) u1 is not the room and not in its shadow; see `not_the_room`.

    low, high, mean, shadow, darkest, lightest, chroma: as in BackgroundLevels.
    y0, y1, x0, x1: the box, half open, px.
    block: spans of 3 x 3 pixels.
    bits: (words, h) u8, zero before.
    The picture has GROUP pixels at least.
    """
    h, w = image.shape[:2]
    picture, least, most, room = image.reshape(-1), low.reshape(-1), high.reshape(-1), mean.reshape(-1)
    last = h * w - GROUP
    for y in range(y0, y1):
        for x in range(x0 // GROUP * GROUP, x1, GROUP):  # and the pixels after the row, if any
            n = y * w + x
            at = min(n, last)
            bits[x >> 6, y] |= (outside(picture, least, most, 3 * at) >> u8(n - at)) << u8(x & 63)
    box = np.empty(4, np.int64)
    box[0], box[1], box[2], box[3] = y0, y1, x0, x1
    close_to(bits, box)
    if not shadow:
        return
    dark, some = np.zeros_like(bits), u8(0)
    for y in range(y0, y1):
        for k in range(x0 >> 6, (x1 + 63) >> 6):
            for first in range(0, 64, GROUP):
                if (bits[k, y] >> u8(first)) & u8(0xFFFF) == 0:
                    continue
                n = y * w + 64 * k + first
                at = min(n, last)
                shade = darker(picture, room, 3 * at, darkest, lightest, chroma) >> u8(n - at)
                dark[k, y] |= shade << u8(first)
            dark[k, y] &= bits[k, y]
            some |= dark[k, y]
    if some != 0:
        shadows = np.empty_like(dark)
        opened(dark, block, box, shadows)
        for k in range(x0 >> 6, (x1 + 63) >> 6):
            for y in range(y0, y1):
                bits[k, y] &= ~shadows[k, y]


@kernel
def _order_statistic(stack, hidden, rank, out):
    """Compute the value of a given rank over the frames; see `order_statistic`.

    stack: (N, P, 3) u1.
    hidden: (N, P) bool, frames that do not count; (0, P): all count.
    rank: (P,) u2.
    out: (P, 3) u1 gets the values.

    The value is found bit by bit, by counting the values smaller than it would be with this bit; in vector lanes.
    """
    n, pixels = stack.shape[0], stack.shape[1]
    block = 128
    guess, found, below = np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint16)
    wanted = np.empty(3 * block, np.uint16)
    flat = stack.reshape(n, 3 * pixels)
    free = np.empty((n, 3 * block), np.uint8)
    result = out.reshape(-1)
    for first in range(0, pixels, block):
        size = 3 * min(block, pixels - first)
        for i in range(size):
            wanted[i] = rank[first + i // 3]
            found[i] = 0
        for k in range(hidden.shape[0]):
            for i in range(size):
                free[k, i] = 1 - hidden[k, first + i // 3]
        for bit in range(7, -1, -1):
            for i in range(size):
                guess[i] = found[i] | np.uint8(1 << bit)
                below[i] = 0
            for k in range(n):
                line = flat[k, 3 * first : 3 * first + size]
                if hidden.shape[0] > 0:
                    seen = free[k]
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16((line[i] < guess[i]) & seen[i]))
                else:
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16(line[i] < guess[i]))
            for i in range(size):
                if below[i] <= wanted[i]:
                    found[i] = guess[i]
        for i in range(size):
            result[3 * first + i] = found[i]


STRIP = 32
"""Number of bytes of rows that are added at once."""
GROUP = 16
"""Number of pixels that are compared at once."""

_BYTES = 3 * GROUP
_blue, _green, _red = (shuffle(range(c, _BYTES, 3)) for c in range(3))
_by_colour = shuffle((0, 3, 1, 4, 2, 5, 6, 7))
"""Reorder two pixels and two more bytes: blue of both, green of both, red of both."""
_repeated, _even, _odd = shuffle((0, 1) * 4), shuffle(range(0, 8, 2)), shuffle(range(1, 8, 2))


@kernel
def weighted_rows(picture, at, stride, weights, first, lines, half, shift, width, sums):
    """Compute the weighted sum of several rows of a picture, for shrinking it, in 16-bit whole numbers.

    sums[i] = (half + sum over k < lines of weights[first + k] picture[at + k stride + i]) shifted right by shift
    bits, for i < width.
    picture: flat uint8.
    at, stride: index of the first byte, and bytes per row.
    weights: uint16.
    sums: uint16, gets the result.

    width: number of bytes, at least STRIP.
    """
    for i in range(0, width, STRIP):
        here = min(i, width - STRIP)
        total = splat(u2(half), STRIP)
        for k in range(lines):
            total = total + cast(load(picture, at + here + stride * k, STRIP), u2) * weights[first + k]
        store(sums, here, total >> shift)


@kernel
def weighted_row(sums, columns, start, weights, taps, scale, half, shift, x0, x1, out, to):
    """Shrink one row of a picture: compute the pixels x0 <= x < x1, and write them to out (uint8), three bytes each,
        from index `to` on.

    A pixel is the sum over k < taps of weights[x, k] (i4) times the pixel columns[x] - start + k of sums (u2), times
    scale, plus half, shifted down; all in 32 bits. The byte after the last pixel becomes 0, and one element of sums
    beyond the last pixel is read.
    """
    for x in range(x0, x1):
        at = (columns[x] - start) * 3
        total = splat(u4(0), 4)  # blue, green, red, and the next byte
        for k in range(taps):
            total = total + cast(load(sums, at + 3 * k, 4), u4) * weights[x * taps + k]
        value = cast((total * scale + half) >> shift, u1)
        store(out, to + 3 * (x - x0), where(ramp(4) < 3, value, splat(u1(0), 4)))


@kernel
def blended_row(picture, step, corner, part, shares, first, count, out, to):
    """Interpolate `count` pixels of a row bilinearly in a picture, and write them to out (uint8), three bytes each,
    from index `to` on.

    Pixel n (n = first, first + 1, ...) is the weighted mean of four neighbouring pixels of picture (flat uint8):
    upper left, upper right, lower left, lower right. corner[n] (int32) is the number of the upper left one; the
    lower ones are `step` bytes further. shares[part[n]] (K, 4) uint16 are the four weights, in 1024ths. One byte
    after the last pixel is written, and two beyond the pixels are read.
    """
    for k in range(count):
        at, share = 3 * np.int64(corner[first + k]), 4 * np.int64(part[first + k])
        total = _blended_pair(picture, at, shares, share) + _blended_pair(picture, at + step, shares, share + 2)
        store(out, to + 3 * k, cast((total + 512) >> 10, u1))


@kernel
def _blended_pair(picture, at, shares, share):
    """Blend a pixel and the one on its right; in whole numbers of 16 bits, which processors multiply and
    add at once.

    picture, at: flat u1, and the byte at which the first pixel begins.
    shares, share: flat u2 in 1024ths, and the index of the first pixel's share.
    Returns: vector of four i4: blue, green, red, and a number without meaning.
    """
    value, weight = load(picture, at, 8), load(shares, share, 2)
    value, weight = cast(_by_colour(value, value), i2), cast(_repeated(weight, weight), i2)
    product = cast(value, i4) * cast(weight, i4)
    return _even(product, product) + _odd(product, product)


@kernel
def outside(picture, low, high, at):
    """Test which of GROUP pixels, from byte `at` on, differ from the room: a pixel does where the value of any
    colour channel is below `low` or above `high`.

    picture, low, high: flat uint8 pictures.
    Returns: whole number whose bit k is set where pixel k differs.
    """
    value = load(picture, at, _BYTES)
    other = (value < load(low, at, _BYTES)) | (value > load(high, at, _BYTES))
    some = where(other, splat(u1(255), _BYTES), splat(u1(0), _BYTES))  # bytes are shuffled faster than bits
    return u8(bits((_blue(some, some) | _green(some, some) | _red(some, some)) != u1(0)))


@kernel
def darker(picture, room, at, darkest, lightest, chroma):
    """Test which of GROUP pixels, from byte `at` on, show the room in shadow.

    Returns: whole number whose bit k is set where pixel k does.

    picture: flat u1.
    at: byte at which the first pixel begins.
    darkest, lightest: least and largest brightness of a shadow relative to the lit room.
    chroma: largest squared colour distance of a shadow, grey levels^2.
    room: f4, flat as pictures.

    The colour is s times the room's colour, s = colour . room / room . room between darkest and lightest, with a rest
    whose square is below chroma. For a black room the product room . room counts as 1.
    """
    colour, mean = load(picture, at, _BYTES), load(room, at, _BYTES)
    x, y, z = _blue(mean, mean), _green(mean, mean), _red(mean, mean)
    b, g, r = cast(_blue(colour, colour), f4), cast(_green(colour, colour), f4), cast(_red(colour, colour), f4)
    s = (b * x + g * y + r * z) / at_least(x * x + y * y + z * z, f4(1))
    b, g, r = b - s * x, g - s * y, r - s * z
    return u8(bits((s > darkest) & (s < lightest) & (b * b + g * g + r * r < chroma)))

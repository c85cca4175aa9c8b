"""numba: the inner steps from pictures to masks as vectors, because the compiler does not see that the three colours of
a pixel lie side by side. Every lane computes the same bits: whole numbers, and floating point that is never fused.

Pictures are flat here, (3 n,) u1: blue, green and red of one pixel after the other.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.simd import at_least, bits, cast, load, ramp, shuffle, splat, store, where

STRIP = 32
"""Bytes of rows that are added at once"""
GROUP = 16
"""Pixels that are compared at once"""

f4, u1, i2, u2, i4, u4, u8 = np.float32, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.uint64
_BYTES = 3 * GROUP
_blue, _green, _red = (shuffle(range(c, _BYTES, 3)) for c in range(3))
_by_colour = shuffle((0, 3, 1, 4, 2, 5, 6, 7))
"""of two pixels and two more bytes: blue of both, green of both, red of both"""
_repeated, _even, _odd = shuffle((0, 1) * 4), shuffle(range(0, 8, 2)), shuffle(range(1, 8, 2))
_next = shuffle((1, 2, 3, 3))


@kernel
def weighted_rows(picture, at, stride, weights, first, lines, half, shift, width, sums):
    """sums (u2) [i], i < width, which is at least STRIP: the sum over k < lines of weights[first + k] (u2) times
    picture (u1) [at + k stride + i], plus half, shifted down; all in 16 bits."""
    for i in range(0, width, STRIP):
        here = min(i, width - STRIP)
        total = splat(u2(half), STRIP)
        for k in range(lines):
            total = total + cast(load(picture, at + here + stride * k, STRIP), u2) * weights[first + k]
        store(sums, here, total >> shift)


@kernel
def weighted_row(sums, columns, start, weights, taps, scale, half, shift, x0, x1, out, to):
    """Pixels x0 <= x < x1 into out (u1), three bytes each from `to` on: the sum over k < taps of weights[x, k] (i4)
    times the pixel columns[x] - start + k of sums (u2), times scale, plus half, shifted down; all in 32 bits. The byte
    after the last pixel becomes 0, and one element of sums beyond the last pixel is read."""
    for x in range(x0, x1):
        at = (columns[x] - start) * 3
        total = splat(u4(0), 4)  # blue, green, red, and what comes after
        for k in range(taps):
            total = total + cast(load(sums, at + 3 * k, 4), u4) * weights[x * taps + k]
        value = cast((total * scale + half) >> shift, u1)
        store(out, to + 3 * (x - x0), where(ramp(4) < 3, value, splat(u1(0), 4)))


@kernel
def blended_row(picture, step, corner, part, shares, first, count, out, to):
    """`count` pixels into out (u1), three bytes each from `to` on. The n-th, from n = first on: of the pixels of
    picture (u1) at number corner[n] (i4), right of it, below (step bytes on) and right of that, shares[part[n]] (K, 4)
    u2 in 1024ths. One byte after the last pixel is written, and two beyond the pixels are read."""
    for k in range(count):
        at, share = 3 * np.int64(corner[first + k]), 4 * np.int64(part[first + k])
        total = _blended_pair(picture, at, shares, share) + _blended_pair(picture, at + step, shares, share + 2)
        store(out, to + 3 * k, cast((total + 512) >> 10, u1))


@kernel
def _blended_pair(picture, at, shares, share):
    """Of a pixel and the one on its right; in whole numbers of 16 bits, which processors multiply and add at once."""
    value, weight = load(picture, at, 8), load(shares, share, 2)
    value, weight = cast(_by_colour(value, value), i2), cast(_repeated(weight, weight), i2)
    product = cast(value, i4) * cast(weight, i4)
    return _even(product, product) + _odd(product, product)


@kernel
def outside(picture, low, high, at):
    """Bit k < GROUP of the result: the k-th pixel from byte `at` on lies in some colour outside low..high (u1)."""
    value = load(picture, at, _BYTES)
    other = (value < load(low, at, _BYTES)) | (value > load(high, at, _BYTES))
    some = where(other, splat(u1(255), _BYTES), splat(u1(0), _BYTES))  # bytes are shuffled faster than bits
    return u8(bits((_blue(some, some) | _green(some, some) | _red(some, some)) != u1(0)))


@kernel
def darker(picture, room, at, darkest, lightest, chroma):
    """Bit k < GROUP of the result: the k-th pixel from byte `at` on shows the room (f4, as pictures), darker:
    s times its colour, s = colour . room / room . room between darkest and lightest, with a rest whose square is below
    chroma. Of a black room the product with itself is 1."""
    colour, mean = load(picture, at, _BYTES), load(room, at, _BYTES)
    x, y, z = _blue(mean, mean), _green(mean, mean), _red(mean, mean)
    b, g, r = cast(_blue(colour, colour), f4), cast(_green(colour, colour), f4), cast(_red(colour, colour), f4)
    s = (b * x + g * y + r * z) / at_least(x * x + y * y + z * z, f4(1))
    b, g, r = b - s * x, g - s * y, r - s * z
    return u8(bits((s > darkest) & (s < lightest) & (b * b + g * g + r * r < chroma)))


@kernel
def mean_outside(picture, at, below, low, high, bound):
    """Whether the mean of the 2 x 2 pixels of picture at byte `at` (the lower ones `below` bytes on) lies in some
    colour outside low..high (u1) at byte bound, of which four are read."""
    upper, lower = _two_pixels(picture, at), _two_pixels(picture, at + below)
    value = (upper + lower + u2(2)) >> 2
    other = (value < cast(load(low, bound, 4), u2)) | (value > cast(load(high, bound, 4), u2))
    return (bits(other) & 7) != 0


@kernel
def _two_pixels(picture, at):
    """The sum of a pixel and the one on its right; a fourth number is rubbish."""
    right = load(picture, at + 2, 4)  # reads no byte beyond it
    return cast(load(picture, at, 4), u2) + cast(_next(right, right), u2)

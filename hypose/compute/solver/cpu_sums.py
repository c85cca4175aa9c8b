"""numba: sums of rows as vectors: the compiler makes none of the sums in a fixed order of cpu_cholesky.dot.

EIGHT partial sums are kept for each and added in the order of `dot`, so the bits are the same as there.
"""

from __future__ import annotations

from hypose.compute.compiled import kernel
from hypose.compute.simd import lane, load, shuffle, splat

EIGHT = 8
SUMS = 27
"""of a joint: for each of the six parts x of a wrench w x . y with the parts y up to it, and w x . residual"""

_low, _high = shuffle(range(4)), shuffle(range(4, 8))


@kernel
def wrench_sums(lanes, row, first, last, sums):
    """sums (SUMS,) of the columns first..last, a multiple of EIGHT, of lanes (9, row) f8: wrench (6), weight w,
    residual, scratch. In the order x y: w x . y for y = 0..x, then w x . residual, for x = 0..5."""
    s = sums  # in three loops of nine, whose sums share what is loaded
    s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8] = _among(lanes, row, first, last, 0)
    s[12], s[13], s[17], s[18], s[19], s[23], s[24], s[25], s[26] = _among(lanes, row, first, last, 3)
    s[9], s[10], s[11], s[14], s[15], s[16], s[20], s[21], s[22] = _between(lanes, row, first, last)


@kernel
def _among(lanes, row, first, last, x):
    """The sums of three parts from x on with each other and with the residual, in that order."""
    zero = splat(0.0, EIGHT)
    aa, ar, ba, bb, br, ca, cb, cc, cr = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(first, last, EIGHT):
        w, r = load(lanes, 6 * row + k, EIGHT), load(lanes, 7 * row + k, EIGHT)
        a, b, c = _parts(lanes, row, x, k)
        wa, wb, wc = w * a, w * b, w * c
        aa, ar, ba, bb, br = aa + wa * a, ar + wa * r, ba + wb * a, bb + wb * b, br + wb * r
        ca, cb, cc, cr = ca + wc * a, cb + wc * b, cc + wc * c, cr + wc * r
    return _added(aa), _added(ar), _added(ba), _added(bb), _added(br), _added(ca), _added(cb), _added(cc), _added(cr)


@kernel
def _between(lanes, row, first, last):
    """The sums of the last three parts with the first three, one after the other."""
    zero = splat(0.0, EIGHT)
    ax, ay, az, bx, by, bz, cx, cy, cz = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(first, last, EIGHT):
        w = load(lanes, 6 * row + k, EIGHT)
        x, y, z = _parts(lanes, row, 0, k)
        a, b, c = _parts(lanes, row, 3, k)
        a, b, c = w * a, w * b, w * c
        ax, ay, az, bx, by, bz = ax + a * x, ay + a * y, az + a * z, bx + b * x, by + b * y, bz + b * z
        cx, cy, cz = cx + c * x, cy + c * y, cz + c * z
    return _added(ax), _added(ay), _added(az), _added(bx), _added(by), _added(bz), _added(cx), _added(cy), _added(cz)


@kernel
def _parts(lanes, row, x, k):
    """Three parts of the wrenches, from x on, of EIGHT columns."""
    return load(lanes, x * row + k, EIGHT), load(lanes, (x + 1) * row + k, EIGHT), load(lanes, (x + 2) * row + k, EIGHT)


@kernel
def _added(value):
    """The partial sums as one, in the order of `dot`."""
    four = _low(value, value) + _high(value, value)
    return (lane(four, 0) + lane(four, 1)) + (lane(four, 2) + lane(four, 3))

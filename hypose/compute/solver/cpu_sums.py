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
    n = 0
    for x in range(6):
        for y in range(0, x + 2, 3):  # three at a time, which share a factor; the last one again where less is left
            a, b, c = y, min(y + 1, x + 1), min(y + 2, x + 1)
            rows = (a if a <= x else 7, b if b <= x else 7, c if c <= x else 7)
            sums[n + a], sums[n + b], sums[n + c] = _three(lanes, row, first, last, x, rows)
        n += x + 2


@kernel
def _three(lanes, row, first, last, x, rows):
    """The sums of w x times these rows."""
    (a, b, c), zero = rows, splat(0.0, EIGHT)
    p, q, r = zero, zero, zero
    for at in range(first, last, EIGHT):
        weighted = load(lanes, 6 * row + at, EIGHT) * load(lanes, x * row + at, EIGHT)
        p = p + weighted * load(lanes, a * row + at, EIGHT)
        q = q + weighted * load(lanes, b * row + at, EIGHT)
        r = r + weighted * load(lanes, c * row + at, EIGHT)
    return _added(p), _added(q), _added(r)


@kernel
def _added(value):
    """The partial sums as one, in the order of `dot`."""
    four = _low(value, value) + _high(value, value)
    return (lane(four, 0) + lane(four, 1)) + (lane(four, 2) + lane(four, 3))

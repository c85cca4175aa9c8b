"""The inner steps of the silhouette scorer as explicit vectors, because the compiler does not vectorise them reliably.

A block holds LANES particles; an array of per-vertex values is (V, LANES), so one load fetches the value of one vertex
for all particles. Every lane computes the same bits.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.simd import (
    as_bytes,
    as_word,
    at_least,
    at_most,
    bits,
    cast,
    ceil,
    load,
    popcount,
    ramp,
    splat,
    store,
    times_plus,
    where,
)

LANES = 16
"""Particles per block; one AVX-512 register of float32."""
STRIP = 64
"""Image columns per strip of the counting pass; one AVX-512 register of int8."""
GUARD = 64
"""Running counts beyond +-GUARD leave the int8 path; steps of one pixel are kept below it, so none can jump past."""

f4, i1, i2, i4, u4 = np.float32, np.int8, np.int16, np.int32, np.uint32


@kernel
def skin_vertex(maps, joint, weight, first, end, x, y, z, out, vertex):
    """Linear blend skinning of one vertex x, y, z (f4) in all lanes: influences first..end of joint (i4), weight (f4);
    maps (J, 12, LANES) f4 rows of the (3, 4) maps; into row vertex of out (V, 3, LANES) f4."""
    a, b, c = splat(f4(0), LANES), splat(f4(0), LANES), splat(f4(0), LANES)
    for k in range(first, end):
        w, at = weight[k], joint[k] * (12 * LANES)
        a = _add_row(maps, at, w * x, w * y, w * z, w, a)
        b = _add_row(maps, at + 4 * LANES, w * x, w * y, w * z, w, b)
        c = _add_row(maps, at + 8 * LANES, w * x, w * y, w * z, w, c)
    store(out, vertex * (3 * LANES), a)
    store(out, vertex * (3 * LANES) + LANES, b)
    store(out, vertex * (3 * LANES) + 2 * LANES, c)


@kernel
def _add_row(maps, at, x, y, z, w, total):
    total = times_plus(load(maps, at, LANES), x, total)
    total = times_plus(load(maps, at + LANES, LANES), y, total)
    total = times_plus(load(maps, at + 2 * LANES, LANES), z, total)
    return times_plus(load(maps, at + 3 * LANES, LANES), w, total)


@kernel
def project_vertices(points, p, u, v, bounds):
    """Pixels u, v (V, LANES) of points (V, 3, LANES) under projections p (12, LANES), all f4; bounds (5, LANES) gets
    x0, x1, y0, y1 and the nearest depth."""
    left, right, top = splat(f4(1e9), LANES), splat(f4(-1e9), LANES), splat(f4(1e9), LANES)
    bottom, near = splat(f4(-1e9), LANES), splat(f4(1e9), LANES)
    for k in range(points.shape[0]):
        at = 3 * LANES * k
        x, y, z = load(points, at, LANES), load(points, at + LANES, LANES), load(points, at + 2 * LANES, LANES)
        depth = _times_row(p, 8 * LANES, x, y, z)
        inverse = f4(1) / depth
        a, b = _times_row(p, 0, x, y, z) * inverse, _times_row(p, 4 * LANES, x, y, z) * inverse
        store(u, LANES * k, a)
        store(v, LANES * k, b)
        left, right, top, bottom = at_most(a, left), at_least(a, right), at_most(b, top), at_least(b, bottom)
        near = at_most(depth, near)
    store(bounds, 0, left)
    store(bounds, LANES, right)
    store(bounds, 2 * LANES, top)
    store(bounds, 3 * LANES, bottom)
    store(bounds, 4 * LANES, near)


@kernel
def _times_row(p, at, x, y, z):
    """A row of projections times points."""
    value = times_plus(load(p, at + 2 * LANES, LANES), z, load(p, at + 3 * LANES, LANES))
    return times_plus(load(p, at, LANES), x, times_plus(load(p, at + LANES, LANES), y, value))


@kernel
def front_lanes(u, v, a, b, c):
    """Bit l of the result: the triangle of vertices a, b, c (rows of u, v (V, LANES)) is clockwise in lane l."""
    ua, ub, uc = load(u, a * LANES, LANES), load(u, b * LANES, LANES), load(u, c * LANES, LANES)
    va, vb, vc = load(v, a * LANES, LANES), load(v, b * LANES, LANES), load(v, c * LANES, LANES)
    return bits((ub - ua) * (vc - va) < (uc - ua) * (vb - va))


@kernel
def prepare_edge(u, v, a, b, window, edge, columns):
    """The edge from vertex a to b in every lane: where it starts in the lane's window and how it runs.

    window (5, LANES) f4: origin x, y, first and end column, rows. Writes edge (4, LANES) f4: left end x, y in the
    window, slope, first column; columns (LANES,) i4: how many it crosses. Returns two masks of lanes: bits 0-15 it
    crosses columns and is not wholly below the window, bits 16-31 it runs right to left.
    """
    left, top, rows = load(window, 0, LANES), load(window, LANES, LANES), load(window, 4 * LANES, LANES)
    xa, xb = load(u, a * LANES, LANES) - left, load(u, b * LANES, LANES) - left
    ya, yb = load(v, a * LANES, LANES) - top, load(v, b * LANES, LANES) - top
    swap = xa > xb
    x0, x1, y0, y1 = where(swap, xb, xa), where(swap, xa, xb), where(swap, yb, ya), where(swap, ya, yb)
    first, end = ceil(at_least(x0, load(window, 2 * LANES, LANES))), ceil(at_most(x1, load(window, 3 * LANES, LANES)))
    active = (first < end) & ((y0 < rows) | (y1 < rows))
    store(edge, 0, x0)
    store(edge, LANES, y0)
    store(edge, 2 * LANES, (y1 - y0) / (x1 - x0))
    store(edge, 3 * LANES, first)
    store(columns, 0, cast(where(active, end - first, splat(f4(0), LANES)), i4))
    return u4(bits(active)) | (u4(bits(swap)) << u4(16))


@kernel
def write_crossings(edge, lane, skip, rows, stride, out, place):
    """LANES pixel indices row * stride + column into out (i4, flat index place): where the prepared edge of a lane
    crosses its columns, from the skip-th on. Those past its end are rubbish, for the next edge to overwrite."""
    x0, y0, slope, first = edge[0, lane], edge[1, lane], edge[2, lane], edge[3, lane]
    column = cast(ramp(LANES), f4) + (first + f4(skip))
    y = (column - x0) * slope + y0
    # the last clamp: rubbish past the image must convert too
    row = ceil(at_most(at_least(y, f4(0)), f4(rows)))
    store(out, place, cast(row, i4) * stride + cast(column, i4))


@kernel
def count_strip(difference, start, stride, rows, mask, drawn, mask_start, mask_stride, counts):
    """Running sums down STRIP columns of difference (i1, flat, from index start): adds to counts (3,) i8 the pixels
    where the sum is positive and that are not set in drawn, those of them set in mask (both u1, packed, low bit first,
    flat index mask_start), and the strips whose sums came near the end of int8. Clears what it read."""
    zero = splat(i1(0), STRIP)
    total, highest, lowest, model, hit = zero, zero, zero, 0, 0
    for k in range(rows):
        here, at = start + k * stride, mask_start + k * mask_stride
        total = total + load(difference, here, STRIP)
        store(difference, here, zero)
        highest, lowest = at_least(total, highest), at_most(total, lowest)
        inside = bits(total > zero) & ~as_word(load(drawn, at, 8))
        model += popcount(inside)
        hit += popcount(inside & as_word(load(mask, at, 8)))
    counts[0] += model
    counts[1] += hit
    counts[2] += bits((highest > i1(GUARD - 1)) | (lowest < i1(-GUARD))) != 0


@kernel
def fill_strip(difference, start, stride, rows, mask, out, place, line, counts):
    """Running sums down STRIP columns of difference (i1, flat, from index start), cleared with it. In out (u1, packed,
    low bit first, flat index `place`, `line` bytes a row) the pixels where the sum is positive are set and no others;
    adds to counts (2,) i8 those pixels, and those of them that were set in mask, packed alike."""
    zero = splat(i1(0), STRIP)
    total, model, hit = zero, 0, 0
    for k in range(rows):
        here, at = start + k * stride, place + k * line
        total = total + load(difference, here, STRIP)
        store(difference, here, zero)
        inside = bits(total > zero)
        model += popcount(inside)
        hit += popcount(inside & as_word(load(mask, at, 8)))
        store(out, at, as_bytes(inside))
    counts[0] += model
    counts[1] += hit


@kernel
def row_stride(columns):
    """Bytes per row of the difference image of a window: whole strips, an odd number so that a column of them does
    not fall on few sets of the cache."""
    return STRIP * (((columns + STRIP - 1) // STRIP) | 1)

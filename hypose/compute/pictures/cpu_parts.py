"""numba: which parts of a body a picture shows (parts.py). A picture is rows of 64 pixels to a word, lowest bit first,
and what lies beyond its last column is never set."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel

NEAR = 0.05
"""Triangles with a corner nearer than this (m) are not drawn."""
_ONE, _ALL = np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)
_PAIRS, _QUADS, _BYTES = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM, _GATHER = np.uint64(0x0101010101010101), np.uint64(0x0102040810204080)


@kernel
def place(points, projection, uv, z, reach):
    """Pixels uv (N, 2), NaN behind the camera, and z (N,) m along the axis of it, of points (N, 3) m; projection
    (3, 4); reach (2, 2): the least and the most of u and of v, infinite without any."""
    p = projection
    reach[:, 0], reach[:, 1] = np.inf, -np.inf
    for i in range(points.shape[0]):
        x, y, t = points[i, 0], points[i, 1], points[i, 2]
        far = p[2, 0] * x + p[2, 1] * y + p[2, 2] * t + p[2, 3]
        z[i] = far
        uv[i, 0] = uv[i, 1] = np.nan
        if far > NEAR:
            uv[i, 0] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * t + p[0, 3]) / far
            uv[i, 1] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * t + p[1, 3]) / far
            for k in range(2):
                reach[k, 0], reach[k, 1] = min(reach[k, 0], uv[i, k]), max(reach[k, 1], uv[i, k])


@kernel
def draw(uv, z, faces, part, width, out):
    """Set the pixels in out[part[f]] (P, h, W), width columns wide, whose centres face f of faces (F, 3) covers, of
    either orientation. uv (V, 2) px, z (V,) m."""
    h = out.shape[1]
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if not (z[a] > NEAR and z[b] > NEAR and z[c] > NEAR):
            continue
        xa, ya, xb, yb, xc, yc = uv[a, 0], uv[a, 1], uv[b, 0], uv[b, 1], uv[c, 0], uv[c, 1]
        if not np.isfinite(xa + ya + xb + yb + xc + yc):
            continue
        if ya > yb:
            xa, ya, xb, yb = xb, yb, xa, ya
        if ya > yc:
            xa, ya, xc, yc = xc, yc, xa, ya
        if yb > yc:
            xb, yb, xc, yc = xc, yc, xb, yb
        r0 = max(0, int(math.ceil(max(ya, -1.0))))
        r1 = min(h - 1, int(math.floor(min(yc, h + 1.0))))
        if r0 > r1 or yc <= ya:
            continue
        slope, plane = (xc - xa) / (yc - ya), part[f]
        middle = min(max(int(math.ceil(min(max(yb, -1.0), h + 1.0))), r0), r1 + 1)
        for below in range(2):  # the side with b, from a on and to c
            x, y, begin, end = (xb, yb, middle, r1 + 1) if below else (xa, ya, r0, middle)
            height = (yc - yb) if below else (yb - ya)
            other = ((xc - xb) if below else (xb - xa)) / height if height > 0.0 else 0.0
            for r in range(begin, end):
                p, q = xa + (r - ya) * slope, x + (r - y) * other
                first = max(0, int(math.ceil(max(min(p, q), -1.0))))
                last = min(width - 1, int(math.floor(min(max(p, q), width + 1.0))))
                _set(out, plane, r, first, last)


@kernel(inline=True)
def _set(bits, p, r, first, last):
    """The pixels first to last of row r of picture p of bits (P, h, W); none when the last comes before the first."""
    i, j = first >> 6, last >> 6
    begin, end = _ALL << np.uint64(first & 63), _ALL >> np.uint64(63 - (last & 63))
    if i == j:  # most often, which is told easily by the processor; whether the row is empty is not
        bits[p, r, i] |= begin & end
    elif i < j:
        bits[p, r, i] |= begin
        for k in range(i + 1, j):
            bits[p, r, k] = _ALL
        bits[p, r, j] |= end


@kernel(inline=True)
def _count(word):
    """How many bits are set."""
    word = word - ((word >> _ONE) & _PAIRS)
    word = (word & _QUADS) + ((word >> np.uint64(2)) & _QUADS)
    return np.int64((((word + (word >> np.uint64(4))) & _BYTES) * _SUM) >> np.uint64(56))


@kernel(inline=True)
def _last(k, words, width):
    """Which bits of word k of a row lie in the picture."""
    return _ALL if k < words - 1 else _ALL >> np.uint64(64 * words - width)


@kernel
def _thin(packed, first, step, width, out):
    """Every step-th pixel of a mask, eight to a byte (H, B), from first (row, column) on, as a picture of bits out (h,
    words)."""
    h, words = out.shape
    line = np.zeros(64 * words, np.uint8)
    eights = line.view(np.uint64)
    for r in range(h):
        y, x = first[0] + r * step, first[1]
        for i in range(width):
            line[i] = (packed[y, x >> 3] >> (x & 7)) & 1
            x += step
        for k in range(words):
            word = np.uint64(0)
            for b in range(8):
                word |= (eights[8 * k + b] * _GATHER >> np.uint64(56)) << np.uint64(8 * b)
            out[r, k] = word


@kernel
def _grow(bits, width, out):
    """A picture (h, W) of bits, and what touches it, corners too."""
    h, words = bits.shape
    for k in range(words):
        within = _last(k, words, width)
        above, here = np.uint64(0), _beside(bits, 0, k) & within
        for r in range(h):
            below = _beside(bits, r + 1, k) & within if r + 1 < h else np.uint64(0)
            out[r, k] = above | here | below
            above, here = here, below


@kernel(inline=True)
def _beside(bits, r, k):
    """Word k of row r of bits (h, W), with the pixels left and right of what is set."""
    word = bits[r, k] | bits[r, k] << _ONE | bits[r, k] >> _ONE
    if k:
        word |= bits[r, k - 1] >> np.uint64(63)
    if k + 1 < bits.shape[1]:
        word |= bits[r, k + 1] << np.uint64(63)
    return word


@kernel
def _opened(covered, within, width, space, out):
    """What of `within` (h, W) lies further than a pixel from `covered`, less what is thinner than three pixels; beyond
    the border lies more of the same. space (h, W)."""
    _grow(covered, width, out)
    for r in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[r, k] |= ~within[r, k] & _last(k, out.shape[1], width)
    _grow(out, width, space)
    for r in range(out.shape[0]):
        for k in range(out.shape[1]):
            space[r, k] = ~space[r, k] & _last(k, out.shape[1], width)
    _grow(space, width, out)


@kernel
def against_mask(mask, hidden, first, step, width, parts, points, square, area, exposed, outside, bare):
    """Counts of `parts.PartView`: of parts (P, h, W) drawn where every step-th pixel of a packed mask (H, B), from
    first (row, column) on, is a pixel; hidden (H, B), (0, 0): none. points (N, 2) in those pixels, square (N,) of
    radii. parts[0] holds all of them afterwards."""
    n, h, words = parts.shape
    seen, shown = np.empty((h, words), np.uint64), np.empty((h, words), np.uint64)
    space, found, everything = np.empty_like(seen), np.empty_like(seen), np.full((h, words), _ALL)
    _thin(mask, first, step, width, seen)
    if hidden.shape[0]:
        _thin(hidden, first, step, width, shown)
    else:
        shown[:] = np.uint64(0)
    for r in range(h):
        for k in range(words):
            space[r, k] = seen[r, k] | shown[r, k]
            seen[r, k], shown[r, k] = seen[r, k] & ~shown[r, k], ~shown[r, k]
    body = space  # in turn what covers the mask, then what the body covers
    _opened(body, everything, width, np.empty_like(seen), found)
    for r in range(h):
        for k in range(words):
            once, twice = np.uint64(0), np.uint64(0)
            for p in range(n):
                twice |= once & parts[p, r, k]
                once |= parts[p, r, k]
            body[r, k] = once
            if once == 0:
                continue
            alone, out = shown[r, k] & ~twice, found[r, k]
            for p in range(n):
                word = parts[p, r, k]
                if word:
                    area[p] += _count(word)
                    exposed[p] += _count(word & alone)
                    outside[p] += _count(word & out)
    _opened(body, seen, width, np.empty_like(seen), found)
    for r in range(h):
        for k in range(words):
            word, x = found[r, k], 64 * k
            while word:
                if word & _ONE:
                    for i in range(points.shape[0]):
                        dx, dy = x - points[i, 0], r - points[i, 1]
                        if dx * dx + dy * dy < square[i]:
                            bare[i] += 1
                word >>= _ONE
                x += 1
            parts[0, r, k] = body[r, k]

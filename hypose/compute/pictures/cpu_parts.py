"""numba: which parts of a body a picture shows (parts.py)."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel

NEAR = 0.05
"""Triangles with a corner nearer than this (m) are not drawn."""


@kernel
def draw(uv, z, faces, bit, out):
    """Set the bit of each face (F,) in out (h, w) where the face, of either orientation, covers a pixel's centre."""
    h, w = out.shape
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
        r0 = max(0, int(np.ceil(max(ya, -1.0))))
        r1 = min(h - 1, int(np.floor(min(yc, h + 1.0))))
        if r0 > r1 or yc <= ya:
            continue
        slope = (xc - xa) / (yc - ya)
        upper = (xb - xa) / (yb - ya) if yb > ya else 0.0
        lower = (xc - xb) / (yc - yb) if yc > yb else 0.0
        for r in range(r0, r1 + 1):
            p = xa + (r - ya) * slope
            if r < yb:
                q = xa + (r - ya) * upper
            elif yc > yb:
                q = xb + (r - yb) * lower
            else:
                q = xb
            if p > q:
                p, q = q, p
            first, last = int(np.ceil(max(p, -1.0))), int(np.floor(min(q, w + 1.0)))
            for x in range(max(0, first), min(w - 1, last) + 1):
                out[r, x] |= bit[f]


@kernel
def tally(parts, outside, area, exposed, over):
    """Pixels of each part; those that it alone covers; those that lie outside."""
    for r in range(parts.shape[0]):
        line, beside = parts[r], outside[r]
        for x in range(line.shape[0]):
            left = np.uint32(line[x])
            alone, out = (left & (left - np.uint32(1))) == 0, beside[x] != 0
            k = 0
            while left != 0:  # most pixels have one part or two
                while (left & np.uint32(1)) == 0:
                    left >>= np.uint32(1)
                    k += 1
                area[k] += 1
                exposed[k] += alone
                over[k] += out
                left >>= np.uint32(1)
                k += 1


@kernel
def near(bare, uv, square, count):
    """Number of bare pixels nearer to each of the points (N, 2) than the square root of its square (N,)."""
    for r in range(bare.shape[0]):
        for x in range(bare.shape[1]):
            if bare[r, x]:
                for k in range(uv.shape[0]):
                    dx, dy = x - uv[k, 0], r - uv[k, 1]
                    if dx * dx + dy * dy < square[k]:
                        count[k] += 1

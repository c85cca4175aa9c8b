"""Which parts of a body a picture shows, small and fast: every pixel knows all the parts that cover it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel

_NEAR = 0.05  # m: triangles with a corner nearer than this are not drawn
_CROSS = np.ones((3, 3), np.uint8)


@kernel
def _draw(uv, z, faces, bit, out):
    """Set the bit of its part in out (h, w) wherever a face covers the pixel's centre."""
    h, w = out.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if not (z[a] > _NEAR and z[b] > _NEAR and z[c] > _NEAR):
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
def _tally(parts, outside, area, exposed, over):
    """Pixels of each part; those that it alone covers; those that lie outside."""
    n = area.shape[0]
    for r in range(parts.shape[0]):
        for x in range(parts.shape[1]):
            p = parts[r, x]
            if p == 0:
                continue
            for k in range(n):
                if p & (np.uint16(1) << np.uint16(k)):
                    area[k] += 1
                    if p == (np.uint16(1) << np.uint16(k)):
                        exposed[k] += 1
                    if outside[r, x]:
                        over[k] += 1


@kernel
def _near(bare, uv, square, count):
    """Number of bare pixels nearer to each of the points (N, 2) than the square root of its square (N,)."""
    for r in range(bare.shape[0]):
        for x in range(bare.shape[1]):
            if bare[r, x]:
                for k in range(uv.shape[0]):
                    dx, dy = x - uv[k, 0], r - uv[k, 1]
                    if dx * dx + dy * dy < square[k]:
                        count[k] += 1


class PartView(NamedTuple):
    """A body's parts against one mask, in pixels: area, exposed (covered by no other part) and outside (of the mask,
    less its rim) of each part (P,); bare (N,): pixels of the mask without body within a radius of each point."""

    area: NDArray[np.int64]
    exposed: NDArray[np.int64]
    outside: NDArray[np.int64]
    bare: NDArray[np.int64]


def parts_against_mask(
    mask: NDArray[np.uint8],
    uv: ArrayLike,
    z: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint16],
    n_parts: int,
    points: ArrayLike,
    radius: ArrayLike,
) -> PartView:
    """A mesh with vertices at uv (V, 2) px and depths z (V,) m against a mask (h, w) of 0 and 1.

    part (F,): each face's part, below n_parts (16 at most); points (N, 2) px, radius (N,) px: around which bare mask is
    counted. Rims of one pixel count neither as bare nor as outside, nor does what is thinner than three pixels.
    """
    drawn = np.zeros(mask.shape, np.uint16)
    bit = (np.uint16(1) << part.astype(np.uint16)).astype(np.uint16)
    _draw(np.asarray(uv, np.float64), np.asarray(z, np.float64), faces, bit, drawn)
    body = (drawn > 0).astype(np.uint8)
    outside = cv2.morphologyEx(1 - cv2.dilate(mask, _CROSS), cv2.MORPH_OPEN, _CROSS)
    bare = cv2.morphologyEx(mask & (1 - cv2.dilate(body, _CROSS)), cv2.MORPH_OPEN, _CROSS)
    out = PartView(*(np.zeros(n_parts, np.int64) for _ in range(3)), np.zeros(len(np.asarray(points)), np.int64))
    _tally(drawn, outside, out.area, out.exposed, out.outside)
    _near(bare, np.asarray(points, np.float64), np.asarray(radius, np.float64) ** 2, out.bare)
    return out

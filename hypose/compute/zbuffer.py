"""Draw triangles with a z-buffer: each pixel keeps the nearest; and interpolate vertex values at the drawn pixels.

A pixel belongs to a triangle when its centre lies inside; pixel centres are at integer coordinates. The compared value
is the inverse of the depth along the optical axis (1/m, 0 where nothing is), which is linear over the picture.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel

f4 = np.float32
NEAR = 0.05
"""Triangles with a corner nearer than this (m) are not drawn."""


@kernel
def project(p, vertices, chosen, seen, size, box):
    """Project some vertices into a picture.

    p: (3, 4) float32 projection of points relative to the root's position.
    vertices: (V, 3) m, relative to the root's position.
    chosen: indices of the vertices to project.

    seen: (4, V) gets the pixels u and v, the depths, m, and the inverse depths (0: nearer than NEAR).
    size: (2,) width and height of the picture.
    box: (4,) gets x0, x1, y0, y1 of the part of the picture in which the vertices in front of NEAR lie.
    """
    u, v, z, inverse = seen[0], seen[1], seen[2], seen[3]
    x0, x1, y0, y1 = f4(1e6), f4(-1e6), f4(1e6), f4(-1e6)
    for k in range(chosen.shape[0]):
        i = chosen[k]
        x, y, d = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        away = p[2, 0] * x + p[2, 1] * y + p[2, 2] * d + p[2, 3]
        z[i], inverse[i], u[i], v[i] = away, f4(0), f4(0), f4(0)
        if away >= f4(NEAR):
            inverse[i] = f4(1) / away
            u[i] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * d + p[0, 3]) * inverse[i]
            v[i] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * d + p[1, 3]) * inverse[i]
            x0, x1, y0, y1 = min(x0, u[i]), max(x1, u[i]), min(y0, v[i]), max(y1, v[i])
    box[0], box[1] = int(max(x0, f4(0))), int(min(x1 + f4(1), f4(size[0])))
    box[2], box[3] = int(max(y0, f4(0))), int(min(y1 + f4(1), f4(size[1])))


@kernel
def draw_nearest(u, v, inverse, faces, chosen, cull, nearest, face):
    """Draw some faces into a z-buffer: a pixel changes where the face lies in front of its present content.

    faces, chosen: (F, 3) triangles, and (N,) indices of those to draw.
    u, v: (V,) positions of the vertices in the picture, px.
    inverse: (V,) inverse depth of the vertices, 1/m; faces with a corner of value 0 are omitted.
    cull: whether to omit faces seen from inside (the corners of the others run clockwise in a picture whose y points
        down).
    nearest: (h, w) f4, gets the inverse depth.
    face: (h, w) i4, gets the numbers of the faces, or None.
    """
    h, w = nearest.shape
    for n in range(chosen.shape[0]):
        f = chosen[n]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ia, ib, ic = inverse[a], inverse[b], inverse[c]
        if not (ia > 0 and ib > 0 and ic > 0):
            continue
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if area == 0 or (cull and area > 0) or not math.isfinite(area):
            continue
        across = ((ib - ia) * (yc - ya) - (ic - ia) * (yb - ya)) / area
        down = ((ic - ia) * (xb - xa) - (ib - ia) * (xc - xa)) / area
        origin = ia - across * xa - down * ya
        if ya > yb:
            xa, ya, xb, yb = xb, yb, xa, ya
        if ya > yc:
            xa, ya, xc, yc = xc, yc, xa, ya
        if yb > yc:
            xb, yb, xc, yc = xc, yc, xb, yb
        first, last = int(math.ceil(max(ya, 0.0))), int(math.floor(min(yc, h - 1.0)))
        if first > last or yc <= ya:
            continue
        long = (xc - xa) / (yc - ya)
        upper = (xb - xa) / (yb - ya) if yb > ya else 0.0
        lower = (xc - xb) / (yc - yb) if yc > yb else 0.0
        for y in range(first, last + 1):
            p = xa + (y - ya) * long
            q = xa + (y - ya) * upper if y < yb else xb + (y - yb) * lower
            left, right = int(math.ceil(max(min(p, q), 0.0))), int(math.floor(min(max(p, q), w - 1.0)))
            if left > right:
                continue
            # a slice, so that indices are known to be positive and the loop runs in vector lanes
            row, start, step = nearest[y, left : right + 1], f4(origin + across * left + down * y), f4(across)
            if face is None:
                for x in range(row.shape[0]):
                    row[x] = max(row[x], start + f4(x) * step)
            else:
                for x in range(row.shape[0]):
                    value = start + f4(x) * step
                    if value > row[x]:
                        row[x] = value
                        face[y, left + x] = f


def inverse_depth(z: ArrayLike, near: float = NEAR) -> NDArray[np.float64]:
    """Compute the inverse depths (V,), 1/m, of depths z (V,), m; 0 where a depth is below `near` (m) or NaN."""
    depth = np.asarray(z, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth > near, 1 / depth, 0.0)


def draw_faces(
    uv: ArrayLike,
    inverse: NDArray[np.float64],
    faces: NDArray[np.int32],
    nearest: NDArray[np.float32],
    face: NDArray[np.int32] | None = None,
    *,
    cull: bool = False,
) -> None:
    """Draw all faces (F, 3) of vertices at uv (V, 2) px, with inverse depths (V,) 1/m, into nearest (h, w), in
    place.

    nearest: (h, w) float32 inverse depth, 1/m, which is changed.
    face: (h, w) int32 that gets the numbers of the visible faces; None: not wanted.
    cull: whether to omit faces seen from inside.
    """
    u, v = (plain(x, np.float64) for x in np.asarray(uv, dtype=np.float64).T)
    f = plain(faces, np.int32)
    draw_nearest(u, v, inverse, f, np.arange(len(f)), cull, nearest, face)


def rasterize(
    uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], size: tuple[int, int], *, cull: bool = True
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Draw triangles with a z-buffer.

    uv, z: (V, 2) px and (V,) m, projected vertices and their depth along the optical axis.
    faces: (F, 3), counter-clockwise from outside.
    size: (width, height).
    cull: whether to omit faces seen from inside.
    Returns: depth (h, w) m (inf where empty), and face_id (h, w) (-1 where empty). A triangle that reaches nearer than
        NEAR is omitted.
    """
    w, h = size
    nearest, face = np.zeros((h, w), f4), np.full((h, w), -1, np.int32)
    draw_faces(uv, inverse_depth(z), faces, nearest, face, cull=cull)
    with np.errstate(divide="ignore"):
        return 1 / nearest, face


def interpolate(
    face: NDArray[np.int32], uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], values: ArrayLike
) -> NDArray[np.float32]:
    """Interpolate vertex values (V, K) at the drawn pixels of a picture, with perspective.

    face: (h, w) number of the face at each pixel, -1 for none, as `rasterize` returns it; the other arguments are as
        given to it.
    Returns: (N, K) values at the N drawn pixels, row by row.
    """
    y, x = np.nonzero(face >= 0)
    corners, at = faces[face[y, x]], np.asarray(uv, dtype=np.float64)
    (ua, va), (ub, vb), (uc, vc) = (at[corners[:, k]].T for k in range(3))
    second, third = (x - ua) * (vc - va) - (uc - ua) * (y - va), (ub - ua) * (y - va) - (x - ua) * (vb - va)
    first = (ub - ua) * (vc - va) - (uc - ua) * (vb - va) - second - third
    share = np.stack([first, second, third], 1) / np.asarray(z, dtype=np.float64)[corners]
    share = (share / share.sum(1, keepdims=True)).astype(f4)
    return np.einsum("nc,nck->nk", share, np.asarray(values, dtype=f4)[corners])

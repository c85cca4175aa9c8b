"""numba: the outline of one pose in VIEWS views at once, a vector lane to each view.

The steps are those of cpu_silhouettes.py, and so are the bits: what is the same in all views, which corners a face has
and which faces meet in an edge, is read once for all of them.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import camera_about_root
from hypose.compute.silhouettes.cpu_silhouettes import cross_columns
from hypose.compute.simd import at_least, at_most, bits, load, splat, store

VIEWS = 4
"""views that are looked at together: a register of every processor"""

f4, u4 = np.float32, np.uint32


@kernel
def _project_views(vertices, p, uv, bounds):
    """Pixels uv (V, 2, VIEWS) of vertices (V, 3) under projections p (12, VIEWS), all f4; bounds (5, VIEWS) gets
    x0, x1, y0, y1 and the nearest depth."""
    left, right, top = splat(f4(1e9), VIEWS), splat(f4(-1e9), VIEWS), splat(f4(1e9), VIEWS)
    bottom, near = splat(f4(-1e9), VIEWS), splat(f4(1e9), VIEWS)
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k, 0], vertices[k, 1], vertices[k, 2]
        depth = _times_row(p, 8 * VIEWS, x, y, z)
        inverse = f4(1) / depth
        u, v = _times_row(p, 0, x, y, z) * inverse, _times_row(p, 4 * VIEWS, x, y, z) * inverse
        store(uv, 2 * VIEWS * k, u)
        store(uv, 2 * VIEWS * k + VIEWS, v)
        left, right, top, bottom = at_most(u, left), at_least(u, right), at_most(v, top), at_least(v, bottom)
        near = at_most(depth, near)
    store(bounds, 0, left)
    store(bounds, VIEWS, right)
    store(bounds, 2 * VIEWS, top)
    store(bounds, 3 * VIEWS, bottom)
    store(bounds, 4 * VIEWS, near)


@kernel
def _times_row(p, at, x, y, z):
    """A row of projections times a point."""
    value = load(p, at, VIEWS) * x + load(p, at + VIEWS, VIEWS) * y + load(p, at + 2 * VIEWS, VIEWS) * z
    return value + load(p, at + 3 * VIEWS, VIEWS)


@kernel
def _front_views(uv, a, b, c):
    """Bit k of the result: the triangle of vertices a, b, c (rows of uv (V, 2, VIEWS) f4) is clockwise in view k."""
    i, j, k = a * (2 * VIEWS), b * (2 * VIEWS), c * (2 * VIEWS)
    ua, ub, uc = load(uv, i, VIEWS), load(uv, j, VIEWS), load(uv, k, VIEWS)
    va, vb, vc = load(uv, i + VIEWS, VIEWS), load(uv, j + VIEWS, VIEWS), load(uv, k + VIEWS, VIEWS)
    return bits((ub - ua) * (vc - va) < (uc - ua) * (vb - va))


@kernel
def project_views(vertices, projections, first, q, p, turned, uv, bounds):
    """Pixels uv (V, 2, VIEWS) of vertices (V, 3) f4, about the root of pose q, in the views from `first` on (the last
    one repeated) of projections (C, 3, 4) f8, which become p (VIEWS, 3, 4) f4; bounds (5, VIEWS) gets x0, x1, y0, y1
    and the nearest depth; turned (12, VIEWS) f4: scratch."""
    for k in range(VIEWS):
        camera_about_root(projections[min(first + k, projections.shape[0] - 1)], q, p[k])
        for r in range(3):
            for c in range(4):
                turned[4 * r + c, k] = p[k, r, c]
    _project_views(vertices, turned, uv, bounds)


@kernel
def front_views(faces, uv, front):
    """front (F,) u1: bit k where a face turns its outside to the camera of view k."""
    for f in range(faces.shape[0]):
        front[f] = _front_views(uv, faces[f, 0], faces[f, 1], faces[f, 2])


@kernel
def contours_of_any(edges, front, union):
    """union (E,) i4: the edges that are on a contour in some view; returns how many."""
    n = 0
    for e in range(edges.shape[0]):
        union[n] = e
        n += front[u4(edges[e, 2])] != front[u4(edges[e, 3])]
    return n


@kernel
def contours_of_view(k, n_union, union, edges, front, uv, start, end, lines):
    """Directed contour edges of view k as in cpu_silhouettes.contour_edges, and lines (4, E) f4: where they start and
    end, u, v, u, v px; returns how many."""
    n, bit = 0, np.uint8(1 << k)
    for i in range(n_union):
        e = u4(union[i])
        left, right = front[u4(edges[e, 2])] & bit, front[u4(edges[e, 3])] & bit
        a, b = edges[e, 0], edges[e, 1]
        start[n] = a if left else b
        end[n] = b if left else a
        n += left != right
    for i in range(n):
        a, b = u4(start[i]), u4(end[i])
        lines[0, i], lines[1, i], lines[2, i], lines[3, i] = uv[a, 0, k], uv[a, 1, k], uv[b, 0, k], uv[b, 1, k]
    return n


@kernel
def emit_lines(n, lines, x0, y0, width, height, difference):
    """Winding differences of n directed contour edges, as cpu_silhouettes.emit_contours makes them."""
    fx, fy = f4(x0), f4(y0)
    for e in range(n):
        xa, ya, xb, yb = lines[0, e] - fx, lines[1, e] - fy, lines[2, e] - fx, lines[3, e] - fy
        cross_columns(xa, ya, xb, yb, 1, width, height, difference)

"""Silhouettes of a skinned mesh by contour winding differences, one pose at a time (kernels): the steps of the contour
solver, VIEWS views at once, and the safe way of the block-wise scorer (scorer.py).

A pixel is model when at least one front face covers its centre. The number of front faces along an image column changes
only where a contour edge (front on exactly one side) crosses it, so +-1 at every crossing and one running sum down the
rows give the silhouette, without rasterizing a triangle. Sampling is half open as in the tests' definition; float32
against float64 moves 1-2 pixels of a silhouette at most. Running counts are int16, 32767 layers, or, for the solver and
what stands, int8: differences may wrap, the counts of up to 127 layers are the same.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.kinematics import camera_about_root
from hypose.compute.simd import at_least, at_most, bits, load, splat, store

f4, u4 = np.float32, np.uint32
NEAR = 0.05
"""Near plane, m: what lies closer (or behind) is cut off."""


@kernel
def front_faces(faces, u, v, front):
    """front (F,) u1 = 1 where a face turns its outside to the camera (clockwise in an image with y down)."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        front[f] = (u[b] - u[a]) * (v[c] - v[a]) < (u[c] - u[a]) * (v[b] - v[a])


@kernel
def contour_edges(edges, front, start, end):
    """Directed contour edges (start, end vertices as their front face holds them); returns how many."""
    n = 0
    for e in range(edges.shape[0]):
        left, right = front[edges[e, 2]], front[edges[e, 3]]
        if left != right:
            start[n] = edges[e, 0] if left else edges[e, 1]
            end[n] = edges[e, 1] if left else edges[e, 0]
            n += 1
    return n


@kernel
def cross_columns(xa, ya, xb, yb, sign, width, height, difference):
    """+-sign at the first row on or below the directed segment, for every column it crosses; x, y about the window."""
    s = np.int16(-sign)
    if xa > xb:
        xa, xb, ya, yb = xb, xa, yb, ya
        s = np.int16(sign)
    # clip as floats: far outside the image the numbers do not fit an integer
    c0 = int(np.ceil(max(xa, f4(0))))
    c1 = int(np.ceil(min(xb, f4(width))))
    if c0 < c1:
        slope = (yb - ya) / (xb - xa)
        for c in range(c0, c1):
            y = min(max(ya + (f4(c) - xa) * slope, f4(0)), f4(height))
            difference[np.uint32(np.ceil(y)), np.uint32(c)] += s  # unsigned: no test for indices from the end


@kernel
def emit_contours(n, start, end, u, v, x0, y0, width, height, difference):
    """Winding differences of n directed contour edges in the window with corner (x0, y0)."""
    fx, fy = f4(x0), f4(y0)
    for e in range(n):
        a, b = start[e], end[e]
        cross_columns(u[a] - fx, v[a] - fy, u[b] - fx, v[b] - fy, 1, width, height, difference)


@kernel
def emit_clipped_faces(vertices, faces, p, x0, y0, width, height, difference, one_sided):
    """The slow safe way when the body reaches the near plane: every face is cut at NEAR and drawn by itself, front or
    back (where the plane opens the body its inside is seen; not if one_sided)."""
    polygon = np.empty((4, 2), np.float32)
    depth = np.empty(3, np.float32)
    for f in range(faces.shape[0]):
        for k in range(3):
            w = vertices[faces[f, k]]
            depth[k] = p[2, 0] * w[0] + p[2, 1] * w[1] + p[2, 2] * w[2] + p[2, 3]
        n = 0
        for k in range(3):
            m = (k + 1) % 3
            a, b = vertices[faces[f, k]], vertices[faces[f, m]]
            if depth[k] >= NEAR:
                polygon[n, 0] = (p[0, 0] * a[0] + p[0, 1] * a[1] + p[0, 2] * a[2] + p[0, 3]) / depth[k]
                polygon[n, 1] = (p[1, 0] * a[0] + p[1, 1] * a[1] + p[1, 2] * a[2] + p[1, 3]) / depth[k]
                n += 1
            if (depth[k] >= NEAR) != (depth[m] >= NEAR):
                if depth[k] < depth[m]:  # one direction for both faces of an edge: the same float on both sides
                    lo, hi, dlo, dhi = a, b, depth[k], depth[m]
                else:
                    lo, hi, dlo, dhi = b, a, depth[m], depth[k]
                t = (f4(NEAR) - dlo) / (dhi - dlo)
                x, y, z = lo[0] + t * (hi[0] - lo[0]), lo[1] + t * (hi[1] - lo[1]), lo[2] + t * (hi[2] - lo[2])
                polygon[n, 0] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / f4(NEAR)
                polygon[n, 1] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / f4(NEAR)
                n += 1
        if n < 3:
            continue
        area = f4(0)
        for k in range(n):
            m = (k + 1) % n
            area += (polygon[k, 0] - polygon[0, 0]) * (polygon[m, 1] - polygon[0, 1])
            area -= (polygon[m, 0] - polygon[0, 0]) * (polygon[k, 1] - polygon[0, 1])
        if one_sided and area >= 0:
            continue
        sign = 1 if area < 0 else -1
        fx, fy = f4(x0), f4(y0)
        for k in range(n):
            m = (k + 1) % n
            cross_columns(
                polygon[k, 0] - fx,
                polygon[k, 1] - fy,
                polygon[m, 0] - fx,
                polygon[m, 1] - fy,
                sign,
                width,
                height,
                difference,
            )


@kernel
def count_window(mask, drawn, x0, y0, width, height, difference, running, model, hit, counts):
    """Running sums down the rows: counts[0] model pixels that are not set in drawn (h, B; packed, low bit first),
    counts[1] those inside the mask; clears the differences."""
    acc, mo, hi = running[:width], model[:width], hit[:width]
    for x in range(width):
        acc[x] = 0
        mo[x] = 0
        hi[x] = 0
    for r in range(height):
        d = difference[r, :width]
        m = mask[y0 + r, x0 : x0 + width]
        for x in range(width):
            acc[x] = np.int16(acc[x] + d[x])
            d[x] = 0
            already = np.uint16(drawn[y0 + r, (x0 + x) >> 3] >> ((x0 + x) & 7)) & np.uint16(1)
            k = np.uint16(acc[x] > 0) & ~already
            mo[x] = np.uint16(mo[x] + k)
            hi[x] = np.uint16(hi[x] + (k & np.uint16(m[x] != 0)))
    difference[height, :width] = 0
    n_model = 0
    n_hit = 0
    for x in range(width):
        n_model += mo[x]
        n_hit += hi[x]
    counts[0] = n_model
    counts[1] = n_hit


@kernel
def areas_in_boxes(masks, boxes, out):
    """Foreground pixels of masks (C, h, w) inside boxes (C, 4)."""
    for c in range(masks.shape[0]):
        n = 0
        for y in range(boxes[c, 2], boxes[c, 3]):
            row = masks[c, y]
            for x in range(boxes[c, 0], boxes[c, 1]):
                n += row[x] != 0
        out[c] = n


VIEWS = 4
"""views that are looked at together: a register of every processor"""


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
    """Directed contour edges of view k as in contour_edges, and lines (4, E) f4: where they start and
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
    """Winding differences of n directed contour edges, as emit_contours makes them."""
    fx, fy = f4(x0), f4(y0)
    for e in range(n):
        xa, ya, xb, yb = lines[0, e] - fx, lines[1, e] - fy, lines[2, e] - fx, lines[3, e] - fy
        cross_columns(xa, ya, xb, yb, 1, width, height, difference)

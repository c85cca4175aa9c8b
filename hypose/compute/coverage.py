"""Compute which pixels triangles cover, by contour winding differences; kernels for many silhouettes at once.

A pixel is covered when its centre lies in at least one triangle. The number of triangles over the pixels of an image
column changes only at their sides. So +-1 is added at the pixel below every crossing of a directed side, and a running
sum down the rows counts the layers, without a test per pixel. Sides of two triangles that are drawn in the same sense
cancel: of a mesh seen from outside only the contour edges (front on exactly one side) are drawn. Sampling is half open
(a triangle covers column x when ceil(left) <= x < ceil(right), and there the rows ceil(top) <= y < ceil(bottom)), as in
the tests' definition; float32 against float64 moves 1-2 pixels of a silhouette at most. Differences are int8 and may
wrap: the sums of up to 127 layers are right.

Variants: VIEWS views of one pose (solver, standing parts), LANES poses in one view (scorer), or any faces (parts of a
    body).
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.kinematics import camera_about_root
from hypose.compute.simd import (
    as_bytes,
    as_word,
    at_least,
    at_most,
    bits,
    cast,
    ceil,
    load,
    lowest_bit,
    popcount,
    ramp,
    splat,
    store,
    times_plus,
    where,
)

f4, i1, i4, u1, u4 = np.float32, np.int8, np.int32, np.uint8, np.uint32
NEAR = 0.05
"""Near plane, m: faces with a corner closer to the camera (or behind it) are omitted."""


@kernel
def cross_columns(xa, ya, xb, yb, sign, width, height, difference):
    """Add the crossings of a directed segment to a difference image, whose sums down each column count the faces
    over each pixel.

    For every column that the segment crosses, the sign is added in the first row on or below the segment. x and y
    are relative to the window.

    xa, ya, xb, yb: ends of the segment, px.
    sign: 1 or -1; a segment from right to left counts the other way round.
    width, height: width and height of the window, px.
    difference: (height + 1, B) difference image, changed in place.
    """
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
def emit_faces(vertices, faces, p, x0, y0, width, height, difference, one_sided):
    """Draw every face separately into a difference image; slow, for bodies that reach the near plane, whose contour
    is not closed, and for those whose crossings do not fit into the lists.

    vertices, faces: (V, 3) m and (F, 3).
    p: (3, 4) camera of these vertices.
    x0, y0, width, height: window in the image that the difference image shows, px.
    difference: (height + 1, B) difference image, changed in place; its sums down each column count the faces over
        each pixel.
    one_sided: False: faces seen from inside are drawn too, because the near plane opens the body.
    """
    uv, z = np.empty((vertices.shape[0], 2), np.float32), np.empty(vertices.shape[0], np.float32)
    for i in range(vertices.shape[0]):
        w = vertices[i]
        z[i] = p[2, 0] * w[0] + p[2, 1] * w[1] + p[2, 2] * w[2] + p[2, 3]
        uv[i, 0] = (p[0, 0] * w[0] + p[0, 1] * w[1] + p[0, 2] * w[2] + p[0, 3]) / z[i] - f4(x0)
        uv[i, 1] = (p[1, 0] * w[0] + p[1, 1] * w[1] + p[1, 2] * w[2] + p[1, 3]) / z[i] - f4(y0)
    parts, images = np.zeros(faces.shape[0], np.uint8), difference.reshape(1, height + 1, difference.shape[1])
    cover_faces(uv, z, faces, parts, one_sided, width, height, images)


@kernel
def cover_faces(uv, z, faces, part, one_sided, width, height, difference):
    """Draw faces into the difference image of their body part; its sums down each column count the faces over each
    pixel.

    width, height: width and height of the picture, px.
    uv, z: (V, 2) px and (V,) depth, m, of the corners.
    faces, part: (F, 3), and (F,) part of each.
    one_sided: omit faces seen from inside.
    difference: (P, height + 1, B) one difference image per part, changed in place.

    Faces nearer than NEAR, and those with a corner that is not finite, are omitted.
    """
    for f in range(faces.shape[0]):
        a, b, c = u4(faces[f, 0]), u4(faces[f, 1]), u4(faces[f, 2])
        xa, ya, xb, yb, xc, yc = uv[a, 0], uv[a, 1], uv[b, 0], uv[b, 1], uv[c, 0], uv[c, 1]
        if not (z[a] > NEAR and z[b] > NEAR and z[c] > NEAR and np.isfinite(xa + ya + xb + yb + xc + yc)):
            continue
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if one_sided and area >= 0:
            continue
        sign, own = 1 if area < 0 else -1, difference[part[f]]
        cross_columns(xa, ya, xb, yb, sign, width, height, own)
        cross_columns(xb, yb, xc, yc, sign, width, height, own)
        cross_columns(xc, yc, xa, ya, sign, width, height, own)


VIEWS = 4
"""Number of views that are computed together: one register of every processor."""


@kernel
def _project_views(vertices, p, uv, bounds):
    """Project vertices (V, 3) with projections p (12, VIEWS), all f4.

    uv: (V, 2, VIEWS) gets the pixels.
    bounds: (5, VIEWS) gets x0, x1, y0, y1 and the smallest depth.
    """
    left, right, top = splat(f4(1e9), VIEWS), splat(f4(-1e9), VIEWS), splat(f4(1e9), VIEWS)
    bottom, near = splat(f4(-1e9), VIEWS), splat(f4(1e9), VIEWS)
    for k in range(vertices.shape[0]):
        x, y, z = vertices[k, 0], vertices[k, 1], vertices[k, 2]
        depth = _row_of_views(p, 8 * VIEWS, x, y, z)
        inverse = f4(1) / depth
        u, v = _row_of_views(p, 0, x, y, z) * inverse, _row_of_views(p, 4 * VIEWS, x, y, z) * inverse
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
def _row_of_views(p, at, x, y, z):
    """Multiply a row of projections with a point.

    p: (12, VIEWS) f4.
    at: flat index at which the row begins.
    x, y, z: the point.
    Returns: vector of VIEWS numbers.
    """
    value = load(p, at, VIEWS) * x + load(p, at + VIEWS, VIEWS) * y + load(p, at + 2 * VIEWS, VIEWS) * z
    return value + load(p, at + 3 * VIEWS, VIEWS)


@kernel
def project_views(vertices, projections, first, q, p, turned, uv, bounds):
    """Project vertices into VIEWS views, from view `first` on (the last view is repeated).

    vertices: (V, 3) f4, relative to the root of pose q.
    projections: (C, 3, 4) f8; they are written to p (VIEWS, 3, 4) f4, relative to the root.
    turned: (12, VIEWS) f4, scratch.
    uv: (V, 2, VIEWS) gets the pixels.
    bounds: (5, VIEWS) gets x0, x1, y0, y1 and the smallest depth.
    """
    for k in range(VIEWS):
        camera_about_root(projections[min(first + k, projections.shape[0] - 1)], q, p[k])
        for r in range(3):
            for c in range(4):
                turned[4 * r + c, k] = p[k, r, c]
    _project_views(vertices, turned, uv, bounds)


@kernel
def front_views(faces, uv, front):
    """Find the faces whose outside faces the camera of each view.

    faces: (F, 3).
    uv: (V, 2, VIEWS) px, of `project_views`.
    front: (F,) u1 gets 1 in bit k where this is so in view k.
    """
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0] * (2 * VIEWS), faces[f, 1] * (2 * VIEWS), faces[f, 2] * (2 * VIEWS)
        ua, ub, uc = load(uv, i, VIEWS), load(uv, j, VIEWS), load(uv, k, VIEWS)
        va, vb, vc = load(uv, i + VIEWS, VIEWS), load(uv, j + VIEWS, VIEWS), load(uv, k + VIEWS, VIEWS)
        front[f] = bits((ub - ua) * (vc - va) < (uc - ua) * (vb - va))  # clockwise in the picture


@kernel
def contours_of_any(edges, front, union):
    """List the edges that are on a contour in any view.

    edges: (E, 4) edges of the mesh.
    front: (F,) of `front_views`.
    union: (E,) i4 gets the edges.
    Returns: their number.
    """
    n = 0
    for e in range(edges.shape[0]):
        union[n] = e
        n += front[u4(edges[e, 2])] != front[u4(edges[e, 3])]
    return n


@kernel
def contours_of_view(k, n_union, union, edges, front, uv, start, end, lines):
    """List the directed contour edges of view k, with the front face on their left.

    n_union, union: edges that are on a contour in any view, of `contours_of_any`.
    edges: (E, 4) edges of the mesh.
    front, uv: as returned by `front_views` and `project_views`.
    start, end: (E,) get their vertices.
    lines: (4, E) f4 gets their ends u, v, u, v px.
    Returns: number of edges.
    """
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
    """Draw the inside of n directed contour edges into a difference image, whose sums down each column count the
    faces over each pixel.

    lines: (4, E) px, as of `contours_of_view`.
    x0, y0, width, height: window in the image that the difference image shows, px.
    difference: (height + 1, B) difference image, changed in place.
    """
    fx, fy = f4(x0), f4(y0)
    for e in range(n):
        xa, ya, xb, yb = lines[0, e] - fx, lines[1, e] - fy, lines[2, e] - fx, lines[3, e] - fy
        cross_columns(xa, ya, xb, yb, 1, width, height, difference)


LANES = 16
"""Number of poses that are computed together: one AVX-512 register of float32."""
STRIP = 64
"""Number of image columns that are summed together: one AVX-512 register of int8."""


@kernel
def project_vertices(points, p, u, v, bounds):
    """Project points (V, 3, LANES) with projections p (12, LANES), all f4.

    u, v: (V, LANES) get the pixels.
    bounds: (5, LANES) gets x0, x1, y0, y1 and the smallest depth.
    """
    left, right, top = splat(f4(1e9), LANES), splat(f4(-1e9), LANES), splat(f4(1e9), LANES)
    bottom, near = splat(f4(-1e9), LANES), splat(f4(1e9), LANES)
    for k in range(points.shape[0]):
        at = 3 * LANES * k
        x, y, z = load(points, at, LANES), load(points, at + LANES, LANES), load(points, at + 2 * LANES, LANES)
        depth = _row_of_lanes(p, 8 * LANES, x, y, z)
        inverse = f4(1) / depth
        a, b = _row_of_lanes(p, 0, x, y, z) * inverse, _row_of_lanes(p, 4 * LANES, x, y, z) * inverse
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
def _row_of_lanes(p, at, x, y, z):
    """Multiply a row of projections with points.

    p: (12, LANES) f4.
    at: flat index at which the row begins.
    x, y, z: vectors of LANES coordinates.
    Returns: vector of LANES numbers.
    """
    value = times_plus(load(p, at + 2 * LANES, LANES), z, load(p, at + 3 * LANES, LANES))
    return times_plus(load(p, at, LANES), x, times_plus(load(p, at + LANES, LANES), y, value))


@kernel
def prepare_edge(u, v, a, b, window, edge, columns):
    """Prepare the edge from vertex a to b in every lane: where it starts in the lane's window, and its slope.

    u, v: (V, LANES) px.
    window: (5, LANES) f4: origin x, y, first and end column, rows.
    edge: (4, LANES) f4 gets the left end x, y in the window, the slope, and the first column.
    columns: (LANES,) i4 gets the number of columns that it crosses.
    Returns: two masks of lanes: bits 0-15: it crosses columns and is not wholly below the window; bits 16-31: it runs
        from right to left.
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
    """Write the pixel indices row * stride + column at which the prepared edge of a lane crosses its columns, from the
    skip-th on.

    edge: as returned by `prepare_edge`.
    rows, stride: rows of the window, and bytes per row of the difference image.
    out: i4, gets LANES indices from the flat index `place` on; those past the end of the edge are invalid and are
        overwritten by the next edge.
    """
    x0, y0, slope, first = edge[0, lane], edge[1, lane], edge[2, lane], edge[3, lane]
    column = cast(ramp(LANES), f4) + (first + f4(skip))
    y = (column - x0) * slope + y0
    # the last clamp: invalid numbers past the image must convert too
    row = ceil(at_most(at_least(y, f4(0)), f4(rows)))
    store(out, place, cast(row, i4) * stride + cast(column, i4))


@kernel
def sum_strip(difference, start, stride, rows, at, line, mask, drawn, out, counts):
    """Sum STRIP columns of a difference image down the rows, set them to 0, and write or count the pixels that the body
    covers (positive sums).

    difference: i1, flat, from index start on.
    rows, stride: number of rows, and bytes per row of the difference image.
    mask, drawn, out: u1, packed, low bit first, from the flat index `at` on, `line` bytes per row.
    drawn: pixels that are omitted; None: none.
    out: gets the pixels; None: they are only counted.
    counts: (2,) i8: the pixels are added, and those of them set in mask; None, with the mask: they are not counted.
    """
    zero = splat(i1(0), STRIP)
    total, model, hit = zero, 0, 0
    for k in range(rows):
        here, there = start + k * stride, at + k * line
        total = total + load(difference, here, STRIP)
        store(difference, here, zero)
        inside = bits(total > zero)
        if drawn is not None:
            inside &= ~as_word(load(drawn, there, 8))
        if out is not None:
            store(out, there, as_bytes(inside))
        if counts is not None:
            model += popcount(inside)
            hit += popcount(inside & as_word(load(mask, there, 8)))
    if counts is not None:
        counts[0] += model
        counts[1] += hit


@kernel
def row_stride(columns):
    """Return the bytes per row of the difference image of a window: whole strips, and an odd number of them.

    Why: with an even number a column would fall on few sets of the processor's cache.
    """
    return STRIP * (((columns + STRIP - 1) // STRIP) | 1)


@kernel
def list_crossings(mesh, u, v, some, window, origin, front, union, edge, columns, lists, ends):
    """List the pixels at which the contours of a posed body cross image columns, for LANES poses at once (one lane
    each).

    mesh: LaneMesh.
    u, v: (V, LANES) px.
    some: mask of the lanes to draw.
    window, origin: as returned by `scorer.lane_windows`.
    front, union, edge, columns: scratch.
    lists: (2 LANES, capacity) i4: upward crossings of lane l at 2 l, downward ones at 2 l + 1.
    ends: (2 LANES,) gets their numbers.
    Returns: mask of the lanes whose lists are full, which must be drawn otherwise.
    """
    full = u4(0)
    for f in range(mesh.faces.shape[0]):
        a, b, c = mesh.faces[f, 0] * LANES, mesh.faces[f, 1] * LANES, mesh.faces[f, 2] * LANES
        ua, ub, uc = load(u, a, LANES), load(u, b, LANES), load(u, c, LANES)
        va, vb, vc = load(v, a, LANES), load(v, b, LANES), load(v, c, LANES)
        front[f] = bits((ub - ua) * (vc - va) < (uc - ua) * (vb - va))  # clockwise: its outside faces the camera
    front[mesh.faces.shape[0]] = 0  # the missing neighbour of an open edge
    n = 0
    for e in range(mesh.edges.shape[0]):
        union[n] = e
        n += ((front[mesh.edges[e, 2]] ^ front[mesh.edges[e, 3]]) & some) != 0
    for k in range(2 * LANES):
        ends[k] = 0
    capacity = lists.shape[1] - LANES
    for i in range(n):
        e = union[i]
        left = u4(front[mesh.edges[e, 2]])
        masks = prepare_edge(u, v, mesh.edges[e, 0], mesh.edges[e, 1], window, edge, columns)
        todo = (left ^ u4(front[mesh.edges[e, 3]])) & some & masks
        down = left ^ (masks >> u4(16))
        while todo != 0:
            k = lowest_bit(todo)
            todo &= todo - u4(1)
            which = 2 * k + np.int64((down >> u4(k)) & u4(1))
            count = np.int64(columns[k])
            end = ends[which]
            if end + count > capacity:
                full |= u4(1) << u4(k)
                continue
            done = 0
            stride = i4(row_stride(origin[k, 2]))
            while True:
                place = which * lists.shape[1] + end + done
                write_crossings(edge, k, f4(done), window[4, k], stride, lists, place)
                done += LANES
                if done >= count:
                    break
            ends[which] = end + count
    return full


@kernel
def draw_lists(up, down, difference):
    """Add the crossings that `list_crossings` found to a difference image, whose sums down each column count the
    faces over each pixel.

    up, down: (N,) and (M,) i4 flat indices of the pixels that get +1 and -1.
    difference: flat i1, is changed.
    """
    for i in range(up.shape[0]):
        difference[u4(up[i])] += i1(1)
    for i in range(down.shape[0]):
        difference[u4(down[i])] -= i1(1)

"""Compute two-way contour distances of a body in one view, as residuals on edges of its mesh; rows.py makes rows of
them.

Long computations are in loops of their own without branches, so that the compiler vectorises them: chosen values are
written to the next place, and the place advances only where the value counts.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.arrays import NOT_KNOWN, OUTLINE_POINTS, RIM, SPACING_OF_HEIGHT
from hypose.compute.compiled import kernel
from hypose.compute.coverage import LANES, NEAR, STRIP, contours_of_view, emit_lines, sum_strip
from hypose.compute.losses import geman_mcclure_kernel as geman_mcclure
from hypose.compute.rows import BORDER

f4, i4, u4, u8 = np.float32, np.int32, np.uint32, np.uint64
_BAND, _BANDS = 8, 64
"""_BAND: rows of a band in which the nearest point of the mask's outline is searched first. _BANDS: number of bands."""
_NEXT_BAND = int(0.98 * 64 * _BAND**2)
"""Packed squared distance that every point exceeds which lies a whole band or more above or below."""
_OUT, _OPEN = -2, -1
"""Marks of outline points: _OUT: no evidence. _OPEN: the neighbouring pixel lies outside the window."""


@kernel
def _nearest(u, v, number, begin, end, x, y):
    """Find the nearest to (x, y) of points u, v (N,) f4 from begin to end.

    Squared distance in 1/64 px^2 and the point's number (i4) are packed into one integer, so that the minimum needs no
    branch and the loop vectorises.
    """
    best = i4(2147483647)
    for i in range(u8(begin), u8(end)):  # signed indices would each be compared with 0
        dx, dy = u[i] - x, v[i] - y
        one = i4((i4(min((dx * dx + dy * dy) * f4(64), f4(1e6))) << i4(11)) | number[i])
        best = one if one < best else best
    return best


@kernel
def _by_row(n, rim_u, rim_v, low, u, v, number, place):
    """Sort the first n outline points into bands of _BAND rows, which begin at row `low`; the last band holds
    everything below.

    rim_u, rim_v: (R,) px, the outline points.
    low: row at which the first band begins, px.
    u, v, number: (R,) get the points and their numbers; far away beyond the last point.
    place: (B + 1,) gets where each band begins.
    """
    bands = place.shape[0] - 1
    place[:] = 0
    for i in range(n):
        place[min(int((rim_v[i] - low) * f4(1 / _BAND)), bands - 1) + 1] += 1
    for b in range(bands):
        place[b + 1] += place[b]
    for i in range(n):
        b = min(int((rim_v[i] - low) * f4(1 / _BAND)), bands - 1)
        to = place[b]
        u[to], v[to], number[to] = rim_u[i], rim_v[i], i
        place[b] = to + 1
    for b in range(bands - 1, 0, -1):  # filled: each has moved to its end
        place[b] = place[b - 1]
    place[0] = 0
    for i in range(n, min((n + 7) // 8 * 8, u.shape[0])):
        u[i], v[i], number[i] = f4(1e8), f4(1e8), i4(2047)


@kernel
def nearest(n, u, v, number, place, low, points, found):
    """Find the nearest of n points, sorted by `_by_row`, to each of points (K, 2) f4.

    u, v, number: the sorted points, px, and their numbers.
    place: (B + 1,) where each band begins.
    low: row at which the first band begins, px.
    found: (K,) i4 gets their numbers; 0 for omitted points. The neighbouring bands are searched first, and the others
        only where these have no point near enough.
    """
    bands = place.shape[0] - 1
    for m in range(points.shape[0]):
        x, y = points[m, 0], points[m, 1]
        found[m] = 0
        if x < f4(-1e5):
            continue
        band = int(np.floor((y - low) * f4(1 / _BAND)))
        # whole vectors, because a part of one takes as long
        begin = place[min(max(band - 1, 0), bands)] // 8 * 8
        end = (place[min(max(band + 2, 0), bands)] + 7) // 8 * 8
        best = _nearest(u, v, number, begin, end, x, y)
        if (best >> 11) >= i4(_NEXT_BAND):
            best = _nearest(u, v, number, 0, (n + 7) // 8 * 8, x, y)
        found[m] = best & 2047


@kernel
def _spread(n, lengths, spacing, edge, along):
    """Place points every `spacing` px along n edges of these lengths, one edge after the other.

    edge, along: (R,) get the edge (i4) and the px along it (f4).
    Returns: number of points.
    """
    found, position = 0, spacing * f4(0.5)
    for e in range(n):
        length = lengths[e]
        if length < f4(1e-6):
            continue
        while position < length and found < edge.shape[0]:
            edge[found], along[found] = e, position
            found += 1
            position += spacing
        position -= length
    return found


@kernel
def _place_rim(work, spot, w, h, x0, y0, width, height, line):
    """Compute the positions of LANES outline points, and the pixel just outside the body next to each.

    w, h: width and height of the image, px.
    x0, y0, width, height: window of the own silhouette in the image, px.
    line: bits per row of the own silhouette.
    work: (6 x LANES,) f4: px along an edge, its ends u, v, u, v, its length px; gets the share of the edge, u, v.
    spot: (LANES,) i4 gets the bit of that pixel in the own silhouette, `line` bits per row; else _OUT or _OPEN.
    """
    right, bottom = f4(w - 1 - BORDER), f4(h - 1 - BORDER)
    left, top, wide, high, row = i4(x0), i4(y0), i4(width), i4(height), i4(line)
    for k in range(LANES):
        xa, ya, length = work[LANES + k], work[2 * LANES + k], work[5 * LANES + k]
        dx, dy = work[3 * LANES + k] - xa, work[4 * LANES + k] - ya
        t = work[k] / length
        x, y = xa + t * dx, ya + t * dy
        work[k], work[LANES + k], work[2 * LANES + k] = t, x, y
        side, below = x + -dy / length + f4(0.5), y + dx / length + f4(0.5)
        # only values that fit become whole numbers
        tx = i4(i4(min(max(side, f4(-2)), f4(1e6))) - left)
        ty = i4(i4(min(max(below, f4(-2)), f4(1e6))) - top)
        at = i4(ty * row + tx)
        at = at if tx >= i4(0) else i4(_OPEN)
        at = at if tx < wide else i4(_OPEN)
        at = at if ty >= i4(0) else i4(_OPEN)
        at = at if ty < high else i4(_OPEN)
        at = i4(_OUT) if x < f4(BORDER) else at
        at = i4(_OUT) if y < f4(BORDER) else at
        at = i4(_OUT) if x > right else at
        spot[k] = i4(_OUT) if y > bottom else at


@kernel
def _rim(n, lines, own, w, h, x0, y0, width, height, line, edge, rim, work, spot):
    """Keep those of n outline points that are visible: next to them the body's own silhouette ends.

    n: number of points.
    lines: (5, E) f4 contour edges, as of Workspace.lines.
    w, h: width and height of the image, px.
    x0, y0, width, height: window of the own silhouette in the image, px.
    work, spot: scratch of `_place_rim`.
    rim: (3, R) f4, first the px along each edge; gets the share of the edge, u, v px of the visible points.
    edge: (R,) their edges.
    own: packed silhouette, `line` bits per row.
    Returns: number of visible points.
    """
    seen = 0
    for first in range(0, n, LANES):
        some = min(LANES, n - first)
        for k in range(some):
            e = u4(edge[first + k])
            work[k] = rim[0, first + k]
            for r in range(5):
                work[(r + 1) * LANES + k] = lines[r, e]
        _place_rim(work, spot, w, h, x0, y0, width, height, line)
        for k in range(some):
            at = spot[k]
            bit = u4(max(at, i4(0)))
            covered = (own[bit >> u4(3)] >> (bit & u4(7))) & u4(1)
            edge[seen] = edge[first + k]
            for r in range(3):
                rim[r, seen] = work[r * LANES + k]
            seen += (at == _OPEN) | ((at >= 0) & (covered == u4(0)))
    return seen


@kernel
def _interpolate(work, i2, weight):
    """Interpolate distances bilinearly at LANES points.

    work: (6 x LANES,) f4: fraction of a pixel right of and below a pixel, and the distances in it, right of it, below
        it, and right below it; gets the gradient along u and v, weight, distance, loss.
    """
    for k in range(LANES):
        fx, fy, s00, s01 = work[k], work[LANES + k], work[2 * LANES + k], work[3 * LANES + k]
        s10, s11 = work[4 * LANES + k], work[5 * LANES + k]
        r = (s00 * (f4(1) - fx) + s01 * fx) * (f4(1) - fy) + (s10 * (f4(1) - fx) + s11 * fx) * fy
        gx = (s01 - s00) * (f4(1) - fy) + (s11 - s10) * fy
        gy = (s10 - s00) * (f4(1) - fx) + (s11 - s01) * fx
        rho, slope, _ = geman_mcclure(r * r * i2, weight, f4(1))
        work[k], work[LANES + k], work[2 * LANES + k], work[3 * LANES + k], work[4 * LANES + k] = gx, gy, slope, r, rho


@kernel
def _forward_rows(n, stride, rim, edge, ws, sdf, corner, size, i2, weight, n_found, count):
    """Append forward rows for every stride-th of n outline points to the found rows, as `contour_rows`.

    n, stride: number of points, and step between those that make a row.
    rim, edge: as returned by `_rim`.
    ws: scratch memory, with the contour edges.
    sdf: (h, w) f4 signed distance, px.
    i2: 1 / scale^2, 1/px^2.
    n_found: number of found rows before.
    count: (2,) its first number grows by the number of rows.
    corner, size: (2,) of sdf in the image.
    weight: divided by scale^2.
    Returns: cost in forward weights, and number of found rows.
    """
    left, top, across, down, row = corner[0], corner[1], size[0] - 1, size[1] - 1, u4(sdf.shape[1])
    work, spot, ends, found = ws.work, ws.spot, ws.ends, ws.found
    cost, last, flat = 0.0, ends.shape[1] - 1, sdf[0]
    for first in range(0, n, LANES * stride):
        some = min(LANES, (n - first + stride - 1) // stride)
        for k in range(some):
            x, y = rim[1, first + k * stride], rim[2, first + k * stride]
            xi, yi = int(x), int(y)
            work[k], work[LANES + k] = x - f4(xi), y - f4(yi)
            xi -= left
            yi -= top
            inside = (xi >= 0) & (xi < across) & (yi >= 0) & (yi < down)
            spot[k] = yi * row + xi if inside else _OPEN
        for k in range(some):  # a loop of its own: many memory reads wait in parallel
            at = u4(max(spot[k], i4(0)))
            s00, s01, s10, s11 = flat[at], flat[at + u4(1)], flat[at + row], flat[at + row + u4(1)]
            work[2 * LANES + k], work[3 * LANES + k], work[4 * LANES + k], work[5 * LANES + k] = s00, s01, s10, s11
            unknown = max(max(s00, s01), max(s10, s11)) >= f4(NOT_KNOWN)
            spot[k] = i4(_OUT) if unknown & (spot[k] >= 0) else spot[k]
        _interpolate(work, i2, weight)
        for k in range(some):
            if spot[k] == _OUT:
                continue
            cost += work[4 * LANES + k] if spot[k] >= 0 else f4(1)  # outside the distance counts as infinite
            count[0] += 1
            m = first + k * stride
            e = u4(edge[m])
            ends[0, n_found], ends[1, n_found], found[0, n_found] = ws.start[e], ws.end[e], rim[0, m]
            for i in range(4):
                found[i + 1, n_found] = work[i * LANES + k]
            n_found += (spot[k] >= 0) & (n_found < last)
    return cost, n_found


@kernel
def _onto_edges(work, i2, weight):
    """Project points onto edges, and compute their distances.

    work: (6 x LANES,) f4: points u, v and the ends of an edge u, v, u, v px; gets the five values of `contour_rows` and
        the loss.
    i2, weight: 1 / scale^2, and weight / scale^2.
    """
    for k in range(LANES):
        x, y, xa, ya = work[k], work[LANES + k], work[2 * LANES + k], work[3 * LANES + k]
        dx, dy = work[4 * LANES + k] - xa, work[5 * LANES + k] - ya
        # onto the edge itself: the nearest sample alone would leave false residuals of half the spacing
        t = min(max(((x - xa) * dx + (y - ya) * dy) / (dx * dx + dy * dy), f4(0)), f4(1))
        dx, dy = xa + t * dx - x, ya + t * dy - y
        d2 = dx * dx + dy * dy
        r = math.sqrt(d2)
        rho, slope, _ = geman_mcclure(d2 * i2, weight, f4(1))
        work[k], work[LANES + k], work[2 * LANES + k] = t, dx / r, dy / r
        work[3 * LANES + k], work[4 * LANES + k], work[5 * LANES + k] = slope, r, rho


@kernel
def _reverse_rows(n, low, outline, edge, lines, ws, i2, weight, n_found, count):
    """Append reverse rows for the mask's outline (K, 2) to the found rows, as `contour_rows`.

    edge, lines: (R,) edges of the outline points, and (5, E) f4 the contour edges.
    ws: scratch memory, with the sorted points.
    i2, weight: 1 / scale^2, 1/px^2, and the weight of a row times that.
    n_found: number of found rows before.
    count: (2,) its second number grows by the number of rows.
    n, low: number of the body's outline points, sorted in bands from row `low` on.
    Returns: cost in reverse weights, and number of found rows.
    """
    work, spot, ends, found = ws.work, ws.spot, ws.ends, ws.found
    cost, last = 0.0, ends.shape[1] - 1
    u, v = ws.sorted[0], ws.sorted[1]
    for first in range(0, outline.shape[0], LANES):
        some = min(LANES, outline.shape[0] - first)
        nearest(n, u, v, ws.sorted_number, ws.bands, low, outline[first : first + some], spot)
        for k in range(some):
            e = edge[u4(spot[k])]
            work[k], work[LANES + k] = outline[first + k, 0], outline[first + k, 1]
            for r in range(4):
                work[(r + 2) * LANES + k] = lines[r, e]
        _onto_edges(work, i2, weight)
        for k in range(some):
            if outline[first + k, 0] < f4(-1e5):  # marked: it may be another person's outline
                continue
            cost += work[5 * LANES + k]
            count[1] += 1
            e = u4(edge[u4(spot[k])])
            ends[0, n_found], ends[1, n_found] = ws.start[e], ws.end[e]
            for i in range(5):
                found[i, n_found] = work[i * LANES + k]
            n_found += (work[4 * LANES + k] > f4(0.05)) & (n_found < last)
    return cost, n_found


@kernel
def contour_rows(c, k, n_union, bounds, mesh, contours, scale, ws, n_found, count):
    """Compute the contour rows of view c; a row is one residual between the outlines of body and mask, with its
    derivatives.

    k: position of the view among the views that the workspace holds.
    n_union: number of edges that are on a contour in any of the views in the workspace.
    mesh, contours: mesh of the body (MeshArrays), and contours of the masks (ContourTerm).
    scale: robust scale, px.
    ws: scratch memory, with the body projected into these views.
    n_found: number of rows found before; new ones are appended to ws.ends and ws.found.
    count: (2,) gets the numbers of forward and reverse rows added.
    bounds: (5, VIEWS) box of the body in each view, x0, x1, y0, y1 px, and its smallest depth, m.
    ws.ends: (2, M) vertices of the edge of each row.
    ws.found: (5, M) f4: place on the edge 0..1, gradient of the residual along u and v per px, weight, residual.
    Returns: cost of the view, and number of found rows.

    Cost of a row: 1/2 w e^2 / (1 + e^2), e = r / scale (Geman & McClure 1985); its weight in the normal equations is
        w
    / (1 + e^2)^2. A view in which the body is not visible costs what its outline points cost at infinite distance.
    Which points are the outline, and which is nearest, is held fixed in the derivatives.
    """
    w, h = contours.sizes[c, 0], contours.sizes[c, 1]
    sdf, outline = contours.sdf[c], contours.outline[c]
    n_outline = outline.shape[0]
    per_mark = contours.weight * OUTLINE_POINTS / contours.outline_count
    unseen = 0.5 * per_mark * n_outline
    if not (bounds[4, k] >= NEAR):
        return unseen, n_found
    x0 = int(max(f4(0), np.floor(bounds[0, k]) - f4(1)))
    x1 = int(min(f4(w), np.ceil(bounds[1, k]) + f4(2)))
    y0 = int(max(f4(0), np.floor(bounds[2, k]) - f4(1)))
    y1 = int(min(f4(h), np.ceil(bounds[3, k]) + f4(2)))
    width, height = x1 - x0, y1 - y0
    if width < 3 or height < 3:
        return unseen, n_found
    lines, rim, edge = ws.lines, ws.rim, ws.rim_edge
    n = contours_of_view(k, n_union, ws.union, mesh.edges, ws.front, ws.uv, ws.start, ws.end, lines)
    emit_lines(n, lines, x0, y0, width, height, ws.difference)
    own, stride = ws.own, ws.difference.shape[1]
    for s in range(0, width, STRIP):
        sum_strip(ws.difference, s, stride, height, s >> 3, stride >> 3, None, None, own, None)
    for x in range(width):
        ws.difference[height, x] = 0
    length = f4(0)
    for e in range(n):  # a loop of its own, which is vectorised
        dx, dy = lines[2, e] - lines[0, e], lines[3, e] - lines[1, e]
        lines[4, e] = math.sqrt(dx * dx + dy * dy)
    for e in range(n):
        length += lines[4, e]
    step = 2 if contours.row_spacing_px >= 2 else 1  # only every second outline point makes a forward row
    wanted = f4(contours.row_spacing_px / step / contours.shrunk[c])
    spacing = max(wanted, length / f4(RIM - 16))
    thinned = spacing / wanted  # weight is per arc length
    own_scale = scale / contours.shrunk[c]
    i2 = f4(1) / f4(own_scale * own_scale)
    per_row = contours.weight * contours.row_spacing_px / (SPACING_OF_HEIGHT * contours.height_px)
    forward, reverse = f4(per_row) * thinned, f4(per_mark)
    # Points of the body's outline, evenly spaced along the contour edges: the pixel just outside must not be the
    # body's.
    n_rim = _spread(n, lines[4], spacing, edge, rim[0])
    n_rim = _rim(n_rim, lines, own, w, h, x0, y0, width, height, stride, edge, rim, ws.work, ws.spot)
    if n_rim == 0:
        return unseen, n_found
    corner, size = contours.corners[c], contours.sdf_sizes[c]
    cost_forward, n_found = _forward_rows(
        *(n_rim, step, rim, edge, ws, sdf, corner, size, i2, forward * i2, n_found, count)
    )
    low = f4(y0)
    _by_row(n_rim, rim[1], rim[2], low, ws.sorted[0], ws.sorted[1], ws.sorted_number, ws.bands)
    cost_reverse, n_found = _reverse_rows(n_rim, low, outline, edge, lines, ws, i2, reverse * i2, n_found, count)
    return 0.5 * (forward * cost_forward + reverse * cost_reverse), n_found

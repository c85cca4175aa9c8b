"""numba: evidence -> rows -> 6 x 6 sums per joint.

Every cue is a set of rows (point p, g = d residual / d point, residual r, weight w, joint j). A row's derivative along
dof d is S_d . x with the dof's twist S_d and the row's wrench x = (p x g, g), everything about the root's position; so
w x x^T (21 numbers) and w r x (6) are added to joint j, and no row as wide as the pose ever exists. cpu_solver.py folds
the sums up the tree.
A skinned point is a blend of joints: its row goes to each joint, times the skinning weight. The gradient is then exact;
the second-order sum drops cross terms between the joints of one point and keeps w_j instead of w_j^2, which only damps.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.silhouettes.cpu_silhouettes import NEAR, contour_edges, emit_contours, front_faces, project
from hypose.compute.solver.cpu_losses import geman_mcclure, lorentzian
from hypose.compute.solver.cpu_sums import EIGHT, SUMS, wrench_sums
from hypose.compute.solver.terms import NOT_KNOWN

f4, i4 = np.float32, np.int32
BORDER = 3
"""px along the image border where outlines are cut off by the image and are no evidence"""
RIM = 2032
"""most outline points of the body in one view (indices must fit 11 bits)"""
_BAND, _BANDS = 8, 64
"""rows of a band in which a point of the mask's outline is looked for first, and so many of them"""
_NEXT_BAND = int(0.98 * 64 * _BAND**2)
"""a squared distance, packed, that no point has which lies a whole band or more above or below"""


@kernel
def add_row(hessian, gradient, j, w, r, px, py, pz, gx, gy, gz):
    """hessian (J, 21), gradient (J, 6) += the wrench of one row on joint j."""
    a0, a1, a2 = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx
    b0, b1, b2, b3, b4, b5 = w * a0, w * a1, w * a2, w * gx, w * gy, w * gz
    c, g = hessian[j], gradient[j]
    c[0] += b0 * a0
    c[1] += b1 * a0
    c[2] += b1 * a1
    c[3] += b2 * a0
    c[4] += b2 * a1
    c[5] += b2 * a2
    c[6] += b3 * a0
    c[7] += b3 * a1
    c[8] += b3 * a2
    c[9] += b3 * gx
    c[10] += b4 * a0
    c[11] += b4 * a1
    c[12] += b4 * a2
    c[13] += b4 * gx
    c[14] += b4 * gy
    c[15] += b5 * a0
    c[16] += b5 * a1
    c[17] += b5 * a2
    c[18] += b5 * gx
    c[19] += b5 * gy
    c[20] += b5 * gz
    g[0] += b0 * r
    g[1] += b1 * r
    g[2] += b2 * r
    g[3] += b3 * r
    g[4] += b4 * r
    g[5] += b5 * r


@kernel
def sum_rows(n, rows, joints, lanes, place, hessian, gradient):
    """hessian (J, 21), gradient (J, 6) += n contour rows, all of a joint at once in vector lanes, which is
    faster than adding each to its joint; lanes (9, M) and place (J + 1,) are scratch."""
    n_joints = hessian.shape[0]
    for j in range(n_joints + 1):
        place[j] = 0
    for i in range(n):
        place[joints[i] + 1] += 1
    for j in range(n_joints):
        place[j + 1] += place[j]
    for i in range(n):
        line, to = rows[i], place[joints[i]]
        for k in range(8):
            lanes[k, to] = line[k]
        place[joints[i]] = to + 1
    first = 0
    sums = np.empty(SUMS)
    for j in range(n_joints):
        last = place[j]  # filled: place[j] has moved to the joint's end
        if last > first:
            whole = first + (last - first) // EIGHT * EIGHT
            wrench_sums(lanes, lanes.shape[1], first, whole, sums)
            at, k = 0, 0
            for x in range(6):
                for y in range(x + 2):
                    other = y if y <= x else 7
                    s = sums[at]
                    for m in range(whole, last):
                        s += lanes[6, m] * lanes[x, m] * lanes[other, m]
                    at += 1
                    if y <= x:
                        hessian[j, k] += s
                        k += 1
                    else:
                        gradient[j, x] += s
        first = last


@kernel
def form_rows(n, ends, found, n_rows, vertices, skin_index, skin_weight, skin_count, p, rows, joints):
    """Appends the rows of n points on mesh edges to rows (M, 8) = wrench, weight, residual, and joints (M,), from row
    n_rows on, one for each joint that moves the point; returns the number of rows then.

    ends (n, 2): the edge's vertices; found (n, 5) f4: place on the edge 0..1, gradient of the residual along u and v
    per px, weight, residual; p (3, 4) f4. One call for all points: a call for each would copy some sixty numbers that
    describe the arrays, which took longer than the arithmetic."""
    for i in range(n):
        a, b = ends[i, 0], ends[i, 1]
        t, gx, gy = found[i, 0], found[i, 1], found[i, 2]
        w, r = found[i, 3], found[i, 4]
        s = f4(1) - t
        x = s * vertices[a, 0] + t * vertices[b, 0]
        y = s * vertices[a, 1] + t * vertices[b, 1]
        z = s * vertices[a, 2] + t * vertices[b, 2]
        iz = f4(1) / (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
        u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) * iz
        v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) * iz
        k = -(gx * u + gy * v) * iz
        gx *= iz
        gy *= iz
        g0 = gx * p[0, 0] + gy * p[1, 0] + k * p[2, 0]
        g1 = gx * p[0, 1] + gy * p[1, 1] + k * p[2, 1]
        g2 = gx * p[0, 2] + gy * p[1, 2] + k * p[2, 2]
        first = n_rows
        for m in range(skin_count[a]):
            joints[n_rows] = skin_index[a, m]
            rows[n_rows, 6] = s * skin_weight[a, m] * w
            n_rows += 1
        for m in range(skin_count[b]):
            at = first  # the ends of an edge mostly hang on the same joints
            while at < n_rows and joints[at] != skin_index[b, m]:
                at += 1
            if at == n_rows:
                joints[at] = skin_index[b, m]
                rows[at, 6] = 0.0
                n_rows += 1
            rows[at, 6] += t * skin_weight[b, m] * w
        for m in range(first, n_rows):
            line = rows[m]
            line[0] = y * g2 - z * g1
            line[1] = z * g0 - x * g2
            line[2] = x * g1 - y * g0
            line[3] = g0
            line[4] = g1
            line[5] = g2
            line[7] = r
    return n_rows


@kernel
def _nearest(u, v, number, x, y):
    """The nearest of points (N,): squared distance in 1/64 px^2 and the point's number are packed into one integer, so
    that the minimum needs no branch and vectorises (a float arg-min does not). Casts keep it in 32 bits, which takes a
    third of the time."""
    best = i4(2147483647)
    for i in range(u.shape[0]):
        dx, dy = u[i] - x, v[i] - y
        distance = i4(min((dx * dx + dy * dy) * f4(64), f4(1e6)))
        best = min(best, i4(i4(distance << i4(11)) | number[i]))
    return best


@kernel
def _by_row(n, rim_u, rim_v, low, u, v, number, place):
    """The first n points of the rim in the order of their bands of _BAND rows, which begin at row `low`, and their
    numbers: u, v (R,) f4, number (R,) i4, far away beyond the last point; place (B + 1,): where each band begins. The
    last band holds what is below."""
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
def nearest(n, u, v, number, place, low, x, y):
    """The number of the nearest of n points in the order of `_by_row`: one in the bands beside (x, y) where that lies
    nearer than all others can."""
    band, bands = int(np.floor((y - low) * f4(1 / _BAND))), place.shape[0] - 1
    # whole vectors, for what is left of them takes as long
    begin = place[min(max(band - 1, 0), bands)] // 8 * 8
    end = (place[min(max(band + 2, 0), bands)] + 7) // 8 * 8
    best = _nearest(u[begin:end], v[begin:end], number[begin:end], x, y)
    if (best >> 11) >= i4(_NEXT_BAND):
        end = (n + 7) // 8 * 8
        best = _nearest(u[:end], v[:end], number[:end], x, y)
    return best & 2047


@kernel
def own_silhouette(x0, y0, width, height, difference, running, own):
    """own (h, w) u1 = the body's silhouette in the window, from its winding differences, which are cleared. i1 takes
    half the time of i2; sums wrap, and no pixel of a body has more than 127 layers."""
    acc = running[:width]
    acc[:] = 0
    for r in range(height):
        d, m = difference[r, :width], own[r, :width]
        for x in range(width):
            acc[x] = np.int8(acc[x] + d[x])
            d[x] = 0
            m[x] = np.uint8(acc[x] > 0)
    difference[height, :width] = 0


@kernel
def _lengths(start, end, u, v, out):
    """out (N,) f4 px: lengths of edges between points (u, v); by itself it vectorises."""
    for e in range(out.shape[0]):
        dx, dy = u[end[e]] - u[start[e]], v[end[e]] - v[start[e]]
        out[e] = math.sqrt(dx * dx + dy * dy)


@kernel
def _onto_edges(edge, outline, start, end, u, v, i2, weight, out):
    """out (6, K) f4: what `form_rows` wants found of outline points (K, 2), each on its edge, and its loss; i2: 1 /
    scale^2. By itself it vectorises."""
    for m in range(edge.shape[0]):
        x, y = outline[m, 0], outline[m, 1]
        a, b = start[edge[m]], end[edge[m]]
        dx, dy = u[b] - u[a], v[b] - v[a]
        # onto the edge itself: the nearest sample alone would leave false residuals of half the spacing
        t = min(max(((x - u[a]) * dx + (y - v[a]) * dy) / (dx * dx + dy * dy), f4(0)), f4(1))
        dx, dy = u[a] + t * dx - x, v[a] + t * dy - y
        d2 = dx * dx + dy * dy
        r = math.sqrt(d2)
        rho, slope, _ = geman_mcclure(d2 * i2, weight, f4(1))
        out[0, m], out[1, m], out[2, m], out[3, m], out[4, m], out[5, m] = t, dx / r, dy / r, slope, r, rho


@kernel
def contour_rows(c, p, mesh, contours, scale, ws, kept, count):
    """Rows of view c under p (3, 4) f4 about the root, kept in ws.rows, kept[0] so far; count[0] forward and count[1]
    reverse rows are added; returns the view's cost.

    Cost of a row: 1/2 w e^2 / (1 + e^2), e = r / scale (Geman & McClure 1985), weight in the normal equations
    w / (1 + e^2)^2. A view in which the body is not to be seen costs what its outline points cost at infinite distance.
    Which points are the outline, and which is nearest, is held fixed in the derivatives.
    """
    w, h = contours.sizes[c, 0], contours.sizes[c, 1]
    sdf, outline = contours.sdf[c], contours.outline[c]
    n_outline = outline.shape[0]
    left, top = contours.corners[c, 0], contours.corners[c, 1]
    across, down = contours.sdf_sizes[c, 0] - 1, contours.sdf_sizes[c, 1] - 1
    unseen = 0.5 * contours.reverse_weight * n_outline
    u, v = ws.u, ws.v
    bounds = np.empty(5, np.float32)
    project(ws.vertices, p, u, v, bounds)
    if not (bounds[4] >= NEAR):
        return unseen
    x0 = int(max(f4(0), np.floor(bounds[0]) - f4(1)))
    x1 = int(min(f4(w), np.ceil(bounds[1]) + f4(2)))
    y0 = int(max(f4(0), np.floor(bounds[2]) - f4(1)))
    y1 = int(min(f4(h), np.ceil(bounds[3]) + f4(2)))
    width, height = x1 - x0, y1 - y0
    if width < 3 or height < 3:
        return unseen
    front_faces(mesh.faces, u, v, ws.front)
    n = contour_edges(mesh.edges, ws.front, ws.start, ws.end)
    emit_contours(n, ws.start, ws.end, u, v, x0, y0, width, height, ws.difference)
    own_silhouette(x0, y0, width, height, ws.difference, ws.running, ws.own)
    lengths, length = np.empty(n, np.float32), f4(0)
    _lengths(ws.start[:n], ws.end[:n], u, v, lengths)
    for e in range(n):
        length += lengths[e]
    wanted = f4(contours.spacing / contours.shrunk[c])
    spacing = max(wanted, length / f4(RIM - 16))
    thinned = spacing / wanted  # weight is per arc length
    stride = contours.stride
    own_scale = scale / contours.shrunk[c]
    i2 = f4(1) / f4(own_scale * own_scale)
    forward = f4(contours.forward_weight) * thinned
    cost_forward = 0.0
    cost_reverse = 0.0
    # Points of the body's outline, evenly spaced along the contour edges: the pixel just outside must not be the
    # body's.
    ends, found, n_found = ws.ends, ws.found, 0
    n_rim = next_row = 0
    position = spacing * f4(0.5)
    for e in range(n):
        edge = lengths[e]
        if edge < f4(1e-6):
            continue
        if position >= edge:  # as most: they are short
            position -= edge
            continue
        a, b = ws.start[e], ws.end[e]
        dx, dy = u[b] - u[a], v[b] - v[a]
        nx, ny = -dy / edge, dx / edge
        while position < edge and n_rim < RIM:
            t = position / edge
            x, y = u[a] + t * dx, v[a] + t * dy
            position += spacing
            if x < BORDER or y < BORDER or x > w - 1 - BORDER or y > h - 1 - BORDER:
                continue
            tx, ty = int(x + nx + f4(0.5)) - x0, int(y + ny + f4(0.5)) - y0
            if 0 <= tx < width and 0 <= ty < height and ws.own[ty, tx] != 0:
                continue
            ws.rim_u[n_rim], ws.rim_v[n_rim], ws.rim_edge[n_rim] = x, y, e
            if n_rim == next_row:
                next_row += stride
                xi, yi = int(x), int(y)
                fx, fy = x - f4(xi), y - f4(yi)
                xi -= left
                yi -= top
                if 0 <= xi < across and 0 <= yi < down:
                    s00, s01, s10, s11 = sdf[yi, xi], sdf[yi, xi + 1], sdf[yi + 1, xi], sdf[yi + 1, xi + 1]
                    if max(max(s00, s01), max(s10, s11)) >= f4(NOT_KNOWN):
                        n_rim += 1
                        continue
                    r = (s00 * (f4(1) - fx) + s01 * fx) * (f4(1) - fy) + (s10 * (f4(1) - fx) + s11 * fx) * fy
                    gx = (s01 - s00) * (f4(1) - fy) + (s11 - s10) * fy
                    gy = (s10 - s00) * (f4(1) - fx) + (s11 - s01) * fx
                    rho, slope, _ = geman_mcclure(r * r * i2, forward * i2, f4(1))
                    cost_forward += rho
                    count[0] += 1
                    if n_found < ends.shape[0]:
                        ends[n_found, 0], ends[n_found, 1] = a, b
                        point = found[n_found]
                        point[0], point[1], point[2], point[3], point[4] = t, gx, gy, slope, r
                        n_found += 1
                else:
                    cost_forward += 1.0
                    count[0] += 1
            n_rim += 1
        position -= edge
    if n_rim == 0:
        return unseen
    rim_u, rim_v, number = np.empty(RIM, np.float32), np.empty(RIM, np.float32), np.empty(RIM, np.int32)
    place, low = np.empty(_BANDS + 1, np.int64), f4(y0)
    _by_row(n_rim, ws.rim_u, ws.rim_v, low, rim_u, rim_v, number, place)
    reverse = f4(contours.reverse_weight)
    edge_of, beside = np.zeros(n_outline, np.int32), np.empty((6, n_outline), np.float32)
    for m in range(n_outline):
        if outline[m, 0] >= f4(-1e5):  # else marked: it may be somebody else's outline
            edge_of[m] = ws.rim_edge[nearest(n_rim, rim_u, rim_v, number, place, low, outline[m, 0], outline[m, 1])]
    _onto_edges(edge_of, outline, ws.start, ws.end, u, v, i2, reverse * i2, beside)
    for m in range(n_outline):
        if outline[m, 0] < f4(-1e5):
            continue
        cost_reverse += beside[5, m]
        if beside[4, m] > f4(0.05) and n_found < ends.shape[0]:
            ends[n_found, 0], ends[n_found, 1] = ws.start[edge_of[m]], ws.end[edge_of[m]]
            for k in range(5):
                found[n_found, k] = beside[k, m]
            n_found += 1
        count[1] += 1
    if kept[0] + 2 * mesh.skin_index.shape[1] * n_found > ws.rows.shape[0]:
        sum_rows(kept[0], ws.rows, ws.row_joints, ws.lanes, ws.place, ws.wrench_hessian, ws.wrench_gradient)
        kept[0] = 0
    index, weight, count_of = mesh.skin_index, mesh.skin_weight, mesh.skin_count
    kept[0] = form_rows(n_found, ends, found, kept[0], ws.vertices, index, weight, count_of, p, ws.rows, ws.row_joints)
    return 0.5 * (forward * cost_forward + reverse * cost_reverse)


@kernel
def keypoint_rows(q, keypoints, rotations, centres, hessian, gradient, count):
    """Rows of 2D key points; returns the cost, 1/2 w 4 log(1 + e^2 / 4) with e = distance / scale (Cauchy, 2 sd).

    A key point behind its camera costs a constant 1/2 w 4 log(1 + 10^6) and pulls nowhere."""
    cost = 0.0
    i2 = 1.0 / (keypoints.scale * keypoints.scale)
    for m in range(keypoints.joint.shape[0]):
        j = keypoints.joint[m]
        o, r = keypoints.offset[m], rotations[j]
        px = centres[j, 0] + r[0, 0] * o[0] + r[0, 1] * o[1] + r[0, 2] * o[2]
        py = centres[j, 1] + r[1, 0] * o[0] + r[1, 1] * o[1] + r[1, 2] * o[2]
        pz = centres[j, 2] + r[2, 0] * o[0] + r[2, 1] * o[1] + r[2, 2] * o[2]
        x, y, z = px + q[0], py + q[1], pz + q[2]
        for c in range(keypoints.points.shape[0]):
            w = keypoints.points[c, m, 2]
            if not w > 0:
                continue
            p = keypoints.projections[c]
            depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
            if depth < 1e-3:
                cost += 2 * w * math.log1p(1e6)
                continue
            iz = 1 / depth
            u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) * iz
            v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) * iz
            du, dv = u - keypoints.points[c, m, 0], v - keypoints.points[c, m, 1]
            rho, slope, _ = lorentzian(0.25 * ((du * du + dv * dv) * i2), w * i2)
            cost += 2 * w * rho
            for a in range(2):
                image, residual = (u, du) if a == 0 else (v, dv)
                g0 = (p[a, 0] - image * p[2, 0]) * iz
                g1 = (p[a, 1] - image * p[2, 1]) * iz
                g2 = (p[a, 2] - image * p[2, 2]) * iz
                add_row(hessian, gradient, j, slope, residual, px, py, pz, g0, g1, g2)
            count[0] += 1
    return cost


@kernel
def point_rows(q, points, rotations, centres, hessian, gradient, count):
    """Rows of 3D points; returns the cost, 1/2 w 4 log(1 + e^2 / 4) with e = distance / scale (Cauchy, 2 sd)."""
    cost = 0.0
    i2 = 1.0 / (points.scale * points.scale)
    d = np.empty(3)
    for m in range(points.joint.shape[0]):
        w = points.weight[m]
        if not w > 0:
            continue
        j = points.joint[m]
        o, r = points.offset[m], rotations[j]
        px = centres[j, 0] + r[0, 0] * o[0] + r[0, 1] * o[1] + r[0, 2] * o[2]
        py = centres[j, 1] + r[1, 0] * o[0] + r[1, 1] * o[1] + r[1, 2] * o[2]
        pz = centres[j, 2] + r[2, 0] * o[0] + r[2, 1] * o[1] + r[2, 2] * o[2]
        d[0] = px + q[0] - points.points_world[m, 0]
        d[1] = py + q[1] - points.points_world[m, 1]
        d[2] = pz + q[2] - points.points_world[m, 2]
        rho, slope, _ = lorentzian(0.25 * ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) * i2), w * i2)
        cost += 2 * w * rho
        add_row(hessian, gradient, j, slope, d[0], px, py, pz, 1.0, 0.0, 0.0)
        add_row(hessian, gradient, j, slope, d[1], px, py, pz, 0.0, 1.0, 0.0)
        add_row(hessian, gradient, j, slope, d[2], px, py, pz, 0.0, 0.0, 1.0)
        count[0] += 1
    return cost


@kernel
def _mark_edge(above, row, below, before, after, marked):
    """marked (n,) u1: 1 where row (n,) is negative and some neighbour positive; by itself it vectorises."""
    for i in range(row.shape[0]):
        most = before[i]
        most = after[i] if after[i] > most else most
        most = above[i] if above[i] > most else most
        most = below[i] if below[i] > most else most
        marked[i] = (most if most < -row[i] else -row[i]) > f4(0)


@kernel
def outline_points(sdf, width, height, out):
    """Up to K points on the zero line of sdf (h, w), evenly taken in row order, BORDER px of the image border left
    out: inside pixels with an outside neighbour, moved by -sdf along its gradient. Fills out (K, 2) (repeating when
    there are fewer) and returns how many outline pixels there are."""
    found = np.empty(width * height, np.int32)  # memory that is not touched costs nothing
    n = 0
    words = (width + 7) // 8
    flags = np.zeros(words, np.uint64)
    flag = flags.view(np.uint8)
    inner, most = flag[1 : width - 1], width - 2
    for y in range(BORDER, height - BORDER):
        above, row, below = sdf[y - 1, 1 : most + 1], sdf[y, 1 : most + 1], sdf[y + 1, 1 : most + 1]
        before, after = sdf[y, :most], sdf[y, 2 : most + 2]
        _mark_edge(above, row, below, before, after, inner)  # what follows looks at the few pixels that count
        for word in range(words):
            if flags[word] == 0:
                continue
            for x in range(max(8 * word, BORDER), min(8 * word + 8, width - BORDER)):
                if flag[x] != 0:
                    found[n] = y * width + x
                    n += 1
    k = out.shape[0]
    m = min(n, k)
    for i in range(m):
        y, x = divmod(found[i * n // m], width)
        gx, gy = (sdf[y, x + 1] - sdf[y, x - 1]) * f4(0.5), (sdf[y + 1, x] - sdf[y - 1, x]) * f4(0.5)
        slope = max(math.sqrt(gx * gx + gy * gy), f4(0.3))
        out[i, 0] = x - sdf[y, x] * gx / slope
        out[i, 1] = y - sdf[y, x] * gy / slope
    for i in range(m, k):
        out[i, 0] = out[i % m, 0] if m > 0 else f4(-1e6)
        out[i, 1] = out[i % m, 1] if m > 0 else f4(-1e6)
    return n

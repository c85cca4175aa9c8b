"""Sum rows of evidence per joint, and compute the rows of key points and 3D points.

Every cue is a set of rows (point p, g = d residual / d point, residual r, weight w, joint j). A row's derivative by dof
d is S_d . x with the dof's twist S_d and the row's wrench x = (p x g, g), everything relative to the root's position.
So w x x^T (21 numbers) and w r x (6) are added to joint j, and no row as wide as the pose is ever stored. solver.py
folds the sums up the tree.
A skinned point is a blend of joints: its row goes to each joint, times the skinning weight. The gradient assumes that
all of them turn the blended point, where each joint turns an image of its own: over a body's vertices it is off by 0.2
% (rms). The second-order sum drops cross terms between the joints of one point and keeps w_j instead of w_j^2, which
only adds damping.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.coverage import LANES
from hypose.compute.losses import lorentzian_kernel as lorentzian
from hypose.compute.simd import lane, load, splat

f4, u4 = np.float32, np.uint32
BORDER = 3
"""px along the image border where outlines are cut off by the image and are no evidence."""


@kernel
def add_row(hessian, gradient, j, w, r, px, py, pz, gx, gy, gz):
    """Add one row (residual with its derivatives) to the normal equations of its joint.

    hessian, gradient: (J, 21) and (J, 6) sums per joint.
    j: joint that carries the point.
    w, r: weight and residual.
    px, py, pz: the point, m, relative to the root's position.
    gx, gy, gz: derivative of the residual by the point.
    """
    a = py * gz - pz * gy, pz * gx - px * gz, px * gy - py * gx, gx, gy, gz
    c, g, k = hessian[j], gradient[j], 0
    for x in range(6):
        b = w * a[x]
        for y in range(x + 1):
            c[k] += b * a[y]
            k += 1
        g[x] += b * r


@kernel
def sum_rows(n, rows, joints, lanes, place, hessian, gradient):
    """Add n rows (residuals with derivatives) to the normal equations of their joints, several rows at a time in
    vector instructions.

    hessian, gradient: (J, 21) and (J, 6) sums per joint, which are changed.

    rows, joints: (M, 8) wrench, weight, residual, and (M,) joint of each row.
    lanes, place: (9, M), with M of 27 at least, and (J + 1,), scratch.
    """
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
    sums = lanes[8]
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
def _wrenches(work, p):
    """Compute wrenches of LANES points.

    Here a wrench is (p x g, g) of a point p with the derivative g of its residual by the place in the world.
    work: (9 x LANES,) f4: x, y, z of the ends of an edge, place on it, gradient along u and v; gets the wrenches.
    p: (3, 4) camera.
    """
    p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
    p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
    p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
    for m in range(LANES):
        t, gx, gy = work[6 * LANES + m], work[7 * LANES + m], work[8 * LANES + m]
        s = f4(1) - t
        x = s * work[m] + t * work[3 * LANES + m]
        y = s * work[LANES + m] + t * work[4 * LANES + m]
        z = s * work[2 * LANES + m] + t * work[5 * LANES + m]
        iz = f4(1) / (p20 * x + p21 * y + p22 * z + p23)
        u = (p00 * x + p01 * y + p02 * z + p03) * iz
        v = (p10 * x + p11 * y + p12 * z + p13) * iz
        k = -(gx * u + gy * v) * iz
        gx *= iz
        gy *= iz
        g0 = gx * p00 + gy * p10 + k * p20
        g1 = gx * p01 + gy * p11 + k * p21
        g2 = gx * p02 + gy * p12 + k * p22
        work[m], work[LANES + m], work[2 * LANES + m] = y * g2 - z * g1, z * g0 - x * g2, x * g1 - y * g0
        work[3 * LANES + m], work[4 * LANES + m], work[5 * LANES + m] = g0, g1, g2


@kernel
def form_rows(first, last, ends, found, work, n_rows, vertices, mesh, p, rows, joints):
    """Append rows (residuals with derivatives) of the outline points first to last, all of one view: one row for
    each joint that moves the point.

    n_rows: number of rows before.
    vertices: (V, 3) f4 m, about the root.
    mesh: mesh of the body.
    ends, found: (2, M) vertices of the mesh edge of each point, and (5, M) its values, as `contours.contour_rows`
        fills them.
    p: (3, 4) f4, camera of the view.
    work: (9 x LANES,) f4, scratch.
    rows, joints: (M, 8) = wrench, weight, residual, and (M,); written from row n_rows on.
    Returns: number of rows.
    """
    skin_index, skin_weight, skin_count = mesh.skin_index, mesh.skin_weight, mesh.skin_count
    for block in range(first, last, LANES):
        some = min(LANES, last - block)
        for m in range(some):
            a, b = u4(ends[0, block + m]), u4(ends[1, block + m])
            for k in range(3):
                work[k * LANES + m], work[(3 + k) * LANES + m] = vertices[a, k], vertices[b, k]
                work[(6 + k) * LANES + m] = found[k, block + m]
        _wrenches(work, p)
        for m in range(some):
            i = block + m
            a, b, t, w, r = u4(ends[0, i]), u4(ends[1, i]), found[0, i], found[3, i], found[4, i]
            s, begin = f4(1) - t, n_rows
            for k in range(skin_count[a]):
                joints[n_rows] = skin_index[a, k]
                rows[n_rows, 6] = s * skin_weight[a, k] * w
                n_rows += 1
            for k in range(skin_count[b]):
                at = begin  # the ends of an edge are mostly carried by the same joints
                while at < n_rows and joints[at] != skin_index[b, k]:
                    at += 1
                if at == n_rows:
                    joints[at] = skin_index[b, k]
                    rows[at, 6] = 0.0
                    n_rows += 1
                rows[at, 6] += t * skin_weight[b, k] * w
            for at in range(begin, n_rows):
                line = rows[at]
                for k in range(6):
                    line[k] = work[k * LANES + m]
                line[7] = r
    return n_rows


@kernel
def keypoint_rows(q, keypoints, rotations, centres, hessian, gradient, count):
    """Add the residuals of 2D key points to the normal equations of the joints; return the cost, 1/2 w 4 log(1 + e^2
    / 4) with e = distance / scale (Cauchy, 2 sd).

    q: (D,) pose.
    keypoints: key points of the frame (KeypointTerm).
    rotations, centres: (J, 3, 3) and (J, 3) m, joint frames about the root.
    hessian, gradient: (J, 21) and (J, 6) sums per joint.
    count: (2,) its first number grows by the number of key points used.

    A key point behind its camera costs a constant 1/2 w 4 log(1 + 10^6) and has no derivative.
    """
    cost, least = 0.0, max(keypoints.min_confidence, 0.0)
    i2 = 1.0 / (keypoints.scale_px * keypoints.scale_px)
    for m in range(keypoints.joint.shape[0]):
        j = keypoints.joint[m]
        o, r = keypoints.offset[m], rotations[j]
        px = centres[j, 0] + r[0, 0] * o[0] + r[0, 1] * o[1] + r[0, 2] * o[2]
        py = centres[j, 1] + r[1, 0] * o[0] + r[1, 1] * o[1] + r[1, 2] * o[2]
        pz = centres[j, 2] + r[2, 0] * o[0] + r[2, 1] * o[1] + r[2, 2] * o[2]
        x, y, z = px + q[0], py + q[1], pz + q[2]
        for c in range(keypoints.points.shape[0]):
            w = keypoints.points[c, m, 2]
            if not (w > least and math.isfinite(keypoints.points[c, m, 0] + keypoints.points[c, m, 1])):
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
    """Add the residuals of 3D points to the normal equations of the joints; return the cost, 1/2 w 4 log(1 + e^2 /
    4) with e = distance / scale (Cauchy, 2 sd).

    q: (D,) pose.
    points: 3D points of the frame (PointArrays).
    rotations, centres: (J, 3, 3) and (J, 3) m, joint frames about the root.
    hessian, gradient: (J, 21) and (J, 6) sums per joint.
    count: (2,) its first number grows by the number of points used.
    """
    cost = 0.0
    d = np.empty(3)
    for m in range(points.joint.shape[0]):
        w = points.weight[m]
        if not w > 0:
            continue
        j, i2 = points.joint[m], 1.0 / (points.scale[m] * points.scale[m])
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
    """Mark in marked (n,) u1 where row (n,) is negative and a neighbour positive; the loop vectorises.

    above, row, below, before, after: (n,) f4 signed distances of the pixels, and of their four neighbours.
    """
    for i in range(row.shape[0]):
        most = before[i]
        most = after[i] if after[i] > most else most
        most = above[i] if above[i] > most else most
        most = below[i] if below[i] > most else most
        marked[i] = (most if most < -row[i] else -row[i]) > f4(0)


@kernel
def _outline_points(sdf, width, height, out):
    """Find up to K points on the zero line of sdf (h, w), evenly in row order, BORDER px from the image border.

    sdf, width, height: (h, w) f4 signed distance, px, and the size of the view in it.

    They are inside pixels with an outside neighbour, moved by -sdf along its gradient.
    out: (K, 2) gets them (repeated where there are fewer).
    Returns: number of outline pixels.
    """
    found = np.empty(width * height, np.int32)  # memory that is not touched costs nothing
    n = 0
    words = (width + 7) // 8
    flags = np.zeros(words, np.uint64)
    flag = flags.view(np.uint8)
    inner, most = flag[1 : width - 1], width - 2
    for y in range(BORDER, height - BORDER):
        above, row, below = sdf[y - 1, 1 : most + 1], sdf[y, 1 : most + 1], sdf[y + 1, 1 : most + 1]
        before, after = sdf[y, :most], sdf[y, 2 : most + 2]
        _mark_edge(above, row, below, before, after, inner)  # below only the marked pixels are visited
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


EIGHT = 8


@kernel
def wrench_sums(lanes, row, first, last, sums):
    """Sum the weighted products of rows of residuals that belong to one joint, for its normal equations.

    lanes: (9, row) float64, one column per residual: wrench x (6 numbers), weight w, residual, scratch.
    first, last: range of columns; their number is a multiple of EIGHT.

    row: number of columns of `lanes`.
    sums: (27,) gets, for x = 0..5: w x . y for y = 0..x, then w x . residual.
    """
    s = sums  # in three loops of nine, whose sums share loaded values
    s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8] = _among(lanes, row, first, last, 0)
    s[12], s[13], s[17], s[18], s[19], s[23], s[24], s[25], s[26] = _among(lanes, row, first, last, 3)
    s[9], s[10], s[11], s[14], s[15], s[16], s[20], s[21], s[22] = _between(lanes, row, first, last)


@kernel
def _among(lanes, row, first, last, x):
    """Sum the products of three parts of the wrenches, from x on, with each other and with the residual,
    in that order.

    lanes, row, first, last: as in `wrench_sums`.
    x: 0 or 3, first of the three parts.
    """
    zero = splat(0.0, EIGHT)
    aa, ar, ba, bb, br, ca, cb, cc, cr = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(first, last, EIGHT):
        w, r = load(lanes, 6 * row + k, EIGHT), load(lanes, 7 * row + k, EIGHT)
        a, b, c = _parts(lanes, row, x, k)
        wa, wb, wc = w * a, w * b, w * c
        aa, ar, ba, bb, br = aa + wa * a, ar + wa * r, ba + wb * a, bb + wb * b, br + wb * r
        ca, cb, cc, cr = ca + wc * a, cb + wc * b, cc + wc * c, cr + wc * r
    return _added(aa), _added(ar), _added(ba), _added(bb), _added(br), _added(ca), _added(cb), _added(cc), _added(cr)


@kernel
def _between(lanes, row, first, last):
    """Sum the products of the last three parts of the wrenches with the first three.

    lanes, row, first, last: as in `wrench_sums`.
    """
    zero = splat(0.0, EIGHT)
    ax, ay, az, bx, by, bz, cx, cy, cz = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(first, last, EIGHT):
        w = load(lanes, 6 * row + k, EIGHT)
        x, y, z = _parts(lanes, row, 0, k)
        a, b, c = _parts(lanes, row, 3, k)
        a, b, c = w * a, w * b, w * c
        ax, ay, az, bx, by, bz = ax + a * x, ay + a * y, az + a * z, bx + b * x, by + b * y, bz + b * z
        cx, cy, cz = cx + c * x, cy + c * y, cz + c * z
    return _added(ax), _added(ay), _added(az), _added(bx), _added(by), _added(bz), _added(cx), _added(cy), _added(cz)


@kernel
def _parts(lanes, row, x, k):
    """Load three parts of the wrenches, from x on, of EIGHT columns.

    lanes, row: as in `wrench_sums`.
    x, k: first part, and first column.
    """
    return load(lanes, x * row + k, EIGHT), load(lanes, (x + 1) * row + k, EIGHT), load(lanes, (x + 2) * row + k, EIGHT)


@kernel
def _added(value):
    """Add the partial sums of a vector, in a fixed order."""
    left = (lane(value, 0) + lane(value, 4)) + (lane(value, 1) + lane(value, 5))
    return left + ((lane(value, 2) + lane(value, 6)) + (lane(value, 3) + lane(value, 7)))


def outline_points(sdf: NDArray[np.float32], size: tuple[int, int], k: int) -> tuple[NDArray[np.float32], int]:
    """Find up to k points on the zero line of a signed distance.

    sdf: (h, w) signed distance, px.
    size: (width, height) size of the view in it.
    k: number of points.
    Returns: (k, 2) float32 px (repeated where the outline has fewer pixels, -1e6 where it has none), and the number of
        outline pixels. Three pixels along the image border are omitted, because there the image cuts the person off.
    """
    out = np.empty((k, 2), dtype=np.float32)
    n = _outline_points(plain(sdf, np.float32), int(size[0]), int(size[1]), out)
    return out, int(n)

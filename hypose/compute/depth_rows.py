"""Rows of depth maps: measured surface points against the body's surface, and body in front of the measured surface."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.losses import geman_mcclure_kernel as geman_mcclure
from hypose.compute.rows import sum_rows

f4, i4 = np.float32, np.int32
_PER_M2 = 4e6
"""Units of a squared distance (m^2) that is packed into 20 bits: half a millimetre squared, up to half a metre."""
_LARGEST_SHARE = 1e6
_TURNED = 0.0036
"""m^2, added to the squared distance of a surface that faces the opposite way; half of it at right angles."""
_BAND_M, _BANDS, _REACH = 0.12, 24, 2
"""_BAND_M: height in m of a band of vertices. _BANDS: number of bands; the last holds everything higher. _REACH: number
of bands on either side in which a point searches its nearest place; farther points have no effect.
"""
_NEXT_BAND = 0.99 * _BAND_M**2 * _PER_M2
"""Packed squared distance that every place exceeds which lies a whole band or more above or below."""
_ON_SURFACE = 0.004
"""m; nearer points pull along the surface's normal, because their own direction is noise."""
_FARTHEST_BEFORE = 0.5
"""m; body farther in front of the measured surface is left to the outline."""
_FREE_SCALE_M, _SLACK_M = 0.06, 0.02
"""m: robust scale of body in front of the measured surface, and distance within which it costs nothing."""
_LANES = 16
"""Number of triangles that are computed together."""


@kernel
def _vertex_normals(vertices, faces, normals):
    """Compute the unit normals (V, 3) f4 of vertices (V, 3) of a closed mesh, weighted by the areas of the faces."""
    normals[:] = f4(0)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for v in (a, b, c):
            normals[v, 0] += x
            normals[v, 1] += y
            normals[v, 2] += z
    for v in range(normals.shape[0]):
        x, y, z = normals[v, 0], normals[v, 1], normals[v, 2]
        inverse = f4(1) / max(math.sqrt(x * x + y * y + z * z), f4(1e-12))
        for k in range(3):
            normals[v, k] *= inverse


@kernel
def _nearest(fx, fy, fz, nx, ny, nz, px, py, pz, ox, oy, oz):
    """Find the nearest of the given points to p, where points with other normals than o count as farther off.

    fx, fy, fz, nx, ny, nz: (N,) f4 points, m, and their unit normals.
    px, py, pz, ox, oy, oz: the point p, m, and its unit normal o.
    Returns: squared distance and index packed into one integer, as in contours.nearest.
    Why an own kernel: everything stays in single precision, and the arrays begin at the first candidate (an index from
    elsewhere takes half as long again).
    """
    best = i4(2147483647)
    for i in range(fx.shape[0]):
        dx, dy, dz = fx[i] - px, fy[i] - py, fz[i] - pz
        turned = f4(1) - (nx[i] * ox + ny[i] * oy + nz[i] * oz)
        far = (dx * dx + dy * dy + dz * dz + f4(_TURNED * 0.5) * turned) * f4(_PER_M2)
        best = min(best, i4(i4(i4(min(far, f4(_LARGEST_SHARE))) << i4(11)) | i4(i)))
    return best


@kernel
def _nearest_edge(vertices, ring, first, last, ax, ay, az, qx, qy, qz):
    """Find which of the rows first to last of the ring around vertex a begins with the edge nearest to q (relative to
    a).

    vertices: (V, 3) f4 m.
    ring: (3 F, 3) as in DepthArrays.
    ax, ay, az: place of vertex a, m.
    qx, qy, qz: the point, m.
    """
    nearest, edge = f4(1e9), first
    for k in range(first, last):
        b = ring[k, 0]
        x, y, z = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        along, length = x * qx + y * qy + z * qz, x * x + y * y + z * z
        t = min(max(along, f4(0)), length) / max(length, f4(1e-12))
        away = t * (t * length - f4(2) * along)
        nearer = away < nearest
        nearest, edge = away if nearer else nearest, k if nearer else edge
    return edge


@kernel
def closest_on_triangles(work):
    """Find the point of each of _LANES triangles that is nearest to a given point; every triangle has a point of its
    own.

    work: (12 _LANES,) f4: lines 0 to 8: corners u and v and the point p (x, y, z), relative to the third corner; lines
        9 to 11 get the shares s and t of the corners u and v, and the squared distance.
    Why in vector lanes: which part of a triangle is nearest cannot be predicted, and a wrong branch takes as long as
    all cases.
    Source: Ericson 2005, Real-Time Collision Detection, section 5.1.5.
    """
    for i in range(_LANES):
        ux, uy, uz = work[i], work[_LANES + i], work[2 * _LANES + i]
        vx, vy, vz = work[3 * _LANES + i], work[4 * _LANES + i], work[5 * _LANES + i]
        px, py, pz = work[6 * _LANES + i], work[7 * _LANES + i], work[8 * _LANES + i]
        none, one = f4(0), f4(1)
        d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
        uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
        d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
        va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
        whole, across = va + vb + vc, (d4 - d3) / ((d4 - d3) + (d5 - d6))
        inside = whole > f4(1e-20)
        s, t = vb / whole if inside else none, vc / whole if inside else none
        opposite = (va <= none) & (d4 - d3 >= none) & (d5 - d6 >= none)
        s, t = one - across if opposite else s, across if opposite else t
        along = (vb <= none) & (d2 >= none) & (d6 <= none)
        s, t = none if along else s, d2 / vv if along else t
        along = (vc <= none) & (d1 >= none) & (d3 <= none)
        s, t = d1 / uu if along else s, none if along else t
        corner = (d6 >= none) & (d5 <= d6)
        s, t = none if corner else s, one if corner else t
        corner = (d3 >= none) & (d4 <= d3)
        s, t = one if corner else s, none if corner else t
        corner = (d1 <= none) & (d2 <= none)
        s, t = none if corner else s, none if corner else t
        x, y, z = s * ux + t * vx - px, s * uy + t * vy - py, s * uz + t * vz - pz
        work[9 * _LANES + i], work[10 * _LANES + i] = s, t
        work[11 * _LANES + i] = x * x + y * y + z * z


@kernel
def _nearest_places(n, vertices, ring_first, ring, corners, found):
    """Find the places on the faces around n vertices that are nearest to points; each is in one of the two faces at the
    edge nearest to the point.

    n: number of points.
    vertices: (V, 3) f4 m.
    ring_first, ring: as in DepthArrays.
    corners: (N, 3) gets the vertices of the faces, beginning with the vertex in corners[:, 0].
    found: (N, 8) f4: columns 3 to 5 are the points, relative to that vertex; columns 0 to 2 get the shares of the
        corners, column 3 the squared distance.
    """
    work, sides = np.zeros(12 * _LANES, np.float32), np.empty(_LANES, np.int64)
    for begin in range(0, n, _LANES // 2):
        some = min(n - begin, _LANES // 2)
        for i in range(some):
            a, q = corners[begin + i, 0], found[begin + i]
            ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
            edge = _nearest_edge(vertices, ring, ring_first[a], ring_first[a + 1], ax, ay, az, q[3], q[4], q[5])
            other = np.int64(ring[edge, 2])
            sides[2 * i], sides[2 * i + 1] = min(edge, other), max(edge, other)
            for k in range(2 * i, 2 * i + 2):
                for corner in range(2):
                    b = ring[sides[k], corner]
                    work[3 * corner * _LANES + k] = vertices[b, 0] - ax
                    work[(3 * corner + 1) * _LANES + k] = vertices[b, 1] - ay
                    work[(3 * corner + 2) * _LANES + k] = vertices[b, 2] - az
                for axis in range(3):
                    work[(6 + axis) * _LANES + k] = q[3 + axis]
        closest_on_triangles(work)
        for i in range(some):
            k = 2 * i + (work[11 * _LANES + 2 * i + 1] < work[11 * _LANES + 2 * i])
            own, u, v = found[begin + i], work[9 * _LANES + k], work[10 * _LANES + k]
            own[0], own[1], own[2], own[3] = f4(1) - u - v, u, v, work[11 * _LANES + k]
            corners[begin + i, 1], corners[begin + i, 2] = ring[sides[k], 0], ring[sides[k], 1]


@kernel
def _by_height(vertices, normals, ex, ey, ez, faces_it, place):
    """Sort the vertices that face an eye by height, into bands of _BAND_M; everything relative to the root.

    vertices, normals: (V, 3) f4, m and unit.
    ex, ey, ez: the eye, m.
    faces_it: (V,) i4 gets the vertices.
    place: (B + 1,) gets where each band begins.
    Returns: height at which the first band begins.
    """
    n_bands = place.shape[0] - 1
    low = f4(1e9)
    for v in range(vertices.shape[0]):
        low = min(low, vertices[v, 2])
    place[:] = 0
    band = np.empty(vertices.shape[0], np.int32)
    for v in range(vertices.shape[0]):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        band[v] = -1
        if normals[v, 0] * (ex - x) + normals[v, 1] * (ey - y) + normals[v, 2] * (ez - z) > f4(0):
            band[v] = min(int((z - low) * f4(1 / _BAND_M)), n_bands - 1)
            place[band[v] + 1] += 1
    for b in range(n_bands):
        place[b + 1] += place[b]
    at = place.copy()
    for v in range(vertices.shape[0]):
        if band[v] >= 0:
            faces_it[at[band[v]]] = v
            at[band[v]] += 1
    return low


@kernel
def _form_rows(n, corners, found, n_rows, vertices, skin_index, skin_weight, skin_count, rows, joints):
    """Append the rows of n points of the surface to rows (M, 8) and joints (M,), as rows.form_rows.

    n_rows: number of rows before.
    vertices: (V, 3) f4 m, about the root.
    skin_index, skin_weight, skin_count: as in MeshArrays.
    corners: (n, 3) vertices of which a point is a blend.
    found: (n, 8) f4: their shares, direction of the residual, weight, residual.
    Returns: number of rows.
    """
    for i in range(n):
        own = found[i]
        gx, gy, gz, w, r = own[3], own[4], own[5], own[6], own[7]
        x = y = z = f4(0)
        first = n_rows
        for k in range(3):
            share, v = own[k], corners[i, k]
            if share <= f4(0):
                continue
            x += share * vertices[v, 0]
            y += share * vertices[v, 1]
            z += share * vertices[v, 2]
            for m in range(skin_count[v]):
                j = skin_index[v, m]
                at = first  # the corners of a face are mostly carried by the same joints
                while at < n_rows and joints[at] != j:
                    at += 1
                if at == n_rows:
                    joints[at] = j
                    rows[at, 6] = 0.0
                    n_rows += 1
                rows[at, 6] += share * skin_weight[v, m] * w
        for m in range(first, n_rows):
            line = rows[m]
            line[0] = y * gz - z * gy
            line[1] = z * gx - x * gz
            line[2] = x * gy - y * gx
            line[3] = gx
            line[4] = gy
            line[5] = gz
            line[7] = r
    return n_rows


@kernel
def depth_rows(q, mesh, given, factor, ws, kept, count):
    """Compute the rows of depth maps into ws.rows, and return their cost. A row is one residual with its
    derivatives.

    q: (D,) pose; ws.vertices holds the skinned vertices about its root.
    mesh: mesh of the body (MeshArrays).
    given: depth maps and surface points (DepthArrays).
    ws: scratch memory.
    kept: (3,) its first number is that of the rows that wait in ws.rows; it is changed.
    factor: factor of the scale.
    count: (2,) gets the numbers of rows of surface points, and of body in front of the measured surface.

    A point of the surface is drawn to the nearest place on the body that faces its sensor and has a similar normal: 1/2
    w e^2 / (1 + e^2), e = distance / scale (Geman & McClure 1985). A vertex that faces the sensor and lies nearer to it
    than the surface measured in its pixel is pushed back along the optical axis, with the same loss. Which place is
    nearest is held fixed in the derivatives.
    """
    vertices, depth = ws.vertices, given.seen
    n_vertices = vertices.shape[0]
    normals = np.empty((n_vertices, 3), np.float32)
    _vertex_normals(vertices, mesh.faces, normals)
    room = (n_vertices + 15) // 16 * 16
    fx, fy, fz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    nx, ny, nz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    which, place = np.empty(room, np.int32), np.empty(_BANDS + 1, np.int64)
    most = depth.points.shape[0] + n_vertices
    corners, found = np.empty((most, 3), np.int32), np.empty((most, 8), np.float32)
    owner = np.empty(depth.points.shape[0], np.int64)
    cost = 0.0
    scale = depth.scale_m * factor
    i2, free_i2 = 1.0 / (scale * scale), 1.0 / (_FREE_SCALE_M * _FREE_SCALE_M)
    for c in range(depth.eyes.shape[0]):
        first, last = depth.first[c], depth.first[c + 1]
        if last <= first:
            continue
        ex, ey, ez = f4(depth.eyes[c, 0] - q[0]), f4(depth.eyes[c, 1] - q[1]), f4(depth.eyes[c, 2] - q[2])
        low = _by_height(vertices, normals, ex, ey, ez, which, place)
        n = place[_BANDS]
        for i in range(n):
            v = which[i]
            fx[i], fy[i], fz[i] = vertices[v, 0], vertices[v, 1], vertices[v, 2]
            nx[i], ny[i], nz[i] = normals[v, 0], normals[v, 1], normals[v, 2]
        if n == 0:
            cost += 0.5 * depth.weight[first:last].sum()
            continue
        whole = (n + 15) // 16 * 16
        for i in range(n, whole):
            fx[i], fy[i], fz[i] = f4(1e3), f4(1e3), f4(1e3)
            nx[i], ny[i], nz[i] = f4(0), f4(0), f4(0)
        n_found = 0
        for m in range(first, last):
            px, py, pz = f4(depth.points[m, 0] - q[0]), f4(depth.points[m, 1] - q[1]), f4(depth.points[m, 2] - q[2])
            ox, oy, oz = f4(depth.normals[m, 0]), f4(depth.normals[m, 1]), f4(depth.normals[m, 2])
            band = int(math.floor((pz - low) * f4(1 / _BAND_M)))
            best = i4(2147483647)
            begin = np.int64(0)
            for reach in range(1, _REACH + 1):
                if (best >> 11) < i4(_NEXT_BAND):  # all others are farther
                    break
                # whole vectors, because a part of one takes as long
                begin = place[min(max(band - reach, 0), _BANDS)] // 8 * 8
                end = (place[min(max(band + reach + 1, 0), _BANDS)] + 7) // 8 * 8
                best = _nearest(
                    *(fx[begin:end], fy[begin:end], fz[begin:end], nx[begin:end], ny[begin:end], nz[begin:end]),
                    *(px, py, pz, ox, oy, oz),
                )
            if (best >> 11) >= i4(_LARGEST_SHARE) - 1:
                cost += 0.5 * depth.weight[m]  # nothing near: the cost at infinite distance
                continue
            a = which[begin + (best & 2047)]
            owner[n_found], corners[n_found, 0], own = m, a, found[n_found]
            own[3], own[4], own[5] = px - vertices[a, 0], py - vertices[a, 1], pz - vertices[a, 2]
            n_found += 1
        _nearest_places(n_found, vertices, given.ring_first, given.ring, corners, found)
        for i in range(n_found):
            m, a, b, d, own = owner[i], corners[i, 0], corners[i, 1], corners[i, 2], found[i]
            px, py, pz = f4(depth.points[m, 0] - q[0]), f4(depth.points[m, 1] - q[1]), f4(depth.points[m, 2] - q[2])
            u, v, w = own[1], own[2], depth.weight[m]
            r = math.sqrt(own[3])
            dx = own[0] * vertices[a, 0] + u * vertices[b, 0] + v * vertices[d, 0] - px
            dy = own[0] * vertices[a, 1] + u * vertices[b, 1] + v * vertices[d, 1] - py
            dz = own[0] * vertices[a, 2] + u * vertices[b, 2] + v * vertices[d, 2] - pz
            if r > f4(_ON_SURFACE):
                gx, gy, gz = dx / r, dy / r, dz / r
            else:
                gx = own[0] * normals[a, 0] + u * normals[b, 0] + v * normals[d, 0]
                gy = own[0] * normals[a, 1] + u * normals[b, 1] + v * normals[d, 1]
                gz = own[0] * normals[a, 2] + u * normals[b, 2] + v * normals[d, 2]
                length = math.sqrt(gx * gx + gy * gy + gz * gz)
                gx, gy, gz = gx / length, gy / length, gz / length
                r = gx * dx + gy * dy + gz * dz
            rho, slope, _ = geman_mcclure(r * r * i2, w * i2, 1.0)
            cost += 0.5 * w * rho
            own[3], own[4], own[5], own[6], own[7] = gx, gy, gz, slope, r
        count[0] += n_found
        # body in front of the measured surface
        p = depth.projections[c]
        sx, sy, sz = f4(p[2, 0]), f4(p[2, 1]), f4(p[2, 2])
        h, width = depth.sizes[c, 1], depth.sizes[c, 0]
        free = depth.free_weight * (last - first) / n
        for i in range(n):
            x, y, z = fx[i] + q[0], fy[i] + q[1], fz[i] + q[2]
            away = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
            if away < 0.05:
                continue
            u = int(math.floor((p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / away + 0.5))
            v = int(math.floor((p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / away + 0.5))
            if u < 0 or v < 0 or u >= width or v >= h:
                continue
            seen = depth.maps[c, v, u]
            before = seen - away - _SLACK_M
            if not seen > 0 or before <= 0 or before > _FARTHEST_BEFORE:
                continue
            rho, slope, _ = geman_mcclure(before * before * free_i2, free * free_i2, 1.0)
            cost += 0.5 * free * rho
            own = found[n_found]
            own[0], own[1], own[2] = f4(1), f4(0), f4(0)
            corners[n_found, 0] = which[i]
            own[3], own[4], own[5], own[6], own[7] = -sx, -sy, -sz, slope, before
            n_found += 1
            count[1] += 1
        index, weight, count_of = mesh.skin_index, mesh.skin_weight, mesh.skin_count
        if kept[0] + 3 * index.shape[1] * n_found > ws.rows.shape[0]:
            sum_rows(kept[0], ws.rows, ws.row_joints, ws.lanes, ws.place, ws.wrench_hessian, ws.wrench_gradient)
            kept[0] = 0
        kept[0] = _form_rows(
            n_found, corners, found, kept[0], vertices, index, weight, count_of, ws.rows, ws.row_joints
        )
    return cost

"""numba: rows of depth maps: points of a surface against the body's, and body that stands where nothing does."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.solver.cpu_losses import geman_mcclure
from hypose.compute.solver.cpu_rows import sum_rows

f4, i4 = np.float32, np.int32
_PER_M2 = 4e6
"""units of a squared distance that is packed into 20 bits: half a millimetre squared, up to half a metre"""
_MOST = 1e6
_TURNED = 0.0036
"""m^2 by which a surface that looks the other way counts as further off, half of it at right angles"""
_BAND_M, _BANDS, _REACH = 0.12, 24, 2
"""m: a point looks for its place in a band of height and so many on either side of it: what is further off pulls
nowhere. The last band holds what is higher"""
_NEXT_BAND = 0.99 * _BAND_M**2 * _PER_M2
"""a squared distance, packed, that no place has which lies a whole band or more above or below"""
_ON_SURFACE = 0.004
"""m: nearer points pull along the surface's normal, for their own direction is noise"""
_FARTHEST_BEFORE = 0.5
"""m: body further before what was seen than that is the outline's affair"""


@kernel
def vertex_normals(vertices, faces, normals):
    """normals (V, 3) f4: unit, of vertices (V, 3) of a closed mesh, by the areas of the faces around."""
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
def closest_on_triangle(ux, uy, uz, vx, vy, vz, px, py, pz):
    """Shares (s, t) of the corners u and v at the point of a triangle nearest to p, all relative to its third corner.
    Source: Ericson 2005, Real-Time Collision Detection, section 5.1.5."""
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    if d1 <= 0 and d2 <= 0:
        return f4(0), f4(0)
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    if d3 >= 0 and d4 <= d3:
        return f4(1), f4(0)
    if d6 >= 0 and d5 <= d6:
        return f4(0), f4(1)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        return d1 / uu, f4(0)
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        return f4(0), d2 / vv
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return f4(1) - t, t
    whole = va + vb + vc
    if whole > f4(1e-20):
        return vb / whole, vc / whole
    return f4(0), f4(0)


@kernel
def _nearest(fx, fy, fz, nx, ny, nz, first, last, px, py, pz, ox, oy, oz):
    """The nearest of the points first to last to p, those with other normals than o counting as further off: squared
    distance and index packed into one integer, as in cpu_rows.nearest. Its own kernel, for all stays in single
    precision here."""
    best = i4(2147483647)
    for k in range(last - first):
        i = np.uint64(first) + np.uint64(k)  # of a signed number it would be asked whether it counts from the end
        dx, dy, dz = fx[i] - px, fy[i] - py, fz[i] - pz
        turned = f4(1) - (nx[i] * ox + ny[i] * oy + nz[i] * oz)
        far = (dx * dx + dy * dy + dz * dz + f4(_TURNED * 0.5) * turned) * f4(_PER_M2)
        best = min(best, i4(i4(i4(min(far, f4(_MOST))) << i4(11)) | i4(i)))
    return best


@kernel
def _nearest_face(vertices, ring, first, last, a, qx, qy, qz):
    """Which of the faces first to last of the ring around vertex a holds the place nearest to q, which is relative to
    a: its number and the shares of its two other corners there. It is one of the two beside the edge that is nearest
    to q."""
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    nearest, edge = f4(1e9), first
    for k in range(first, last):
        b = ring[k, 0]
        x, y, z = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        along, length = x * qx + y * qy + z * qz, x * x + y * y + z * z
        t = min(max(along, f4(0)), length) / max(length, f4(1e-12))
        away = t * (t * length - f4(2) * along)
        if away < nearest:
            nearest, edge = away, k
    side, u, v, nearest = edge, f4(0), f4(0), f4(1e9)
    for k in range(first, last):
        if k != edge and ring[k, 1] != ring[edge, 0]:
            continue
        b, d = ring[k, 0], ring[k, 1]
        bx, by, bz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        dx, dy, dz = vertices[d, 0] - ax, vertices[d, 1] - ay, vertices[d, 2] - az
        s, t = closest_on_triangle(bx, by, bz, dx, dy, dz, qx, qy, qz)
        x, y, z = s * bx + t * dx - qx, s * by + t * dy - qy, s * bz + t * dz - qz
        away = x * x + y * y + z * z
        if away < nearest:
            nearest, side, u, v = away, k, s, t
    return side, u, v, nearest


@kernel
def _by_height(vertices, normals, ex, ey, ez, faces_it, place):
    """Which vertices face an eye, from low to high in bands of _BAND_M: faces_it (V,) i4; place (B + 1,): where each
    band begins; returns the height at which the first one does. All relative to the root."""
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
    """Appends the rows of n points of the surface to rows (M, 8) and joints (M,), as cpu_rows.form_rows does.

    corners (n, 3): vertices of which a point is a blend; found (n, 8) f4: their shares, direction of the residual,
    weight, residual."""
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
                at = first  # the corners of a face mostly hang on the same joints
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
def depth_rows(q, mesh, depth, factor, ws, kept, count):
    """Rows of depth maps, kept in ws.rows as `contour_rows` keeps its own; returns their cost. factor: of the scale.
    count[0] gets the rows of surface points, count[1] those of body before what was seen.

    A point of the surface is drawn to the nearest place on the body among what faces its sensor and looks about as it
    does: 1/2 w e^2 / (1 + e^2), e = distance / scale (Geman & McClure 1985). A vertex that faces the sensor and lies
    nearer to it than what was seen in its pixel is pushed back along the optical axis, with the same loss. Which place
    is nearest is held fixed in the derivatives."""
    vertices = ws.vertices
    n_vertices = vertices.shape[0]
    normals = np.empty((n_vertices, 3), np.float32)
    vertex_normals(vertices, mesh.faces, normals)
    room = (n_vertices + 15) // 16 * 16
    fx, fy, fz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    nx, ny, nz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    which, place = np.empty(room, np.int32), np.empty(_BANDS + 1, np.int64)
    most = depth.points.shape[0] + n_vertices
    corners, found = np.empty((most, 3), np.int32), np.empty((most, 8), np.float32)
    cost = 0.0
    scale = depth.scale * factor
    i2, free_i2 = 1.0 / (scale * scale), 1.0 / (depth.free_scale * depth.free_scale)
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
            w = depth.weight[m]
            px, py, pz = f4(depth.points[m, 0] - q[0]), f4(depth.points[m, 1] - q[1]), f4(depth.points[m, 2] - q[2])
            ox, oy, oz = f4(depth.normals[m, 0]), f4(depth.normals[m, 1]), f4(depth.normals[m, 2])
            band = int(math.floor((pz - low) * f4(1 / _BAND_M)))
            best = i4(2147483647)
            for reach in range(1, _REACH + 1):
                if (best >> 11) < i4(_NEXT_BAND):  # all that was not looked at lies further off
                    break
                # whole vectors, for what is left of them takes as long
                begin = place[min(max(band - reach, 0), _BANDS)] // 8 * 8
                end = (place[min(max(band + reach + 1, 0), _BANDS)] + 7) // 8 * 8
                best = _nearest(fx, fy, fz, nx, ny, nz, begin, end, px, py, pz, ox, oy, oz)
            if (best >> 11) >= i4(_MOST) - 1:
                cost += 0.5 * w  # nothing near: it costs what it costs at infinite distance
                continue
            a = which[best & 2047]
            ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
            qx, qy, qz = px - ax, py - ay, pz - az
            begin, end = depth.ring_first[a], depth.ring_first[a + 1]
            side, u, v, nearest = _nearest_face(vertices, depth.ring, begin, end, a, qx, qy, qz)
            b, d = depth.ring[side, 0], depth.ring[side, 1]
            own = found[n_found]
            own[0], own[1], own[2] = f4(1) - u - v, u, v
            corners[n_found, 0], corners[n_found, 1], corners[n_found, 2] = a, b, d
            r = math.sqrt(nearest)
            dx = own[0] * ax + u * vertices[b, 0] + v * vertices[d, 0] - px
            dy = own[0] * ay + u * vertices[b, 1] + v * vertices[d, 1] - py
            dz = own[0] * az + u * vertices[b, 2] + v * vertices[d, 2] - pz
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
            n_found += 1
        count[0] += n_found
        # body before what was seen
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
            before = seen - away - depth.slack
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

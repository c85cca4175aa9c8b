"""numba: rows of depth maps: points of a surface against the body's, and body that stands where nothing does."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.solver.cpu_losses import geman_mcclure
from hypose.compute.solver.cpu_rows import add_row

f4, i4 = np.float32, np.int32
_PER_M2 = 4e6
"""units of a squared distance that is packed into 20 bits: half a millimetre squared, up to half a metre"""
_MOST = 1e6
_TURNED = 0.0036
"""m^2 by which a surface that looks the other way counts as further off, half of it at right angles"""
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
def closest_on_triangle(px, py, pz, a, b, c, share):
    """share (3,): weights of the corners a, b, c (3,) at the point of the triangle nearest to p. Source: Ericson 2005,
    Real-Time Collision Detection, section 5.1.5."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = px - a[0], py - a[1], pz - a[2]
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    s = t = f4(0)  # weights of b and c
    if d1 <= 0 and d2 <= 0:
        share[0], share[1], share[2] = 1, 0, 0
        return
    bpx, bpy, bpz = px - b[0], py - b[1], pz - b[2]
    d3, d4 = abx * bpx + aby * bpy + abz * bpz, acx * bpx + acy * bpy + acz * bpz
    cpx, cpy, cpz = px - c[0], py - c[1], pz - c[2]
    d5, d6 = abx * cpx + aby * cpy + abz * cpz, acx * cpx + acy * cpy + acz * cpz
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d3 >= 0 and d4 <= d3:
        s = f4(1)
    elif d6 >= 0 and d5 <= d6:
        t = f4(1)
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        s = d1 / (d1 - d3)
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        t = d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = f4(1) - t
    else:
        whole = va + vb + vc
        if whole > f4(1e-20):
            s, t = vb / whole, vc / whole
    share[0], share[1], share[2] = f4(1) - s - t, s, t


@kernel
def _nearest(fx, fy, fz, nx, ny, nz, whole, px, py, pz, ox, oy, oz):
    """The nearest of the first `whole` points to p, those with other normals than o counting as further off: squared
    distance and index packed into one integer, as in cpu_rows.nearest. Its own kernel, for all stays in single
    precision here."""
    best = i4(2147483647)
    for i in range(whole):
        dx, dy, dz = fx[i] - px, fy[i] - py, fz[i] - pz
        turned = f4(1) - (nx[i] * ox + ny[i] * oy + nz[i] * oz)
        far = (dx * dx + dy * dy + dz * dz + f4(_TURNED * 0.5) * turned) * f4(_PER_M2)
        best = min(best, i4(i4(i4(min(far, f4(_MOST))) << i4(11)) | i4(i)))
    return best


@kernel
def _spread_row(mesh, corners, share, w, r, px, py, pz, gx, gy, gz, joints, parts, hessian, gradient):
    """Adds the row of a skinned point, a blend of up to three vertices, to each joint that moves it."""
    n = 0
    for k in range(corners.shape[0]):
        if share[k] <= 0:
            continue
        v = corners[k]
        for m in range(mesh.skin_count[v]):
            j = mesh.skin_index[v, m]
            at = 0
            while at < n and joints[at] != j:
                at += 1
            if at == n:
                joints[n] = j
                parts[n] = 0.0
                n += 1
            parts[at] += share[k] * mesh.skin_weight[v, m]
    for k in range(n):
        add_row(hessian, gradient, joints[k], w * parts[k], r, px, py, pz, gx, gy, gz)


@kernel
def depth_rows(q, mesh, depth, factor, vertices, hessian, gradient, count):
    """Rows of depth maps; returns their cost. vertices (V, 3) f4 m about the root's position q[:3]; factor: of the
    scale. count[0] gets the rows of surface points, count[1] those of body before what was seen.

    A point of the surface is drawn to the nearest place on the body among what faces its sensor and looks about as it
    does: 1/2 w e^2 / (1 + e^2), e = distance / scale (Geman & McClure 1985). A vertex that faces the sensor and lies
    nearer to it than what was seen in its pixel is pushed back along the optical axis, with the same loss. Which place
    is nearest is held fixed in the derivatives."""
    n_vertices = vertices.shape[0]
    normals = np.empty((n_vertices, 3), np.float32)
    vertex_normals(vertices, mesh.faces, normals)
    room = (n_vertices + 15) // 16 * 16
    fx, fy, fz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    nx, ny, nz = np.empty(room, np.float32), np.empty(room, np.float32), np.empty(room, np.float32)
    which = np.empty(room, np.int32)
    joints, parts = np.empty(16, np.int64), np.empty(16)
    share, best_share = np.empty(3, np.float32), np.empty(3, np.float32)
    one, own = np.ones(1, np.float32), np.empty(1, np.int32)
    cost = 0.0
    scale = depth.scale * factor
    i2, free_i2 = 1.0 / (scale * scale), 1.0 / (depth.free_scale * depth.free_scale)
    for c in range(depth.eyes.shape[0]):
        first, last = depth.first[c], depth.first[c + 1]
        if last <= first:
            continue
        ex, ey, ez = f4(depth.eyes[c, 0] - q[0]), f4(depth.eyes[c, 1] - q[1]), f4(depth.eyes[c, 2] - q[2])
        n = 0
        for v in range(n_vertices):
            x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
            if normals[v, 0] * (ex - x) + normals[v, 1] * (ey - y) + normals[v, 2] * (ez - z) > f4(0):
                fx[n], fy[n], fz[n] = x, y, z
                nx[n], ny[n], nz[n] = normals[v, 0], normals[v, 1], normals[v, 2]
                which[n] = v
                n += 1
        if n == 0:
            cost += 0.5 * depth.weight[first:last].sum()
            continue
        whole = (n + 15) // 16 * 16
        for i in range(n, whole):
            fx[i], fy[i], fz[i] = f4(1e3), f4(1e3), f4(1e3)
            nx[i], ny[i], nz[i] = f4(0), f4(0), f4(0)
        for m in range(first, last):
            w = depth.weight[m]
            px, py, pz = f4(depth.points[m, 0] - q[0]), f4(depth.points[m, 1] - q[1]), f4(depth.points[m, 2] - q[2])
            ox, oy, oz = f4(depth.normals[m, 0]), f4(depth.normals[m, 1]), f4(depth.normals[m, 2])
            best = _nearest(fx, fy, fz, nx, ny, nz, whole, px, py, pz, ox, oy, oz)
            if (best >> 11) >= i4(_MOST) - 1:
                cost += 0.5 * w  # nothing near: it costs what it costs at infinite distance
                continue
            at = which[best & 2047]
            nearest = f4(1e9)
            face = -1
            for k in range(depth.face_first[at], depth.face_first[at + 1]):
                f = depth.face_of[k]
                corner = mesh.faces[f]
                a, b, d = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
                closest_on_triangle(px, py, pz, a, b, d, share)
                dx = share[0] * a[0] + share[1] * b[0] + share[2] * d[0] - px
                dy = share[0] * a[1] + share[1] * b[1] + share[2] * d[1] - py
                dz = share[0] * a[2] + share[1] * b[2] + share[2] * d[2] - pz
                away = dx * dx + dy * dy + dz * dz
                if away < nearest:
                    nearest, face = away, f
                    best_share[0], best_share[1], best_share[2] = share[0], share[1], share[2]
            corner = mesh.faces[face]
            x = y = z = f4(0)
            gx = gy = gz = f4(0)
            for k in range(3):
                v = corner[k]
                x += best_share[k] * vertices[v, 0]
                y += best_share[k] * vertices[v, 1]
                z += best_share[k] * vertices[v, 2]
                gx += best_share[k] * normals[v, 0]
                gy += best_share[k] * normals[v, 1]
                gz += best_share[k] * normals[v, 2]
            dx, dy, dz = x - px, y - py, z - pz
            r = math.sqrt(nearest)
            if r > f4(_ON_SURFACE):
                gx, gy, gz = dx / r, dy / r, dz / r
            else:
                length = math.sqrt(gx * gx + gy * gy + gz * gz)
                gx, gy, gz = gx / length, gy / length, gz / length
                r = gx * dx + gy * dy + gz * dz
            rho, slope, _ = geman_mcclure(r * r * i2, w * i2, 1.0)
            cost += 0.5 * w * rho
            _spread_row(mesh, corner, best_share, slope, r, x, y, z, gx, gy, gz, joints, parts, hessian, gradient)
            count[0] += 1
        # body before what was seen
        p = depth.projections[c]
        ax, ay, az = p[2, 0], p[2, 1], p[2, 2]
        h, width = depth.sizes[c, 1], depth.sizes[c, 0]
        free = depth.free_weight * (last - first) / n
        for i in range(n):
            x, y, z = fx[i] + q[0], fy[i] + q[1], fz[i] + q[2]
            away = ax * x + ay * y + az * z + p[2, 3]
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
            own[0] = which[i]
            _spread_row(
                mesh, own, one, slope, before, fx[i], fy[i], fz[i], -ax, -ay, -az, joints, parts, hessian, gradient
            )
            count[1] += 1
    return cost

"""numba: how far posed bodies lie from what depth cameras saw, by drawing them."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import camera_about_root, joint_frames

f4 = np.float32
_FAR = f4(1e9)


@kernel(inline=True)
def _off(own, other, most):
    """What a pixel costs where the body lies at own and was seen at other, 0 where only one of both is."""
    if other > f4(0) and own < _FAR:
        return min(abs(own - other), most)
    return f4(0)


@kernel
def _draw(faces, chosen, u, v, z, seen, most, depth, touched, count):
    """Draws the chosen faces that look at the camera into depth (h, w) f4 m, the nearest counts; returns by how much
    the cost of the picture against seen (h, w) has grown. Pixels that change are noted in touched, count[0] of them.
    Distances are taken as a plane over the picture, which over a face of a body differs from the truth by less than
    noise."""
    h, w = depth.shape
    grown = 0.0
    n = count[0]
    for k in range(chosen.shape[0]):
        f = chosen[k]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        # seen from outside; what lies behind the camera has been given no picture
        if not area < f4(0) or z[a] < f4(0.05) or z[b] < f4(0.05) or z[c] < f4(0.05):
            continue
        x0 = max(0, int(np.ceil(min(xa, min(xb, xc)))))
        x1 = min(w - 1, int(np.floor(max(xa, max(xb, xc)))))
        y0 = max(0, int(np.ceil(min(ya, min(yb, yc)))))
        y1 = min(h - 1, int(np.floor(max(ya, max(yb, yc)))))
        if x0 > x1 or y0 > y1:
            continue
        inverse = f4(1) / area
        bx, by = (yc - ya) * inverse, -(xc - xa) * inverse
        cx, cy = -(yb - ya) * inverse, (xb - xa) * inverse
        zb, zc = z[b] - z[a], z[c] - z[a]
        for y in range(y0, y1 + 1):
            dx, dy = f4(x0) - xa, f4(y) - ya
            kb, kc = dx * bx + dy * by, dx * cx + dy * cy
            row = depth[y]
            for x in range(x0, x1 + 1):
                if kb >= f4(-1e-5) and kc >= f4(-1e-5) and kb + kc <= f4(1.00001):
                    own = z[a] + kb * zb + kc * zc
                    if own < row[x]:
                        grown += _off(own, seen[y, x], most) - _off(row[x], seen[y, x], most)
                        row[x] = own
                        if n < touched.shape[0]:
                            touched[n] = y * w + x
                        n += 1
                kb += bx
                kc += cx
    count[0] = n
    return grown


@kernel
def _skin(rotations, centres, tree, mesh, chosen, vertices):
    """The chosen vertices about the root's position: linear blend skinning in float32."""
    n_joints = rotations.shape[0]
    maps = np.empty((n_joints, 12), np.float32)
    for j in range(n_joints):
        r = rotations[j]
        x, y, z = tree.joints[j, 0], tree.joints[j, 1], tree.joints[j, 2]
        for i in range(3):
            maps[j, 4 * i] = r[i, 0]
            maps[j, 4 * i + 1] = r[i, 1]
            maps[j, 4 * i + 2] = r[i, 2]
            maps[j, 4 * i + 3] = centres[j, i] - r[i, 0] * x - r[i, 1] * y - r[i, 2] * z
    for k in range(chosen.shape[0]):
        v = chosen[k]
        x, y, z = mesh.vertices[v, 0], mesh.vertices[v, 1], mesh.vertices[v, 2]
        px = py = pz = f4(0)
        for m in range(mesh.skin_count[v]):
            b, w = maps[mesh.skin_index[v, m]], mesh.skin_weight[v, m]
            px += w * (b[0] * x + b[1] * y + b[2] * z + b[3])
            py += w * (b[4] * x + b[5] * y + b[6] * z + b[7])
            pz += w * (b[8] * x + b[9] * y + b[10] * z + b[11])
        vertices[v, 0], vertices[v, 1], vertices[v, 2] = px, py, pz


@kernel
def _project(projection, q, vertices, chosen, u, v, z):
    """Pixels and distances of the chosen vertices, which are about the root of pose q."""
    p = np.empty((3, 4), np.float32)
    camera_about_root(projection, q, p)
    for k in range(chosen.shape[0]):
        i = chosen[k]
        x, y, d = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        away = p[2, 0] * x + p[2, 1] * y + p[2, 2] * d + p[2, 3]
        inverse = f4(1) / max(away, f4(0.05))
        z[i] = away
        u[i] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * d + p[0, 3]) * inverse
        v[i] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * d + p[1, 3]) * inverse


@kernel
def energies(poses, first, last, tree, mesh, moving, moved, still, stood, seen, projections, sizes, most, out):
    """out (N, C): cost of the drawn poses (N, D), of which first to last are done, against seen (C, h, w) f4: sum of
    `_off`, over most. moving: faces that differ from pose to pose, and moved: their vertices; still, stood: the
    others, which stand as in the last pose."""
    n_vertices, n_joints = mesh.vertices.shape[0], tree.parents.shape[0]
    rotations, centres = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3))
    twists = np.empty((poses.shape[1], 6))
    vertices = np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    n_views, h, w = seen.shape
    standing = np.full(seen.shape, _FAR, np.float32)
    cost = np.zeros(n_views)
    touched = np.empty(8 * h * w, np.int64)
    count = np.zeros(1, np.int64)
    if still.shape[0] > 0:
        q = poses[poses.shape[0] - 1]
        joint_frames(q, tree, rotations, centres, twists)
        _skin(rotations, centres, tree, mesh, stood, vertices)
        for c in range(n_views):
            _project(projections[c], q, vertices, stood, u, v, z)
            part = standing[c, : sizes[c, 1], : sizes[c, 0]]
            count[0] = touched.shape[0]  # nobody takes it back
            cost[c] = _draw(mesh.faces, still, u, v, z, seen[c], most, part, touched, count)
    drawn = standing.copy()
    for n in range(first, last):
        joint_frames(poses[n], tree, rotations, centres, twists)
        _skin(rotations, centres, tree, mesh, moved, vertices)
        for c in range(n_views):
            _project(projections[c], poses[n], vertices, moved, u, v, z)
            width = sizes[c, 0]
            part = drawn[c, : sizes[c, 1], :width]
            count[0] = 0
            out[n, c] = cost[c] + _draw(mesh.faces, moving, u, v, z, seen[c], most, part, touched, count)
            out[n, c] /= most
            if count[0] <= touched.shape[0]:
                for k in range(count[0]):
                    y, x = touched[k] // width, touched[k] % width
                    part[y, x] = standing[c, y, x]
            else:
                for y in range(sizes[c, 1]):
                    for x in range(width):
                        part[y, x] = standing[c, y, x]

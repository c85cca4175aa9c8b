"""numba: how far posed bodies lie from what depth cameras saw, by drawing them."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.arrays import BALL
from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import (
    bone_map,
    camera_about_root,
    joint_frames,
    multiply,
    skin_about_root,
    so3_exp,
)

f4 = np.float32
_FAR = f4(1e9)


@kernel(inline=True)
def _off(own, other, most):
    """What a pixel costs where the body lies at own and was seen at other, 0 where only one of both is."""
    if other > f4(0) and own < _FAR:
        return min(abs(own - other), most)
    return f4(0)


@kernel
def _draw(faces, chosen, u, v, z, seen, most, depth, size, touched, count):
    """Draws the chosen faces that look at the camera into depth (h, w) f4 m, of which size (2,) = width and height are
    used; the nearest counts. Returns by how much the cost of the picture against seen (h, w) has grown. Pixels that
    change are noted in touched, count[0] of them. Distances are taken as a plane over the picture, which over a face of
    a body differs from the truth by less than noise."""
    w, h = size[0], size[1]
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
def _roughly(faces, chosen, u, v, z, seen, most, standing, width, height):
    """About what `_draw` says of the chosen faces before what stands (h, w) f4 m: each as one thing at its middle, as
    large as its area, whatever lies before it."""
    grown = f4(0)
    third, half = f4(1 / 3), f4(0.5)
    for k in range(chosen.shape[0]):
        f = chosen[k]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        twice = (xc - xa) * (yb - ya) - (xb - xa) * (yc - ya)
        if not twice > f4(0) or z[a] < f4(0.05) or z[b] < f4(0.05) or z[c] < f4(0.05):
            continue
        left, top = (xa + xb + xc) * third + half, (ya + yb + yc) * third + half
        if not (left >= f4(0) and top >= f4(0) and left < f4(width) and top < f4(height)):
            continue
        x, y = int(left), int(top)
        own, before = (z[a] + z[b] + z[c]) * third, standing[y, x]
        if own < before:
            grown += half * twice * (_off(own, seen[y, x], most) - _off(before, seen[y, x], most))
    return grown


@kernel
def _turned(q, tree, joints, rotations, centres):
    """The frames of some joints, in the tree's order, at pose q (D,), where those of all others are known: as
    `joint_frames`, without the twists."""
    local, frame = np.empty((3, 3)), np.empty((3, 3))
    for n in range(joints.shape[0]):
        j = joints[n]
        a = tree.parents[j]
        r = rotations[a]
        for i in range(3):
            centres[j, i] = centres[a, i]
            for k in range(3):
                centres[j, i] += r[i, k] * (tree.joints[j, k] - tree.joints[a, k])
                frame[i, k] = r[i, k]
        first = tree.dof_start[j]
        if tree.kind[j] == BALL:
            so3_exp(q[first], q[first + 1], q[first + 2], local)
            multiply(frame, local, rotations[j])
            continue
        for m in range(tree.dof_count[j]):
            d = first + m
            so3_exp(q[d] * tree.axes[d, 0], q[d] * tree.axes[d, 1], q[d] * tree.axes[d, 2], local)
            multiply(frame, local, rotations[j])
            for i in range(3):
                for k in range(3):
                    frame[i, k] = rotations[j, i, k]
        for i in range(3):
            for k in range(3):
                rotations[j, i, k] = frame[i, k]


@kernel
def _skin(maps, mesh, chosen, vertices):
    """The chosen vertices about the root's position: linear blend skinning in float32."""
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
def _project(p, vertices, chosen, u, v, z):
    """Pixels and distances of the chosen vertices under a camera p (3, 4) f4 about the root."""
    for k in range(chosen.shape[0]):
        i = chosen[k]
        x, y, d = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        away = p[2, 0] * x + p[2, 1] * y + p[2, 2] * d + p[2, 3]
        inverse = f4(1) / max(away, f4(0.05))
        z[i] = away
        u[i] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * d + p[0, 3]) * inverse
        v[i] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * d + p[1, 3]) * inverse


@kernel
def energies(poses, first, last, tree, mesh, seen, projections, sizes, most, out):
    """out (N, C): cost of the drawn poses (N, D), of which first to last are done, against seen (C, h, w) f4: sum of
    `_off`, over most."""
    every, drawn = np.arange(mesh.faces.shape[0]), np.empty(seen.shape, np.float32)
    rotations, centres = np.empty((tree.parents.shape[0], 3, 3)), np.empty((tree.parents.shape[0], 3))
    for n in range(first, last):
        stand(poses[n], tree, mesh, every, seen, projections, sizes, most, rotations, centres, drawn, out[n])


@kernel
def stand(q, tree, mesh, faces, seen, projections, sizes, most, rotations, centres, drawn, cost):
    """drawn (C, h, w) f4: some faces of the body at pose q (D,), whose frames are rotations (J, 3, 3) and centres
    (J, 3); cost (C,): theirs against seen (C, h, w) f4, over most. All overwritten."""
    n_vertices = mesh.vertices.shape[0]
    every, vertices = np.arange(n_vertices), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    nothing, count, p = np.empty(0, np.int64), np.zeros(1, np.int64), np.empty((3, 4), np.float32)
    joint_frames(q, tree, rotations, centres, np.empty((q.shape[0], 6)))
    skin_about_root(rotations, centres, tree, mesh, vertices)
    drawn[:] = _FAR
    for c in range(seen.shape[0]):
        camera_about_root(projections[c], q, p)
        _project(p, vertices, every, u, v, z)
        cost[c] = _draw(mesh.faces, faces, u, v, z, seen[c], most, drawn[c], sizes[c], nothing, count) / most


@kernel
def limb_energies(poses, first, last, tree, mesh, standing, seen, projections, sizes, most, rough, out):
    """out (N, C): as `energies`, of poses that differ in a limb alone from what stands. rough: `_roughly`."""
    joints, moving, moved = standing.joints, standing.faces, standing.vertices
    n_vertices = mesh.vertices.shape[0]
    rotations, centres, drawn = standing.rotations.copy(), standing.centres.copy(), standing.drawn
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    p = np.empty((seen.shape[0], 3, 4), np.float32)
    for c in range(seen.shape[0]):
        camera_about_root(projections[c], standing.pose, p[c])
    for j in range(tree.parents.shape[0]):
        bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
    touched, count = np.empty(0 if rough else 8 * seen.shape[1] * seen.shape[2], np.int64), np.zeros(1, np.int64)
    if not rough:
        drawn = drawn.copy()
    for n in range(first, last):
        _turned(poses[n], tree, joints, rotations, centres)
        for k in range(joints.shape[0]):
            j = joints[k]
            bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
        _skin(maps, mesh, moved, vertices)
        for c in range(seen.shape[0]):
            _project(p[c], vertices, moved, u, v, z)
            width, height = sizes[c, 0], sizes[c, 1]
            if rough:
                grown = _roughly(mesh.faces, moving, u, v, z, seen[c], most, drawn[c], width, height)
                out[n, c] = standing.cost[c] + grown / most
                continue
            count[0] = 0
            grown = _draw(mesh.faces, moving, u, v, z, seen[c], most, drawn[c], sizes[c], touched, count)
            out[n, c] = standing.cost[c] + grown / most
            if count[0] <= touched.shape[0]:
                for k in range(count[0]):
                    y, x = touched[k] // width, touched[k] % width
                    drawn[c, y, x] = standing.drawn[c, y, x]
            else:
                for y in range(height):
                    for x in range(width):
                        drawn[c, y, x] = standing.drawn[c, y, x]


@kernel
def limb_shown(tree, mesh, standing, seen, projections, sizes, centre, reach, apart, out):
    """out (C, 3), zero, of the limb that was left out of what stands, in the pose that this was drawn at, in m^2 at the
    distance of a centre (3,), from the root: what of it is in sight; what of that lies within `apart` m of what the
    sensor saw; and what the sensor saw, no further than `reach` m from the centre, that lies more than `apart` before
    all of the body, or beside it."""
    n_vertices = mesh.vertices.shape[0]
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    nothing, count, p = np.empty(0, np.int64), np.zeros(1, np.int64), np.empty((3, 4), np.float32)
    for j in range(tree.parents.shape[0]):
        bone_map(standing.rotations[j], standing.centres[j], tree.joints[j], maps[j])
    _skin(maps, mesh, standing.vertices, vertices)
    for c in range(seen.shape[0]):
        whole, width, height = standing.drawn[c].copy(), sizes[c, 0], sizes[c, 1]
        camera_about_root(projections[c], standing.pose, p)
        _project(p, vertices, standing.vertices, u, v, z)
        _draw(mesh.faces, standing.faces, u, v, z, seen[c], apart, whole, sizes[c], nothing, count)
        away = p[2, 0] * centre[0] + p[2, 1] * centre[1] + p[2, 2] * centre[2] + p[2, 3]
        across = p[0, 0] * centre[0] + p[0, 1] * centre[1] + p[0, 2] * centre[2] + p[0, 3]
        down = p[1, 0] * centre[0] + p[1, 1] * centre[1] + p[1, 2] * centre[2] + p[1, 3]
        away = max(away, 0.05)
        left, top = across / away, down / away
        beside = p[0, 0] * p[2, 0] + p[0, 1] * p[2, 1] + p[0, 2] * p[2, 2]  # the last row has unit length
        squared = p[0, 0] * p[0, 0] + p[0, 1] * p[0, 1] + p[0, 2] * p[0, 2] - beside * beside
        metre = math.sqrt(squared) / away
        within = reach * reach * metre * metre
        for y in range(height):
            for x in range(width):
                other = seen[c, y, x]
                if whole[y, x] < standing.drawn[c, y, x]:
                    out[c, 0] += 1
                    out[c, 1] += other > f4(0) and abs(whole[y, x] - other) < apart
                dx, dy = x - left, y - top
                if other > f4(0) and whole[y, x] - other > apart and dx * dx + dy * dy < within:
                    out[c, 2] += 1
        for k in range(3):
            out[c, k] /= metre * metre

"""numba: rows of monocular evidence and their sums.

A row is a point of the body (a blend of up to three vertices), a direction in space along which the cost is
differentiated, and the first and second derivative of the cost along it. Rows of all cues wait in one table and are
summed in one call: J^T first and J^T second J, with the exact derivative of linear blend skinning. The chain of joints
is walked by wrenches: a vertex v carried by joint j adds w (x_j cross d, d) to j, sums run up the tree, and the
derivative along a dof is its twist times the sum at its joint.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.monocular.mono_terms import GAUSSIAN, LORENTZIAN
from hypose.compute.solver.cpu_losses import along, leclerc, lorentzian, quadratic

f4 = np.float32
SHARE = 0.1
"""least second derivative along a residual, as a share of that without rho''"""


@kernel
def robust(form, s, sigma2):
    """rho(s) and its first and second derivative for height 1: equations (2) and (3) of Sminchisescu & Triggs 2001,
    and s / sigma^2 for the Gaussian."""
    t, gain = s / sigma2, 1 / sigma2
    if form == GAUSSIAN:
        value, first, second = quadratic(t, gain)
    elif form == LORENTZIAN:
        value, first, second = lorentzian(t, gain)
    else:
        value, first, second = leclerc(t, gain)
    return value, first, second * gain


@kernel
def curvature(first, second, s, second_order):
    """Second derivative of rho(s) / 2 along the residual, rho' + 2 rho'' s of equation (9), kept positive: far from
    the peak it is negative and a Newton step would climb."""
    if not second_order:
        return first
    return max(along(first, second, s), SHARE * first)


@kernel
def sum_vertex_rows(n, model, ws, hessian, gradient):
    """hessian (A, A), gradient (A,) += n rows of ws; of the hessian either [i, k] or [k, i] gets a pair's sum."""
    tree, mesh, slot = model.tree, model.mesh, model.slot
    joints, rotations, centres, twists = tree.joints, ws.rotations, ws.centres, ws.twists
    vertices, index, weight, carriers = mesh.vertices, mesh.skin_index, mesh.skin_weight, mesh.skin_count
    rows, values, wrench, marked = ws.row_vertices, ws.row_values, ws.wrench, ws.marked
    columns, entries = np.empty(gradient.shape[0], np.int64), np.empty(gradient.shape[0])
    for r in range(n):
        dx, dy, dz = values[r, 3], values[r, 4], values[r, 5]
        for i in range(3):
            v = rows[r, i]
            if v < 0:
                continue
            for k in range(carriers[v]):
                j = index[v, k]
                w = values[r, i] * weight[v, k]
                ox, oy, oz = vertices[v, 0] - joints[j, 0], vertices[v, 1] - joints[j, 1], vertices[v, 2] - joints[j, 2]
                x = centres[j, 0] + rotations[j, 0, 0] * ox + rotations[j, 0, 1] * oy + rotations[j, 0, 2] * oz
                y = centres[j, 1] + rotations[j, 1, 0] * ox + rotations[j, 1, 1] * oy + rotations[j, 1, 2] * oz
                z = centres[j, 2] + rotations[j, 2, 0] * ox + rotations[j, 2, 1] * oy + rotations[j, 2, 2] * oz
                wrench[j, 0] += w * (y * dz - z * dy)
                wrench[j, 1] += w * (z * dx - x * dz)
                wrench[j, 2] += w * (x * dy - y * dx)
                wrench[j, 3] += w * dx
                wrench[j, 4] += w * dy
                wrench[j, 5] += w * dz
                marked[j] = 1
        m = climb(tree, slot, twists, wrench, marked, columns, entries)
        spread(m, columns, entries, values[r, 6], values[r, 7], hessian, gradient)


@kernel
def climb(tree, slot, twists, wrench, marked, columns, entries):
    """Wrenches at marked joints -> the m non-zero entries of a row over the active dof; wrench and marks are cleared.
    Returns m."""
    parents, start, count = tree.parents, tree.dof_start, tree.dof_count
    m = 0
    for j in range(parents.shape[0] - 1, -1, -1):
        if marked[j] == 0:
            continue
        marked[j] = 0
        first, last = start[j], start[j] + count[j]
        if j == 0:
            first = 0
        for d in range(first, last):
            if slot[d] >= 0:
                s = 0.0
                for k in range(6):
                    s += twists[d, k] * wrench[j, k]
                columns[m], entries[m] = slot[d], s
                m += 1
        a = parents[j]
        if a >= 0:
            marked[a] = 1
            for k in range(6):
                wrench[a, k] += wrench[j, k]
        for k in range(6):
            wrench[j, k] = 0.0
    return m


@kernel
def spread(m, columns, entries, first, second, hessian, gradient):
    """gradient += first J, hessian += second J^T J for a row of m entries."""
    for i in range(m):
        e = entries[i]
        gradient[columns[i]] += first * e
        h = hessian[columns[i]]
        e *= second
        for k in range(i + 1):
            h[columns[k]] += e * entries[k]


@kernel
def mark_terms(q, model, marks, second_order, ws, hessian, gradient):
    """2D points: cost 1/2 weight nu rho(|residual|^2) with nu = sigma^2, so that it is a squared residual in standard
    deviations near zero; a point behind the camera costs what 1000 px cost."""
    p = model.projection
    columns, entries = np.empty(gradient.shape[0], np.int64), np.empty(gradient.shape[0])
    tree = model.tree
    cost = 0.0
    for m in range(marks.joint.shape[0]):
        w = marks.weight[m]
        if not w > 0:
            continue
        j = marks.joint[m]
        scale2 = marks.scale[m] * marks.scale[m]
        # a Lorentzian tail that starts at 2 sd, as for key points elsewhere
        sigma2 = 4.0 * scale2
        w *= 4.0
        o, r = marks.offset[m], ws.rotations[j]
        x = ws.centres[j, 0] + r[0, 0] * o[0] + r[0, 1] * o[1] + r[0, 2] * o[2]
        y = ws.centres[j, 1] + r[1, 0] * o[0] + r[1, 1] * o[1] + r[1, 2] * o[2]
        z = ws.centres[j, 2] + r[2, 0] * o[0] + r[2, 1] * o[1] + r[2, 2] * o[2]
        gx, gy, gz = x + q[0], y + q[1], z + q[2]
        depth = p[2, 0] * gx + p[2, 1] * gy + p[2, 2] * gz + p[2, 3]
        if depth < 0.05:
            cost += 0.5 * w * robust(marks.form, 1e6, sigma2)[0]
            continue
        iz = 1 / depth
        u = (p[0, 0] * gx + p[0, 1] * gy + p[0, 2] * gz + p[0, 3]) * iz
        v = (p[1, 0] * gx + p[1, 1] * gy + p[1, 2] * gz + p[1, 3]) * iz
        du, dv = u - marks.pixels[m, 0], v - marks.pixels[m, 1]
        s = du * du + dv * dv
        value, first, second = robust(marks.form, s, sigma2)
        cost += 0.5 * w * value
        length = math.sqrt(s)
        nx, ny = (du / length, dv / length) if length > 1e-9 else (1.0, 0.0)
        for k in range(2):
            if k == 1:
                nx, ny = -ny, nx
            dx = (nx * (p[0, 0] - u * p[2, 0]) + ny * (p[1, 0] - v * p[2, 0])) * iz
            dy = (nx * (p[0, 1] - u * p[2, 1]) + ny * (p[1, 1] - v * p[2, 1])) * iz
            dz = (nx * (p[0, 2] - u * p[2, 2]) + ny * (p[1, 2] - v * p[2, 2])) * iz
            wrench = ws.wrench[j]
            wrench[0], wrench[1], wrench[2] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
            wrench[3], wrench[4], wrench[5] = dx, dy, dz
            ws.marked[j] = 1
            n = climb(tree, model.slot, ws.twists, ws.wrench, ws.marked, columns, entries)
            slope = w * first * length if k == 0 else 0.0
            bend = w * (curvature(first, second, s, second_order) if k == 0 else first)
            spread(n, columns, entries, slope, bend, hessian, gradient)
    return cost


@kernel
def sphere_terms(model, spheres, ws, hessian, gradient):
    """Interpenetration: 1/2 weight (apart - distance)^2 for pairs of spheres that are too near."""
    tree = model.tree
    columns, entries = np.empty(gradient.shape[0], np.int64), np.empty(gradient.shape[0])
    at = np.empty((spheres.joint.shape[0], 3))
    for i in range(at.shape[0]):
        j = spheres.joint[i]
        o, r = spheres.offset[i], ws.rotations[j]
        for k in range(3):
            at[i, k] = ws.centres[j, k] + r[k, 0] * o[0] + r[k, 1] * o[1] + r[k, 2] * o[2]
    cost = 0.0
    for n in range(spheres.pairs.shape[0]):
        a, b = spheres.pairs[n, 0], spheres.pairs[n, 1]
        dx, dy, dz = at[a, 0] - at[b, 0], at[a, 1] - at[b, 1], at[a, 2] - at[b, 2]
        d2 = dx * dx + dy * dy + dz * dz
        if d2 >= spheres.apart[n] * spheres.apart[n] or d2 < 1e-8:
            continue
        d = math.sqrt(d2)
        short = spheres.apart[n] - d
        cost += 0.5 * spheres.weight * short * short
        for k in range(2):
            i, sign = (a, 1 / d) if k == 0 else (b, -1 / d)
            j = spheres.joint[i]
            x, y, z, wrench = at[i, 0], at[i, 1], at[i, 2], ws.wrench[j]
            gx, gy, gz = sign * dx, sign * dy, sign * dz
            wrench[0] += y * gz - z * gy
            wrench[1] += z * gx - x * gz
            wrench[2] += x * gy - y * gx
            wrench[3] += gx
            wrench[4] += gy
            wrench[5] += gz
            ws.marked[j] = 1
        m = climb(tree, model.slot, ws.twists, ws.wrench, ws.marked, columns, entries)
        spread(m, columns, entries, -spheres.weight * short, spheres.weight, hessian, gradient)
    return cost


@kernel
def floor_terms(q, model, floor, second_order, ws, hessian, gradient):
    """The lowest point of the soles stands on the floor, and none lies under it: cost as of a 2D point (a Lorentzian
    with its tail from 2 sd on, so that a jump costs little more than a step)."""
    if not floor.weight > 0:
        return 0.0
    columns, entries = np.empty(gradient.shape[0], np.int64), np.empty(gradient.shape[0])
    at = np.empty((floor.joint.shape[0], 3))
    lowest = 0
    for i in range(at.shape[0]):
        o, r = floor.offset[i], ws.rotations[floor.joint[i]]
        for k in range(3):
            at[i, k] = ws.centres[floor.joint[i], k] + r[k, 0] * o[0] + r[k, 1] * o[1] + r[k, 2] * o[2]
        if at[i, 2] < at[lowest, 2]:
            lowest = i
    cost, sigma2, w = 0.0, 4 * floor.scale * floor.scale, 4 * floor.weight
    for i in range(at.shape[0]):
        above = at[i, 2] + q[2] - floor.height
        if i != lowest and above >= 0:
            continue
        value, first, second = robust(LORENTZIAN, above * above, sigma2)
        cost += 0.5 * w * value
        wrench = ws.wrench[floor.joint[i]]
        wrench[0], wrench[1], wrench[5] = at[i, 1], -at[i, 0], 1.0
        ws.marked[floor.joint[i]] = 1
        m = climb(model.tree, model.slot, ws.twists, ws.wrench, ws.marked, columns, entries)
        bend = w * curvature(first, second, above * above, second_order)
        spread(m, columns, entries, w * first * above, bend, hessian, gradient)
    return cost

"""Rows of monocular evidence (edges, mask, flow, 2D points, spheres, floor), and their sums (kernels).

A row is a point of the body (a blend of up to three vertices), a direction in space, and the first and second
derivative of the cost along it. Rows of all cues are collected in one table and summed in one call: J^T first and J^T
second J, with the exact derivative of linear blend skinning. The chain of joints is handled by wrenches: a vertex v
carried by joint j adds w (x_j cross d, d) to j, sums run up the tree, and the derivative by a dof is its twist times
the sum at its joint.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.losses import along_kernel as along
from hypose.compute.losses import leclerc_kernel as leclerc
from hypose.compute.losses import lorentzian_kernel as lorentzian
from hypose.compute.losses import quadratic_kernel as quadratic
from hypose.compute.mono_nodes import bilinear
from hypose.compute.mono_terms import GAUSSIAN, LORENTZIAN

f4 = np.float32
_SHARE = 0.1
"""Least second derivative along a residual, as a share of that without rho''."""


@kernel
def robust(form, s, sigma2):
    """Compute rho(s) and its first and second derivative for height 1: equations (2) and (3) of Sminchisescu & Triggs
    2001, and s / sigma^2 for the Gaussian.

    form: GAUSSIAN, LORENTZIAN or LECLERC.
    """
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
    """Compute the second derivative of rho(s) / 2 along the residual, rho' + 2 rho'' s of equation (9) of
    Sminchisescu & Triggs 2001, kept positive.

    Why: far from the peak it is negative, and a Newton step would climb.
    """
    if not second_order:
        return first
    return max(along(first, second, s), _SHARE * first)


@kernel
def sum_vertex_rows(n, model, ws, hessian, gradient):
    """Add n rows of ws to hessian (A, A) and gradient (A,); of the hessian either [i, k] or [k, i] gets
    a pair's sum.
    """
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
    """Convert wrenches at marked joints to the non-zero entries of a row over the active dof; wrenches and marks are
    cleared.

    columns, entries: get the dof and the values.
    Returns: number of entries.
    """
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
    """Add a row of m entries: gradient += first J, hessian += second J^T J."""
    for i in range(m):
        e = entries[i]
        gradient[columns[i]] += first * e
        h = hessian[columns[i]]
        e *= second
        for k in range(i + 1):
            h[columns[k]] += e * entries[k]


@kernel
def mark_terms(q, model, marks, second_order, ws, hessian, gradient):
    """Compute the cost of 2D points: 1/2 weight nu rho(|residual|^2) with nu = sigma^2.

    Near zero it is a squared residual in standard deviations. A point behind the camera costs as much as at 1000 px.
    """
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
    """Compute the cost of interpenetration: 1/2 weight (apart - distance)^2 for pairs of spheres that are too near."""
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
    """Compute the cost of the floor: the lowest point of the soles stands on it, and no point lies under it.

    The loss is that of a 2D point: a Lorentzian with its tail from 2 sd on, so that a jump costs little more than a
    step.
    """
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


MOST_EDGES = 16
"""Largest number of edges kept in the window of one node."""


@kernel
def image_row(p, ws, r, u, v, depth, nx, ny, first, second):
    """Write direction and derivatives of row r: along (nx, ny) in the image, for a point seen at (u, v)."""
    values = ws.row_values[r]
    iz = 1 / depth
    values[3] = (nx * (p[0, 0] - u * p[2, 0]) + ny * (p[1, 0] - v * p[2, 0])) * iz
    values[4] = (nx * (p[0, 1] - u * p[2, 1]) + ny * (p[1, 1] - v * p[2, 1])) * iz
    values[5] = (nx * (p[0, 2] - u * p[2, 2]) + ny * (p[1, 2] - v * p[2, 2])) * iz
    values[6], values[7] = first, second


@kernel
def contour_row(p, ws, r, i, nx, ny, first, second):
    """Write row r of contour node i along (nx, ny)."""
    node = ws.nodes[i]
    a, b, t = ws.node_ends[i, 0], ws.node_ends[i, 1], node[0]
    ws.row_vertices[r, 0], ws.row_vertices[r, 1], ws.row_vertices[r, 2] = a, b, -1
    ws.row_values[r, 0], ws.row_values[r, 1], ws.row_values[r, 2] = 1 - t, t, 0.0
    depth = (1 - t) * ws.uvz[a, 2] + t * ws.uvz[b, 2]
    image_row(p, ws, r, node[1], node[2], depth, nx, ny, first, second)


@kernel
def line_search(field, x, y, nx, ny, window, threshold, energy, offset, strength):
    """Find all edges in the window along the normal: local maxima of the gradient's component along it.

    offset, strength: get their sub-pixel offset and strength (at most 1).
    energy: (2 window + 1,), scratch.
    Returns: number of edges.
    """
    h, w = field.shape[0], field.shape[1]
    for k in range(2 * window + 1):
        u, v = x + (k - window) * nx, y + (k - window) * ny
        u, v = min(max(u, 0.0), w - 1.001), min(max(v, 0.0), h - 1.001)
        i, j = int(u), int(v)
        a, b = f4(u - i), f4(v - j)
        top, bottom = field[j], field[j + 1]
        c00, c01, c10, c11 = (f4(1) - a) * (f4(1) - b), a * (f4(1) - b), (f4(1) - a) * b, a * b
        gx = c00 * top[i, 0] + c01 * top[i + 1, 0] + c10 * bottom[i, 0] + c11 * bottom[i + 1, 0]
        gy = c00 * top[i, 1] + c01 * top[i + 1, 1] + c10 * bottom[i, 1] + c11 * bottom[i + 1, 1]
        energy[k] = abs(gx * nx + gy * ny)
    m = 0
    for k in range(1, 2 * window):
        e, before, after = energy[k], energy[k - 1], energy[k + 1]
        if e > threshold and e >= before and e > after and m < MOST_EDGES:
            bend = before - 2 * e + after
            offset[m] = k - window + (0.5 * (before - after) / bend if abs(bend) > 1e-9 else 0.0)
            strength[m] = min(1.0, e)
            m += 1
    return m


@kernel
def edge_terms(n_nodes, problem, sigma, want, ws, n_rows):
    """Compute the cost of the contour nodes, over all edges of each node's window: equation (7) of
    Sminchisescu & Triggs 2001, first sum.

    want: whether to append rows.
    Returns: cost and number of rows.
    Deviations: a node's edges share the weight 1, less where they are weak in sum; the rest counts as unassigned, at
    the cost of the window's end. An occluded node costs k nu / 2, so that k is its share of the cost of a node without
    an edge. A node stands for its length of contour, and the sum is not divided by N nu of equation (6), so that it is
    a log-likelihood to which priors can be added. Back-facing nodes cost nothing, because their share of a closed
    surface hardly changes. The expected cost of a place without a body is subtracted for every node, because otherwise
    limbs would hide.
    """
    edges, p = problem.edges, problem.model.projection
    window, sigma2 = edges.window, sigma * sigma
    energy, offset, strength = np.empty(2 * window + 1), np.empty(MOST_EDGES), np.empty(MOST_EDGES)
    unassigned = robust(edges.form, float(window * window), sigma2)[0]
    cost = 0.0
    for i in range(n_nodes):
        node = ws.nodes[i]
        samples = edges.weight * edges.height * node[5] / edges.sample
        if node[6] == 0:
            cost += 0.5 * samples * (edges.occluded - edges.background) * unassigned
            ws.counts[3] += 1
            continue
        ws.counts[0] += 1
        nx, ny = node[3], node[4]
        m = line_search(edges.field, node[1], node[2], nx, ny, window, edges.threshold, energy, offset, strength)
        total = 0.0
        for k in range(m):
            total += strength[k]
        scale = 1 / max(1.0, total)
        value, first, second = (1 - total * scale) * unassigned, 0.0, 0.0
        for k in range(m):
            d, w = offset[k], strength[k] * scale
            s = d * d
            r0, r1, r2 = robust(edges.form, s, sigma2)
            value += w * r0
            first -= w * r1 * d
            second += w * curvature(r1, r2, s, problem.second_order)
        cost += 0.5 * samples * (value - edges.background * unassigned)
        if m > 0:
            ws.counts[1] += 1
            ws.counts[2] += m
            if want and n_rows < ws.row_values.shape[0]:
                contour_row(p, ws, n_rows, i, nx, ny, samples * first, samples * second)
                n_rows += 1
    return cost, n_rows


@kernel
def flow_terms(q, n_flow, problem, want, ws, n_rows):
    """Compute the cost of the distances of inner nodes from where the flow has carried them: equation (7) of
    Sminchisescu & Triggs 2001, second sum.

    Outliers of the flow have weight 0.
    """
    flow, p, second_order = problem.flow, problem.model.projection, problem.second_order
    sigma2 = flow.sigma * flow.sigma
    x, cost = ws.vertices, 0.0
    for i in range(n_flow):
        a, b, c = ws.flow_faces[i, 0], ws.flow_faces[i, 1], ws.flow_faces[i, 2]
        node = ws.flow_nodes[i]
        w1, w2 = node[0], node[1]
        w0 = 1 - w1 - w2
        gx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] + q[0]
        gy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] + q[1]
        gz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] + q[2]
        depth = p[2, 0] * gx + p[2, 1] * gy + p[2, 2] * gz + p[2, 3]
        weight = flow.height * node[4]
        if depth < 0.05:
            cost += 0.5 * weight * robust(flow.form, 1e6, sigma2)[0]
            continue
        u = (p[0, 0] * gx + p[0, 1] * gy + p[0, 2] * gz + p[0, 3]) / depth
        v = (p[1, 0] * gx + p[1, 1] * gy + p[1, 2] * gz + p[1, 3]) / depth
        du, dv = u - node[2], v - node[3]
        s = du * du + dv * dv
        value, first, second = robust(flow.form, s, sigma2)
        cost += 0.5 * weight * value
        if not want or n_rows + 2 > ws.row_values.shape[0]:
            continue
        length = math.sqrt(s)
        nx, ny = (du / length, dv / length) if length > 1e-9 else (1.0, 0.0)
        for k in range(2):
            # along the residual and across it: the eigenvectors of (9)'s bracket
            ws.row_vertices[n_rows, 0], ws.row_vertices[n_rows, 1], ws.row_vertices[n_rows, 2] = a, b, c
            ws.row_values[n_rows, 0], ws.row_values[n_rows, 1], ws.row_values[n_rows, 2] = w0, w1, w2
            if k == 0:
                bend = weight * curvature(first, second, s, second_order)
                image_row(p, ws, n_rows, u, v, depth, nx, ny, weight * first * length, bend)
            else:
                image_row(p, ws, n_rows, u, v, depth, -ny, nx, 0.0, weight * first)
            n_rows += 1
    return cost, n_rows


@kernel
def mask_terms(n_nodes, problem, want, ws, n_rows):
    """Compute the cost of the outer contour against a silhouette, in both directions.

    Nodes are compared with the distance to the mask's edge, and points of the mask's outline with the nearest node
    (along its normal), so that neither a small nor a large body is preferred.
    """
    mask, p = problem.mask, problem.model.projection
    h, w = mask.distance.shape
    if h < 3 or w < 3 or not mask.height > 0:
        return 0.0, n_rows
    sigma2, cost = mask.sigma * mask.sigma, 0.0
    outer = np.empty(n_nodes, np.int64)
    places = np.empty((2, n_nodes), np.float32)
    n = 0
    for i in range(n_nodes):
        node = ws.nodes[i]
        if node[6] == 0 or node[7] == 0:
            continue
        outer[n] = i
        places[0, n], places[1, n] = node[1], node[2]
        n += 1
        x, y = min(max(node[1], 1.0), w - 3.0), min(max(node[2], 1.0), h - 3.0)
        d = bilinear(mask.distance, x, y)
        gx = 0.5 * (bilinear(mask.distance, x + 1, y) - bilinear(mask.distance, x - 1, y))
        gy = 0.5 * (bilinear(mask.distance, x, y + 1) - bilinear(mask.distance, x, y - 1))
        slope = math.sqrt(gx * gx + gy * gy)
        weight = 0.5 * mask.height * node[5] / mask.sample
        value, first, second = robust(mask.form, d * d, sigma2)
        cost += 0.5 * weight * value
        if want and slope > 0.1 and n_rows < ws.row_values.shape[0]:
            bend = curvature(first, second, d * d, problem.second_order)
            contour_row(p, ws, n_rows, i, gx / slope, gy / slope, weight * first * d, weight * bend)
            n_rows += 1
    weight = 0.5 * mask.height * mask.outline_share / mask.sample
    for m in range(mask.outline.shape[0]):
        x, y = mask.outline[m, 0], mask.outline[m, 1]
        nearest, best = f4(1e12), -1
        for i in range(n):
            dx, dy = places[0, i] - x, places[1, i] - y
            d2 = dx * dx + dy * dy
            if d2 < nearest:
                nearest, best = d2, i
        if best < 0:
            cost += 0.5 * weight * robust(mask.form, 1e6, sigma2)[0]
            continue
        node = ws.nodes[outer[best]]
        d = node[3] * (node[1] - x) + node[4] * (node[2] - y)
        # the distance along the contour is that between nodes, unless there is no contour near
        aside = max(nearest - d * d - 100.0, 0.0)
        s = d * d + aside
        value, first, second = robust(mask.form, s, sigma2)
        cost += 0.5 * weight * value
        if want and n_rows < ws.row_values.shape[0]:
            bend = curvature(first, second, d * d, problem.second_order)
            contour_row(p, ws, n_rows, outer[best], node[3], node[4], weight * first * d, weight * bend)
            n_rows += 1
    return cost, n_rows

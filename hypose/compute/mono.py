"""Monocular tracking: the cost of a pose in one picture and its derivatives (kernels).

A row is a point of the body (a blend of up to three vertices, or a point on a joint), a direction in space, and the
first and second derivative of the cost along it. Rows of edges, mask and flow are collected in one table. The sum of
all rows is J^T first and J^T second J, with the exact derivative of linear blend skinning. Wrenches handle the chain of
joints: a vertex v carried by joint j adds w (x_j cross d, d) to j, sums run up the tree, and the derivative by a dof is
its twist times the sum at its joint. The search for the least cost is in hypose.tracking.monocular.problem.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays, plain
from hypose.compute.compiled import kernel
from hypose.compute.losses import along_kernel as along
from hypose.compute.losses import leclerc_kernel as leclerc
from hypose.compute.losses import lorentzian_kernel as lorentzian
from hypose.compute.losses import quadratic_kernel as quadratic
from hypose.compute.mono_nodes import bilinear, contour_nodes, draw_still, fill_depth, inner_nodes, pose_mesh
from hypose.compute.mono_terms import (
    GAUSSIAN,
    LORENTZIAN,
    CueSettings,
    EdgeArrays,
    EdgeSettings,
    FloorArrays,
    FlowArrays,
    FlowSettings,
    MarkArrays,
    MaskArrays,
    MonoModel,
    MonoPriors,
    MonoProblem,
    MonoWorkspace,
    SphereArrays,
)
from hypose.geometry import Array

MOST_NODES, MOST_INNER = 3000, 3000


def model(
    tree: TreeArrays, mesh: MeshArrays, moves: NDArray[np.bool_], active: ArrayLike, projection: Array
) -> MonoModel:
    """Make the model of the estimated degrees of freedom of a body.

    tree, mesh: of the body.
    moves: (D, J) which joints each dof carries.
    active: (A,) indices of the estimated dof.
    projection: (3, 4) pinhole.
    """
    dofs = np.array(active, dtype=np.int64)
    slot = np.full(len(tree.axes), -1, dtype=np.int64)
    slot[dofs] = np.arange(len(dofs))
    carried = moves[dofs].any(0)
    share = (mesh.skin_weight * carried[mesh.skin_index]).sum(1)
    moving = (share > 0.01)[mesh.faces].any(1)
    return MonoModel(
        tree,
        mesh,
        dofs,
        slot,
        np.flatnonzero(moving).astype(np.int32),
        np.flatnonzero(~moving).astype(np.int32),
        share > 0.5,
        plain(projection, np.float64),
    )


def workspace(m: MonoModel, height: int, width: int) -> MonoWorkspace:
    """Make scratch memory for pictures of (height, width); one per thread."""
    f4, i4 = np.float32, np.int32
    v, f, j, d = len(m.mesh.vertices), len(m.mesh.faces), len(m.tree.parents), len(m.tree.axes)
    rows = 2 * MOST_NODES + 2 * MOST_INNER
    return MonoWorkspace(
        np.zeros((j, 3, 3)),
        np.zeros((j, 3)),
        np.zeros((d, 6)),
        np.zeros((v, 3), f4),
        np.zeros((v, 3), f4),
        np.zeros(v, f4),
        np.zeros(f, np.uint8),
        np.zeros((height, width), f4),
        np.zeros((height, width), f4),
        np.zeros((MOST_NODES, 2), i4),
        np.zeros((MOST_NODES, 8)),
        np.zeros((MOST_INNER, 3), i4),
        np.zeros((MOST_INNER, 5)),
        np.zeros((rows, 3), i4),
        np.zeros((rows, 8)),
        np.zeros((j, 6)),
        np.zeros(j, np.uint8),
        np.zeros(len(m.active), np.int64),
        np.zeros(len(m.active)),
        np.zeros(7, np.int64),
    )


f4 = np.float32
_SHARE = 0.1
"""Least second derivative along a residual, as a share of that without rho''."""


@kernel
def robust(form, s, sigma2):
    """Compute rho(s) and its first and second derivative for height 1: equations (2) and (3) of Sminchisescu & Triggs
    2001, and s / sigma^2 for the Gaussian.

    s, sigma2: squared length of the residual, and squared scale, px^2 or m^2.
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

    first, second: rho' and rho'' at s.
    s: squared length of the residual.
    second_order: False: rho' alone is used.
    Why: far from the peak it is negative, and a Newton step would climb.
    """
    if not second_order:
        return first
    return max(along(first, second, s), _SHARE * first)


@kernel
def add_wrench(ws, j, w, x, y, z, gx, gy, gz):
    """Add w times the wrench of a point (x, y, z) that joint j carries, along (gx, gy, gz), to the row that is being
    made.

    ws: scratch memory.
    """
    wrench = ws.wrench[j]
    wrench[0] += w * (y * gz - z * gy)
    wrench[1] += w * (z * gx - x * gz)
    wrench[2] += w * (x * gy - y * gx)
    wrench[3] += w * gx
    wrench[4] += w * gy
    wrench[5] += w * gz
    ws.marked[j] = 1


@kernel
def add_row(model, ws, first, second, hessian, gradient):
    """Finish the row J whose wrenches were added: gradient += first J, hessian += second J^T J, and clear the wrenches.

    model, ws: MonoModel and scratch memory.
    first, second: derivatives of the cost along the row's direction.
    hessian, gradient: (A, A) and (A,).
    Wrenches climb the tree: the derivative by a dof is its twist times the sum at its joint. Of the hessian either
    [i, k] or [k, i] gets a pair's sum.
    """
    tree, wrench, marked, columns, entries = model.tree, ws.wrench, ws.marked, ws.columns, ws.entries
    m = 0
    for j in range(marked.shape[0] - 1, -1, -1):
        if marked[j] == 0:
            continue
        marked[j] = 0
        begin, end = tree.dof_start[j], tree.dof_start[j] + tree.dof_count[j]
        if j == 0:
            begin = 0
        for d in range(begin, end):
            if model.slot[d] >= 0:
                s = 0.0
                for k in range(6):
                    s += ws.twists[d, k] * wrench[j, k]
                columns[m], entries[m] = model.slot[d], s
                m += 1
        a = tree.parents[j]
        if a >= 0:
            marked[a] = 1
            for k in range(6):
                wrench[a, k] += wrench[j, k]
        for k in range(6):
            wrench[j, k] = 0.0
    for i in range(m):
        e = entries[i]
        gradient[columns[i]] += first * e
        line = hessian[columns[i]]
        e *= second
        for k in range(i + 1):
            line[columns[k]] += e * entries[k]


@kernel
def joint_point(ws, j, o):
    """Compute the place (x, y, z) of a point at offset o (3,) in the frame of joint j, relative to the root.

    ws: scratch memory with the joint frames.
    """
    c, r = ws.centres[j], ws.rotations[j]
    x = c[0] + r[0, 0] * o[0] + r[0, 1] * o[1] + r[0, 2] * o[2]
    y = c[1] + r[1, 0] * o[0] + r[1, 1] * o[1] + r[1, 2] * o[2]
    z = c[2] + r[2, 0] * o[0] + r[2, 1] * o[1] + r[2, 2] * o[2]
    return x, y, z


@kernel
def sum_vertex_rows(n, model, ws, hessian, gradient):
    """Add the first n rows of ws.row_vertices and ws.row_values to hessian (A, A) and gradient (A,).

    model, ws: MonoModel and scratch memory.
    """
    tree, mesh, rows, values, offset = model.tree, model.mesh, ws.row_vertices, ws.row_values, np.empty(3)
    for r in range(n):
        for i in range(3):
            v = rows[r, i]
            if v < 0:
                continue
            for k in range(mesh.skin_count[v]):
                j, w = mesh.skin_index[v, k], values[r, i] * mesh.skin_weight[v, k]
                for c in range(3):
                    offset[c] = mesh.vertices[v, c] - tree.joints[j, c]
                x, y, z = joint_point(ws, j, offset)
                add_wrench(ws, j, w, x, y, z, values[r, 3], values[r, 4], values[r, 5])
        add_row(model, ws, values[r, 6], values[r, 7], hessian, gradient)


@kernel
def projected(p, x, y, z):
    """Project a point of the world.

    p: (3, 4) projection.
    x, y, z: the point, m.
    Returns: its pixel u and v, and its depth, m; the pixel is 0, 0 nearer than 0.05 m.
    """
    depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
    if depth < 0.05:
        return 0.0, 0.0, depth
    u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / depth
    v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / depth
    return u, v, depth


@kernel
def image_direction(p, u, v, depth, nx, ny):
    """Compute the derivative (x, y, z) by a point in the world of its pixel (u, v) along (nx, ny), px / m.

    p: (3, 4) projection.
    u, v, depth: pixel and depth of the point, px and m.
    nx, ny: direction in the image.
    """
    iz = 1 / depth
    dx = (nx * (p[0, 0] - u * p[2, 0]) + ny * (p[1, 0] - v * p[2, 0])) * iz
    dy = (nx * (p[0, 1] - u * p[2, 1]) + ny * (p[1, 1] - v * p[2, 1])) * iz
    dz = (nx * (p[0, 2] - u * p[2, 2]) + ny * (p[1, 2] - v * p[2, 2])) * iz
    return dx, dy, dz


@kernel
def mark_terms(q, problem, ws, hessian, gradient):
    """Compute the cost of 2D points at pose q (D,): 1/2 weight nu rho(|residual|^2) with nu = sigma^2.

    problem, ws: evidence and priors, and scratch memory.

    Near zero it is a squared residual in standard deviations. A point behind the camera costs as much as at 1000 px.
    hessian, gradient: (A, A) and (A,), the derivatives are added to them.
    """
    model, marks, form = problem.model, problem.marks, problem.cues.point_form
    cost = 0.0
    for m in range(marks.joint.shape[0]):
        j = marks.joint[m]
        # a Lorentzian tail that starts at 2 sd, as for key points elsewhere
        sigma2, w = 4.0 * marks.scale[m] * marks.scale[m], 4.0 * marks.weight[m]
        x, y, z = joint_point(ws, j, marks.offset[m])
        u, v, depth = projected(model.projection, x + q[0], y + q[1], z + q[2])
        if depth < 0.05:
            cost += 0.5 * w * robust(form, 1e6, sigma2)[0]
            continue
        du, dv = u - marks.pixels[m, 0], v - marks.pixels[m, 1]
        s = du * du + dv * dv
        value, first, second = robust(form, s, sigma2)
        cost += 0.5 * w * value
        length = math.sqrt(s)
        nx, ny = (du / length, dv / length) if length > 1e-9 else (1.0, 0.0)
        slope, bend = w * first * length, w * curvature(first, second, s, problem.second_order)
        for _ in range(2):  # along the residual and across it
            dx, dy, dz = image_direction(model.projection, u, v, depth, nx, ny)
            add_wrench(ws, j, 1.0, x, y, z, dx, dy, dz)
            add_row(model, ws, slope, bend, hessian, gradient)
            nx, ny, slope, bend = -ny, nx, 0.0, w * first
    return cost


@kernel
def sphere_terms(model, spheres, ws, hessian, gradient):
    """Compute the cost of interpenetration: 1/2 weight (apart - distance)^2 for pairs of spheres that are too near.

    model, ws: MonoModel and scratch memory.
    spheres: SphereArrays.
    hessian, gradient: (A, A) and (A,), the derivatives are added to them.
    """
    at = np.empty((spheres.joint.shape[0], 3))
    for i in range(at.shape[0]):
        at[i, 0], at[i, 1], at[i, 2] = joint_point(ws, spheres.joint[i], spheres.offset[i])
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
        for i, w in ((a, 1 / d), (b, -1 / d)):
            add_wrench(ws, spheres.joint[i], 1.0, at[i, 0], at[i, 1], at[i, 2], w * dx, w * dy, w * dz)
        add_row(model, ws, -spheres.weight * short, spheres.weight, hessian, gradient)
    return cost


@kernel
def floor_terms(q, model, floor, second_order, ws, hessian, gradient):
    """Compute the cost of the floor at pose q (D,): the lowest point of the soles stands on it, and no point lies under
    it.

    model, ws: MonoModel and scratch memory.
    floor: FloorArrays.
    second_order: as in `curvature`.
    The loss is that of a 2D point: a Lorentzian with its tail from 2 sd on, so that a jump costs little more than a
    step.
    hessian, gradient: (A, A) and (A,), the derivatives are added to them.
    """
    if not floor.weight > 0:
        return 0.0
    at = np.empty((floor.joint.shape[0], 3))
    lowest = 0
    for i in range(at.shape[0]):
        at[i, 0], at[i, 1], at[i, 2] = joint_point(ws, floor.joint[i], floor.offset[i])
        if at[i, 2] < at[lowest, 2]:
            lowest = i
    cost, sigma2, w = 0.0, 4 * floor.scale * floor.scale, 4 * floor.weight
    for i in range(at.shape[0]):
        above = at[i, 2] + q[2] - floor.height
        if i != lowest and above >= 0:
            continue
        value, first, second = robust(LORENTZIAN, above * above, sigma2)
        cost += 0.5 * w * value
        add_wrench(ws, floor.joint[i], 1.0, at[i, 0], at[i, 1], at[i, 2], 0.0, 0.0, 1.0)
        bend = w * curvature(first, second, above * above, second_order)
        add_row(model, ws, w * first * above, bend, hessian, gradient)
    return cost


MOST_EDGES = 16
"""Largest number of edges kept in the window of one node."""


@kernel
def put_row(ws, r, a, b, c, t, w, dx, dy, dz, first, second):
    """Write row r of ws: a point of the surface, and the derivatives of the cost along a direction in the world.

    a, b, c: vertices of which the point is a blend; c -1: only two.
    t, w: shares of b and c.
    dx, dy, dz: direction.
    first, second: derivatives of the cost along it.
    """
    ws.row_vertices[r, 0], ws.row_vertices[r, 1], ws.row_vertices[r, 2] = a, b, c
    values = ws.row_values[r]
    values[0], values[1], values[2], values[3], values[4], values[5] = 1 - t - w, t, w, dx, dy, dz
    values[6], values[7] = first, second


@kernel
def contour_row(p, ws, r, i, nx, ny, first, second):
    """Write row r of contour node i along (nx, ny) in the image; p (3, 4), first, second: derivatives of the cost.

    ws: scratch memory with the nodes.
    """
    node = ws.nodes[i]
    a, b, t = ws.node_ends[i, 0], ws.node_ends[i, 1], node[0]
    depth = (1 - t) * ws.uvz[a, 2] + t * ws.uvz[b, 2]
    dx, dy, dz = image_direction(p, node[1], node[2], depth, nx, ny)
    put_row(ws, r, a, b, -1, t, 0.0, dx, dy, dz, first, second)


@kernel
def line_search(field, x, y, nx, ny, window, threshold, energy, offset, strength):
    """Find all edges in the window along the normal: local maxima of the gradient's component along it.

    field: (h, w, 2) image gradient, as in EdgeArrays.
    x, y, nx, ny: node and unit normal, px.
    window: px that are searched on either side.
    threshold: weakest edge that counts.
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

    problem, ws: evidence and priors, and scratch memory.
    n_nodes: number of nodes in ws.nodes.
    sigma: scale of the loss, px.
    want: whether to append rows to those in ws.
    n_rows: number of rows before.
    Returns: cost, and number of rows.
    Deviations: a node's edges share the weight 1, less where they are weak in sum; the rest counts as unassigned, at
    the cost of the window's end. An occluded node costs k nu / 2, so that k is its share of the cost of a node without
    an edge. A node stands for its length of contour, and the sum is not divided by N nu of equation (6), so that it is
    a log-likelihood to which priors can be added. Back-facing nodes cost nothing, because their share of a closed
    surface hardly changes. The expected cost of a place without a body is subtracted for every node, because otherwise
    limbs would hide.
    """
    edges, p = problem.edges.settings, problem.model.projection
    window, sigma2 = edges.window_px, sigma * sigma
    energy, offset, strength = np.empty(2 * window + 1), np.empty(MOST_EDGES), np.empty(MOST_EDGES)
    unassigned = robust(edges.form, float(window * window), sigma2)[0]
    cost = 0.0
    for i in range(n_nodes):
        node = ws.nodes[i]
        samples = edges.height * node[5] / edges.sample_px
        if node[6] == 0:
            cost += 0.5 * samples * (edges.occluded - edges.background) * unassigned
            ws.counts[3] += 1
            continue
        ws.counts[0] += 1
        nx, ny = node[3], node[4]
        m = line_search(
            problem.edges.field, node[1], node[2], nx, ny, window, edges.threshold, energy, offset, strength
        )
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

    problem, ws: evidence and priors, and scratch memory.

    Outliers of the flow have no nodes.
    q: (D,) pose.
    n_flow: number of nodes in ws.flow_nodes.
    want, n_rows: as in `edge_terms`.
    Returns: cost, and number of rows.
    """
    flow, p, x, cost = problem.flow.settings, problem.model.projection, ws.vertices, 0.0
    sigma2 = flow.sigma_px * flow.sigma_px
    for i in range(n_flow):
        a, b, c = ws.flow_faces[i, 0], ws.flow_faces[i, 1], ws.flow_faces[i, 2]
        node = ws.flow_nodes[i]
        w1, w2 = node[0], node[1]
        w0 = 1 - w1 - w2
        gx = w0 * x[a, 0] + w1 * x[b, 0] + w2 * x[c, 0] + q[0]
        gy = w0 * x[a, 1] + w1 * x[b, 1] + w2 * x[c, 1] + q[1]
        gz = w0 * x[a, 2] + w1 * x[b, 2] + w2 * x[c, 2] + q[2]
        u, v, depth = projected(p, gx, gy, gz)
        weight = flow.height * node[4]
        if depth < 0.05:
            cost += 0.5 * weight * robust(flow.form, 1e6, sigma2)[0]
            continue
        du, dv = u - node[2], v - node[3]
        s = du * du + dv * dv
        value, first, second = robust(flow.form, s, sigma2)
        cost += 0.5 * weight * value
        if not want or n_rows + 2 > ws.row_values.shape[0]:
            continue
        length = math.sqrt(s)
        nx, ny = (du / length, dv / length) if length > 1e-9 else (1.0, 0.0)
        slope, bend = weight * first * length, weight * curvature(first, second, s, problem.second_order)
        for _ in range(2):  # along the residual and across it: the eigenvectors of (9)'s bracket
            dx, dy, dz = image_direction(p, u, v, depth, nx, ny)
            put_row(ws, n_rows, a, b, c, w1, w2, dx, dy, dz, slope, bend)
            nx, ny, slope, bend = -ny, nx, 0.0, weight * first
            n_rows += 1
    return cost, n_rows


@kernel
def mask_terms(n_nodes, problem, want, ws, n_rows):
    """Compute the cost of the outer contour against a silhouette, in both directions.

    problem, ws: evidence and priors, and scratch memory.

    Nodes are compared with the distance to the mask's edge, and points of the mask's outline with the nearest node
    (along its normal), so that neither a small nor a large body is preferred.
    n_nodes, want, n_rows: as in `edge_terms`.
    Returns: cost, and number of rows.
    """
    mask, p, form = problem.mask, problem.model.projection, problem.cues.silhouette_form
    h, w = mask.distance.shape
    if h < 3 or w < 3:
        return 0.0, n_rows
    sigma2, cost = problem.cues.silhouette_sigma_px**2, 0.0
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
        weight = 0.5 * problem.cues.silhouette_height * node[5] / mask.sample_px
        value, first, second = robust(form, d * d, sigma2)
        cost += 0.5 * weight * value
        if want and slope > 0.1 and n_rows < ws.row_values.shape[0]:
            bend = curvature(first, second, d * d, problem.second_order)
            contour_row(p, ws, n_rows, i, gx / slope, gy / slope, weight * first * d, weight * bend)
            n_rows += 1
    weight = 0.5 * problem.cues.silhouette_height * mask.outline_share / mask.sample_px
    for m in range(mask.outline.shape[0]):
        x, y = mask.outline[m, 0], mask.outline[m, 1]
        nearest, best = f4(1e12), -1
        for i in range(n):
            dx, dy = places[0, i] - x, places[1, i] - y
            d2 = dx * dx + dy * dy
            if d2 < nearest:
                nearest, best = d2, i
        if best < 0:
            cost += 0.5 * weight * robust(form, 1e6, sigma2)[0]
            continue
        node = ws.nodes[outer[best]]
        d = node[3] * (node[1] - x) + node[4] * (node[2] - y)
        # the distance along the contour is that between nodes, unless there is no contour near
        aside = max(nearest - d * d - 100.0, 0.0)
        s = d * d + aside
        value, first, second = robust(form, s, sigma2)
        cost += 0.5 * weight * value
        if want and n_rows < ws.row_values.shape[0]:
            bend = curvature(first, second, d * d, problem.second_order)
            contour_row(p, ws, n_rows, outer[best], node[3], node[4], weight * first * d, weight * bend)
            n_rows += 1
    return cost, n_rows


@kernel
def image_cost(q, problem, sigma, n_flow, want, ws, hessian, gradient):
    """Compute the cost of all evidence at pose q (D,).

    problem, ws: evidence and priors, and scratch memory.
    sigma: scale of the edges, px.
    n_flow: number of inner nodes (0: without flow).
    want: whether to compute derivatives.
    hessian, gradient: (A, A) and (A,) get the derivatives by the active dof.
    """
    model, a = problem.model, gradient.shape[0]
    for i in range(a):
        gradient[i] = 0.0
        for k in range(a):
            hessian[i, k] = 0.0
    ws.counts[:] = 0
    pose_mesh(q, model, ws)
    cost, n_rows = 0.0, 0
    if problem.edges.use or problem.mask.distance.size > 0:
        fill_depth(model, ws)
        n = contour_nodes(model, problem.edges.settings.spacing_px, ws)
        if problem.edges.use:
            part, n_rows = edge_terms(n, problem, sigma, want, ws, n_rows)
            cost += part
        part, n_rows = mask_terms(n, problem, want, ws, n_rows)
        cost += part
    part, n_rows = flow_terms(q, n_flow, problem, want, ws, n_rows)
    cost += part
    if want:
        sum_vertex_rows(n_rows, model, ws, hessian, gradient)
    cost += mark_terms(q, problem, ws, hessian, gradient)
    cost += sphere_terms(model, problem.spheres, ws, hessian, gradient)
    cost += floor_terms(q, model, problem.floor, problem.second_order, ws, hessian, gradient)
    for i in range(a):
        for k in range(i):
            s = hessian[i, k] + hessian[k, i]
            hessian[i, k] = s
            hessian[k, i] = s
    for f in range(ws.front.shape[0]):
        ws.counts[4] += 1 - ws.front[f]
    ws.counts[5], ws.counts[6] = n_flow, n_rows
    return cost


@kernel
def prior_cost(q, priors, active, hessian, gradient):
    """Compute the quadratics of the prediction and of the rest posture at pose q (D,).

    priors, active: MonoPriors, and the (A,) dof that they concern.
    hessian, gradient: (A, A) and (A,), the derivatives are added to them.
    """
    cost = 0.0
    for i in range(priors.centre.shape[0]):
        for k in range(active.shape[0]):
            w = priors.weight[i, k]
            if w > 0:
                e = q[active[k]] - priors.centre[i, k]
                cost += 0.5 * w * e * e
                gradient[k] += w * e
                hessian[k, k] += w
    return cost


@kernel
def full_cost(q, problem, sigma, n_flow, ws, hessian, gradient):
    """Compute the cost of evidence and priors at pose q (D,): equations (6) and (10) of Sminchisescu & Triggs 2001.

    problem, ws: evidence and priors, and scratch memory.
    sigma, n_flow, hessian, gradient: as in `image_cost`.
    Deviation: the evidence is not divided by N nu; masks, 2D points, interpenetration and the floor are added.
    """
    cost = image_cost(q, problem, sigma, n_flow, True, ws, hessian, gradient)
    return cost + prior_cost(q, problem.priors, problem.model.active, hessian, gradient)


@kernel
def prepare_terms(before, q, problem, ws):
    """Prepare the workspace for a search from pose q (D,): draw the still parts, place the inner nodes of the flow.

    problem, ws: evidence and priors, and scratch memory.
    before: (D,) pose in the previous picture, on whose surface the inner nodes lie.
    Returns: number of inner nodes; 0 without flow.
    """
    n_flow = 0
    if problem.flow.flow.shape[0] > 1:
        draw_still(before, problem.model, ws)
        pose_mesh(before, problem.model, ws)
        fill_depth(problem.model, ws)
        n_flow = inner_nodes(problem.model, problem.flow, ws)
    draw_still(q, problem.model, ws)
    return n_flow


@kernel
def _score(poses, problem, ws, costs):
    """Compute the costs (N,) of poses (N, D) without flow; see `score`.

    problem, ws: evidence and priors, and scratch memory.
    """
    a = problem.model.active.shape[0]
    hessian, gradient = np.empty((a, a)), np.empty(a)
    if poses.shape[0] > 0:
        draw_still(poses[0], problem.model, ws)
    for n in range(poses.shape[0]):
        cost = image_cost(poses[n], problem, problem.edges.settings.sigma_px, 0, False, ws, hessian, gradient)
        costs[n] = cost + prior_cost(poses[n], problem.priors, problem.model.active, hessian, gradient)


def score(poses: ArrayLike, problem: MonoProblem, ws: MonoWorkspace) -> Array:
    """Compute the costs (N,) by which hypotheses (N, D) are ranked; releases the GIL.

    problem, ws: evidence and priors, and scratch memory.
    Returns: all but flow, whose targets differ between hypotheses.
    Source: Sminchisescu & Triggs 2001, section 4.2. Deviation: the printed cost is the edge term alone; here priors,
        interpenetration and, where given, masks, 2D points and the floor are included.
    """
    q = plain(poses, np.float64)
    costs = np.empty(len(q))
    _score(q, problem, ws, costs)
    return costs


def warm_up(tree: TreeArrays, mesh: MeshArrays, pose: Array, projection: Array) -> None:
    """Compile (or load from the cache) every kernel of monocular tracking on a toy body at pose (D,), before a pinhole
    (3, 4) of 32 x 32 px.

    tree, mesh: of the body.
    """
    d, j = len(pose), len(tree.parents)
    still = np.zeros((32, 32, 2), np.float32)
    error, corner = np.zeros((32, 32), np.float32), np.zeros(2, dtype=np.int64)
    pixels, places, joint = np.full((1, 2), 16.0), np.zeros((2, 3)), np.zeros(2, dtype=np.int64)
    bounds = np.full(d, np.inf)
    problem = MonoProblem(
        model(tree, mesh, np.ones((d, j), dtype=np.bool_), np.arange(d), projection),
        EdgeArrays(still, True, EdgeSettings()),
        FlowArrays(still, error, corner, FlowSettings()),
        MaskArrays(error, pixels.astype(np.float32), 1.0, 8.0),
        MarkArrays(pixels, np.ones(1), joint[:1], places[:1], np.ones(1)),
        SphereArrays(joint, places, np.array([[0, 1]]), np.ones(1), 1.0),
        FloorArrays(joint, places, 0.0, 1.0, 1.0),
        CueSettings(),
        MonoPriors(np.zeros((2, d)), np.ones((2, d)), -bounds, bounds, np.ones(d)),
        True,
    )
    ws = workspace(problem.model, 32, 32)
    n_flow = prepare_terms(pose, pose, problem, ws)
    full_cost(pose, problem, 1.0, n_flow, ws, np.empty((d, d)), np.empty(d))
    score(pose[None], problem, ws)

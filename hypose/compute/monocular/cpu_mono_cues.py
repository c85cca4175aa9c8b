"""numba: image cues as rows: contour nodes against edges and against a mask, inner nodes against flow."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.monocular.cpu_mono_nodes import bilinear
from hypose.compute.monocular.cpu_mono_rows import curvature, robust

f4 = np.float32
MOST_EDGES = 16
"""most edges kept in one node's window"""


@kernel
def image_row(p, ws, r, u, v, depth, nx, ny, first, second):
    """Direction and derivatives of row r: along (nx, ny) in the image, for a point seen at (u, v)."""
    values = ws.row_values[r]
    iz = 1 / depth
    values[3] = (nx * (p[0, 0] - u * p[2, 0]) + ny * (p[1, 0] - v * p[2, 0])) * iz
    values[4] = (nx * (p[0, 1] - u * p[2, 1]) + ny * (p[1, 1] - v * p[2, 1])) * iz
    values[5] = (nx * (p[0, 2] - u * p[2, 2]) + ny * (p[1, 2] - v * p[2, 2])) * iz
    values[6], values[7] = first, second


@kernel
def contour_row(p, ws, r, i, nx, ny, first, second):
    """Row r of contour node i along (nx, ny)."""
    node = ws.nodes[i]
    a, b, t = ws.node_ends[i, 0], ws.node_ends[i, 1], node[0]
    ws.row_vertices[r, 0], ws.row_vertices[r, 1], ws.row_vertices[r, 2] = a, b, -1
    ws.row_values[r, 0], ws.row_values[r, 1], ws.row_values[r, 2] = 1 - t, t, 0.0
    depth = (1 - t) * ws.uvz[a, 2] + t * ws.uvz[b, 2]
    image_row(p, ws, r, node[1], node[2], depth, nx, ny, first, second)


@kernel
def line_search(field, x, y, nx, ny, window, threshold, energy, offset, strength):
    """All edges in the window along the normal: local maxima of the gradient's component along it, with sub-pixel
    offset and strength (at most 1). Returns their number. energy (2 window + 1,) is scratch."""
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
    """Cost of the contour nodes: equation (7), first sum, over all edges of each node's window; appends rows when
    derivatives are wanted. Returns cost and rows.

    Deviation: a node's edges share the weight 1, less when they are weak in sum; what is left counts as unassigned, at
    the cost of the window's end. Deviation: an occluded node costs k nu / 2, so that k is its share of what a node
    costs that finds no edge. Deviation: a node stands for its length of contour, and the sum is not divided by N nu of
    equation (6), so that it is a log-likelihood to which priors can be added. Deviation: back-facing nodes cost
    nothing, because their share of a closed surface hardly changes. Deviation: every node is credited with the expected
    cost of a place without a body, else limbs would hide."""
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
    """Cost of inner nodes against where flow has carried them: equation (7), second sum; outliers of the flow weigh
    0."""
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
    """Cost of the outer contour against a silhouette: nodes against the distance to the mask's edge, and points of the
    mask's outline against the nearest node (along its normal), so that neither a small nor a large body wins."""
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

"""Evidence of a pose in one picture: contours against edges, inner points against optical flow (kernels).

Every term gives rows: a point of the body's surface (a blend of up to three vertices), a direction in the world, and
the first and second derivative of the cost along it. hypose.tracking.monocular.problem adds the rows of other cues and
searches for the pose of least cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays, plain
from hypose.compute.compiled import kernel
from hypose.compute.losses import along_kernel as along
from hypose.compute.losses import leclerc_kernel as leclerc
from hypose.compute.losses import lorentzian_kernel as lorentzian
from hypose.compute.losses import quadratic_kernel as quadratic
from hypose.compute.mono_nodes import contour_nodes, fill_depth, inner_nodes, pose_mesh
from hypose.geometry import Array

GAUSSIAN, LORENTZIAN, LECLERC = 0, 1, 2
"""Forms of a robust loss."""
MOST_NODES, MOST_INNER, MOST_EDGES = 3000, 3000, 16
"""Largest number of contour nodes, of inner nodes, and of edges in the window of one node."""
_SHARE = 0.1
"""Least second derivative along a residual, as a share of that without rho''."""
f4 = np.float32


class MonoModel(NamedTuple):
    """Body before a camera, with the parts that the estimated degrees of freedom move.

    tree, mesh: joint tree and mesh of the body.
    all_vertices, all_faces, moving_faces: indices of all vertices and faces, and of the faces that they move.
    moving_vertices: (V,) vertices of which these degrees of freedom carry more than half of the weight.
    projection: (3, 4) pinhole projection of the camera.
    """

    tree: TreeArrays
    mesh: MeshArrays
    all_vertices: NDArray[np.int64]
    all_faces: NDArray[np.int64]
    moving_faces: NDArray[np.int64]
    moving_vertices: NDArray[np.bool_]
    projection: NDArray[np.float64]


class EdgeSettings(NamedTuple):
    """Settings of the edge term, which compares contours with image edges.

    form: form of the loss: GAUSSIAN, LORENTZIAN or LECLERC.
    sigma_px: its scale, px.
    height: nu, the cost of one independent sample that finds no edge.
    sample_px: px of contour per independent sample.
    window_px: px that are searched along the normal on either side.
    spacing_px: distance of the contour's nodes, px.
    strength: quantile of the image gradient that counts as a full edge.
    threshold: weakest edge that counts, as a share of a full one.
    smoothing_px: standard deviation of the smoothing of the image before, px.
    background: expected cost of a node where no body is, as a share of nu, subtracted from each node. Why: a contour
        that fits worse than by chance would cost less the shorter it is, so with too low a value limbs hide.
    occluded: k of equation (5), cost of an occluded node as a share of nu; equal to background, hiding has no effect.
    boundary_floor: weight of an edge where nothing moves.
    coarse_factor: factor on sigma in the first iterations.
    """

    form: int = LECLERC
    sigma_px: float = 3.0
    height: float = 5.0
    sample_px: float = 8.0
    window_px: int = 14
    spacing_px: float = 6.0
    strength: float = 0.93
    threshold: float = 0.08
    smoothing_px: float = 1.2
    background: float = 0.8
    occluded: float = 0.8
    boundary_floor: float = 0.1
    coarse_factor: float = 2.0


class FlowSettings(NamedTuple):
    """Settings of the flow term, which compares inner nodes with optical flow.

    form, sigma_px, height: form, scale (px) and height of the loss, as for edges.
    area_px: side of the square that makes one independent sample, px.
    spacing_px: distance of the grid's nodes, px.
    consistency_px: nodes with a larger forward-backward error are outliers.
    """

    form: int = LORENTZIAN
    sigma_px: float = 1.2
    height: float = 0.1
    area_px: float = 14.0
    spacing_px: float = 8.0
    consistency_px: float = 1.0


class EdgeArrays(NamedTuple):
    """Evidence of the edge term.

    field: (h, w, 2) image gradient in units of a full edge, weighted by the motion boundaries.
    use: False: the term is omitted.
    settings: settings of the term.
    """

    field: NDArray[np.float32]
    use: bool
    settings: EdgeSettings


class FlowArrays(NamedTuple):
    """Evidence of the flow term.

    flow: (h, w, 2) px from the previous picture to this one, of a part of the image; (0, 0, 2) where there is none.
    error: (h, w) px, forward-backward.
    corner: (2,) x, y of the part's first pixel.
    settings: settings of the term.
    """

    flow: NDArray[np.float32]
    error: NDArray[np.float32]
    corner: NDArray[np.int64]
    settings: FlowSettings


class PictureArrays(NamedTuple):
    """Evidence of one picture.

    model: the body before the camera.
    edges, flow: the terms.
    """

    model: MonoModel
    edges: EdgeArrays
    flow: FlowArrays


class MonoWorkspace(NamedTuple):
    """Scratch memory of one thread; the contents are undefined between calls.

    rotations, centres, twists: joint frames of the pose, about the root.
    vertices: (V, 3) about the root.
    seen: (4, V) pixels u and v, depths and inverse depths, of `zbuffer.project`.
    box: (4,) part of the picture in which the body lies.
    front: (F,) 1: seen from outside.
    depth: (h, w) z-buffer, 1/m, 0 = nothing.
    node_ends: (N, 2) vertices between which a contour node lies.
    nodes: (N, 7): place 0..1, u, v, normal u, v, length px, seen.
    flow_faces: (M, 3) vertices around an inner node.
    flow_nodes: (M, 5): weights of the second and third vertex, target u, v, weight.
    row_vertices: (R, 3) vertices of a row's point.
    row_values: (R, 8): their shares, direction in the world, first and second derivative along it.
    counts: (7,): contour nodes seen, of these with an edge, edges, occluded, facing away, flow nodes, rows.
    """

    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    twists: NDArray[np.float64]
    vertices: NDArray[np.float32]
    seen: NDArray[np.float32]
    box: NDArray[np.int64]
    front: NDArray[np.uint8]
    depth: NDArray[np.float32]
    node_ends: NDArray[np.int32]
    nodes: NDArray[np.float64]
    flow_faces: NDArray[np.int32]
    flow_nodes: NDArray[np.float64]
    row_vertices: NDArray[np.int32]
    row_values: NDArray[np.float64]
    counts: NDArray[np.int64]


def model(tree: TreeArrays, mesh: MeshArrays, carried: NDArray[np.bool_], projection: Array) -> MonoModel:
    """Make the model of a body before a camera.

    tree, mesh: joint tree and mesh of the body.
    carried: (J,) joints that the estimated degrees of freedom move.
    projection: (3, 4) pinhole.
    """
    share = (mesh.skin_weight * carried[mesh.skin_index]).sum(1)
    moving = np.flatnonzero((share > 0.01)[mesh.faces].any(1))
    every = np.arange(len(mesh.vertices)), np.arange(len(mesh.faces))
    return MonoModel(tree, mesh, *every, moving, share > 0.5, plain(projection, np.float64))


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
        np.zeros((4, v), f4),
        np.zeros(4, np.int64),
        np.zeros(f, np.uint8),
        np.zeros((height, width), f4),
        np.zeros((MOST_NODES, 2), i4),
        np.zeros((MOST_NODES, 7)),
        np.zeros((MOST_INNER, 3), i4),
        np.zeros((MOST_INNER, 5)),
        np.zeros((rows, 3), i4),
        np.zeros((rows, 8)),
        np.zeros(7, np.int64),
    )


@kernel
def robust(form, s, sigma2):
    """Compute rho(s) and its first and second derivative (height 1): equations (2) and (3) of Sminchisescu & Triggs
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
def curvature(first, second, s):
    """Compute the second derivative of rho(s) / 2 along the residual, rho' + 2 rho'' s of equation (9) of
    Sminchisescu & Triggs 2001, kept positive.

    first, second: rho' and rho'' at s.
    s: squared length of the residual.
    Why: far from the peak it is negative, and a Newton step would climb.
    """
    return max(along(first, second, s), _SHARE * first)


@kernel
def image_direction(p, u, v, depth, nx, ny):
    """Compute the derivative of a pixel's position along an image direction with respect to the point in the world,
    px / m.

    p: (3, 4) projection.
    u, v, depth: pixel and depth of the point, px and m.
    nx, ny: direction in the image.
    Returns: derivatives by x, y and z.
    """
    iz = 1 / depth
    dx = (nx * (p[0, 0] - u * p[2, 0]) + ny * (p[1, 0] - v * p[2, 0])) * iz
    dy = (nx * (p[0, 1] - u * p[2, 1]) + ny * (p[1, 1] - v * p[2, 1])) * iz
    dz = (nx * (p[0, 2] - u * p[2, 2]) + ny * (p[1, 2] - v * p[2, 2])) * iz
    return dx, dy, dz


@kernel
def put_row(ws, r, a, b, c, t, w, dx, dy, dz, first, second):
    """Write row r of ws: a point of the surface, and the derivatives of the cost along a direction in the world.

    a, b, c: vertices of which the point is a blend.
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
    depth = (1 - t) * ws.seen[2, a] + t * ws.seen[2, b]
    dx, dy, dz = image_direction(p, node[1], node[2], depth, nx, ny)
    put_row(ws, r, a, b, a, t, 0.0, dx, dy, dz, first, second)


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
def edge_terms(n_nodes, picture, sigma, ws, n_rows):
    """Compute the cost of the contour nodes, over all edges of each node's window: equation (7) of
    Sminchisescu & Triggs 2001, first sum.

    picture, ws: PictureArrays and scratch memory.
    n_nodes: number of nodes in ws.nodes.
    sigma: scale of the loss, px.
    n_rows: number of rows in ws before, to which rows are added.
    Returns: cost, and number of rows.
    Deviations: a node's edges share the weight 1, less where they are weak in sum; the rest counts as unassigned, at
    the cost of the window's end. An occluded node costs k nu / 2, so that k is its share of the cost of a node without
    an edge. A node stands for its length of contour, and the sum is not divided by N nu of equation (6), so that it is
    a log-likelihood to which priors can be added. Back-facing nodes cost nothing, because their share of a closed
    surface hardly changes. The expected cost of a place without a body is subtracted for every node, because otherwise
    limbs would hide.
    """
    edges, p = picture.edges.settings, picture.model.projection
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
            picture.edges.field, node[1], node[2], nx, ny, window, edges.threshold, energy, offset, strength
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
            second += w * curvature(r1, r2, s)
        cost += 0.5 * samples * (value - edges.background * unassigned)
        if m > 0:
            ws.counts[1] += 1
            ws.counts[2] += m
            if n_rows < ws.row_values.shape[0]:
                contour_row(p, ws, n_rows, i, nx, ny, samples * first, samples * second)
                n_rows += 1
    return cost, n_rows


@kernel
def flow_terms(q, n_flow, picture, ws, n_rows):
    """Compute the cost of the distances of inner nodes from where the flow has carried them: equation (7) of
    Sminchisescu & Triggs 2001, second sum.

    picture, ws: PictureArrays and scratch memory.

    Outliers of the flow have no nodes.
    q: (D,) pose.
    n_flow: number of nodes in ws.flow_nodes.
    n_rows: as in `edge_terms`.
    Returns: cost, and number of rows.
    """
    flow, p, x, cost = picture.flow.settings, picture.model.projection, ws.vertices, 0.0
    sigma2 = flow.sigma_px * flow.sigma_px
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
        if n_rows + 2 > ws.row_values.shape[0]:
            continue
        length = math.sqrt(s)
        nx, ny = (du / length, dv / length) if length > 1e-9 else (1.0, 0.0)
        slope, bend = weight * first * length, weight * curvature(first, second, s)
        for _ in range(2):  # along the residual and across it: the eigenvectors of (9)'s bracket
            dx, dy, dz = image_direction(p, u, v, depth, nx, ny)
            put_row(ws, n_rows, a, b, c, w1, w2, dx, dy, dz, slope, bend)
            nx, ny, slope, bend = -ny, nx, 0.0, weight * first
            n_rows += 1
    return cost, n_rows


@kernel
def prepare_terms(before, picture, ws):
    """Place the inner nodes of the flow on the surface of the pose before (D,), that in the previous picture.

    picture, ws: PictureArrays and scratch memory, which gets the nodes.
    Returns: number of inner nodes; 0 without flow.
    """
    if picture.flow.flow.shape[0] < 2:
        return 0
    pose_mesh(before, picture.model, ws)
    fill_depth(picture.model, ws)
    return inner_nodes(picture.model, picture.flow, ws)


@kernel
def picture_cost(q, picture, sigma, n_flow, ws):
    """Compute the cost of edges and flow at pose q (D,): equations (6) and (7) of Sminchisescu & Triggs 2001.

    picture, ws: PictureArrays and scratch memory, which gets the rows.
    sigma: scale of the edges, px.
    n_flow: number of inner nodes (0: without flow).
    Returns: cost, and number of rows.
    Deviation: the evidence is not divided by N nu.
    """
    ws.counts[:] = 0
    pose_mesh(q, picture.model, ws)
    cost, n_rows = 0.0, 0
    if picture.edges.use:
        fill_depth(picture.model, ws)
        n = contour_nodes(picture.model, picture.edges.settings.spacing_px, ws)
        cost, n_rows = edge_terms(n, picture, sigma, ws, n_rows)
    part, n_rows = flow_terms(q, n_flow, picture, ws, n_rows)
    cost += part
    for f in range(ws.front.shape[0]):
        ws.counts[4] += 1 - ws.front[f]
    ws.counts[5], ws.counts[6] = n_flow, n_rows
    return cost, n_rows


def warm_up(tree: TreeArrays, mesh: MeshArrays, pose: Array, projection: Array) -> None:
    """Compile (or load from the cache) every kernel of monocular tracking on a toy body at pose (D,), before a pinhole
    (3, 4) of 32 x 32 px.

    tree, mesh: joint tree and mesh of the body.
    """
    still, error = np.zeros((32, 32, 2), np.float32), np.zeros((32, 32), np.float32)
    picture = PictureArrays(
        model(tree, mesh, np.ones(len(tree.parents), dtype=np.bool_), projection),
        EdgeArrays(still, True, EdgeSettings()),
        FlowArrays(still, error, np.zeros(2, dtype=np.int64), FlowSettings()),
    )
    ws = workspace(picture.model, 32, 32)
    picture_cost(pose, picture, 1.0, prepare_terms(pose, picture, ws), ws)

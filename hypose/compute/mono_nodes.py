"""Compute what a camera sees of a body: projected vertices, z-buffer, contour nodes, inner nodes with their flow
(kernels).
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.kinematics import camera_about_root, joint_frames, skin_about_root
from hypose.compute.zbuffer import draw_nearest, project

f4 = np.float32
NEAR = f4(0.1)
"""m; faces with a corner nearer than this are not drawn."""
_EMPTY = f4(1e9)
_HIDDEN, BEYOND, ROUND = 0.03, 0.03, 0.12
"""m of depth at a contour node. _HIDDEN: the node is occluded where its outer side lies so far behind another surface;
ROUND: or its inner side so far (a trunk's own surface rises by 6 cm within the two pixels). BEYOND: it is a contour
where the surface on its outer side lies so far behind it.
"""
INNER, OUTER = 1.5, 1.7
"""px from the contour at which the depths of its inner and outer side are read."""


@kernel
def pose_mesh(q, model, ws):
    """Compute the joint frames, the vertices about the root, their pixels and depths, and the faces that are seen
    from outside, at pose q (D,).

    q: (D,) pose, rad and m.
    model: MonoModel.
    ws: scratch memory that gets them.
    """
    joint_frames(q, model.tree, ws.rotations, ws.centres, ws.twists)
    skin_about_root(ws.rotations, ws.centres, model.tree, model.mesh, ws.vertices)
    p = np.empty((3, 4), np.float32)
    camera_about_root(model.projection, q, p)
    size = np.empty(2, np.int64)
    size[0], size[1] = ws.depth.shape[1], ws.depth.shape[0]
    project(p, ws.vertices, model.all_vertices, ws.seen, size, ws.box)
    u, v, z, faces, front = ws.seen[0], ws.seen[1], ws.seen[2], model.mesh.faces, ws.front
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
        near = z[a] <= NEAR or z[b] <= NEAR or z[c] <= NEAR
        # pixels run downwards: counter-clockwise from outside has a negative area
        front[f] = 1 if area < f4(-1e-9) and not near else 0


@kernel(inline=True)
def _depth(nearest):
    """Convert an inverse depth, 1/m, to m; a very large number (_EMPTY) for 0, where nothing is."""
    return f4(1) / nearest if nearest > f4(0) else _EMPTY


@kernel
def fill_depth(model, ws):
    """Draw the z-buffer of the body.

    model, ws: MonoModel and scratch memory; ws.depth gets the picture, in the body's box and a few pixels around it.
    """
    h, w = ws.depth.shape
    left, right = max(ws.box[0] - 6, 0), min(ws.box[1] + 6, w)
    for y in range(max(ws.box[2] - 6, 0), min(ws.box[3] + 6, h)):
        row = ws.depth[y, left:right]
        for x in range(row.shape[0]):
            row[x] = f4(0)
    draw_nearest(ws.seen[0], ws.seen[1], ws.seen[3], model.mesh.faces, model.all_faces, True, ws.depth, None)


@kernel
def contour_nodes(model, spacing, ws):
    """Place nodes on the occluding contour of the moving parts, `spacing` px apart, into ws.node_ends and ws.nodes;
    return their number.

    model, ws: MonoModel and scratch memory with the posed mesh and its z-buffer.

    A node lies on a mesh edge between a face seen from outside and one that is not. It is seen where nothing lies in
    front of it and its outer side shows a surface well behind it (the background: outer). Else it is occluded (kept,
    seen = 0), or not a contour (omitted).
    """
    mesh, seen, depth, nodes = model.mesh, ws.seen, ws.depth, ws.nodes
    h, w = depth.shape
    n = 0
    for e in range(mesh.edges.shape[0]):
        f, g = mesh.edges[e, 2], mesh.edges[e, 3]
        if ws.front[f] == ws.front[g]:
            continue
        a, b = mesh.edges[e, 0], mesh.edges[e, 1]
        if not (model.moving_vertices[a] and model.moving_vertices[b]):
            continue
        if seen[2, a] <= NEAR or seen[2, b] <= NEAR:
            continue
        dx, dy = np.float64(seen[0, b] - seen[0, a]), np.float64(seen[1, b] - seen[1, a])
        length = math.sqrt(dx * dx + dy * dy)
        if length < 0.3:
            continue
        face = f if ws.front[f] == 1 else g
        c = mesh.faces[face, 0] + mesh.faces[face, 1] + mesh.faces[face, 2] - a - b
        nx, ny = dy / length, -dx / length
        if nx * (seen[0, c] - seen[0, a]) + ny * (seen[1, c] - seen[1, a]) > 0:
            nx, ny = -nx, -ny
        parts = min(4, max(1, int(length / spacing + 0.5)))
        for k in range(parts):
            if n >= nodes.shape[0]:
                return n
            # the place in space, so that the node is a fixed point of the body
            t = (k + 0.5) / parts
            za, zb = np.float64(seen[2, a]), np.float64(seen[2, b])
            z = (1 - t) * za + t * zb
            x = ((1 - t) * za * seen[0, a] + t * zb * seen[0, b]) / z
            y = ((1 - t) * za * seen[1, a] + t * zb * seen[1, b]) / z
            xi, yi = int(x - INNER * nx + 0.5), int(y - INNER * ny + 0.5)
            xo, yo = int(x + OUTER * nx + 0.5), int(y + OUTER * ny + 0.5)
            if min(min(xi, yi), min(xo, yo)) < 2 or max(xi, xo) >= w - 2 or max(yi, yo) >= h - 2:
                continue
            outside = _depth(depth[yo, xo])
            if outside < z - _HIDDEN or _depth(depth[yi, xi]) < z - ROUND:
                visible = 0.0
            elif outside > z + BEYOND:
                visible = 1.0
            else:
                continue
            ws.node_ends[n, 0], ws.node_ends[n, 1] = a, b
            node = nodes[n]
            node[0], node[1], node[2], node[3], node[4], node[5] = t, x, y, nx, ny, length / parts
            node[6] = visible
            n += 1
    return n


@kernel
def bilinear(image, x, y):
    """Interpolate an image (h, w) bilinearly at a pixel (x, y) well inside it."""
    i, j = int(x), int(y)
    a, b = x - i, y - j
    return (image[j, i] * (1 - a) + image[j, i + 1] * a) * (1 - b) + (
        image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a
    ) * b


@kernel
def inner_nodes(model, flow, ws):
    """Place nodes on the surface of the previous pose, and find where the flow has carried them; return their number.

    model: MonoModel.
    flow: FlowArrays.
    ws: scratch memory.

    The mesh and z-buffer of the previous pose are in ws. Nodes lie on a grid of flow.spacing px; ws.flow_faces and
    ws.flow_nodes get them. Hidden nodes, those near a jump in depth or on still parts, and outliers of the flow are
    omitted.
    """
    h, w = ws.depth.shape
    fh, fw = flow.error.shape
    if fh < 2 or fw < 2:
        return 0
    faces, seen, depth = model.mesh.faces, ws.seen, ws.depth
    how = flow.settings
    step = how.spacing_px
    n = 0
    for i in range(model.moving_faces.shape[0]):
        f = model.moving_faces[i]
        if ws.front[f] == 0:
            continue
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if not (model.moving_vertices[a] and model.moving_vertices[b] and model.moving_vertices[c]):
            continue
        x0, y0, x1, y1 = np.float64(seen[0, a]), np.float64(seen[1, a]), np.float64(seen[0, b]), np.float64(seen[1, b])
        x2, y2 = np.float64(seen[0, c]), np.float64(seen[1, c])
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        left, right = max(min(x0, min(x1, x2)), 5.0), min(max(x0, max(x1, x2)), w - 6.0)
        top, bottom = max(min(y0, min(y1, y2)), 5.0), min(max(y0, max(y1, y2)), h - 6.0)
        if not (left <= right and top <= bottom):
            continue
        for gy in range(int(math.ceil(top / step)), int(math.floor(bottom / step)) + 1):
            for gx in range(int(math.ceil(left / step)), int(math.floor(right / step)) + 1):
                x, y = gx * step, gy * step
                k1 = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
                k2 = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
                if k1 < 0 or k2 < 0 or k1 + k2 > 1:
                    continue
                # weights in space from those in the image
                wa, wb, wc = (1 - k1 - k2) / seen[2, a], k1 / seen[2, b], k2 / seen[2, c]
                z = 1 / (wa + wb + wc)
                xi, yi = int(x + 0.5), int(y + 0.5)
                if _depth(depth[yi, xi]) < z - 0.03:
                    continue
                inside = True
                for k in range(4):
                    ox, oy = (4, 0) if k == 0 else ((-4, 0) if k == 1 else ((0, 4) if k == 2 else (0, -4)))
                    jump = _depth(depth[yi + oy, xi + ox]) - z
                    if jump > 0.12 or jump < -0.12:
                        inside = False
                if not inside:
                    continue
                lx, ly = x - flow.corner[0], y - flow.corner[1]
                if lx < 0 or ly < 0 or lx > fw - 2 or ly > fh - 2:
                    continue
                if bilinear(flow.error, lx, ly) >= how.consistency_px:
                    continue
                if n >= ws.flow_nodes.shape[0]:
                    return n
                ws.flow_faces[n, 0], ws.flow_faces[n, 1], ws.flow_faces[n, 2] = a, b, c
                node = ws.flow_nodes[n]
                node[0], node[1] = wb * z, wc * z
                node[2] = x + bilinear(flow.flow[:, :, 0], lx, ly)
                node[3] = y + bilinear(flow.flow[:, :, 1], lx, ly)
                node[4] = (step / how.area_px) ** 2
                n += 1
    return n

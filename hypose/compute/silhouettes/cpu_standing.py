"""numba: the part of the body that stands still while a limb is searched, drawn once for all poses.

The layers of front faces over a pixel add up over the faces of the body, so the body's silhouette is the union of the
silhouettes of its parts, each drawn by its own front faces.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import camera_about_root, joint_frames, skin_about_root
from hypose.compute.silhouettes.cpu_silhouettes import (
    NEAR,
    contour_edges,
    emit_clipped_faces,
    emit_contours,
    front_faces,
    project,
)

f4 = np.float32
_GATHER = np.uint64(0x0102040810204080)
"""times eight bytes of 0 or 1: their bits in the highest byte, the first one lowest"""


@kernel
def stamp(mask, x0, y0, width, height, difference, running, own, bits, counts):
    """Sets the bits (h, B) of the silhouette whose winding differences are given in the window with corner (x0, y0);
    counts (2,): pixels set, those of them in the mask (h, w); running, own: scratch, own (8 (B + 1),) all zero."""
    shift = x0 & 7
    acc, inside = running[:width], own[shift : shift + width]
    words, first = own.view(np.uint64), x0 >> 3
    n_words = (shift + width + 7) >> 3
    acc[:] = 0
    model, hit = 0, 0
    for r in range(height):
        d, m, line = difference[r, :width], mask[y0 + r, x0 : x0 + width], bits[y0 + r]
        n_model, n_hit = np.uint32(0), np.uint32(0)
        for x in range(width):
            acc[x] = np.int8(acc[x] + d[x])
            inside[x] = np.uint8(acc[x] > 0)
            n_model += np.uint32(inside[x])
            n_hit += np.uint32(inside[x] & np.uint8(m[x] != 0))
        model += n_model
        hit += n_hit
        if n_model > 0:
            for w in range(n_words):
                line[first + w] |= np.uint8((words[w] * _GATHER) >> np.uint64(56))
    inside[:] = 0
    counts[0] = model
    counts[1] = hit


@kernel
def draw_standing(pose, tree, mesh, faces, standing, prepared, boxes, bits, counts):
    """Silhouettes of the faces (K, 3) of the mesh at a pose (D,), inside boxes (C, 4): bits (C, h, B), counts (C, 2)
    model and intersection pixels; standing (F,) tells the same faces among all."""
    n_joints, n_vertices = tree.parents.shape[0], mesh.vertices.shape[0]
    rotations, centres = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3))
    twists = np.empty((pose.shape[0], 6))
    vertices = np.empty((n_vertices, 3), np.float32)
    u, v = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    p, bounds = np.empty((3, 4), np.float32), np.empty(5, np.float32)
    front = np.empty(mesh.faces.shape[0], np.uint8)
    start, end = np.empty(mesh.edges.shape[0], np.int32), np.empty(mesh.edges.shape[0], np.int32)
    views, _, columns = prepared.masks.shape
    running, own = np.empty(columns, np.int8), np.zeros(8 * (bits.shape[2] + 1), np.uint8)
    joint_frames(pose, tree, rotations, centres, twists)
    skin_about_root(rotations, centres, tree, mesh, vertices)
    for c in range(views):
        if not prepared.usable[c]:
            continue
        camera_about_root(prepared.projections[c], pose, p)
        project(vertices, p, u, v, bounds)
        x0, x1, y0, y1 = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        near = not (bounds[4] >= NEAR)
        if not near:
            x0 = int(min(max(f4(x0), np.floor(bounds[0])), f4(x1)))
            x1 = int(max(min(f4(x1), np.ceil(bounds[1]) + f4(1)), f4(x0)))
            y0 = int(min(max(f4(y0), np.floor(bounds[2])), f4(y1)))
            y1 = int(max(min(f4(y1), np.ceil(bounds[3]) + f4(1)), f4(y0)))
        if x0 >= x1 or y0 >= y1:
            continue
        difference = np.zeros((y1 - y0 + 1, x1 - x0), np.int8)  # no larger: pages of memory touched first cost most
        if near:
            emit_clipped_faces(vertices, faces, p, x0, y0, x1 - x0, y1 - y0, difference, True)
        else:
            front_faces(mesh.faces, u, v, front)
            for f in range(front.shape[0]):
                front[f] &= standing[f]
            n = contour_edges(mesh.edges, front, start, end)
            emit_contours(n, start, end, u, v, x0, y0, x1 - x0, y1 - y0, difference)
        stamp(prepared.masks[c], x0, y0, x1 - x0, y1 - y0, difference, running, own, bits[c], counts[c])

"""numba: the part of the body that stands still while a limb is searched, drawn once for all poses.

The layers of front faces over a pixel add up over the faces of the body, so the body's silhouette is the union of the
silhouettes of its parts, each drawn by its own front faces.
"""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import joint_frames, skin_about_root
from hypose.compute.silhouettes.cpu_lanes import row_stride
from hypose.compute.silhouettes.cpu_silhouettes import NEAR, emit_clipped_faces
from hypose.compute.silhouettes.cpu_vectors import STRIP, fill_strip
from hypose.compute.silhouettes.cpu_views import (
    VIEWS,
    contours_of_any,
    contours_of_view,
    emit_lines,
    front_views,
    project_views,
)

f4 = np.float32


@kernel
def draw_standing(pose, tree, mesh, faces, standing, prepared, boxes, bits, counts):
    """Silhouettes of the faces (K, 3) of the mesh at a pose (D,), inside boxes (C, 4): bits (C, h, B), counts (C, 2)
    model and intersection pixels, both zero before; standing (F,) tells the same faces among all."""
    n_joints, n_vertices, n_edges = tree.parents.shape[0], mesh.vertices.shape[0], mesh.edges.shape[0]
    rotations, centres = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3))
    twists = np.empty((pose.shape[0], 6))
    vertices, uv = np.empty((n_vertices, 3), np.float32), np.empty((n_vertices, 2, VIEWS), np.float32)
    cameras, bounds = np.empty((VIEWS, 3, 4), np.float32), np.empty((5, VIEWS), np.float32)
    turned = np.empty((12, VIEWS), np.float32)
    front, union = np.empty(mesh.faces.shape[0], np.uint8), np.empty(n_edges, np.int32)
    start, end, lines = np.empty(n_edges, np.int32), np.empty(n_edges, np.int32), np.empty((4, n_edges), np.float32)
    n_union, line = 0, bits.shape[2]
    joint_frames(pose, tree, rotations, centres, twists)
    skin_about_root(rotations, centres, tree, mesh, vertices)
    for c in range(prepared.masks.shape[0]):
        k = c % VIEWS
        if k == 0:
            project_views(vertices, prepared.projections, c, pose, cameras, turned, uv, bounds)
            front_views(mesh.faces, uv, front)
            for f in range(front.shape[0]):
                front[f] = front[f] if standing[f] else np.uint8(0)
            n_union = contours_of_any(mesh.edges, front, union)
        if not prepared.usable[c]:
            continue
        x0, x1, y0, y1 = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        near = not (bounds[4, k] >= NEAR)
        if not near:
            x0 = int(min(max(f4(x0), np.floor(bounds[0, k])), f4(x1)))
            x1 = int(max(min(f4(x1), np.ceil(bounds[1, k]) + f4(1)), f4(x0)))
            y0 = int(min(max(f4(y0), np.floor(bounds[2, k])), f4(y1)))
            y1 = int(max(min(f4(y1), np.ceil(bounds[3, k]) + f4(1)), f4(y0)))
        if x0 >= x1 or y0 >= y1:
            continue
        width, height, aside = x1 - x0, y1 - y0, x0 & 7
        stride = row_stride(aside + width)
        # no larger: pages of memory touched first cost most
        begun = np.zeros((height + 1) * stride + aside, np.int8)
        difference = begun[aside:].reshape(height + 1, stride)
        if near:
            emit_clipped_faces(vertices, faces, cameras[k], x0, y0, width, height, difference, True)
        else:
            n = contours_of_view(k, n_union, union, mesh.edges, front, uv, start, end, lines)
            emit_lines(n, lines, x0, y0, width, height, difference)
        for s in range(0, aside + width, STRIP):
            place = (c * bits.shape[1] + y0) * line + ((x0 + s) >> 3)
            fill_strip(begun, s, stride, height, prepared.bits, bits, place, line, counts[c])

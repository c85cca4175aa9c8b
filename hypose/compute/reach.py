"""Draw the part of a body that stands still while a limb is searched, once for all poses; and score limbs as a few
points against masks: which of many poses lie where the rest of the body does not explain the mask.

The number of front faces over a pixel is a sum over the faces of the body, so that the silhouette of the body is the
union of the silhouettes of its parts, each drawn by its own front faces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import lane_mesh
from hypose.compute.arrays import MeshArrays, PreparedMasks, Standing, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.compute.coverage import (
    NEAR,
    STRIP,
    VIEWS,
    contours_of_any,
    contours_of_view,
    emit_faces,
    emit_lines,
    front_views,
    project_views,
    row_stride,
    sum_strip,
)
from hypose.compute.kinematics import joint_frames, skin_about_root
from hypose.compute.threads import over_chunks
from hypose.geometry import Array

f4 = np.float32


@kernel
def _draw_standing(pose, tree, mesh, faces, standing, prepared, bits, counts):
    """Draw the silhouettes of some faces of the mesh at a pose (D,).

    faces: (K, 3) the faces.
    standing: (F,) True for the same faces among all.
    prepared: masks of the frame; views that are not usable stay empty.
    bits: (C, h, B), zero before, gets the silhouettes.
    counts: (C, 2), zero before, gets model and intersection pixels.
    """
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
        x0, x1, y0, y1 = 0, prepared.sizes[c, 0], 0, prepared.sizes[c, 1]
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
        # no larger than needed: touching new pages of memory costs most
        begun = np.zeros((height + 1) * stride + aside, np.int8)
        difference = begun[aside:].reshape(height + 1, stride)
        if near:
            emit_faces(vertices, faces, cameras[k], x0, y0, width, height, difference, True)
        else:
            n = contours_of_view(k, n_union, union, mesh.edges, front, uv, start, end, lines)
            emit_lines(n, lines, x0, y0, width, height, difference)
        for s in range(0, aside + width, STRIP):
            place = (c * bits.shape[1] + y0) * line + ((x0 + s) >> 3)
            sum_strip(begun, s, stride, height, place, line, prepared.bits, None, bits, counts[c])


_BLOCK = 128
"""Number of poses that are computed together, in vector lanes."""


@kernel
def pixels(m, x, y, z, n, width, height, line, place):
    """Compute the pixels of n points x, y, z (n,) under a projection m (3, 4).

    width, height: width and height of the image, px.
    line: number of pixels of a row in memory.
    place: (n,) i4 gets line x row + column; -1 outside the image, and nearer than 0.05 m.
    """
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    w, h = np.float64(width), np.float64(height)
    for i in range(n):
        depth = m20 * x[i] + m21 * y[i] + m22 * z[i] + m23
        u = (m00 * x[i] + m01 * y[i] + m02 * z[i] + m03) / depth + 0.5
        v = (m10 * x[i] + m11 * y[i] + m12 * z[i] + m13) / depth + 0.5
        u = u if depth >= 0.05 else -1.0  # single choices one after the other can be vectorised
        u = u if u < w else -1.0
        u = u if v >= 0 else -1.0
        u = u if v < h else -1.0
        v = v if u >= 0 else 0.0
        u = u if u >= 0 else -1.0
        place[i] = np.int32(v) * np.int32(line) + np.int32(u)


@kernel
def _score_points(points, weights, rotation, centre, prepared, bits, cutoff, out):
    """Score points of limbs into out (N,), as `score_points`.

    points: (N, P, 3) m, in the frame of a joint.
    weights: (P,) weights of the points.
    rotation, centre: frame of the joint in the world, (3, 3) and (3,) m.
    prepared: masks of the frame.
    bits: (C, h, B) the standing parts, packed like the masks.
    cutoff: a pose whose score is certain to lie above it is not scored to the end.

    The last points are scored first, because ends of limbs are the most informative.
    """
    views = prepared.projections.shape[0]
    m = np.empty((views, 3, 4))
    seen = 0
    for c in range(views):
        seen += prepared.usable[c]
        for i in range(3):
            for j in range(3):
                a = 0.0
                for k in range(3):
                    a += prepared.projections[c, i, k] * rotation[k, j]
                m[c, i, j] = a
            a = prepared.projections[c, i, 3]
            for k in range(3):
                a += prepared.projections[c, i, k] * centre[k]
            m[c, i, 3] = a
    worth = 0.0
    for p in range(weights.shape[0]):
        worth += weights[p] * seen
    x, y, z = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    place, total, alive = np.empty(_BLOCK, np.int32), np.empty(_BLOCK), np.empty(_BLOCK, np.int64)
    worth_of, hidden, line = np.zeros(3), prepared.hidden.size > 0, 8 * bits.shape[2]
    for first in range(0, points.shape[0], _BLOCK):
        n_alive = min(_BLOCK, points.shape[0] - first)
        for n in range(n_alive):
            alive[n], total[n] = n, 0.0
        n_block, left = n_alive, worth
        for p in range(points.shape[1] - 1, -1, -1):
            n = 0
            for i in range(n_alive):
                alive[n] = alive[i]
                n += not total[alive[i]] - left > cutoff  # else the remaining points cannot make up for it
            n_alive = n
            left -= weights[p] * seen
            worth_of[0], worth_of[1] = weights[p], -weights[p]  # no mask; a mask alone; a standing part, or nothing
            for i in range(n_alive):
                point = points[first + alive[i], p]
                x[i], y[i], z[i] = point[0], point[1], point[2]
            for c in range(views):
                if prepared.usable[c]:
                    pixels(m[c], x, y, z, n_alive, prepared.sizes[c, 0], prepared.sizes[c, 1], line, place)
                    mask, drawn = prepared.bits[c, 0], bits[c, 0]  # and on, as if the view were one row
                    for i in range(n_alive):  # without branches, which cannot be predicted
                        at = place[i]
                        byte, bit = np.uint32(max(at, np.int32(0))) >> np.uint32(3), np.uint8(at & 7)
                        decided = mask[byte]
                        if hidden:
                            decided |= prepared.hidden[c, 0, byte]
                        kind = ((decided >> bit) & 1) + (((decided & drawn[byte]) >> bit) & 1)
                        total[alive[i]] += worth_of[np.uint8(kind) if at >= 0 else np.uint8(2)]
        for n in range(n_block):
            out[first + n] = total[n]


def standing(
    pose: ArrayLike, tree: TreeArrays, mesh: MeshArrays, prepared: PreparedMasks, moving: ArrayLike
) -> Standing:
    """Draw the silhouettes of the parts of a body that do not move when some joints turn.

    pose: (D,) at which the parts stand.
    tree, mesh: joint tree and mesh of the body.
    prepared: masks of the frame.
    moving: (J,) bool, joints that turn; they and the joints below them are left out.
    Returns: the silhouettes in the masks' pixels, ignored pixels included, and their counts without these.
    """
    q, turning = plain(pose, np.float64), plain(moving, np.bool_)
    parts, given = lane_mesh.moving_parts(mesh, tree, turning), tidy(prepared)
    bits, counts = np.zeros_like(prepared.bits), np.zeros((len(prepared.masks), 2), dtype=np.int64)
    _draw_standing(q, tidy(tree), tidy(mesh), parts.corners, parts.standing, given, bits, counts)
    if prepared.hidden.size:  # ignored pixels are drawn, so that nothing else counts there, and count for nothing
        counts[:, 0] -= np.bitwise_count(bits & prepared.hidden).sum((1, 2), dtype=np.int64)
        np.bitwise_or(bits, prepared.hidden, out=bits)
    return Standing(bits, counts)


def whole_images(prepared: PreparedMasks) -> NDArray[np.int64]:
    """Return the boxes x0, x1, y0, y1 (C, 4) of whole views, px."""
    boxes = np.zeros((len(prepared.sizes), 4), dtype=np.int64)
    boxes[:, 1::2] = prepared.sizes
    return boxes


def score_points(
    points: ArrayLike,
    weights: ArrayLike,
    rotation: ArrayLike,
    centre: ArrayLike,
    prepared: PreparedMasks,
    rest: Standing,
    cutoff: float = np.inf,
) -> Array:
    """Score how badly points of a limb lie on the masks, given in the frame of a joint.

    points: (N, P, 3) m.
    weights: (P,) weight (area) of each point.
    rotation, centre: frame of the joint in the world, (3, 3) and (3,) m.
    prepared: masks of the frame.
    rest: drawing of the standing parts.
    cutoff: scores above it are not computed to the end.
    Returns: (N,) sums over usable views and points of the weight: plus where there is no mask, minus in the mask where
        the standing parts are not; 0 on the standing parts, outside the image, and nearer than 0.05 m. Above the cutoff
        a score only means that it lies above it.
    """
    p, w = plain(points, np.float64), plain(weights, np.float64)
    frame = plain(rotation, np.float64), plain(centre, np.float64)
    out, given = np.empty(len(p)), (w, *frame, tidy(prepared), rest.bits, float(cutoff))
    over_chunks(lambda i, k: _score_points(p[i:k], *given, out[i:k]), len(p), None, 256)
    return out

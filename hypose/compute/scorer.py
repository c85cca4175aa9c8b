"""Compare silhouettes of many poses with the masks of a frame, LANES poses at a time, by contour winding differences.

The drawing is that of coverage.py: each contour edge writes the indices of the pixels where it crosses columns to one
of two lists per pose (up or down), the lists are added into an int8 image, and one pass of running sums compares STRIP
columns at a time with the mask's packed bits. Poses that reach the near plane, and bodies so near that their lists are
full, are drawn face by face.
Before a limb is drawn, its cost has a lower bound: it cannot explain more of a mask than the uncovered pixels in its
window.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import lane_mesh, reach
from hypose.compute.arrays import MeshArrays, PreparedMasks, Standing, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.compute.coverage import (
    LANES,
    NEAR,
    STRIP,
    draw_lists,
    emit_faces,
    list_crossings,
    project_vertices,
    row_stride,
    sum_strip,
)
from hypose.compute.kinematics import bone_map, frames_of
from hypose.compute.lane_mesh import lane_scratch
from hypose.compute.simd import load, splat, store, times_plus
from hypose.compute.threads import over_chunks
from hypose.errors import InputError, SolverError
from hypose.geometry import Array

f4 = np.float32


@kernel
def skin_vertex(maps, joint, weight, first, end, x, y, z, out, vertex):
    """Skin one vertex x, y, z (f4) in all lanes by linear blend skinning.

    maps: (J, 12, LANES) f4, rows of the (3, 4) maps.
    joint, weight: influences first..end (i4, f4).
    out: (V, 3, LANES) f4, row `vertex` gets the result.
    """
    a, b, c = splat(f4(0), LANES), splat(f4(0), LANES), splat(f4(0), LANES)
    for k in range(first, end):
        w, at = weight[k], joint[k] * (12 * LANES)
        a = _add_row(maps, at, w * x, w * y, w * z, w, a)
        b = _add_row(maps, at + 4 * LANES, w * x, w * y, w * z, w, b)
        c = _add_row(maps, at + 8 * LANES, w * x, w * y, w * z, w, c)
    store(out, vertex * (3 * LANES), a)
    store(out, vertex * (3 * LANES) + LANES, b)
    store(out, vertex * (3 * LANES) + 2 * LANES, c)


@kernel
def _add_row(maps, at, x, y, z, w, total):
    """Add one row of a map, from the flat index `at` on, times (x, y, z, w) to total, in all lanes."""
    total = times_plus(load(maps, at, LANES), x, total)
    total = times_plus(load(maps, at + LANES, LANES), y, total)
    total = times_plus(load(maps, at + 2 * LANES, LANES), z, total)
    return times_plus(load(maps, at + 3 * LANES, LANES), w, total)


@kernel
def skin_lanes(poses, first, tree, mesh, turning, rotations, centres, maps, points):
    """Skin the mesh in LANES poses at once, from index `first` on (the last pose is repeated).

    poses: (N, D) pose vectors, rad and m.
    tree: joint tree of the body.
    mesh: LaneMesh.
    turning: indices of the joints that have moved since the last call, parents before their children.
    rotations, centres: (LANES, J, 3, 3) and (LANES, J, 3) joint frames of the poses, about the root; those of these
        joints are computed.
    maps: (J, 12, LANES) f4 rows of the (3, 4) affine maps by which joints carry the vertices at rest; likewise.
    points: (V, 3, LANES) f4 gets the vertices relative to each pose's root, m.
    """
    last, own = poses.shape[0] - 1, np.empty(12, np.float32)
    for k in range(LANES):
        frames_of(poses[min(first + k, last)], tree, turning, rotations[k], centres[k], None)
        for n in range(turning.shape[0]):
            j = turning[n]
            bone_map(rotations[k, j], centres[k, j], tree.joints[j], own)
            for i in range(12):
                maps[j, i, k] = own[i]
    for i in range(points.shape[0]):
        x, y, z = mesh.vertices[i, 0], mesh.vertices[i, 1], mesh.vertices[i, 2]
        skin_vertex(maps, mesh.joint, mesh.weight, mesh.start[i], mesh.start[i + 1], x, y, z, points, i)


@kernel
def camera_lanes(projection, poses, first, p):
    """Convert a projection (3, 4) f8 of world points to p (12, LANES) f4 for points about each pose's root.

    poses, first: (N, D) poses, and the first of the LANES poses (the last one is repeated).
    """
    last = poses.shape[0] - 1
    for r in range(3):
        for k in range(LANES):
            q = poses[min(first + k, last)]
            for c in range(3):
                p[4 * r + c, k] = projection[r, c]
            p[4 * r + 3, k] = (
                projection[r, 0] * q[0] + projection[r, 1] * q[1] + projection[r, 2] * q[2] + projection[r, 3]
            )


@kernel
def lane_windows(bounds, box, lanes, window, origin):
    """Compute the image window of each of LANES poses: the part of the bounding box of its silhouette that lies in a
    box (x0, x1, y0, y1).

    bounds: (5, LANES), by `coverage.project_vertices`.
    lanes: number of lanes in use.
    window: (5, LANES) f4 gets origin x, y, first and end column, rows.
    origin: (LANES, 4) i8 gets x, y, columns, rows. Windows begin at a multiple of 8 columns, where the mask's bits
        begin a byte.
    Returns: two masks of lanes: those to draw, and those that reach the near plane (their window is the whole box).
    """
    some, near = np.uint32(0), np.uint32(0)
    for k in range(lanes):
        x0, x1, y0, y1 = box[0], box[1], box[2], box[3]
        if bounds[4, k] >= NEAR:  # half-open sampling: first pixel ceil(minimum), one past the last ceil(maximum)
            x0 = int(min(max(f4(x0), np.ceil(bounds[0, k])), f4(x1)))
            x1 = int(max(min(f4(x1), np.ceil(bounds[1, k])), f4(x0)))
            y0 = int(min(max(f4(y0), np.ceil(bounds[2, k])), f4(y1)))
            y1 = int(max(min(f4(y1), np.ceil(bounds[3, k])), f4(y0)))
        if x0 < x1 and y0 < y1:
            if bounds[4, k] >= NEAR:
                some |= np.uint32(1) << np.uint32(k)
            else:
                near |= np.uint32(1) << np.uint32(k)
        left = x0 & ~7
        origin[k, 0], origin[k, 1], origin[k, 2], origin[k, 3] = left, y0, x1 - left, y1 - y0
        window[0, k], window[1, k], window[2, k], window[3, k], window[4, k] = left, y0, x0 - left, x1 - left, y1 - y0
    return some, near


@kernel
def _silhouette_xor(
    poses,
    first,
    last,
    tree,
    mesh,
    moved_joints,
    turning,
    prepared,
    usable,
    boxes,
    box_areas,
    drawn,
    drawn_counts,
    scratch,
    out,
):
    """Compare blocks first..last (of LANES poses) with the masks, inside boxes (C, 4), in the views that are usable
    (C,).

    poses: (N, D) pose vectors, rad and m.
    tree, mesh: joint tree and mesh of the body, the mesh as LaneMesh.
    prepared: masks of the frame.
    box_areas: (C,) pixels of the masks in the boxes.
    moved_joints, turning: indices of the joints to compute for the first block, and for the others.
    drawn: (C, h, B) packed like the masks, pixels that belong to the body in every pose.
    drawn_counts: (C, 2) model and intersection pixels of these.
    scratch: scratch memory from `lane_mesh.lane_scratch`, for this mesh and these images.
    out: (N, C, 3) gets (xor, model, intersection) pixels.
    """
    views, image_rows, _ = prepared.masks.shape
    rotations, centres, maps, points, u, v, p, bounds, window, origin = scratch[:10]
    front, union, edge, columns, lists, ends, difference, counts = scratch[10:]
    mask_stride = prepared.bits.shape[2]
    for block in range(first, last):
        begin = block * LANES
        lanes = min(LANES, poses.shape[0] - begin)
        moved = moved_joints if block == first else turning
        skin_lanes(poses, begin, tree, mesh, moved, rotations, centres, maps, points)
        for c in range(views):
            if not usable[c]:
                continue
            camera_lanes(prepared.projections[c], poses, begin, p)
            project_vertices(points, p, u, v, bounds)
            some, near = lane_windows(bounds, boxes[c], lanes, window, origin)
            full = np.uint32(0)
            if some != 0:
                full = list_crossings(mesh, u, v, some, window, origin, front, union, edge, columns, lists, ends)
            for k in range(lanes):
                bit = np.uint32(1) << np.uint32(k)
                counts[0] = counts[1] = 0
                if ((some | near) & bit) != 0:
                    stride, rows = row_stride(origin[k, 2]), origin[k, 3]
                    if ((near | full) & bit) != 0:
                        aside = np.int64(window[2, k])
                        plane = difference[aside : aside + (rows + 1) * stride].reshape(rows + 1, stride)
                        left, width = origin[k, 0] + aside, origin[k, 2] - aside
                        one_sided = mesh.one_sided or (near & bit) == 0
                        vertices, camera = points[:, :, k].copy(), p[:, k].copy().reshape(3, 4)
                        emit_faces(vertices, mesh.faces, camera, left, origin[k, 1], width, rows, plane, one_sided)
                    else:
                        up, down = lists[2 * k, : ends[2 * k]], lists[2 * k + 1, : ends[2 * k + 1]]
                        draw_lists(up, down, difference)
                    corner = (c * image_rows + origin[k, 1]) * mask_stride + (origin[k, 0] >> 3)
                    for s in range(0, origin[k, 2], STRIP):
                        place = corner + (s >> 3)
                        sum_strip(difference, s, stride, rows, place, mask_stride, prepared.bits, drawn, None, counts)
                        for x in range(s, s + STRIP):
                            difference[rows * stride + x] = 0
                model, hits = counts[0] + drawn_counts[c, 0], counts[1] + drawn_counts[c, 1]
                out[begin + k, c, 0] = model + box_areas[c] - 2 * hits
                out[begin + k, c, 1] = model
                out[begin + k, c, 2] = hits


CELL = 8
"""Number of rows that are counted together, and of columns: those of a byte."""

u1 = np.uint8


@kernel
def uncovered(prepared, drawn, cells):
    """Sum the pixels of the masks that the drawing `drawn` (C, h, B), packed as the masks, does not cover, over all
    cells above and to the left of each cell (integral image).

    prepared: masks of the frame.
    cells: (C, R + 1, B + 1) i4, zero before, gets the sums.
    """
    for c in range(prepared.bits.shape[0]):
        if not prepared.usable[c]:
            continue
        total = cells[c]
        for r in range(prepared.bits.shape[1]):
            mask, other, line = prepared.bits[c, r], drawn[c, r], total[r // CELL + 1, 1:]
            for b in range(mask.shape[0]):
                x = mask[b] & u1(~other[b])
                x = u1(x - ((x >> 1) & 0x55))
                x = u1((x & 0x33) + ((x >> 2) & 0x33))
                line[b] += (x + (x >> 4)) & 0x0F
        for r in range(1, total.shape[0]):
            along = np.int32(0)
            for b in range(1, total.shape[1]):
                along += total[r, b]
                total[r, b] = total[r - 1, b] + along


@kernel
def least_energies(poses, first, last, tree, mesh, turning, prepared, boxes, drawn_counts, cells, scratch, out):
    """Compute lower bounds of the silhouette cost of poses, for the blocks first..last of LANES poses each, into out
    (N, C).

    poses: (N, D) pose vectors, rad and m.
    tree, mesh, prepared: joint tree and mesh of the body, and masks of the frame.
    turning, boxes, drawn_counts, scratch: the same arrays with which `_silhouette_xor` was called.
    cells: sums as filled by `uncovered`.
    """
    rotations, centres, maps, points, u, v, p, bounds, window, origin = scratch[:10]
    for block in range(first, last):
        begin = block * LANES
        lanes = min(LANES, poses.shape[0] - begin)
        skin_lanes(poses, begin, tree, mesh, turning, rotations, centres, maps, points)
        for c in range(prepared.bits.shape[0]):
            if not prepared.usable[c]:
                continue
            camera_lanes(prepared.projections[c], poses, begin, p)
            project_vertices(points, p, u, v, bounds)
            lane_windows(bounds, boxes[c], lanes, window, origin)
            sums = cells[c]
            for k in range(lanes):
                left, top = origin[k, 0] // CELL, origin[k, 1] // CELL
                right = (origin[k, 0] + origin[k, 2] + CELL - 1) // CELL
                bottom = (origin[k, 1] + origin[k, 3] + CELL - 1) // CELL
                open_pixels = sums[bottom, right] - sums[bottom, left] - sums[top, right] + sums[top, left]
                worst = drawn_counts[c, 0] + prepared.areas[c] - 2 * drawn_counts[c, 1]
                out[begin + k, c] = (worst - open_pixels) / prepared.norm[c]


@kernel
def view_that_tells(cells, norm, left):
    """Find the view, among `left`, with the largest share of mask that is not drawn yet.

    cells: (C, R + 1, B + 1) pixels of the mask that are not drawn, summed by `uncovered`.
    norm: (C,) divisor of each view's pixel count.
    left: (C,) bool, views that are still open.
    Returns: index of the view; -1 where there is none.
    """
    best, found = -1.0, -1
    for c in range(norm.shape[0]):
        if left[c] and cells[c, -1, -1] / norm[c] > best:
            best, found = cells[c, -1, -1] / norm[c], c
    return found


@kernel
def _limb_energies(
    poses, slack, more, tree, mesh, turning, prepared, boxes, drawn, drawn_counts, cells, scratch, counts, decided
):
    """Compare poses of a limb with the masks, one view after the other, and drop poses that are certainly too costly.

    slack, more: a pose is dropped when it costs more than `slack` times the first one, plus `more`.
    cells: zero before. The other arguments are as for `_silhouette_xor`.
    counts: (N, C, 3), zero before, gets the counts of `_silhouette_xor`.
    decided: (N,), False before, gets whether the counts are those of all views.
    """
    n, views, n_dof = poses.shape[0], prepared.bits.shape[0], poses.shape[1]
    norm, left, limit, view = prepared.norm, prepared.usable.copy(), more + 1e-9 * abs(more), -1
    alive, n_alive = np.arange(n), min(n, LANES)  # the first block is as much work as the first pose alone
    least, total, only, moved_joints = np.zeros((n, views)), np.zeros(n), prepared.usable, mesh.needed
    while True:
        tried, out = np.empty((n_alive, n_dof)), np.zeros((n_alive, views, 3), np.int64)
        for i in range(n_alive):
            for d in range(n_dof):
                tried[i, d] = poses[alive[i], d]
        blocks = (n_alive + LANES - 1) // LANES
        _silhouette_xor(
            *(tried, 0, blocks, tree, mesh, moved_joints, turning),
            *(prepared, only, boxes, prepared.areas, drawn, drawn_counts, scratch, out),
        )
        kept = 0
        for i in range(n_alive):
            a = alive[i]
            for c in range(views):
                if only[c]:
                    for k in range(3):
                        counts[a, c, k] = out[i, c, k]
                    if view >= 0:
                        total[a] += out[i, c, 0] / norm[c] - least[a, c]
                    elif a == 0:
                        limit += out[i, c, 0] / norm[c] * slack * (1 + 1e-9)  # sums may round otherwise
            decided[a] = view < 0
            alive[kept] = a
            kept += total[a] <= limit
        n_alive = kept
        if view < 0:
            uncovered(prepared, drawn, cells)
            blocks = (n + LANES - 1) // LANES
            least_energies(poses, 1, blocks, tree, mesh, turning, prepared, boxes, drawn_counts, cells, scratch, least)
            n_alive = 0
            for a in range(min(n, LANES), n):
                for c in range(views):
                    total[a] += least[a, c]
                alive[n_alive] = a
                n_alive += total[a] <= limit
        view = view_that_tells(cells, norm, left) if n_alive > 0 else -1
        if view < 0:
            break
        only = np.zeros(views, np.bool_)
        only[view] = True
        left[view] = False
        moved_joints = turning
    for i in range(n_alive):
        decided[alive[i]] = True


def silhouette_xor(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    boxes: ArrayLike | None = None,
    threads: int | None = None,
    faces: ArrayLike | None = None,
    moving: ArrayLike | None = None,
    rest: Standing | None = None,
) -> NDArray[np.int64]:
    """Compare silhouettes of the mesh at poses (N, D) with the frame's masks.

    tree, mesh: joint tree and mesh of the body.
    prepared: masks of the frame.
    boxes: (C, 4) = x0, x1, y0, y1 (half open, px) within which pixels are counted; None: each view's whole image.
    threads: number of threads; None: the default.
    faces: (F,) bool: only these triangles of the mesh, as seen from outside (body parts, where a hierarchical search
        has not placed the rest yet).
    moving: (J,) bool: only these joints turn; everything else stands as in the last pose, and is drawn once. Not
        together with boxes or faces.
    rest: drawing of the parts that do not move, made by `reach.standing`; None: it is made.
    Returns: (N, C, 3) = (xor, model, intersection) pixels; zeros in views that are not usable.
    Raises: SolverError for poses that are not finite.

    The counts are the same for any number of threads, and for a pose alone or among others. They are exact up to 1-2
    pixels of a silhouette whose edge passes through a pixel's centre. Faces with a corner nearer than 0.05 m to a
    camera's plane, or behind it, are omitted.
    """
    q = _finite(poses)
    n, c = len(q), len(prepared.masks)
    b = reach.whole_images(prepared)
    if boxes is not None:
        whole, b = b, np.array(boxes, dtype=np.int64)
        if b.shape != (c, 4):
            raise InputError(f"boxes needs one row x0, x1, y0, y1 per view: shape {(c, 4)}, got {b.shape}.")
        b = np.ascontiguousarray(np.clip(b, 0, whole[:, [1, 1, 3, 3]]))
        b[:, 1::2] = np.maximum(b[:, 1::2], b[:, ::2])
    wanted = None if faces is None else plain(faces, np.bool_)
    if wanted is not None and wanted.shape != (len(mesh.faces),):
        raise InputError(f"faces needs a truth value per face: shape {(len(mesh.faces),)}, got {wanted.shape}.")
    turning = None if moving is None else plain(moving, np.bool_)
    if turning is not None:
        q = np.where(turning[tree.joint_of_dof], q, q[-1:])
    t, prepared = tidy(tree), tidy(prepared)
    areas = prepared.areas
    if boxes is not None:
        inside = (m[y0:y1, x0:x1] for m, (x0, x1, y0, y1) in zip(prepared.masks, b, strict=True))
        areas = np.array([np.count_nonzero(m) for m in inside], dtype=np.int64)
    drawn, drawn_counts = np.zeros_like(prepared.bits), np.zeros((c, 2), dtype=np.int64)
    moved = np.ones(len(tree.parents), np.bool_)
    if turning is not None and n:
        parts = lane_mesh.moving_parts(mesh, tree, turning)
        wanted, moved = parts.moved, parts.turning
        drawn, drawn_counts = rest or reach.standing(q[-1], tree, mesh, prepared, turning)
    elif prepared.hidden.size:
        drawn = prepared.hidden  # one more standing part, of another person: it counts nowhere
    m = lane_mesh.prepare_lanes(mesh, tree, wanted)
    out = np.zeros((n, c, 3), dtype=np.int64)

    def score(first: int, last: int) -> None:
        scratch = lane_scratch(m, len(tree.parents), prepared.masks.shape[1:])
        _silhouette_xor(
            *(q, first, last, t, m, m.needed, m.needed[moved[m.needed]]),
            *(prepared, prepared.usable, b, areas, drawn, drawn_counts, scratch, out),
        )

    over_chunks(score, -(-n // LANES), threads)
    return out


def limb_energies(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    moving: ArrayLike,
    rest: Standing | None = None,
    slack: float = 1.0,
    more: float = 0.0,
) -> Array:
    """Compute the silhouette energies (eq. 2.8) of poses (N, D) in which only the joints `moving` (J,) turn.

    tree, mesh: joint tree and mesh of the body.
    prepared: masks of the frame.
    rest: drawing of the standing parts; None: it is made.
    slack, more: poses whose energy is certainly above `slack` times that of the first pose, plus `more`, are not
        computed to the end.
    Returns: (N,) energies; infinite for such poses.

    Why: most poses of a limb are worse than its current one, and one or two views show it, because a limb cannot
    explain more of a mask than what lies uncovered in its window. The others have the energies of `silhouette_xor`.
    """
    use = prepared.usable
    q, turning = _finite(poses), plain(moving, np.bool_)
    q = np.where(turning[tree.joint_of_dof], q, q[-1:])
    prepared = tidy(prepared)
    drawn, drawn_counts = rest or reach.standing(q[-1], tree, mesh, prepared, turning)
    parts = lane_mesh.moving_parts(mesh, tree, turning)
    m = lane_mesh.prepare_lanes(mesh, tree, parts.moved)
    scratch = lane_scratch(m, len(tree.parents), prepared.masks.shape[1:])
    cells = np.zeros((len(use), -(-drawn.shape[1] // CELL) + 1, drawn.shape[2] + 1), dtype=np.int32)
    counts, decided = np.zeros((len(q), len(use), 3), dtype=np.int64), np.zeros(len(q), dtype=np.bool_)
    turned, boxes = m.needed[parts.turning[m.needed]], reach.whole_images(prepared)
    given = tidy(tree), m, turned, prepared, boxes, drawn, drawn_counts
    _limb_energies(q, float(slack), float(more), *given, cells, scratch, counts, decided)
    return np.where(decided, (counts[:, use, 0] / prepared.norm[use]).sum(1), np.inf)


def _finite(poses: ArrayLike) -> Array:
    """Return poses (N, D) as a plain array.

    Raises: SolverError where a number is not finite, or above 1e6.
    """
    q = plain(poses, np.float64)
    if q.size and not np.abs(q).max() < 1e6:
        bad = int(np.argmax(~(np.abs(q).max(1) < 1e6)))
        raise SolverError(f"Pose {bad} of {len(q)} is not finite; check the motion model that made it.")
    return q

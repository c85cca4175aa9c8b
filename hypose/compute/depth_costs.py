"""Compare posed bodies with depth maps: the difference of depth over the pixels that show both."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.compute.kinematics import (
    bone_map,
    camera_about_root,
    frames_of,
    joint_frames,
    skin_about_root,
    skin_vertices,
)
from hypose.compute.lane_mesh import moving_parts
from hypose.compute.threads import over_chunks
from hypose.compute.zbuffer import draw_nearest, project


class SeenDepth(NamedTuple):
    """Depth maps of a person from C sensors, small, so that many bodies can be compared with them.

    maps: (C, h, w) m along the optical axis at the person's pixels, 0 elsewhere.
    sizes: (C, 2) width, height of each.
    projections: (C, 3, 4) pinhole projections to these pixels; the last row has unit length, so that it gives
        metres.
    counts: (C,) number of pixels of the person.
    """

    maps: NDArray[np.float32]
    sizes: NDArray[np.int64]
    projections: NDArray[np.float64]
    counts: NDArray[np.int64]


class StandingDepth(NamedTuple):
    """Parts of a body that stand still while a limb is searched, drawn once.

    pose: (D,) pose in which they were drawn.
    rotations: (J, 3, 3) rotations of all joints at this pose.
    centres: (J, 3) m, relative to the root's position.
    joints: indices of the joints that turn, in the tree's order.
    faces: indices of the faces that move.
    vertices: indices of their vertices.
    drawn: (C, h, w) 1/m, 0 = none: inverse depth of the standing faces.
    cost: (C,) depth cost of the standing faces in each view, in pixels.
    """

    pose: NDArray[np.float64]
    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    joints: NDArray[np.int64]
    faces: NDArray[np.int64]
    vertices: NDArray[np.int64]
    drawn: NDArray[np.float32]
    cost: NDArray[np.float64]


def depth_energy(
    poses: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, threads: int | None = None
) -> NDArray[np.float64]:
    """Compute how badly the depths of posed bodies fit the depth maps.

    tree, mesh: joint tree and mesh of the body.
    poses: (N, D) pose vectors, rad and m.
    seen: depth maps of the person.
    most_m: largest difference that counts, m.
    threads: number of threads; None: the default.
    Returns: (N, C): the sum over pixels that show both the person and the body of min(|z - z'|, most_m) / most_m,
        divided by the person's pixels. Pixels that show only one of them are left to the silhouettes. 0 for a view
        without the person. The result is the same for any number of threads, and for a pose alone or among others.
    """
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    given = tidy(tree), tidy(mesh), seen, np.float32(most_m)
    over_chunks(lambda first, last: _energies(q, first, last, *given, out), len(q), threads, 16)
    return out / np.maximum(seen.counts, 1)


def standing_depth(
    pose: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, moving: ArrayLike
) -> StandingDepth:
    """Draw the parts of a body at a pose (D,) that stand still while a limb moves.

    tree, mesh: joint tree and mesh of the body.
    seen: depth maps of the person.
    most_m: largest difference of depth that counts, m.
    moving: (J,) bool, joints that move; they and the joints below them are left out.
    Returns: the drawn parts, for `limb_depth_energy`.
    """
    q = plain(pose, np.float64)
    n = len(tree.parents)
    parts = moving_parts(mesh, tree, plain(moving, np.bool_))
    rotations, centres = np.empty((n, 3, 3)), np.empty((n, 3))
    drawn, cost = np.empty(seen.maps.shape, np.float32), np.zeros(len(seen.maps))
    given = tidy(tree), tidy(mesh), np.flatnonzero(parts.standing), seen, np.float32(most_m)
    _stand(q, *given, rotations, centres, drawn, cost)
    joints, faces = np.flatnonzero(parts.turning), np.flatnonzero(parts.moved)
    return StandingDepth(q, rotations, centres, joints, faces, parts.vertices, drawn, cost)


def limb_depth_energy(
    poses: ArrayLike,
    tree: TreeArrays,
    mesh: MeshArrays,
    seen: SeenDepth,
    most_m: float,
    standing: StandingDepth,
    rough: bool = False,
    threads: int | None = None,
) -> NDArray[np.float64]:
    """Compute `depth_energy` of poses that differ only in one limb from the standing parts.

    poses: (N, D) pose vectors, rad and m.
    tree, mesh: joint tree and mesh of the body.
    seen: depth maps of the person.
    most_m: largest difference of depth that counts, m.
    standing: drawn by `standing_depth`.
    rough: do not draw the limb, but compare each of its faces at its middle, which takes half the time.
    Returns: (N, C) depth energy of each pose in each view, as defined in `depth_energy`.
    """
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    given = tidy(tree), tidy(mesh), standing, seen, np.float32(most_m), rough
    over_chunks(lambda first, last: _limb_energies(q, first, last, *given, out), len(q), threads, 96 if rough else 16)
    return out / np.maximum(seen.counts, 1)


def limb_shown(
    tree: TreeArrays,
    mesh: MeshArrays,
    seen: SeenDepth,
    standing: StandingDepth,
    centre: ArrayLike,
    reach_m: float,
    apart_m: float,
) -> NDArray[np.float64]:
    """Measure how much of a limb a sensor shows, at the pose at which the standing parts were drawn.

    tree, mesh: joint tree and mesh of the body.
    seen: depth maps of the person.
    standing: parts without the limb.
    centre: (3,) m, world; areas are computed at its distance.
    reach_m: radius around the centre in which measured surface counts, m.
    apart_m: largest distance of surfaces that agree, m.
    Returns: (C, 3) m^2: visible area of the limb; area of that within apart_m of the measured surface; measured area
        within the reach that lies more than apart_m in front of the whole body, or next to it.
    """
    out = np.zeros((len(seen.maps), 3))
    at = plain(np.asarray(centre, dtype=np.float64) - standing.pose[:3], np.float64)
    _limb_shown(tidy(tree), tidy(mesh), standing, seen, at, float(reach_m), np.float32(apart_m), out)
    return out


f4 = np.float32
_NO_SURFACE = f4(1e9)


@kernel(inline=True)
def _off(near, other, most):
    """Compute the cost of one pixel, m: the difference of depths, at most `most`; 0 where one of the two is missing.

    near: inverse depth of the body, 1/m; 0: none.
    other: measured depth, m; 0: none.
    """
    if other > f4(0) and near > f4(0):
        return min(abs(f4(1) / near - other), most)
    return f4(0)


@kernel
def _cost(nearest, seen, most, box):
    """Sum the costs of `_off` over the pixels of a box.

    nearest: (h, w) f4 1/m, drawn picture.
    seen: (h, w) f4 m, measured depth.
    most: largest difference that counts, m.
    box: (4,) x0, x1, y0, y1, half open, px.
    """
    total = 0.0
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            total += _off(nearest[y, x], seen[y, x], most)
    return total


@kernel
def _roughly(faces, chosen, about, seen, most, standing, size):
    """Estimate by how much the cost grows with the chosen faces in front of the standing parts (h, w) f4 1/m.

    faces: (F, 3).
    chosen: indices of the limb's faces.

    Each face is compared at its middle and weighted by its area, without hiding other faces.
    about: (4, V) projected vertices, by `zbuffer.project`.
    seen: (h, w) f4 measured depth, m.
    most: largest difference that counts, m.
    size: (2,) width and height of the picture.
    Returns: the growth, m times pixels.
    """
    u, v, z, grown = about[0], about[1], about[2], f4(0)
    third, half = f4(1 / 3), f4(0.5)
    for k in range(chosen.shape[0]):
        f = chosen[k]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        twice = (xc - xa) * (yb - ya) - (xb - xa) * (yc - ya)
        if not twice > f4(0) or z[a] < f4(0.05) or z[b] < f4(0.05) or z[c] < f4(0.05):
            continue
        left, top = (xa + xb + xc) * third + half, (ya + yb + yc) * third + half
        if not (left >= f4(0) and top >= f4(0) and left < f4(size[0]) and top < f4(size[1])):
            continue
        x, y = int(left), int(top)
        own, before = f4(3) / (z[a] + z[b] + z[c]), standing[y, x]
        if own > before:
            grown += half * twice * (_off(own, seen[y, x], most) - _off(before, seen[y, x], most))
    return grown


@kernel
def _draw(about, faces, chosen, size, drawn):
    """Draw the chosen faces, projected by `zbuffer.project` into about (4, V), into drawn (h, w) f4, 1/m."""
    draw_nearest(about[0], about[1], about[3], faces, chosen, True, drawn[: size[1], : size[0]], None)


@kernel
def _energies(poses, first, last, tree, mesh, seen, most, out):
    """Compute the costs of drawn poses against depth maps: the sum of `_off`, over most.

    poses, first, last: (N, D), of which those from first to last are computed.
    tree, mesh: joint tree and mesh of the body.
    seen: SeenDepth.
    most: largest difference that counts, m.
    out: (N, C) gets the costs, in pixels.
    """
    every, drawn = np.arange(mesh.faces.shape[0]), np.empty(seen.maps.shape, np.float32)
    rotations, centres = np.empty((tree.parents.shape[0], 3, 3)), np.empty((tree.parents.shape[0], 3))
    for n in range(first, last):
        _stand(poses[n], tree, mesh, every, seen, most, rotations, centres, drawn, out[n])


@kernel
def _stand(q, tree, mesh, faces, seen, most, rotations, centres, drawn, cost):
    """Draw some faces of the body at pose q (D,) and compute their cost; all outputs are overwritten.

    tree, mesh: joint tree and mesh of the body.
    faces: indices of the faces that are drawn.
    most: largest difference that counts, m.
    seen: SeenDepth.
    rotations, centres: (J, 3, 3) and (J, 3) get the joint frames, about the root.
    drawn: (C, h, w) f4 gets the inverse depth, 1/m.
    cost: (C,) gets the cost against the maps, over most.
    """
    every, vertices = np.arange(mesh.vertices.shape[0]), np.empty(mesh.vertices.shape, np.float32)
    about, box, p = np.empty((4, every.shape[0]), np.float32), np.empty(4, np.int64), np.empty((3, 4), np.float32)
    joint_frames(q, tree, rotations, centres, np.empty((q.shape[0], 6)))
    skin_about_root(rotations, centres, tree, mesh, vertices)
    drawn[:] = f4(0)
    for c in range(seen.maps.shape[0]):
        camera_about_root(seen.projections[c], q, p)
        project(p, vertices, every, about, seen.sizes[c], box)
        _draw(about, mesh.faces, faces, seen.sizes[c], drawn[c])
        cost[c] = _cost(drawn[c], seen.maps[c], most, box) / most


@kernel
def _limb_energies(poses, first, last, tree, mesh, standing, seen, most, rough, out):
    """Compute the costs out (N, C), as `_energies`, of poses that differ only in one limb from the standing parts.

    poses, first, last: (N, D), of which those from first to last are computed.
    tree, mesh: joint tree and mesh of the body.
    standing: StandingDepth.
    seen: SeenDepth.
    most: largest difference that counts, m.
    rough: estimate by `_roughly` instead of drawing.
    """
    joints, moved = standing.joints, standing.vertices
    rotations, centres, drawn = standing.rotations.copy(), standing.centres.copy(), standing.drawn
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty(mesh.vertices.shape, np.float32)
    about, box = np.empty((4, vertices.shape[0]), np.float32), np.empty(4, np.int64)
    p = np.empty((seen.maps.shape[0], 3, 4), np.float32)
    for c in range(p.shape[0]):
        camera_about_root(seen.projections[c], standing.pose, p[c])
    for j in range(tree.parents.shape[0]):
        bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
    if not rough:
        drawn = drawn.copy()
    for n in range(first, last):
        frames_of(poses[n], tree, joints, rotations, centres, None)
        for k in range(joints.shape[0]):
            j = joints[k]
            bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
        skin_vertices(maps, mesh, moved, vertices)
        for c in range(p.shape[0]):
            size, measured = seen.sizes[c], seen.maps[c]
            project(p[c], vertices, moved, about, size, box)
            if rough:
                grown = _roughly(mesh.faces, standing.faces, about, measured, most, drawn[c], size)
                out[n, c] = standing.cost[c] + grown / most
                continue
            _draw(about, mesh.faces, standing.faces, size, drawn[c])
            grown = _cost(drawn[c], measured, most, box) - _cost(standing.drawn[c], measured, most, box)
            out[n, c] = standing.cost[c] + grown / most
            for y in range(box[2], box[3]):
                for x in range(box[0], box[1]):
                    drawn[c, y, x] = standing.drawn[c, y, x]


@kernel
def _limb_shown(tree, mesh, standing, seen, centre, reach, apart, out):
    """Measure the visible areas of a limb into out (C, 3), zero before, as `limb_shown`.

    tree, mesh: joint tree and mesh of the body.
    standing: StandingDepth, the parts without the limb.
    seen: SeenDepth.
    centre: (3,) m from the root.
    reach, apart: m.
    """
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty(mesh.vertices.shape, np.float32)
    about, box = np.empty((4, vertices.shape[0]), np.float32), np.empty(4, np.int64)
    p, at = np.empty((3, 4), np.float32), np.empty(3)
    for j in range(tree.parents.shape[0]):
        bone_map(standing.rotations[j], standing.centres[j], tree.joints[j], maps[j])
    skin_vertices(maps, mesh, standing.vertices, vertices)
    for c in range(seen.maps.shape[0]):
        whole, width, height = standing.drawn[c].copy(), seen.sizes[c, 0], seen.sizes[c, 1]
        camera_about_root(seen.projections[c], standing.pose, p)
        project(p, vertices, standing.vertices, about, seen.sizes[c], box)
        _draw(about, mesh.faces, standing.faces, seen.sizes[c], whole)
        for k in range(3):
            at[k] = p[k, 0] * centre[0] + p[k, 1] * centre[1] + p[k, 2] * centre[2] + p[k, 3]
        away = max(at[2], 0.05)
        left, top = at[0] / away, at[1] / away
        along_axis = p[0, 0] * p[2, 0] + p[0, 1] * p[2, 1] + p[0, 2] * p[2, 2]  # the last row has unit length
        squared = p[0, 0] * p[0, 0] + p[0, 1] * p[0, 1] + p[0, 2] * p[0, 2] - along_axis * along_axis
        metre = math.sqrt(squared) / away
        within = reach * reach * metre * metre
        for y in range(height):
            for x in range(width):
                other, own = seen.maps[c, y, x], _NO_SURFACE
                if whole[y, x] > f4(0):
                    own = f4(1) / whole[y, x]
                if whole[y, x] > standing.drawn[c, y, x]:
                    out[c, 0] += 1
                    out[c, 1] += other > f4(0) and abs(own - other) < apart
                dx, dy = x - left, y - top
                if other > f4(0) and own - other > apart and dx * dx + dy * dy < within:
                    out[c, 2] += 1
        for k in range(3):
            out[c, k] /= metre * metre

"""How far posed bodies lie from what depth cameras saw: the difference of depth over the pixels that both show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import BALL, MeshArrays, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.compute.kinematics import (
    bone_map,
    camera_about_root,
    joint_frames,
    multiply,
    rotation_matrix,
    skin_about_root,
    skin_vertices,
)
from hypose.compute.lane_mesh import moving_parts
from hypose.compute.threads import over_chunks
from hypose.compute.zbuffer import NEAR, draw_nearest


class SeenDepth(NamedTuple):
    """What sensors C saw of a person, small, so that many bodies can be compared."""

    maps: NDArray[np.float32]
    """(C, h, w) m along the optical axis at the person's pixels, 0 elsewhere"""
    sizes: NDArray[np.int64]
    """(C, 2) width, height of each"""
    projections: NDArray[np.float64]
    """(C, 3, 4) of these pixels, the last row of unit length"""
    counts: NDArray[np.int64]
    """(C,) pixels of the person"""


class StandingDepth(NamedTuple):
    """What of a body stands still while a limb is searched, drawn once."""

    pose: NDArray[np.float64]
    """(D,)"""
    rotations: NDArray[np.float64]
    """(J, 3, 3) of all joints at this pose"""
    centres: NDArray[np.float64]
    """(J, 3) m, from the root's position"""
    joints: NDArray[np.int64]
    """those that turn, in the tree's order"""
    faces: NDArray[np.int64]
    """those that turn"""
    vertices: NDArray[np.int64]
    """theirs"""
    drawn: NDArray[np.float32]
    """(C, h, w) 1/m, 0 = none: the faces that stand"""
    cost: NDArray[np.float64]
    """(C,) pixels: theirs"""


def depth_energy(
    poses: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, threads: int | None = None
) -> NDArray[np.float64]:
    """Return (N, C) of poses (N, D): sum over the pixels that show the person and the drawn body of min(|z - z'|,
    most_m) / most_m, over the person's pixels; what only one of both shows is the silhouettes' affair. 0 for a view
    without the person. The same for any number of threads, and for a pose alone or among others."""
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    score, given = _energies, (tidy(tree), tidy(mesh), *_against(seen, most_m))
    if len(q):
        over_chunks(lambda first, last: score(q, first, last, *given, out), len(q), threads, 16)
    return out / np.maximum(seen.counts, 1)


def standing_depth(
    pose: ArrayLike, tree: TreeArrays, mesh: MeshArrays, seen: SeenDepth, most_m: float, moving: ArrayLike
) -> StandingDepth:
    """What the joints `moving` (J,) bool, and those below them, do not move of a body at a pose (D,)."""
    q = plain(pose, np.float64)
    n = len(tree.parents)
    parts = moving_parts(mesh, tree, plain(moving, np.bool_), None)
    rotations, centres = np.empty((n, 3, 3)), np.empty((n, 3))
    drawn, cost = np.empty(seen.maps.shape, np.float32), np.zeros(len(seen.maps))
    against = _against(seen, most_m)
    still = np.flatnonzero(parts.standing)
    _stand(q, tidy(tree), tidy(mesh), still, *against, rotations, centres, drawn, cost)
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
    """`depth_energy` of poses that differ in a limb alone from what stands. rough: the limb is not drawn, each of its
    faces counts at its middle, which takes half the time."""
    q = plain(poses, np.float64)
    out = np.zeros((len(q), len(seen.maps)))
    score, given = _limb_energies, (tidy(tree), tidy(mesh), standing)
    against = _against(seen, most_m)
    if len(q):
        work = lambda first, last: score(q, first, last, *given, *against, rough, out)  # noqa: E731
        over_chunks(work, len(q), threads, 96 if rough else 16)
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
    """Return (C, 3) m^2, at the distance of a centre (3,) m, world, of the limb that was left out of what stands, in
    the pose that this was drawn at: what of it is in sight; what of that lies within apart_m of what the sensor saw;
    and what the sensor saw, no further than reach_m from the centre, that lies more than apart_m before all of the
    body, or next to it."""
    out = np.zeros((len(seen.maps), 3))
    maps, projections, sizes, apart = _against(seen, apart_m)
    at = plain(np.asarray(centre, dtype=np.float64) - standing.pose[:3], np.float64)
    show = _limb_shown
    show(tidy(tree), tidy(mesh), standing, maps, projections, sizes, at, float(reach_m), apart, out)
    return out


def _against(
    seen: SeenDepth, most_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int64], np.float32]:
    return seen.maps, seen.projections, seen.sizes, np.float32(most_m)


f4 = np.float32
_NO_SURFACE = f4(1e9)


@kernel(inline=True)
def _off(near, other, most):
    """What a pixel costs where the body lies at the inverse depth `near` and something was seen at `other` m, 0 where
    only one of both is."""
    if other > f4(0) and near > f4(0):
        return min(abs(f4(1) / near - other), most)
    return f4(0)


@kernel
def _cost(nearest, seen, most, box):
    """Cost of a drawn picture (h, w) f4, 1/m, against seen (h, w) f4 m in a box (4,) x0, x1, y0, y1."""
    total = 0.0
    for y in range(box[2], box[3]):
        for x in range(box[0], box[1]):
            total += _off(nearest[y, x], seen[y, x], most)
    return total


@kernel
def _roughly(faces, chosen, u, v, z, seen, most, standing, width, height):
    """About by how much the cost grows with the chosen faces before what stands (h, w) f4, 1/m: each as one thing at
    its middle, as large as its area, whatever lies before it."""
    grown = f4(0)
    third, half = f4(1 / 3), f4(0.5)
    for k in range(chosen.shape[0]):
        f = chosen[k]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        twice = (xc - xa) * (yb - ya) - (xb - xa) * (yc - ya)
        if not twice > f4(0) or z[a] < f4(0.05) or z[b] < f4(0.05) or z[c] < f4(0.05):
            continue
        left, top = (xa + xb + xc) * third + half, (ya + yb + yc) * third + half
        if not (left >= f4(0) and top >= f4(0) and left < f4(width) and top < f4(height)):
            continue
        x, y = int(left), int(top)
        own, before = f4(3) / (z[a] + z[b] + z[c]), standing[y, x]
        if own > before:
            grown += half * twice * (_off(own, seen[y, x], most) - _off(before, seen[y, x], most))
    return grown


@kernel
def _turned(q, tree, joints, rotations, centres):
    """The frames of some joints, in the tree's order, at pose q (D,), where those of all others are known: as
    `joint_frames`, without the twists."""
    local, frame = np.empty((3, 3)), np.empty((3, 3))
    for n in range(joints.shape[0]):
        j = joints[n]
        a = tree.parents[j]
        r = rotations[a]
        for i in range(3):
            centres[j, i] = centres[a, i]
            for k in range(3):
                centres[j, i] += r[i, k] * (tree.joints[j, k] - tree.joints[a, k])
                frame[i, k] = r[i, k]
        first = tree.dof_start[j]
        if tree.kind[j] == BALL:
            rotation_matrix(q[first], q[first + 1], q[first + 2], local)
            multiply(frame, local, rotations[j])
            continue
        for m in range(tree.dof_count[j]):
            d = first + m
            rotation_matrix(q[d] * tree.axes[d, 0], q[d] * tree.axes[d, 1], q[d] * tree.axes[d, 2], local)
            multiply(frame, local, rotations[j])
            for i in range(3):
                for k in range(3):
                    frame[i, k] = rotations[j, i, k]
        for i in range(3):
            for k in range(3):
                rotations[j, i, k] = frame[i, k]


@kernel
def _project(p, vertices, chosen, u, v, z, inverse, size, box):
    """Pixels, distances and inverse distances (0: nearer than NEAR) of the chosen vertices under a camera p (3, 4) f4
    about the root; box (4,): x0, x1, y0, y1 of the picture of size (2,) in which those before it lie."""
    x0, x1, y0, y1 = f4(1e6), f4(-1e6), f4(1e6), f4(-1e6)
    for k in range(chosen.shape[0]):
        i = chosen[k]
        x, y, d = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        away = p[2, 0] * x + p[2, 1] * y + p[2, 2] * d + p[2, 3]
        z[i], inverse[i], u[i], v[i] = away, f4(0), f4(0), f4(0)
        if away >= f4(NEAR):
            inverse[i] = f4(1) / away
            u[i] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * d + p[0, 3]) * inverse[i]
            v[i] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * d + p[1, 3]) * inverse[i]
            x0, x1, y0, y1 = min(x0, u[i]), max(x1, u[i]), min(y0, v[i]), max(y1, v[i])
    box[0], box[1] = int(max(x0, f4(0))), int(min(x1 + f4(1), f4(size[0])))
    box[2], box[3] = int(max(y0, f4(0))), int(min(y1 + f4(1), f4(size[1])))


@kernel
def _energies(poses, first, last, tree, mesh, seen, projections, sizes, most, out):
    """out (N, C): cost of the drawn poses (N, D), of which first to last are done, against seen (C, h, w) f4: sum of
    `_off`, over most."""
    every, drawn = np.arange(mesh.faces.shape[0]), np.empty(seen.shape, np.float32)
    rotations, centres = np.empty((tree.parents.shape[0], 3, 3)), np.empty((tree.parents.shape[0], 3))
    for n in range(first, last):
        _stand(poses[n], tree, mesh, every, seen, projections, sizes, most, rotations, centres, drawn, out[n])


@kernel
def _stand(q, tree, mesh, faces, seen, projections, sizes, most, rotations, centres, drawn, cost):
    """drawn (C, h, w) f4, 1/m: some faces of the body at pose q (D,), whose frames are rotations (J, 3, 3) and centres
    (J, 3); cost (C,): theirs against seen (C, h, w) f4, over most. All overwritten."""
    n_vertices = mesh.vertices.shape[0]
    every, vertices = np.arange(n_vertices), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    inverse, box, p = np.empty(n_vertices, np.float32), np.empty(4, np.int64), np.empty((3, 4), np.float32)
    joint_frames(q, tree, rotations, centres, np.empty((q.shape[0], 6)))
    skin_about_root(rotations, centres, tree, mesh, vertices)
    drawn[:] = f4(0)
    for c in range(seen.shape[0]):
        camera_about_root(projections[c], q, p)
        _project(p, vertices, every, u, v, z, inverse, sizes[c], box)
        draw_nearest(u, v, inverse, mesh.faces, faces, True, drawn[c, : sizes[c, 1], : sizes[c, 0]], None)
        cost[c] = _cost(drawn[c], seen[c], most, box) / most


@kernel
def _limb_energies(poses, first, last, tree, mesh, standing, seen, projections, sizes, most, rough, out):
    """out (N, C): as `_energies`, of poses that differ in a limb alone from what stands. rough: `_roughly`."""
    joints, moving, moved = standing.joints, standing.faces, standing.vertices
    n_vertices = mesh.vertices.shape[0]
    rotations, centres, drawn = standing.rotations.copy(), standing.centres.copy(), standing.drawn
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    inverse, box, p = (
        np.empty(n_vertices, np.float32),
        np.empty(4, np.int64),
        np.empty((seen.shape[0], 3, 4), np.float32),
    )
    for c in range(seen.shape[0]):
        camera_about_root(projections[c], standing.pose, p[c])
    for j in range(tree.parents.shape[0]):
        bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
    if not rough:
        drawn = drawn.copy()
    for n in range(first, last):
        _turned(poses[n], tree, joints, rotations, centres)
        for k in range(joints.shape[0]):
            j = joints[k]
            bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
        skin_vertices(maps, mesh, moved, vertices)
        for c in range(seen.shape[0]):
            width, height = sizes[c, 0], sizes[c, 1]
            _project(p[c], vertices, moved, u, v, z, inverse, sizes[c], box)
            if rough:
                grown = _roughly(mesh.faces, moving, u, v, z, seen[c], most, drawn[c], width, height)
                out[n, c] = standing.cost[c] + grown / most
                continue
            draw_nearest(u, v, inverse, mesh.faces, moving, True, drawn[c, :height, :width], None)
            grown = _cost(drawn[c], seen[c], most, box) - _cost(standing.drawn[c], seen[c], most, box)
            out[n, c] = standing.cost[c] + grown / most
            for y in range(box[2], box[3]):
                for x in range(box[0], box[1]):
                    drawn[c, y, x] = standing.drawn[c, y, x]


@kernel
def _limb_shown(tree, mesh, standing, seen, projections, sizes, centre, reach, apart, out):
    """out (C, 3), zero, of the limb that was left out of what stands, in the pose that this was drawn at, in m^2 at the
    distance of a centre (3,), from the root: what of it is in sight; what of that lies within `apart` m of what the
    sensor saw; and what the sensor saw, no further than `reach` m from the centre, that lies more than `apart` before
    all of the body, or next to it."""
    n_vertices = mesh.vertices.shape[0]
    maps, vertices = np.empty((tree.parents.shape[0], 12), np.float32), np.empty((n_vertices, 3), np.float32)
    u, v, z = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    inverse, box, p = np.empty(n_vertices, np.float32), np.empty(4, np.int64), np.empty((3, 4), np.float32)
    for j in range(tree.parents.shape[0]):
        bone_map(standing.rotations[j], standing.centres[j], tree.joints[j], maps[j])
    skin_vertices(maps, mesh, standing.vertices, vertices)
    for c in range(seen.shape[0]):
        whole, width, height = standing.drawn[c].copy(), sizes[c, 0], sizes[c, 1]
        camera_about_root(projections[c], standing.pose, p)
        _project(p, vertices, standing.vertices, u, v, z, inverse, sizes[c], box)
        draw_nearest(u, v, inverse, mesh.faces, standing.faces, True, whole[:height, :width], None)
        away = p[2, 0] * centre[0] + p[2, 1] * centre[1] + p[2, 2] * centre[2] + p[2, 3]
        across = p[0, 0] * centre[0] + p[0, 1] * centre[1] + p[0, 2] * centre[2] + p[0, 3]
        down = p[1, 0] * centre[0] + p[1, 1] * centre[1] + p[1, 2] * centre[2] + p[1, 3]
        away = max(away, 0.05)
        left, top = across / away, down / away
        along_axis = p[0, 0] * p[2, 0] + p[0, 1] * p[2, 1] + p[0, 2] * p[2, 2]  # the last row has unit length
        squared = p[0, 0] * p[0, 0] + p[0, 1] * p[0, 1] + p[0, 2] * p[0, 2] - along_axis * along_axis
        metre = math.sqrt(squared) / away
        within = reach * reach * metre * metre
        for y in range(height):
            for x in range(width):
                other, own = seen[c, y, x], _NO_SURFACE
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

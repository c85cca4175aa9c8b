"""The definitions of hot functions in numpy, slow and plain: kernels are tested against them."""

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import BALL, HINGES, MeshArrays, PreparedMasks, TreeArrays
from hypose.geometry import Array, so3_exp

NEAR = 0.05
"""Near plane, m."""


def forward_kinematics(poses: Array, tree: TreeArrays) -> tuple[Array, Array]:
    """Poses (N, D) -> rotations world_from_joint (N, J, 3, 3), joint centres (N, J, 3) m (Alcoverro 2014, eq. 2.11)."""
    n, j = len(poses), len(tree.parents)
    rotations, centres = np.empty((n, j, 3, 3)), np.empty((n, j, 3))
    for k in range(j):
        a = tree.parents[k]
        if a < 0:
            frame, centres[:, k] = np.broadcast_to(np.eye(3), (n, 3, 3)), poses[:, :3]
        else:
            frame = rotations[:, a]
            centres[:, k] = centres[:, a] + frame @ (tree.joints[k] - tree.joints[a])
        s = tree.dof_start[k]
        if tree.kind[k] == BALL:
            frame = frame @ so3_exp(poses[:, s : s + 3])
        elif tree.kind[k] == HINGES:
            for d in range(s, s + tree.dof_count[k]):
                frame = frame @ so3_exp(poses[:, d, None] * tree.axes[d])
        rotations[:, k] = frame
    return rotations, centres


def skin(rotations: Array, centres: Array, tree: TreeArrays, mesh: MeshArrays) -> Array:
    """Linear blend skinning: frames (N, J, 3, 3), (N, J, 3) -> vertices (N, V, 3) m (Alcoverro 2014, eq. 2.12)."""
    index, weight = mesh.skin_index, mesh.skin_weight.astype(np.float64)
    local = mesh.vertices[:, None].astype(np.float64) - tree.joints[index]
    moved = centres[:, index] + np.einsum("nvkij,vkj->nvki", rotations[:, index], local)
    return np.einsum("vk,nvki->nvi", weight, moved)


def rasterize(
    vertices: Array,
    faces: NDArray[np.int32],
    projection: Array,
    size: tuple[int, int],
    *,
    one_sided: bool = False,
) -> NDArray[np.bool_]:
    """Silhouette (h, w) of a triangle mesh: vertices (V, 3), projection (3, 4), size (width, height).

    A pixel is set when its centre lies in the image of any triangle that lies beyond the near plane. Half open: a
    triangle covers column x when ceil(xmin) <= x < ceil(xmax), and there the rows ceil(top) <= y < ceil(bottom), so
    meshes that share vertices leave no gap and count no pixel twice. one_sided: only triangles seen from outside."""
    homogeneous = vertices @ projection[:, :3].T + projection[:, 3]
    safe = homogeneous[faces[(homogeneous[faces, 2] >= NEAR).all(1)]]
    drawn = safe[..., :2] / safe[..., 2:]
    if one_sided:
        a, b, c = (drawn[:, k] for k in range(3))
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
        drawn = drawn[area < 0]  # clockwise on a screen with y down: seen from outside
    return _cover(drawn, size)


def _cover(triangles: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Pixels (h, w) that any of the triangles (T, 3, 2) covers: +1 at the first row of every triangle in every column,
    -1 below its last, and the running sum down the rows counts its layers."""
    w, h = size
    first, last = (np.ceil(np.clip(f(triangles[..., 0], 1), 0, w)).astype(int) for f in (np.min, np.max))
    count = last - first
    which = np.repeat(np.arange(len(triangles)), count)
    x = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + first[which]
    rows = np.full((len(which), 3), np.nan)
    for k in range(3):
        a, b = triangles[which, k], triangles[which, (k + 1) % 3]
        swap = a[:, :1] > b[:, :1]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        crossed = (np.ceil(a[:, 0]) <= x) & (x < np.ceil(b[:, 0]))
        run = np.where(crossed, b[:, 0] - a[:, 0], 1)
        rows[crossed, k] = (a[:, 1] + (x - a[:, 0]) / run * (b[:, 1] - a[:, 1]))[crossed]
    spans = np.isfinite(rows).sum(1) == 2  # one or three only where float64 cannot tell the corners' columns apart
    top, bottom = (np.ceil(np.clip(f(rows[spans], 1), 0, h)).astype(int) for f in (np.nanmin, np.nanmax))
    layers = np.zeros((h + 1, w), dtype=np.int64)
    np.add.at(layers, (top, x[spans]), 1)
    np.add.at(layers, (bottom, x[spans]), -1)
    return np.cumsum(layers, 0)[:h] > 0


def nearest_faces(
    uv: Array, z: Array, faces: NDArray[np.int32], size: tuple[int, int], *, cull: bool
) -> tuple[Array, NDArray[np.int64]]:
    """Inverse depth (h, w) 1/m of the nearest triangle at each pixel's centre, 0 where there is none, and its number,
    -1: corners at uv (V, 2) px and z (V,) m, those nearer than NEAR are left out; cull: so are those seen from inside.
    Inverse depth is a plane over the image."""
    w, h = size
    x, y = np.meshgrid(np.arange(w), np.arange(h))
    nearest, number = np.zeros((h, w)), np.full((h, w), -1)
    for f, face in enumerate(faces):
        (a, b, c), inverse = uv[face], 1 / z[face]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if (z[face] <= NEAR).any() or area == 0 or (cull and area > 0):
            continue
        second = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
        third = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
        value = (1 - second - third) * inverse[0] + second * inverse[1] + third * inverse[2]
        before = (second >= 0) & (third >= 0) & (second + third <= 1) & (value > nearest)
        nearest[before], number[before] = value[before], f
    return nearest, number


def ignored_pixels(prepared: PreparedMasks) -> NDArray[np.bool_]:
    """(C, h, w) pixels that say nothing."""
    if not prepared.hidden.size:
        return np.zeros(prepared.masks.shape, np.bool_)
    return np.unpackbits(prepared.hidden, axis=2, count=prepared.masks.shape[2], bitorder="little") > 0


def silhouette_xor(
    poses: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    boxes: NDArray[np.int64] | None = None,
    faces: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """(N, C, 3) = (xor, model, intersection) pixels inside boxes (C, 4) = x0, x1, y0, y1 (default:
    everywhere); zeros for unusable views.

    faces (F,): only these triangles, seen from outside. (A closed mesh is covered by its front faces; a part of it is
    open, and counting only front faces makes the layers of its parts add up to those of the whole.)"""
    out = np.zeros((len(poses), len(prepared.masks), 3), dtype=np.int64)
    vertices = skin(*forward_kinematics(poses, tree), tree, mesh)
    for c in np.flatnonzero(prepared.usable):
        w, h = prepared.sizes[c].tolist()
        x0, x1, y0, y1 = (0, w, 0, h) if boxes is None else np.clip(boxes[c], 0, (w, w, h, h))
        mask = prepared.masks[c, y0:y1, x0:x1] != 0
        reported = ~ignored_pixels(prepared)[c, y0:y1, x0:x1]
        for n in range(len(poses)):
            drawn = mesh.faces if faces is None else mesh.faces[faces]
            model = rasterize(vertices[n], drawn, prepared.projections[c], (w, h), one_sided=faces is not None)
            model = model[y0:y1, x0:x1] & reported
            out[n, c] = (model ^ mask).sum(), model.sum(), (model & mask).sum()
    return out

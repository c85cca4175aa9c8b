"""numpy: the definitions of the hot functions, slow and plain; the numba kernels are tested against them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import BALL, HINGES, MeshArrays, TreeArrays
from hypose.compute.terms import PreparedMasks
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

    A pixel is set when its centre lies in the image of any triangle, cut at the near plane. Half open: a triangle
    covers column x when ceil(xmin) <= x < ceil(xmax), and there the rows ceil(top) <= y < ceil(bottom), so meshes
    that share vertices leave no gap and count no pixel twice. one_sided: only triangles whose outside is seen."""
    w, h = size
    image = np.zeros((h, w), dtype=bool)
    homogeneous = vertices @ projection[:, :3].T + projection[:, 3]
    for face in faces:
        corners = _cut_at_near(homogeneous[face])
        if len(corners) < 3:
            continue
        uv = corners[:, :2] / corners[:, 2:]
        if one_sided and _area(uv) >= 0:
            continue
        for k in range(1, len(uv) - 1):
            _fill(image, uv[[0, k, k + 1]])
    return image


def _cut_at_near(corners: Array) -> Array:
    out = []
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if a[2] >= NEAR:
            out.append(a)
        if (a[2] >= NEAR) != (b[2] >= NEAR):
            lo, hi = (a, b) if a[2] < b[2] else (b, a)
            out.append(lo + (NEAR - lo[2]) / (hi[2] - lo[2]) * (hi - lo))
    return np.array(out)


def _area(uv: Array) -> float:
    """Twice the signed area of a polygon (K, 2), negative when it is clockwise on a screen with y down: seen from
    outside."""
    d = uv - uv[0]
    return float(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(d[1:], d[2:], strict=False)))


def _fill(image: NDArray[np.bool_], triangle: Array) -> None:
    h, w = image.shape
    first, last = np.ceil(np.clip([triangle[:, 0].min(), triangle[:, 0].max()], 0, w)).astype(int)
    for x in range(first, last):
        crossings = []
        for k in range(3):
            (xa, ya), (xb, yb) = triangle[k], triangle[(k + 1) % 3]
            if xa > xb:
                xa, ya, xb, yb = xb, yb, xa, ya
            if np.ceil(xa) <= x < np.ceil(xb):
                crossings.append(ya + (x - xa) / (xb - xa) * (yb - ya))
        if len(crossings) == 2:
            top, bottom = np.ceil(np.clip(sorted(crossings), 0, h)).astype(int)
            image[top:bottom, x] = True


def silhouette_xor(
    poses: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    prepared: PreparedMasks,
    boxes: NDArray[np.int64],
    faces: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """(N, C, 3) = (xor, model, intersection) pixels inside boxes (C, 4) = x0, x1, y0, y1; zeros for unusable views.

    faces (F,): only these triangles, seen from outside. (A closed mesh is covered by its front faces; a part of it is
    open, and counting only front faces makes the layers of its parts add up to those of the whole.)"""
    out = np.zeros((len(poses), len(prepared.masks), 3), dtype=np.int64)
    vertices = skin(*forward_kinematics(poses, tree), tree, mesh)
    for c in np.flatnonzero(prepared.usable):
        x0, x1, y0, y1 = boxes[c]
        mask = prepared.masks[c, y0:y1, x0:x1] != 0
        for n in range(len(poses)):
            w, h = prepared.sizes[c].tolist()
            drawn = mesh.faces if faces is None else mesh.faces[faces]
            model = rasterize(vertices[n], drawn, prepared.projections[c], (w, h), one_sided=faces is not None)
            model = model[y0:y1, x0:x1]
            out[n, c] = (model ^ mask).sum(), model.sum(), (model & mask).sum()
    return out

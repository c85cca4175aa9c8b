"""Rows of depth maps for a person's shape: where the surface is, to a body whose sizes are unknown too.

The same distances as in the pose solver (hypose.compute, depth rows), with derivatives by the shape; the nearest place
is looked for among points on the faces that look at the sensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Mesh
from hypose.compute import geman_mcclure
from hypose.fitting.depth_surface import DepthTerm
from hypose.geometry import Array

_FARTHEST_M = 0.3
_TURNED_M = 0.06
"""m by which a surface that looks the other way counts as further off"""
_CORNERS = np.array(
    [[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [2.5, 2.5, 1], [2.5, 1, 2.5], [1, 2.5, 2.5]], dtype=np.float64
)
_CORNERS /= _CORNERS.sum(1, keepdims=True)


class ShapeRows(NamedTuple):
    """jacobian (R, D + K) by pose and shape, weight (R,), residual (R,) m, and the robust cost."""

    jacobian: Array
    weight: Array
    residual: Array
    cost: float


def depth_shape_rows(
    mesh: Mesh, vertices: Array, slopes: Array, twists: Array, moves: Array, term: DepthTerm, factor: float, gain: float
) -> ShapeRows:
    """Rows of one frame. vertices (V, 3) m of the posed mesh; slopes (V, K, 3) by the shape; twists (D, 6); moves (V,
    D): share of a dof's motion at a vertex; factor: of the robust scale; gain: of the weights."""
    from scipy.spatial import KDTree  # takes long to import

    faces = np.asarray(mesh.faces)
    corner = vertices[faces]  # (F, 3, 3)
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    smooth = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(smooth, faces[:, k], across)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
    middle = corner.mean(1)
    found: list[tuple[NDArray[np.int64], Array, Array, Array]] = []
    lost = 0.0
    for c, eye in enumerate(term.eyes):
        own = slice(int(term.first[c]), int(term.first[c + 1]))
        points, outward, weight = term.points[own], term.normals[own], gain * term.weight[own]
        front = np.flatnonzero(((eye - middle) * normal).sum(1) > 0)
        if not len(points) or not len(front):
            continue
        place = np.einsum("sc,fcd->fsd", _CORNERS, corner[front]).reshape(-1, 3)
        looks = np.einsum("sc,fcd->fsd", _CORNERS, smooth[faces[front]]).reshape(-1, 3)
        tree = KDTree(np.concatenate([place, _TURNED_M * looks], 1))
        away, nearest = tree.query(np.concatenate([points, _TURNED_M * outward], 1))
        near = np.asarray(away) < _FARTHEST_M
        lost += 0.5 * float(weight[~near].sum())
        at = np.asarray(nearest)[near].astype(np.int64)
        found.append((front[at // len(_CORNERS)], _CORNERS[at % len(_CORNERS)], points[near], weight[near]))
    if not found:
        none = np.zeros(0)
        return ShapeRows(np.zeros((0, len(twists) + slopes.shape[1])), none, none, lost)
    three = faces[np.concatenate([f[0] for f in found])]
    share, seen, w = (np.concatenate([f[k] for f in found]) for k in (1, 2, 3))
    point = np.einsum("rc,rcd->rd", share, vertices[three])
    gradient = np.einsum("rc,rcd->rd", share, smooth[three])
    gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
    r = ((point - seen) * gradient).sum(1)
    far = np.linalg.norm(point - seen, axis=1)
    off = far > 0.04  # nothing is there along the normal: drawn to the point itself
    gradient[off] = ((point - seen) / np.maximum(far, 1e-9)[:, None])[off]
    r = np.where(off, far, r)
    scale = term.scale_m * factor
    rho, slope, _ = geman_mcclure((r / scale) ** 2, w / scale**2)
    by_shape = np.einsum("rc,rd,rckd->rk", share, gradient, slopes[three])
    wrench = np.concatenate([np.cross(point, gradient), gradient], 1)
    by_pose = np.einsum("rk,dk->rd", wrench, twists) * np.einsum("rc,rcd->rd", share, moves[three])
    return ShapeRows(np.concatenate([by_pose, by_shape], 1), slope, r, lost + 0.5 * float((w * rho).sum()))

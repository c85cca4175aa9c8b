"""The outer surface of a body as an even mesh: signed distances on a grid, gaps between fingers and toes closed,
marching cubes. Exactly symmetric: only x >= 0 is computed, and the grid has a layer in the plane x = 0."""

from __future__ import annotations

from typing import cast

import numpy as np
from decimation import vertex_normals
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import marching_cubes


def envelope_half(
    vertices: np.ndarray, faces: np.ndarray, close_near: np.ndarray, step: float = 0.007, radius: float = 0.009
) -> tuple[np.ndarray, np.ndarray]:
    """Left half (H,3), (G,3) of the outer surface of a closed symmetric mesh.

    close_near (V,) marks the vertices around which gaps narrower than 2*radius are filled (fingers, toes).
    """
    low = np.array([0.0, vertices[:, 1].min() - 6 * step, vertices[:, 2].min() - 6 * step])
    size = np.ceil((vertices.max(0) - low) / step).astype(int) + 7
    inside = _inside(vertices, faces, low, size, step)
    edge = _steps_inside(inside) + _steps_inside(~inside)
    band = np.argwhere(edge <= 4.5)
    points = low + band * step
    surface, normal = _samples(vertices, faces, 0.5 * step)
    distance, index = KDTree(surface).query(points)
    plane = ((points - surface[index]) * normal[index]).sum(1)
    sign = np.where(inside[tuple(band.T)], -1.0, 1.0)
    # near the surface the nearest sample's plane is exact where the distance to the sample itself is not
    value = np.where(distance < step, np.where(np.abs(plane) < distance, plane, sign * distance), sign * distance)
    field = np.where(inside, -5 * step, 5 * step)
    field[tuple(band.T)] = value
    # closing = erosion of the dilation; the nearest point outside the dilation is known to a fraction of a step
    depth, outside = cast("tuple[np.ndarray, np.ndarray]", distance_transform_edt(field <= radius, return_indices=True))
    filled = radius - (depth * step - (field[tuple(outside)] - radius))
    near = KDTree(vertices[close_near]).query(points)[0] < 2 * radius
    where = tuple(band[near].T)
    field[where] = np.minimum(field[where], filled[where])
    out, triangles, _, _ = marching_cubes(field, 0.0, gradient_direction="descent")
    out = out * step + low
    out[np.abs(out[:, 0]) < 1e-7, 0] = 0.0
    return _clean(out, triangles.astype(int))


def _steps_inside(mask: np.ndarray) -> np.ndarray:
    """Distance in steps from each true grid point to the nearest false one."""
    return cast("np.ndarray", distance_transform_edt(mask))


def _inside(vertices: np.ndarray, faces: np.ndarray, low: np.ndarray, size: np.ndarray, step: float) -> np.ndarray:
    """Grid points (size) enclosed by the mesh: signed crossings of the vertical line through each column."""
    crossings = np.zeros((size[0], size[1], size[2] + 1), np.int32)
    shift = np.array([1.1e-5, 1.7e-5])  # off the mesh's own edges in the plane x = 0
    for a, b, c in (vertices[faces] - low) / step:
        first = np.maximum(np.floor(np.min([a, b, c], 0)[:2]).astype(int), 0)
        last = np.ceil(np.max([a, b, c], 0)[:2]).astype(int)
        if last[0] < 0:
            continue
        i, j = np.mgrid[first[0] : last[0] + 1, first[1] : last[1] + 1]
        p = np.stack([i, j], -1) + shift / step
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(double) < 1e-12:
            continue
        w = [
            ((q[0] - p[..., 0]) * (r[1] - p[..., 1]) - (q[1] - p[..., 1]) * (r[0] - p[..., 0])) / double
            for q, r in ((b, c), (c, a), (a, b))
        ]
        hit = (w[0] > 0) & (w[1] > 0) & (w[2] > 0)
        z = w[0] * a[2] + w[1] * b[2] + w[2] * c[2]
        k = np.clip(np.ceil(z[hit]).astype(int), 0, size[2])
        np.add.at(crossings, (i[hit], j[hit], k), 1 if double > 0 else -1)
    # an upward-facing crossing at height z closes the solid below it
    return np.cumsum(crossings[:, :, ::-1], 2)[:, :, ::-1][:, :, 1:] > 0


def _samples(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points on the surface no further apart than about `spacing`, and the unit normals of their faces."""
    _, normal = vertex_normals(vertices, faces)
    p = vertices[faces]
    longest = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(1)
    need = np.ceil(longest / spacing).astype(int)
    points, normals = [], []
    for k in np.unique(need):
        corner = np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]) / k
        chosen = need == k
        points.append(np.einsum("sc,fcd->fsd", corner, p[chosen]).reshape(-1, 3))
        normals.append(np.repeat(normal[chosen], len(corner), 0))
    return np.concatenate(points), np.concatenate(normals)


def _clean(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without vertices no face uses, and without small separate pieces."""
    edges = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices),) * 2)
    label = connected_components(graph, directed=False)[1]
    keep = label == np.bincount(label).argmax()
    index = np.full(len(vertices), -1)
    index[keep] = np.arange(keep.sum())
    return vertices[keep], index[faces[keep[faces].all(1)]]

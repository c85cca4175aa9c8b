"""Rows of a body's outline against a mask's, in both directions, where the body's sizes or the cameras are unknown too.

The pose solver never stores its rows (rows.py); here they are returned, because their derivatives are by more than a
pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import NOT_KNOWN, MeshArrays, plain
from hypose.compute.compiled import kernel
from hypose.compute.parts import covered
from hypose.compute.rows import BORDER
from hypose.geometry import Array

_REFERENCE_PX, _HEIGHT_PX, _OUTLINE = 6.0, 260.0, 130
"""_REFERENCE_PX: distance, px, of rows of weight 1 on a person of _HEIGHT_PX. _OUTLINE: reference number of points of
the mask's outline.
"""
_FARTHEST = 0.25
"""Share of the person's height beyond which an outline is another one."""
_USUAL = 1024
"""Number of rows of a view for which there is room at first."""
_NEAR_M = 0.05


def outline_rows(
    vertices: Array,
    faces: NDArray[np.int32],
    edges: NDArray[np.int32],
    projection: ArrayLike,
    size: Sequence[int],
    sdf: NDArray[np.float32],
    outline: NDArray[np.float32],
    height_px: float,
    spacing_px: float,
    least_cosine: float,
) -> tuple[NDArray[np.int64], Array] | None:
    """Compute the rows (residuals with derivatives) of one view between the outlines of body and mask, in both
    directions.

    vertices, faces, edges: (V, 3) m, (F, 3) and (E, 4) of a closed mesh.
    projection: (3, 4) pinhole projection.
    size: (2,) width, height, px.
    sdf, outline: (h, w) signed distance, px, negative inside, and (K, 2) px of the mask.
    height_px: height of the person, px.
    spacing_px: spacing of the rows along the body's outline, px.
    least_cosine: rows whose outlines have normals with a smaller cosine are omitted.
    Returns: ends (R, 2): vertices a, b; values (R, 6): along, so that the row's point is (1 - along) a + along b;
        residual, px; its gradient (3) by the point, px/m; weight. None where the body is not in the view.

    Which points are the outline, and which is nearest, is held fixed in the derivatives.
    """
    reference = max(_REFERENCE_PX / _HEIGHT_PX * height_px, 1.0)
    lengths = np.array([reference, _FARTHEST * height_px, _OUTLINE / max(len(outline), 1)])
    v, p = plain(vertices, np.float64), plain(projection, np.float64)
    seen = np.einsum("vc,rc->vr", v, p[:, :3]) + p[:, 3]
    if not (seen[:, 2] > _NEAR_M).all():
        return None
    uv, f = seen[:, :2] / seen[:, 2:], plain(faces, np.int32)
    own = covered(uv, seen[:, 2], f, (size[1], size[0]))
    given = v, uv, f, plain(edges, np.int32), p, own, plain(sdf, np.float32), plain(outline, np.float32)
    n = -_USUAL
    while n < -1:
        ends, values = np.empty((-n, 2), np.int64), np.empty((-n, 6))
        find = _outline_rows
        n = find(*given, float(spacing_px), float(least_cosine), lengths, ends, values)
    return None if n < 0 else (ends[:n], values[:n])


def warm_up(mesh: MeshArrays) -> None:
    """Compile (or load from the cache) the kernel on a toy."""
    picture, outline = np.zeros((8, 8), np.float32), np.zeros((1, 2), np.float32)
    outline_rows(mesh.vertices + 1.0, mesh.faces, mesh.edges, np.eye(3, 4), [8, 8], picture, outline, 8.0, 4.0, 0.5)


_OUT = 1.2
"""px from the outline to where the body must have ended."""
_FLAT = 0.3
"""Slope of a distance below which it has no direction: where two outlines meet."""
_FEWEST = 8


@kernel
def bilinear(image, x, y, out):
    """Interpolate an image (h, w) bilinearly at a point (x, y), px, inside it; out (4,) gets value, gradient, and
    the largest of the four pixels.
    """
    i = min(max(int(math.floor(x)), 0), image.shape[1] - 2)
    j = min(max(int(math.floor(y)), 0), image.shape[0] - 2)
    fx, fy = x - i, y - j
    s00, s01 = float(image[j, i]), float(image[j, i + 1])
    s10, s11 = float(image[j + 1, i]), float(image[j + 1, i + 1])
    out[0] = (s00 * (1 - fx) + s01 * fx) * (1 - fy) + (s10 * (1 - fx) + s11 * fx) * fy
    out[1] = (s01 - s00) * (1 - fy) + (s11 - s10) * fy
    out[2] = (s10 - s00) * (1 - fx) + (s11 - s01) * fx
    out[3] = max(max(s00, s01), max(s10, s11))


@kernel
def _outline_rows(vertices, uv, faces, edges, p, own, sdf, marks, spacing, least_cosine, lengths, ends, rows):
    """Compute the two-way rows of one view into ends (M, 2) and rows (M, 6) = place on the edge, residual, gradient,
    weight.

    vertices, faces, edges: (V, 3) m, (F, 3) and (E, 4).
    p: (3, 4) camera.
    sdf: (h, w) signed distance to the mask's edge, px.
    spacing, least_cosine: as in `outline_rows`.
    uv: (V, 2) px of the vertices.
    own: (h, w) the body's silhouette.
    marks: (K, 2) the mask's outline.
    lengths: (3,): px between the rows of the reference, px by which an outline may be off, and weight of a reverse row.
    Returns: number of rows; -1: the body is not in the view; another negative number -n: M must be at least n, and
        nothing was written.
    """
    front = np.empty(faces.shape[0], np.uint8)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        across = (uv[b, 0] - uv[a, 0]) * (uv[c, 1] - uv[a, 1]) - (uv[b, 1] - uv[a, 1]) * (uv[c, 0] - uv[a, 0])
        front[f] = across < 0  # image y grows downwards
    edge, length = np.empty((edges.shape[0], 2), np.int64), np.empty(edges.shape[0])
    n_edges = n_samples = 0
    for k in range(edges.shape[0]):
        if front[edges[k, 2]] == front[edges[k, 3]]:
            continue
        a, b = edges[k, 0], edges[k, 1]
        if not front[edges[k, 2]]:
            a, b = b, a
        dx, dy = uv[b, 0] - uv[a, 0], uv[b, 1] - uv[a, 1]
        long = math.sqrt(dx * dx + dy * dy)
        if long > 1e-3:
            edge[n_edges, 0], edge[n_edges, 1], length[n_edges] = a, b, long
            n_edges += 1
            n_samples += max(int(math.ceil(long / spacing)), 1)
    if n_edges < _FEWEST:
        return -1
    if n_samples + marks.shape[0] > ends.shape[0]:
        return -n_samples - marks.shape[0]
    height, width = own.shape
    # the visible outline of the body: edge, place on it, arc length, point, outward normal
    of, rim = np.empty(n_samples, np.int64), np.empty((n_samples, 6))
    n_rim = 0
    for e in range(n_edges):
        a, b = edge[e, 0], edge[e, 1]
        dx, dy = uv[b, 0] - uv[a, 0], uv[b, 1] - uv[a, 1]
        nx, ny = -dy / length[e], dx / length[e]  # the front face lies on the other side
        count = max(int(math.ceil(length[e] / spacing)), 1)
        for i in range(count):
            t = (i + 0.5) / count
            x, y = uv[a, 0] + t * dx, uv[a, 1] + t * dy
            if not (BORDER <= x < width - 1 - BORDER and BORDER <= y < height - 1 - BORDER):
                continue
            c, r = int(np.rint(x + _OUT * nx)), int(np.rint(y + _OUT * ny))
            if own[min(max(r, 0), height - 1), min(max(c, 0), width - 1)]:
                continue
            of[n_rim] = e
            line = rim[n_rim]
            line[0], line[1], line[2], line[3], line[4], line[5] = t, length[e] / count, x, y, nx, ny
            n_rim += 1
    if n_rim < _FEWEST:
        return -1
    n, look = 0, np.empty(4)
    reference, farthest, reverse = lengths[0], lengths[1], lengths[2]
    for k in range(n_rim):  # forward: the body's outline in the mask's distances
        line = rim[k]
        bilinear(sdf, line[2], line[3], look)
        slope = math.sqrt(look[1] * look[1] + look[2] * look[2])
        agree = look[1] * line[4] + look[2] * line[5] > least_cosine * slope or slope < _FLAT
        if agree and look[3] < NOT_KNOWN:
            ends[n, 0], ends[n, 1] = edge[of[k], 0], edge[of[k], 1]
            row = rows[n]
            row[0], row[1], row[2], row[3], row[5] = line[0], look[0], look[1], look[2], line[1] / reference
            n += 1
    for m in range(marks.shape[0]):  # reverse: the mask's outline to the body's nearest with a similar normal
        x, y = float(marks[m, 0]), float(marks[m, 1])
        if not (x > -1e5 and y > -1e5):
            continue
        bilinear(sdf, x, y, look)
        slope = max(math.sqrt(look[1] * look[1] + look[2] * look[2]), 1e-6)
        gx, gy = look[1] / slope, look[2] / slope
        nearest, least = -1, farthest * farthest
        for k in range(n_rim):
            dx, dy = x - rim[k, 2], y - rim[k, 3]
            gap = dx * dx + dy * dy
            if gap < least and gx * rim[k, 4] + gy * rim[k, 5] > least_cosine:
                nearest, least = k, gap
        if nearest >= 0:
            line, row = rim[nearest], rows[n]
            ends[n, 0], ends[n, 1] = edge[of[nearest], 0], edge[of[nearest], 1]
            # along the body's normal: sliding along the outline costs nothing
            row[0], row[1] = line[0], (line[2] - x) * line[4] + (line[3] - y) * line[5]
            row[2], row[3], row[5] = line[4], line[5], reverse
            n += 1
    for k in range(n):  # gradients from the image into the world
        a, b = ends[k, 0], ends[k, 1]
        row = rows[k]
        t, gu, gv = row[0], row[2], row[3]
        x = (1 - t) * vertices[a, 0] + t * vertices[b, 0]
        y = (1 - t) * vertices[a, 1] + t * vertices[b, 1]
        d = (1 - t) * vertices[a, 2] + t * vertices[b, 2]
        deep = p[2, 0] * x + p[2, 1] * y + p[2, 2] * d + p[2, 3]
        u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * d + p[0, 3]) / deep
        v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * d + p[1, 3]) / deep
        for c in range(3):
            row[2 + c] = (gu * (p[0, c] - u * p[2, c]) + gv * (p[1, c] - v * p[2, c])) / deep
    return n

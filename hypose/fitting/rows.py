"""Rows of cues on a body whose poses, shape or cameras are unknown: linearised residuals of points of the body.

A cue gives its residuals and their derivatives by a point in the world; `problem.Rows` computes the rest. (The compiled
solve of one frame sums such rows without storing them: hypose.compute.)
Sources: two-way contour distances as in Gall et al. 2009, with the loss of Geman & McClure 1985; depth as in
    articulated ICP (Knoop et al. 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import NOT_KNOWN
from hypose.compute.losses import geman_mcclure, lorentzian
from hypose.compute.parts import covered, projected
from hypose.compute.rows import BORDER
from hypose.evidence.terms import ContourTerm, DepthTerm, KeypointTerm
from hypose.fitting.problem import Posed, Rows
from hypose.geometry import Array

_REFERENCE_PX, _HEIGHT_PX, _OUTLINE = 6.0, 260.0, 130
"""_REFERENCE_PX: distance, px, of rows of weight 1 on a person of _HEIGHT_PX. _OUTLINE: reference number of points of
the mask's outline.
"""
_FARTHEST = 0.25
"""Share of the person's height beyond which an outline is another one."""
_OUT_PX = 1.2
"""px from the outline to where the body must have ended."""
_FLAT = 0.3
"""Slope of a distance below which it has no direction: where two outlines meet."""
_FEWEST = 8
"""Least number of points of a visible outline."""
_FARTHEST_M = 0.3
_TURNED_M = 0.06
"""m, extra distance of a surface whose normal points the opposite way."""
_ALONG_M = 0.04
"""m; a measured point farther off the surface is drawn to its nearest place instead of along the normal."""
_CORNERS = np.array(
    [[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [2.5, 2.5, 1], [2.5, 1, 2.5], [1, 2.5, 2.5]], dtype=np.float64
)
_CORNERS /= _CORNERS.sum(1, keepdims=True)


def rows_of_contours(
    at: Posed,
    term: ContourTerm,
    factor: float,
    weight: float,
    spacing_px: float,
    normals: float,
    projections: Array | None = None,
) -> Iterator[Rows]:
    """Compute contour rows in both directions between the outlines of the body and of the masks.

    at: the posed body.
    term: outlines of the masks.
    factor: factor of the term's robust scale.
    weight: weight of a row at the reference density.
    spacing_px: distance of the rows along the body's outline, px.
    normals: least cosine between the normals of both outlines; other rows are omitted.
    projections: (C, 3, 4) cameras; None: those of the term.
    Returns: rows of each usable view.
    """
    reference = max(_REFERENCE_PX / _HEIGHT_PX * term.height_px, 1.0)
    farthest, scale = _FARTHEST * term.height_px, term.scale_px * factor
    for c in np.flatnonzero(term.usable).tolist():
        p, (width, height) = (term.projections if projections is None else projections)[c], term.sizes[c].tolist()
        rim = _visible_outline(at, p, (height, width), spacing_px)
        if rim is None:
            continue
        (ends, along, length, uv, normal), sdf = rim, term.sdf[c]
        # forward: the body's outline in the mask's distances
        distance, gradient, known = _bilinear(sdf, uv)
        steep = np.hypot(gradient[:, 0], gradient[:, 1])
        use = ((gradient * normal).sum(1) > normals * steep) | (steep < _FLAT)
        use &= known
        # reverse: the mask's outline to the body's nearest with a similar normal
        mark = term.outline[c].astype(np.float64)
        mark = mark[(mark > -1e5).all(1)]
        outward = _bilinear(sdf, mark)[1]
        outward /= np.maximum(np.hypot(outward[:, 0], outward[:, 1]), 1e-6)[:, None]
        gap = (mark[:, :1] - uv[:, 0]) ** 2 + (mark[:, 1:] - uv[:, 1]) ** 2
        gap[outward[:, :1] * normal[:, 0] + outward[:, 1:] * normal[:, 1] <= normals] = np.inf
        nearest = gap.argmin(1)
        near = gap[np.arange(len(mark)), nearest] < farthest**2
        nearest, mark = nearest[near], mark[near]
        # along the body's normal: sliding along the outline costs nothing
        r = np.r_[distance[use], ((uv[nearest] - mark) * normal[nearest]).sum(1)]
        direction, of = np.concatenate([gradient[use], normal[nearest]]), np.r_[np.flatnonzero(use), nearest]
        reverse = np.full(len(nearest), _OUTLINE / max(len(term.outline[c]), 1))
        own = weight * np.r_[length[use] / reference, reverse]
        rho, pull, _ = geman_mcclure((r / scale) ** 2, own / scale**2)
        share = np.column_stack([1 - along, along, np.zeros(len(along))])[of]
        carrier = ends[of][:, [0, 1, 1]]
        point = np.einsum("rc,rcd->rd", share, at.vertices[carrier])
        seen = np.einsum("rc,nc->nr", p[:, :3], point) + p[:, 3]
        slope = np.einsum("nr,rc->nc", direction, p[:2, :3])
        slope -= (direction * seen[:, :2] / seen[:, 2:]).sum(1, keepdims=True) * p[2, :3]
        slope /= seen[:, 2:]
        cost = 0.5 * float((own * rho).sum())
        yield Rows(carrier, share, point, slope, r, pull, np.full(len(of), c), cost)


def _visible_outline(
    at: Posed, projection: Array, shape: tuple[int, int], spacing_px: float
) -> tuple[NDArray[np.int64], Array, Array, Array, Array] | None:
    """Sample the visible outline of a body in one view, away from the border of the picture.

    projection: (3, 4) pinhole projection.
    shape: (h, w) shape of the picture.
    spacing_px: distance of the points, px.
    Returns: of N points: (N, 2) vertices of the mesh edge, (N,) place on it, 0..1, (N,) length of outline for which a
        point stands, px, (N, 2) px, (N, 2) unit outward normals; None where the body is not in the view.
    """
    uv, depth, _ = projected(at.vertices, projection)
    if not np.isfinite(uv).all():
        return None
    faces, edges, size = np.asarray(at.mesh.faces), np.asarray(at.mesh.edges), np.array(shape[::-1])
    one, two = uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
    front = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] < 0  # image y grows downwards
    parts = lambda length: np.maximum(np.ceil(length / spacing_px), 1)  # noqa: E731
    ends, along, length, normal = contour_points(edges, front, uv, 1e-3, parts)
    point = uv[ends[:, 0]] + along[:, None] * (uv[ends[:, 1]] - uv[ends[:, 0]])
    inside = ((point >= BORDER) & (point < size - 1 - BORDER)).all(1)
    column, row = np.clip(np.rint(point + _OUT_PX * normal), 0, size - 1).astype(np.int64).T
    kept = inside & (covered(uv, depth, faces, shape)[row, column] == 0)
    if kept.sum() < _FEWEST:
        return None
    return ends[kept], along[kept], length[kept], point[kept], normal[kept]


def contour_points(
    edges: NDArray[np.int32], front: NDArray[np.bool_], uv: Array, shortest_px: float, parts: Callable[[Array], Array]
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Place points on the mesh edges between a face that is seen from outside and one that is not.

    edges: (E, 4) vertices, and faces left and right; front: (F,) faces seen from outside; uv: (V, 2) px.
    shortest_px: shorter edges have no points.
    parts: function that computes the number of points of edges from their lengths (N,), px.
    Returns: of N points: (N, 2) vertices of the edge, (N,) place on it, 0..1, (N,) length of contour for which a point
        stands, px, (N, 2) unit outward normals in the image.
    """
    left = front[edges[:, 2]]
    on = left != front[edges[:, 3]]
    ends = np.where(left[on, None], edges[on][:, :2], edges[on][:, 1::-1]).astype(np.int64)
    way = uv[ends[:, 1]] - uv[ends[:, 0]]
    length = np.hypot(way[:, 0], way[:, 1])
    count = np.where(length >= shortest_px, parts(length), 0).astype(np.int64)
    of = np.repeat(np.arange(len(count)), count)
    along = (np.arange(len(of)) - (np.cumsum(count) - count)[of] + 0.5) / count[of]
    normal = np.stack([-way[of, 1], way[of, 0]], 1) / length[of, None]  # the front face lies on the other side
    return ends[of], along, (length[of] / count[of]), normal


def _bilinear(image: NDArray[np.float32], at: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Interpolate a signed distance (h, w) bilinearly at points (N, 2), px, inside it.

    Returns: values (N,); gradients (N, 2); whether all four pixels are known (N,).
    """
    low = np.clip(np.floor(at).astype(np.int64), 0, np.array(image.shape[::-1]) - 2)
    (x, y), (a, b) = low.T, (at - low).T
    s00, s01, s10, s11 = (image[y + j, x + i].astype(np.float64) for j in (0, 1) for i in (0, 1))
    value = (s00 * (1 - a) + s01 * a) * (1 - b) + (s10 * (1 - a) + s11 * a) * b
    right, down = (s01 - s00) * (1 - b) + (s11 - s10) * b, (s10 - s00) * (1 - a) + (s11 - s01) * a
    return value, np.stack([right, down], 1), np.maximum.reduce([s00, s01, s10, s11]) < NOT_KNOWN


def rows_of_keypoints(
    at: Posed, term: KeypointTerm, projections: Array, weight: float = 1.0, least_depth_m: float = 0.05
) -> Rows:
    """Compute rows of key points in the images of pinhole cameras; points behind a camera are omitted.

    at: the posed body.
    term: the key points.
    projections: (C, 3, 4) cameras.
    weight: factor of the confidences.
    least_depth_m: least depth of a point before the camera, m.
    Returns: two rows (u, v) per point.
    """
    places = at.body.skeleton.points(term.joint, term.offset, at.pose)
    homogeneous = np.einsum("cij,kj->cki", projections[:, :, :3], places) + projections[:, None, :, 3]
    seen = (term.points[..., 2] > term.min_confidence) & (homogeneous[..., 2] > least_depth_m)
    view, k = np.nonzero(seen)
    h, p = homogeneous[seen], projections[view]
    uv = h[:, :2] / h[:, 2:]
    slope = (p[:, :2, :3] - uv[..., None] * p[:, 2:, :3]) / h[:, 2, None, None]
    r, own, scale = uv - term.points[view, k, :2], weight * term.points[view, k, 2], 2 * term.scale_px
    rho, pull, _ = lorentzian((r**2).sum(1) / scale**2, 4 * own / scale**2)
    view, k = np.repeat(view, 2), np.repeat(k, 2)
    carrier = len(at.vertices) + np.repeat(term.joint[k][:, None], 3, 1)
    share = np.tile([1.0, 0.0, 0.0], (len(k), 1))
    cost = 2 * float((own * rho).sum())
    return Rows(carrier, share, places[k], slope.reshape(-1, 3), r.ravel(), np.repeat(pull, 2), view, cost)


def rows_of_depth(at: Posed, term: DepthTerm, factor: float = 1.0, gain: float = 1.0) -> Iterator[Rows]:
    """Compute rows from measured points to the nearest place of the body that faces their sensor.

    at: the posed body.
    term: measured points with normals, by sensor.
    factor: factor of the robust scale.
    gain: gain of the weights.
    Returns: rows of each sensor.
    """
    from scipy.spatial import KDTree  # takes long to import

    faces, (flat, smooth) = np.asarray(at.mesh.faces), at.normals
    corner = at.vertices[faces]
    for c, eye in enumerate(term.eyes):
        own = slice(int(term.first[c]), int(term.first[c + 1]))
        points, outward, weight = term.points[own], term.normals[own], gain * term.weight[own]
        front = np.flatnonzero(((eye - corner.mean(1)) * flat).sum(1) > 0)
        if not len(points) or not len(front):
            continue
        place = np.einsum("sc,fcd->fsd", _CORNERS, corner[front]).reshape(-1, 3)
        looks = np.einsum("sc,fcd->fsd", _CORNERS, smooth[faces[front]]).reshape(-1, 3)
        away, nearest = KDTree(np.concatenate([place, _TURNED_M * looks], 1)).query(
            np.concatenate([points, _TURNED_M * outward], 1)
        )
        near = np.asarray(away) < _FARTHEST_M
        lost = 0.5 * float(weight[~near].sum())
        which, seen, w = np.asarray(nearest)[near].astype(np.int64), points[near], weight[near]
        carrier, share = faces[front[which // len(_CORNERS)]].astype(np.int64), _CORNERS[which % len(_CORNERS)]
        point = np.einsum("rc,rcd->rd", share, at.vertices[carrier])
        slope = np.einsum("rc,rcd->rd", share, smooth[carrier])
        slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
        r, far = ((point - seen) * slope).sum(1), np.linalg.norm(point - seen, axis=1)
        off = far > _ALONG_M
        slope[off] = ((point - seen) / np.maximum(far, 1e-9)[:, None])[off]
        r = np.where(off, far, r)
        scale = term.scale_m * factor
        rho, pull, _ = geman_mcclure((r / scale) ** 2, w / scale**2)
        cost = lost + 0.5 * float((w * rho).sum())
        yield Rows(carrier, share, point, slope, r, pull, np.full(len(r), c), cost)

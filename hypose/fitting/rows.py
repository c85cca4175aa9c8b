"""Rows of cues on a body whose poses, shape or cameras are unknown: linearised residuals of points of the body.

A cue gives its residuals and their derivatives by a point in the world; `problem.Rows` computes the rest. (The compiled
solve of one frame sums such rows without storing them: hypose.compute.)
Sources: two-way contour distances as in Gall et al. 2009, with the loss of Geman & McClure 1985; depth as in
    articulated ICP (Knoop et al. 2006).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hypose.compute.losses import geman_mcclure, lorentzian
from hypose.compute.shape_rows import outline_rows
from hypose.evidence.terms import ContourTerm, DepthTerm, KeypointTerm
from hypose.fitting.problem import Posed, Rows
from hypose.geometry import Array

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
    for c in np.flatnonzero(term.usable).tolist():
        seen = (term.projections if projections is None else projections)[c], term.sizes[c].tolist()
        given = at.vertices, at.mesh.faces, at.mesh.edges, *seen, term.sdf[c], term.outline[c]
        found = outline_rows(*given, term.height_px, spacing_px, normals)
        if found is not None:
            (ends, values), scale = found, term.scale_px * factor
            own = weight * values[:, 5]
            rho, pull, _ = geman_mcclure((values[:, 1] / scale) ** 2, own / scale**2)
            share = np.column_stack([1 - values[:, 0], values[:, 0], np.zeros(len(ends))])
            carrier = ends[:, [0, 1, 1]]
            point = np.einsum("rc,rcd->rd", share, at.vertices[carrier])
            cost = 0.5 * float((own * rho).sum())
            yield Rows(carrier, share, point, values[:, 2:5], values[:, 1], pull, np.full(len(ends), c), cost)


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

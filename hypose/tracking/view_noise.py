"""Estimate how much noisier the key points of one view are than those of the others.

Such a view has a camera that was moved or lags, or shifted detections. The detector's confidence does not show it, and
a robust cost does not leave it out when its errors are as large as the noise that was measured with them. The noise of
each view is estimated from its residuals against the triangulation: variance components, whose sums of squares are
divided by the share that is left in the residuals (Förstner, W. 1979, Ein Verfahren zur Schätzung von Varianz- und
Kovarianzkomponenten), with medians in place of sums.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig, triangulate
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import other_sides
from hypose.geometry import Array

LARGEST = 12.0
"""Largest noise factor of a view; with it the view has practically no weight."""
USUAL = 1.6
"""Factors up to this are chance, or due to what a view sees of the person."""
_ROUNDS = 12
_LEAST_POINTS = 30
_CONFIDENT = 0.3
_NEAREST_M = 0.3
_LEAST_LEFT = 0.2


def view_factors(keypoints: Sequence[Keypoints]) -> Array:
    """Estimate by how much the noise in metres of each view is larger than that of the better half of the views.

    keypoints: frames of one recording.
    Returns: (C,) factors >= 1; all 1 with fewer than three views, and where too little is seen in three.
    The worst view is left out before the others are judged, as long as three are left, so that its errors are not
    charged to them. A view that calls left what the others call right is not noisier for it: its sides are exchanged in
    frames where they then lie nearer to those of the others.
    """
    rig, other = keypoints[0].rig, other_sides(keypoints[0].names)
    points = np.stack([k.points for k in keypoints], 1)
    seen = (points[..., 2] > _CONFIDENT) & np.isfinite(points[..., :2]).all(-1)
    uv, factor, active = np.nan_to_num(points[..., :2]), np.ones(len(rig)), np.ones(len(rig), dtype=np.bool_)
    while active.sum() >= 3:
        chosen = seen[active].sum(0) >= 3
        if chosen.sum() < _LEAST_POINTS:
            break
        found = _components(rig, uv, seen & chosen, active, other)
        worst = int(np.argmax(np.where(active, found, 0.0)))
        if found[worst] <= USUAL:
            break
        factor[worst], active[worst] = found[worst], False
    return factor


def _components(
    rig: CameraRig, uv: Array, seen: NDArray[np.bool_], active: NDArray[np.bool_], other: NDArray[np.int64]
) -> Array:
    """Estimate the factors (C,) of the active views.

    uv: (C, T, K, 2) points, px; seen: (C, T, K) where they are seen.
    other: (K,) column of each point's other side.
    """
    views, shape = len(rig), seen.shape
    factor, size = np.ones(views), np.ones((views, seen[0].size))
    named, shown = uv, (seen & active[:, None, None]).reshape(views, -1)
    for _ in range(_ROUNDS):
        world, _ = triangulate(rig, named.reshape(views, -1, 2), shown / (factor[:, None] * size))  # weights of rows
        residual, slope, size = _rows(world, named.reshape(views, -1, 2), rig.projections, shown)
        weight = shown / (factor[:, None] * size) ** 2
        normal = np.einsum("cn,cnia,cnib->nab", weight, slope, slope)
        least = 1e-9 * np.maximum(np.trace(normal, axis1=1, axis2=2), 1.0)
        inverse = np.linalg.inv(normal + least[:, None, None] * np.eye(3))
        left = 2 - weight * np.einsum("cnia,nab,cnib->cn", slope, inverse, slope)
        square = (residual**2).sum(-1) / size**2 / np.maximum(left, _LEAST_LEFT)
        many = shown.sum(1) >= _LEAST_POINTS
        medians = [np.median(s[k]) if m else np.nan for s, k, m in zip(square, shown, many, strict=True)]
        noise = np.sqrt(np.array(medians))
        usual = np.sort(noise[many])[(many.sum() - 1) // 2]
        found = np.clip(np.nan_to_num(noise / max(float(usual), 1e-6), nan=1.0), 1.0, LARGEST)
        factor = np.sqrt(factor * found)
        exchanged = _exchanged(world.reshape(*shape[1:], 3), uv, rig.projections, seen, other)[..., None]
        named = np.where(exchanged[..., None], uv[:, :, other], uv)
        shown = (np.where(exchanged, seen[:, :, other], seen) & active[:, None, None]).reshape(views, -1)
    return factor


def _exchanged(
    world: Array, uv: Array, projections: Array, seen: NDArray[np.bool_], other: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Find views and frames (C, T) whose points lie nearer to the 3D points (T, K, 3) when their sides change
    places."""
    h = np.einsum("cij,tkj->ctki", projections[:, :, :3], world) + projections[:, None, None, :, 3]
    there = h[..., :2] / np.maximum(h[..., 2:], _NEAREST_M)
    known = seen & np.isfinite(there).all(-1)
    known &= known[:, :, other]
    as_named = np.linalg.norm(np.nan_to_num(there - uv), axis=-1)
    as_other = np.linalg.norm(np.nan_to_num(there - uv[:, :, other]), axis=-1)
    return np.asarray((known * (as_named - as_other)).sum(-1) > 0)


def _rows(world: Array, uv: Array, projections: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Compute the residuals of 3D points (N, 3) seen at uv (C, N, 2).

    Returns: residuals (C, N, 2), px; derivatives (C, N, 2, 3), px/m; pixels per metre (C, N).
    """
    h = np.einsum("cij,nj->cni", projections[:, :, :3], world) + projections[:, None, :, 3]
    depth = np.maximum(np.nan_to_num(h[..., 2]), _NEAREST_M)
    projected = h[..., :2] / depth[..., None]
    by_point = projections[:, None, :2, :3] - projected[..., None] * projections[:, None, 2:, :3]
    slope = by_point / depth[..., None, None]
    size = np.linalg.norm(projections[:, :2, :3], axis=(1, 2))[:, None] / np.sqrt(2) / depth
    residual = np.where(seen[..., None], np.nan_to_num(projected - uv), 0.0)
    return residual, np.nan_to_num(slope), size

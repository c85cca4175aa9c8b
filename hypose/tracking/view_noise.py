"""How much worse the key points of one view are than those of the others: a camera that was moved, lags, or whose
detections are shifted.

A view that is wrong as a whole is not told by its detector's confidence, and a robust cost does not leave it out when
the wrong distances are as large as the noise that was measured with them. The views' noise is estimated from what they
leave of each other's triangulation: variance components, whose sums of squares are divided by the share of them that
is left in the residuals (Förstner, W. 1979, Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten), with
medians in place of sums.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig, triangulate
from hypose.evidence.frame import Keypoints
from hypose.geometry import Array

LARGEST = 12.0
"""No view is taken for worse than so many times the others: it is as good as left out then."""
USUAL = 1.6
"""Up to this factor views differ by chance, and by what they see of the person."""
_ROUNDS = 12
_LEAST_POINTS = 30
_CONFIDENT = 0.3
_NEAREST_M = 0.3
_LEAST_LEFT = 0.2


def view_factors(keypoints: Sequence[Keypoints]) -> Array:
    """(C,) >= 1: by how much the noise in metres of each view is larger than that of the better half of the views, from
    frames of one recording; all 1 with fewer than three views, and where too little is seen in three.

    The worst view is left out before the others are judged, as long as three are left: what it has spoilt of them is
    not theirs."""
    rig = keypoints[0].rig
    points = np.stack([k.points for k in keypoints], 1).reshape(len(rig), -1, 3)
    seen = (points[..., 2] > _CONFIDENT) & np.isfinite(points[..., :2]).all(-1)
    uv, factor, active = np.nan_to_num(points[..., :2]), np.ones(len(rig)), np.ones(len(rig), dtype=np.bool_)
    while active.sum() >= 3:
        chosen = seen[active].sum(0) >= 3
        if chosen.sum() < _LEAST_POINTS:
            break
        found = _components(rig, uv[:, chosen], seen[:, chosen], active)
        worst = int(np.argmax(np.where(active, found, 0.0)))
        if found[worst] <= USUAL:
            break
        factor[worst], active[worst] = found[worst], False
    return factor


def _components(rig: CameraRig, uv: Array, seen: NDArray[np.bool_], active: NDArray[np.bool_]) -> Array:
    """(C,) factors of the active views, from points (C, N, 2) px where they are seen (C, N)."""
    factor, size = np.ones(len(rig)), np.ones(seen.shape)
    seen = seen & active[:, None]
    for _ in range(_ROUNDS):
        world, _ = triangulate(rig, uv, seen / (factor[:, None] * size))  # rows are multiplied by it
        residual, slope, size = _rows(world, uv, rig.projections, seen)
        weight = seen / (factor[:, None] * size) ** 2
        normal = np.einsum("cn,cnia,cnib->nab", weight, slope, slope)
        inverse = np.linalg.inv(normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3))
        left = 2 - weight * np.einsum("cnia,nab,cnib->cn", slope, inverse, slope)
        square = (residual**2).sum(-1) / size**2 / np.maximum(left, _LEAST_LEFT)
        many = seen.sum(1) >= _LEAST_POINTS
        medians = [np.median(s[k]) if m else np.nan for s, k, m in zip(square, seen, many, strict=True)]
        noise = np.sqrt(np.array(medians))
        usual = np.sort(noise[many])[(many.sum() - 1) // 2]
        found = np.clip(np.nan_to_num(noise / max(float(usual), 1e-6), nan=1.0), 1.0, LARGEST)
        factor = np.sqrt(factor * found)
    return factor


def _rows(world: Array, uv: Array, projections: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Of points (N, 3) seen at uv (C, N, 2): residuals (C, N, 2) px, their derivatives (C, N, 2, 3) px/m, and pixels
    per metre (C, N) there."""
    h = np.einsum("cij,nj->cni", projections[:, :, :3], world) + projections[:, None, :, 3]
    depth = np.maximum(np.nan_to_num(h[..., 2]), _NEAREST_M)
    projected = h[..., :2] / depth[..., None]
    by_point = projections[:, None, :2, :3] - projected[..., None] * projections[:, None, 2:, :3]
    slope = by_point / depth[..., None, None]
    size = np.linalg.norm(projections[:, :2, :3], axis=(1, 2))[:, None] / np.sqrt(2) / depth
    residual = np.where(seen[..., None], np.nan_to_num(projected - uv), 0.0)
    return residual, np.nan_to_num(slope), size

"""Views whose key points and mask cannot be of one person: what speaks against the tracked body is left out there.

A joint's centre lies in the person's mask, whatever they do. Where half of a view's key points lie outside it, one of
the two is of somebody else, of another moment or of another calibration; the body as it is expected tells which, and
where it can tell nothing both stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.evidence.frame import Keypoints, Silhouettes
from hypose.geometry import Array
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, KeypointModel, pixels_per_metre

NEAR_M = 0.04
"""So far outside a mask a point still counts as in it: masks fray, detectors scatter."""
REFUTED, CONFIRMED = 0.5, 0.75
"""Shares of a view's points in its mask: below the one they speak against each other; from the other on the expected
body is where the mask is."""
EXPECTED_M = 0.15
"""Key points whose median is not further from the expected ones are where the body is expected."""
_LEAST_POINTS = 6
_AROUND = np.array([(0, 0), *((np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 8, endpoint=False))])


def without_refuted(
    keypoints: Keypoints, silhouettes: Silhouettes, body: Body, model: KeypointModel, expected: Array
) -> tuple[Keypoints, Silhouettes]:
    """The frame's key points, and its masks, without the views in which the other one and the expected pose (D,) speak
    against them."""
    points = np.nan_to_num(keypoints.points)
    used = (points[..., 2] > MIN_CONFIDENCE) & model.known
    places = model.positions(body, expected)
    uv = np.stack([camera.project_pinhole(places) for camera in keypoints.rig])
    used &= np.isfinite(uv).all(-1)
    size = pixels_per_metre(keypoints, expected[:3])
    confidence, usable = points[..., 2].copy(), silhouettes.usable.copy()
    reasons = list(silhouettes.reasons)
    for c in np.flatnonzero(silhouettes.usable & (used.sum(1) >= _LEAST_POINTS)).tolist():
        scale = np.array(silhouettes.rig[c].size) / np.array(keypoints.rig[c].size)
        mask, (w, h) = silhouettes.masks[c], silhouettes.rig.sizes[c]
        seen = used[c]
        if _share_inside(mask[:h, :w], points[c, seen, :2], scale, NEAR_M * size[c]) >= REFUTED:
            continue
        there = _share_inside(mask[:h, :w], uv[c, seen], scale, NEAR_M * size[c])
        away = float(np.median(np.linalg.norm(points[c, seen, :2] - uv[c, seen], axis=-1))) / size[c]
        if there >= CONFIRMED:
            confidence[c] = 0.0
        elif there < REFUTED and away < EXPECTED_M:
            usable[c], reasons[c] = False, f"{silhouettes.rig.names[c]}: the mask is not where the key points are"
    if (usable == silhouettes.usable).all() and (confidence == points[..., 2]).all():
        return keypoints, silhouettes
    kept = replace(keypoints, points=np.concatenate([points[..., :2], confidence[..., None]], -1))
    if (usable == silhouettes.usable).all():
        return kept, silhouettes
    return kept, replace(silhouettes, usable=usable, reasons=tuple(reasons))


def _share_inside(mask: NDArray[np.uint8], points: Array, scale: Array, reach: float) -> float:
    """Share of points (N, 2) px, of pictures 1 / scale times as large as the mask, in it or not further from it than
    reach (px of theirs); points outside the picture count as inside."""
    at = np.rint((points[:, None] + reach * _AROUND + 0.5) * scale - 0.5).astype(int)
    h, w = mask.shape
    out = np.asarray((at < 0).any(-1) | (at >= (w, h)).any(-1), dtype=np.bool_)
    found = mask[np.clip(at[..., 1], 0, h - 1), np.clip(at[..., 0], 0, w - 1)] > 0
    return float((found.any(1) | out[:, 0]).mean())

"""Pose2Sim's way from key points to 3D points, for comparison: what its version 0.10.49 does with its default settings.

Each point: confidence-weighted linear triangulation, views taken away one after the other until the mean reprojection
error is below 15 px; gaps of fewer than 20 frames bridged straight; Hampel's outlier test and a Butterworth low-pass of
6 Hz, forth and back. Source: Pagnon, Domalain & Reveret 2021, 2022, and the documentation of its settings. Written
anew; `real-balancing` reports how far it is from the tool's own result file. Deviation: points are undistorted first.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from hypose.cameras.camera import CameraRig, triangulate
from hypose.geometry import Array

_ERROR_PX, _LIKELIHOOD, _GAP, _CUTOFF_HZ, _SHORTEST = 15.0, 0.3, 20, 6.0, 9


def pose2sim_points(rig: CameraRig, points: Array, frame_rate: float) -> Array:
    """(T, K, 3) m: filtered 3D points from detections points (T, C, K, 3) = u, v px of the rig's (full-size) pinhole
    cameras and confidence; NaN where there are none."""
    uv = np.moveaxis(points[..., :2], 1, 0)
    weight = np.moveaxis(np.where(points[..., 2] >= _LIKELIHOOD, points[..., 2], 0.0), 1, 0)
    x = _best_views(rig, uv, weight)
    flat = x.reshape(len(x), -1)
    out = np.stack([_filtered(_bridged(column), frame_rate) for column in flat.T], 1)
    return out.reshape(x.shape)


def _best_views(rig: CameraRig, uv: Array, weight: Array) -> Array:
    """(T, K, 3) triangulated with as many views as the error allows; uv (C, T, K, 2), weight (C, T, K)."""
    views = len(rig)
    best = np.full((*uv.shape[1:3], 3), np.nan)
    least = np.full(uv.shape[1:3], np.inf)
    for off in range(views - 1):
        todo = least > _ERROR_PX
        found, error = best.copy(), np.full_like(least, np.inf)
        for without in combinations(range(views), off):
            w = weight.copy()
            w[list(without)] = 0.0
            x, n = triangulate(rig, uv, w)
            distance = np.stack(
                [np.linalg.norm(c.project_pinhole(x) - z, axis=-1) for c, z in zip(rig, uv, strict=True)]
            )
            seen = w > 0
            mean = np.where(seen, np.nan_to_num(distance, nan=np.inf), 0.0).sum(0) / np.maximum(n, 1)
            better = (n >= 2) & (mean < error)
            found[better], error[better] = x[better], mean[better]
        best[todo], least[todo] = found[todo], error[todo]
    best[~(least <= _ERROR_PX)] = np.nan
    return best


def _bridged(column: Array) -> Array:
    known = np.flatnonzero(np.isfinite(column))
    out = column.copy()
    for a, b in zip(known[:-1], known[1:], strict=True):
        if 1 < b - a <= _GAP:
            out[a:b] = np.linspace(column[a], column[b], b - a + 1)[:-1]
    return out


def _filtered(column: Array, frame_rate: float) -> Array:
    out = column.copy()
    for t in range(3, len(column) - 3):
        window = column[t - 3 : t + 4]
        middle = np.median(window)
        spread = np.median(np.abs(window - middle))
        if spread > 0 and abs(0.6745 * (column[t] - middle) / spread) > 2:
            out[t] = middle
    sections = butter(2, _CUTOFF_HZ / (frame_rate / 2), output="sos")
    known = np.flatnonzero(np.isfinite(out))
    for part in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(part) > _SHORTEST:
            out[part] = sosfiltfilt(sections, out[part], padlen=_SHORTEST)
    return out

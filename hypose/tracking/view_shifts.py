"""How far each view's mask lies from the body as a whole: what is left of a wrong calibration, a lag, a wrong body.

A solve halves the difference between views that contradict each other; what is left points one way in each of them and
stays, while the noise of outlines points everywhere. It tells errors that no curvature of a cost knows.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

_SCALE_M = 0.025
"""Outlines that lie further apart count less (Tukey's weight, zero at three times that): they are of something else."""
_ROUNDS, _SETTLED_PX = 8, 0.01
_LEAST = 30
"""points of the outline without which a view's shift is not known"""


def shift_of_mask(
    mask: NDArray[np.uint8], body: NDArray[np.uint8], metre: float, ignored: NDArray[np.uint8] | None = None
) -> Array:
    """(2,) m, right and down: by how much a body drawn as (h, w) of 0 and 1 would have to move to lie in a mask (h, w),
    NaN where too little is seen. metre: pixels of a metre; ignored (h, w): 1 = a pixel that says nothing."""
    outlines, _ = cv2.findContours(body, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return np.full(2, np.nan)
    x, y = max(outlines, key=len)[:, 0].T
    inside = (x > 0) & (y > 0) & (x < mask.shape[1] - 1) & (y < mask.shape[0] - 1)
    if ignored is not None:
        inside &= ignored[y, x] == 0
    x, y = x[inside], y[inside]
    if len(x) < _LEAST:
        return np.full(2, np.nan)
    # what lies further from the outline than this has no weight
    margin = int(2 * 3 * _SCALE_M * metre) + 2
    low, high = np.maximum((x.min() - margin, y.min() - margin), 0), (x.max() + margin + 1, y.max() + margin + 1)
    mask = np.ascontiguousarray(mask[low[1] : high[1], low[0] : high[0]])
    if not mask.any() or mask.all():  # no edge is anywhere near
        return np.full(2, np.nan)
    distance = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) - cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    distance += mask - np.float32(0.5)  # the edge lies between the pixels
    smooth, below = cv2.GaussianBlur(distance, (0, 0), 1.0).ravel(), mask.shape[1]
    at = (y - low[1]) * below + (x - low[0])  # numbers of the pixels
    residual = (distance.ravel()[at] + 0.5).astype(np.float64)  # the outline's pixels are the body's last ones
    right, down = (smooth[at + 1] - smooth[at - 1]) / 2, (smooth[at + below] - smooth[at - below]) / 2
    steep = np.maximum(np.sqrt(right * right + down * down), 1e-3)
    across, weighted = np.empty((len(at), 2)), np.empty((len(at), 2))
    across[:, 0], across[:, 1] = right / steep, down / steep
    found, limit = np.zeros(2), 3 * _SCALE_M * metre
    for _ in range(_ROUNDS):
        weight = np.maximum(1 - ((residual + across @ found) / limit) ** 2, 0.0) ** 2
        for k in range(2):  # numpy goes along rows of two one by one
            np.multiply(across[:, k], weight, out=weighted[:, k])
        last, found = found, -np.linalg.solve(weighted.T @ across + 1e-3 * np.eye(2), weighted.T @ residual)
        if np.abs(found - last).max() < _SETTLED_PX:
            break
    return np.asarray(found / metre, dtype=np.float64)


def apart(shifts: Array) -> float:
    """m: root mean square over the views of their shifts (C, 2); NaN with fewer than two that are known."""
    square = (shifts**2).sum(1)
    known = np.isfinite(square)
    return float(np.sqrt(square[known].mean())) if known.sum() > 1 else float("nan")

"""Edges for contour trackers: the gradient of a smoothed picture in units of a full edge."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError

WEAKEST = 3.0
"""grey levels per px: the least gradient that may count as a full edge; below lies the noise"""


def edge_field(image: NDArray[np.uint8], smoothing_px: float = 1.2, strength: float = 0.93) -> NDArray[np.float32]:
    """Gradient (h, w, 2) float32 of image (h, w, 3) or (h, w) uint8, of length 1 where it is at least a full edge.

    Each pixel takes the colour channel of largest gradient; a full edge is the `strength` quantile of all lengths.
    Source: Sminchisescu & Triggs 2001, section 3.2 (Gaussian smoothing, then Sobel). Deviation: Scharr's kernels, which
    turn with the edge more exactly, and the cut, so that the contrast of the background does not outvote the body.
    """
    if image.ndim not in (2, 3) or image.dtype != np.uint8:
        raise InputError(f"A picture must be (h, w) or (h, w, 3) uint8, got {image.shape} {image.dtype}.")
    smooth = image.astype(np.float32)
    if smoothing_px > 0:
        smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), smoothing_px), dtype=np.float32)
    field = _strongest_gradient(smooth if smooth.ndim == 3 else smooth[..., None])
    size = np.linalg.norm(field, axis=2)
    # every other row and column: the quantile needs no more
    full = max(float(np.quantile(size[1:-1:2, 1:-1:2], strength)), WEAKEST) if min(size.shape) > 2 else WEAKEST
    return field / np.maximum(size, np.float32(full))[..., None]


def _strongest_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scharr gradient (h, w, 2) per px of the channel of image (h, w, C) in which it is largest; 0 along the border."""
    slopes = np.stack([cv2.Scharr(image, cv2.CV_32F, 1 - k, k, scale=1 / 32).reshape(image.shape) for k in range(2)], 2)
    best = (slopes**2).sum(2).argmax(2)
    field = np.take_along_axis(slopes, best[..., None, None], 3)[..., 0]
    field[[0, -1]] = 0
    field[:, [0, -1]] = 0
    return field

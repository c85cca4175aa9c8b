"""Edges for contour trackers: the gradient of a smoothed picture in units of a full edge."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute import mono
from hypose.errors import InputError

WEAKEST = 3.0
"""grey levels per px: the least gradient that may count as a full edge; below lies the noise"""
PEAK = 3.0
"""times the mean gradient around it: what counts as a full edge there"""
CELL = 8
"""px: side of the cells in which that mean is taken first"""


def edge_field(
    image: NDArray[np.uint8], smoothing_px: float = 1.2, strength: float = 0.93, contrast_px: float = 0.0
) -> NDArray[np.float32]:
    """Gradient (h, w, 2) float32 of image (h, w, 3) or (h, w) uint8, of length 1 where it is at least a full edge.

    Each pixel takes the colour channel of largest gradient. A full edge is the `strength` quantile of all lengths or,
    with contrast_px > 0, less where the picture has less contrast within about that radius, so that a dark sleeve
    before a dark coat is an edge too.
    Source: Sminchisescu & Triggs 2001, section 3.2 (Gaussian smoothing, then Sobel). Deviation: Scharr's kernels, which
    turn with the edge more exactly, and the cut, so that the contrast of the background does not outvote the body.
    """
    if image.ndim not in (2, 3) or image.dtype != np.uint8:
        raise InputError(f"A picture must be (h, w) or (h, w, 3) uint8, got {image.shape} {image.dtype}.")
    smooth = image.astype(np.float32)
    if smoothing_px > 0:
        smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), smoothing_px), dtype=np.float32)
    field, size = mono.strongest_gradient(smooth if smooth.ndim == 3 else smooth[..., None])
    # every other row and column: the quantile needs no more
    full = max(float(np.quantile(size[1:-1:2, 1:-1:2], strength)), WEAKEST) if min(size.shape) > 2 else WEAKEST
    h, w = size.shape
    everywhere = np.full((h, w), full, np.float32)
    if contrast_px > 0:
        cells = cv2.resize(size, (max(w // CELL, 1), max(h // CELL, 1)), interpolation=cv2.INTER_AREA)
        around = cv2.resize(cv2.GaussianBlur(cells, (0, 0), contrast_px / CELL), (w, h), interpolation=cv2.INTER_LINEAR)
        everywhere = np.clip(PEAK * np.asarray(around, np.float32), WEAKEST, full)
    mono.saturate(field, size, everywhere)
    return field

"""Compute edges of a picture (the gradient in units of a full edge), and optical flow with outliers and motion
boundaries.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError

WEAKEST = 3.0
"""grey levels per px: least gradient that can count as a full edge; below is noise"""


def edge_field(image: NDArray[np.uint8], smoothing_px: float = 1.2, strength: float = 0.93) -> NDArray[np.float32]:
    """Compute the gradient (h, w, 2) float32 of a picture, with length 1 where it is at least a full edge.

    image: (h, w, 3) or (h, w) uint8. Each pixel uses the colour channel with the largest gradient.
    strength: quantile of all lengths that is a full edge.
    Source: Sminchisescu & Triggs 2001, section 3.2 (Gaussian smoothing, then Sobel). Deviations: Scharr's kernels,
        whose direction is more exact; and the limit of 1, so that high contrast in the background does not outweigh the
        body.
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
    return np.asarray(field / np.maximum(size, full)[..., None], dtype=np.float32)


def _strongest_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the Scharr gradient (h, w, 2) per px of the channel of image (h, w, C) in which it is largest; 0 on
    the border.
    """
    slopes = np.stack([cv2.Scharr(image, cv2.CV_32F, 1 - k, k, scale=1 / 32).reshape(image.shape) for k in range(2)], 2)
    best = (slopes**2).sum(2).argmax(2)
    field = np.take_along_axis(slopes, best[..., None, None], 3)[..., 0]
    field[[0, -1]] = 0
    field[:, [0, -1]] = 0
    return np.asarray(field, dtype=np.float32)


_STEEP, WRONG = 6.0, 2.0
"""Sobel slope of the flow, and forward-backward error (px), that make a full motion boundary"""
SMOOTHING, GAIN = 3.0, 1.6
"""px by which boundaries are smoothed, and the factor that restores their height"""
_LEAST_SIDE_PX = 48
"""px: a smaller part of a picture has too little support at the coarse scales of flow"""


@dataclass(frozen=True)
class Flow:
    """Optical flow in a part of the picture, from the previous picture to this one.

    flow: (h, w, 2) float32 px, at the previous picture's pixels.
    error: (h, w) forward-backward error, px, at the same pixels: the outlier map.
    boundaries: (h, w) motion boundaries, 0 to 1, at this picture's pixels.
    corner: (x, y) where the part begins.
    """

    flow: NDArray[np.float32]
    error: NDArray[np.float32]
    boundaries: NDArray[np.float32]
    corner: tuple[int, int]


def optical_flow(
    previous: NDArray[np.uint8], current: NDArray[np.uint8], box: tuple[int, int, int, int] | None = None
) -> Flow:
    """Compute the optical flow from the previous to the current grey picture (h, w) uint8.

    box: x0, x1, y0, y1 (half open; default: the whole picture).
    Raises: InputError where the pictures differ in size or are too small.
    Source: Sminchisescu & Triggs 2001, section 3.2: robust flow with an outlier map, from which smoothed motion
        boundaries are made. Deviation: DIS flow (Kroeger et al. 2016) in both directions, with the forward-backward
        error as the outlier map, instead of Black & Anandan's flow.
    """
    if previous.shape != current.shape or previous.ndim != 2:
        raise InputError(
            f"Flow needs two grey pictures of one size, got {previous.shape} and {current.shape}; check that the video "
            "does not change its size."
        )
    h, w = current.shape
    x0, x1, y0, y1 = _wide_enough(box or (0, w, 0, h), w, h)
    if min(x1 - x0, y1 - y0) < _LEAST_SIDE_PX:
        raise InputError(
            f"Flow needs pictures of at least {_LEAST_SIDE_PX} x {_LEAST_SIDE_PX} px, got {w} x {h}; give larger ones."
        )
    a, b = (np.ascontiguousarray(p[y0:y1, x0:x1]) for p in (previous, current))
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there = np.asarray(solver.calc(a, b, None), dtype=np.float32)  # type: ignore[call-overload]
    back = np.asarray(solver.calc(b, a, None), dtype=np.float32)  # type: ignore[call-overload]
    slopes = [cv2.Sobel(back, cv2.CV_32F, 1 - k, k, borderType=cv2.BORDER_REPLICATE) for k in range(2)]
    steepness = np.sqrt((np.stack(slopes) ** 2).sum((0, 3)))
    raw = np.minimum(steepness / _STEEP, 1) + np.minimum(_flow_error(back, there) / WRONG, 1)
    smooth = np.minimum(cv2.GaussianBlur(raw, (0, 0), SMOOTHING) * np.float32(GAIN), np.float32(1))
    return Flow(there, _flow_error(there, back), np.asarray(smooth, dtype=np.float32), (x0, y0))


def _flow_error(there: NDArray[np.float32], back: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the length (h, w), px, of there(x) + back(x + there(x)); outside the picture the border's flow is
    used.
    """
    h, w = there.shape[:2]
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    at = x + there[..., 0], y + there[..., 1]
    returned = cv2.remap(back, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.linalg.norm(there + returned, axis=2)


def _wide_enough(box: tuple[int, int, int, int], w: int, h: int) -> tuple[int, int, int, int]:
    """Clip the box to the picture, and enlarge it to at least _LEAST_SIDE_PX px where possible.

    box: x0, x1, y0, y1, half open.
    w, h: size of the picture, px.
    """
    size = np.array([w, h])
    low, high = np.maximum((box[0], box[2]), 0), np.minimum((box[1], box[3]), size)
    middle = np.clip((low + high - _LEAST_SIDE_PX) // 2, 0, np.maximum(size - _LEAST_SIDE_PX, 0))
    low = np.where(high - low < _LEAST_SIDE_PX, middle, low)
    (x0, y0), (x1, y1) = low.tolist(), np.minimum(np.maximum(high, low + _LEAST_SIDE_PX), size).tolist()
    return x0, x1, y0, y1

"""Encode colours of pictures as one number per pixel that changes little with light and shade."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

SHADES = (4, 16, 16)
"""Number of levels of brightness (an octave each), of the share of red and of the share of green."""
COLOURS = SHADES[0] * SHADES[1] * SHADES[2]
# Sum of the three channels below which all colours are the darkest level.
_DARKEST = 48
# First share and width of a level: of red in skin and cloth 0.2 to 0.65, of green 0.2 to 0.5.
_RED, _GREEN = (0.15, 0.03), (0.20, 0.02)


def colour_codes(image: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Quantise the colour of each pixel of an image (h, w, 3) BGR to a code (h, w), an integer from 0 to COLOURS -
    1.
    """
    whole = image.sum(2, dtype=np.float32)
    share = image[..., :0:-1] / np.maximum(whole, 1)[..., None]  # red, green
    red, green = (
        np.clip((share[..., k] - first) * (1 / width), 0, n - 1).astype(np.uint16)
        for k, ((first, width), n) in enumerate(zip((_RED, _GREEN), SHADES[1:], strict=True))
    )
    bright = np.clip(np.log2(np.maximum(whole, 1) / _DARKEST), 0, SHADES[0] - 1).astype(np.uint16)
    return (bright * SHADES[1] + red) * SHADES[2] + green


# Factor from grey levels per pixel to edge values, which end at 255.
_STEEP = 8.0


def colour_edges(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Compute how fast the colour changes along rows and columns (2, h, w) of an image (h, w, 3) BGR."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, 1 - k, k) / 8 for k in (0, 1)]
    return np.stack([np.minimum(_STEEP * np.sqrt((s**2).sum(-1)), 255) for s in slopes]).astype(np.uint8)

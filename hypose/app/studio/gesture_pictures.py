"""Depth pictures and detection maps as the page gets them."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.studio.sockets import DEPTH, MAP, picture
from hypose.compute import Depth

_NEAR, _FAR = 500, 4200
"""mm: the colours' range; what is nearer or farther has the end's colour."""
_QUALITY = 75
# from near to far: BGR, light enough to stand out on both themes' stages
_COLOURS = (
    (0.00, (196, 243, 255)),
    (0.18, (110, 214, 250)),
    (0.36, (104, 168, 214)),
    (0.55, (138, 116, 120)),
    (0.78, (108, 72, 52)),
    (1.00, (58, 36, 26)),
)
_HOLE = (22, 15, 12)


def depth_picture(depth: Depth, seq: int, time: float) -> bytes:
    """A depth picture (h, w) uint16 mm as a message of type DEPTH."""
    data = cv2.imencode(".jpg", coloured(depth), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return picture(DEPTH, 0, seq, time, data.tobytes())


def coloured(depth: Depth) -> NDArray[np.uint8]:
    """(h, w, 3) BGR of a depth picture (h, w) uint16 mm; holes are dark."""
    return cv2.applyColorMap(np.take(_levels(), depth), _palette())  # type: ignore[return-value] - uint8, as it says


def map_picture(density: NDArray[np.float32], seq: int, time: float, full: float) -> bytes:
    """A map of voting surface (rows, columns) as a message of type MAP: alpha is the share of `full`, the density that
    is shown opaque."""
    alpha = np.clip(density * (255 / max(full, 1e-12)), 0, 255).astype(np.uint8)
    image = np.empty((*alpha.shape, 4), np.uint8)
    image[..., :3] = (60, 90, 255)
    image[..., 3] = alpha
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    return picture(MAP, 0, seq, time, data.tobytes())


@cache
def _levels() -> NDArray[np.uint8]:
    """Level of each depth in mm: 0 = hole, then from near to far."""
    mm = np.arange(1 << 16)
    level = 1 + np.rint(254 * np.clip((mm - _NEAR) / (_FAR - _NEAR), 0, 1))
    level[0] = 0
    return level.astype(np.uint8)


@cache
def _palette() -> NDArray[np.uint8]:
    at, colours = zip(*_COLOURS, strict=True)
    share = np.linspace(0, 1, 255)
    rows = np.stack([np.interp(share, at, [c[k] for c in colours]) for k in range(3)], 1)
    return np.concatenate([[_HOLE], np.rint(rows)]).astype(np.uint8)[:, None]

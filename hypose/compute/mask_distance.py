"""Compute the signed distance of masks (OpenCV's chamfer transform)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Mask

_FARTHEST = np.float32(1e4)
"""px; larger distances count as this."""


def signed_distance(mask: Mask) -> NDArray[np.float32]:
    """Compute the signed distance to the edge of a mask, px, negative inside.

    mask: (h, w) 1 = person, else 0.
    Returns: (h, w) float32. The zero lies between the last inside and the first outside pixel. An empty (full) mask
        gives _FARTHEST (minus it) everywhere.

    Distances are those of a 5 x 5 chamfer mask (within 2 % of Euclid). OpenCV's steps are 1, 1.4 and 2.1969 px; rounded
    to fifths, near the edge they are those of Borgefors 1986 (5, 7 and 11).
    """
    x, y, w, h = cv2.boundingRect(mask)
    # the inside needs the mask's own box only, and one background pixel around it
    own = slice(max(y - 1, 0), y + h + 1), slice(max(x - 1, 0), x + w + 1)
    out = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)
    out[own] -= cv2.distanceTransform(mask[own], cv2.DIST_L2, 5)
    fifths = np.rint(np.float32(5) * np.clip(out, -_FARTHEST, _FARTHEST))
    return np.float32(0.2) * fifths + (mask - np.float32(0.5))

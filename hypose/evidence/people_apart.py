"""Do masks show several people? Told view by view, without any calibration: one may be what is looked for."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.evidence.frame import Silhouettes

_LARGE, _TALL = 0.3, 0.5
"""Share of the largest part's area, and of its height, from which a part of a mask is somebody, too: a person who is
nearly twice as far away."""
OFTEN, NOW_AND_THEN, _VIEWS = 0.5, 0.25, 2
"""Share of the frames in which a view must show several, without and with other evidence of them, and how many views
must: an arm or a chair that a table cuts off is seen so by one."""


def several_apart(silhouettes: Sequence[Silhouettes], often: float = OFTEN) -> bool:
    """Whether so many of these frames, a share of them, show people beside each other in two views or more."""
    if not silhouettes:
        return False
    usable = np.array([s.usable for s in silhouettes])
    shown = [[u and _beside(m) > 1 for m, u in zip(s.masks, s.usable, strict=True)] for s in silhouettes]
    views = np.array(shown).sum(0) > often * np.maximum(usable.sum(0), 1)
    return int(views.sum()) >= _VIEWS


def _beside(mask: NDArray[np.uint8]) -> int:
    """How many large parts of a mask (h, w) stand beside each other; what stands above another is the same one."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    parts = stats[1:]
    if not len(parts):
        return 0
    area, height = parts[:, cv2.CC_STAT_AREA], parts[:, cv2.CC_STAT_HEIGHT]
    first = int(area.argmax())
    large = parts[(area >= _LARGE * area[first]) & (height >= _TALL * height[first])]
    count, end = 0, -1
    for left, width in sorted(large[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_WIDTH]].tolist()):
        count += left > end
        end = max(end, left + width)
    return count

"""Limbs of a 2D skeleton that the mask does not confirm: there nothing of the mask may be cut away.

A mask that is kept within a thick skeleton loses whatever a detector has got wrong: a limb that is taken for the other
one, or is not seen at all, is cut off, and silhouettes that were to correct the key points can only agree with them.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIRMED = 0.6
"""Share of a limb's line that lies in the mask; of true limbs nearly all does, in front of the trunk too."""
_MIN_CONFIDENCE = 0.3
_LEAST_WHOLE = 3
_LIMBS = tuple(
    (f"{side}_{root}", f"{side}_{middle}", f"{side}_{end}", reach)
    for side in ("left", "right")
    for root, middle, end, reach in (("shoulder", "elbow", "wrist", 0.46), ("hip", "knee", "ankle", 0.58))
)
"""Root, middle and end of the limbs, and how far they reach, with hand or foot, in heights of the person."""


def with_doubted_limbs(
    band: NDArray[np.uint8], mask: NDArray[np.uint8], points: ArrayLike, names: Sequence[str], height: float
) -> NDArray[np.uint8] | None:
    """The band (h, w) with the reach of all limbs that the mask (h, w), made within it, does not confirm; None when it
    confirms all. points (K, 3) px; height of the person, px. A limb whose root is not known is left alone. Where most
    of the limbs that are seen whole lie outside the mask it is not cut at all: the skeleton is somewhere else."""
    p = np.asarray(points, dtype=np.float64)
    at = {n: p[k] for k, n in enumerate(names) if p[k, 2] > _MIN_CONFIDENCE}
    out = band.copy()
    doubted, whole, outside = False, 0, 0
    for root, middle, end, reach in _LIMBS:
        if root not in at or height <= 0:
            continue
        line = [at[n][:2] for n in (root, middle, end) if n in at]
        if len(line) == 3:
            whole += 1
            if _inside(mask, np.stack(line)) >= CONFIRMED:
                continue
            outside += 1
        doubted = True
        u, v = (int(np.clip(round(x), -4 * max(mask.shape), 4 * max(mask.shape))) for x in at[root][:2])
        cv2.circle(out, (u, v), max(1, round(reach * height)), 1, -1)
    if whole >= _LEAST_WHOLE and outside > 0.5 * whole:
        return np.ones_like(band)
    return out if doubted else None


def _inside(mask: NDArray[np.uint8], line: NDArray[np.float64]) -> float:
    """Share of points along a line (N, 2) px, apart from its first tenth, that lie in the mask; what lies outside the
    picture counts as in it."""
    share = np.linspace(0.0, 1.0, 12)[1:, None]
    along = np.concatenate([a + share * (b - a) for a, b in zip(line[:-1], line[1:], strict=True)])
    u, v = np.rint(along).astype(int).T
    h, w = mask.shape
    out = (u < 0) | (v < 0) | (u >= w) | (v >= h)
    found = mask[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)] > 0
    return float((found | out).mean())

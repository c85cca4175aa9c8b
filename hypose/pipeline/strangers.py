"""Who else is in the masks: connected parts of them in which no part of the tracked body lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton
from hypose.compute import projected, touched_area
from hypose.evidence.ahead import prepared_masks
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS


def strangers_share(now: Silhouettes, before: Silhouettes, skeleton: Skeleton, joints: Array) -> NDArray[np.float32]:
    """(C,) area of the largest part of each view's mask that the body does not touch, over the area of what it touches;
    NaN where it touches nothing, or the mask is not usable. joints (J, 3): m, world, of the tracked body.

    Only what was there in the frame before as well is looked at: noise comes and goes."""
    points = _points(skeleton, joints)
    cameras, seen, then = now.rig, prepared_masks(now), prepared_masks(before)
    step = max(1, round(int(cameras.sizes.max()) / SETTINGS.stranger_looked_at))
    out = np.full(len(cameras), np.nan, np.float32)
    for c in np.flatnonzero(now.usable & before.usable).tolist():
        w, h = (int(n) for n in cameras.sizes[c])
        at = projected(points, cameras.projections[c])[0]
        own, other = touched_area(seen.bits[c], then.bits[c], (w, h), step, at)
        if own:
            out[c] = other / own
    return out


def _points(skeleton: Skeleton, joints: Array) -> Array:
    """(N, 3) joints, and points along the bones between them."""
    child = np.flatnonzero(np.asarray(skeleton.parents) >= 0)
    parent = np.asarray(skeleton.parents)[child]
    return np.concatenate(
        [joints, *(joints[parent] + a * (joints[child] - joints[parent]) for a in SETTINGS.stranger_along)]
    )

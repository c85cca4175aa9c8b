"""Who else is in the masks: connected parts of them in which no part of the tracked body lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from hypose.body.skeleton import Skeleton
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array

_LOOKED_AT = 160
"""px: of the longer side of the thinned masks in which parts are counted; a limb stays two or three pixels wide."""
_ALONG = (0.25, 0.5, 0.75)
_TOUCHING = np.ones((3, 3))


def strangers_share(now: Silhouettes, before: Silhouettes, skeleton: Skeleton, joints: Array) -> NDArray[np.float32]:
    """(C,) area of the largest part of each view's mask that the body does not touch, over the area of what it touches;
    NaN where it touches nothing, or the mask is not usable. joints (J, 3): m, world, of the tracked body.

    Only what was there in the frame before as well is looked at: noise comes and goes."""
    points = _points(skeleton, joints)
    cameras = now.rig
    step = max(1, round(int(cameras.sizes.max()) / _LOOKED_AT))
    out = np.full(len(cameras), np.nan, np.float32)
    for c in np.flatnonzero(now.usable & before.usable).tolist():
        w, h = (int(n) for n in cameras.sizes[c])
        part = (c, slice(0, h, step), slice(0, w, step))
        thin = now.masks[part] & before.masks[part]
        for ignored in (s.ignored for s in (now, before) if s.ignored is not None):
            thin = thin & (1 - ignored[part])
        labels = np.zeros(thin.shape, dtype=np.int32)
        label(thin, _TOUCHING, output=labels)  # OpenCV would wake its threads for so small a picture
        area = np.bincount(labels.ravel())
        own = np.zeros(len(area), dtype=bool)
        u, v = np.rint(_inside(cameras[c].project_pinhole(points), (w, h)) / step).astype(int).T
        own[labels[np.minimum(v, thin.shape[0] - 1), np.minimum(u, thin.shape[1] - 1)]] = True
        own[0], area[0] = False, 0  # the background
        if own.any():
            out[c] = area[~own].max() / area[own].sum()
    return out


def _points(skeleton: Skeleton, joints: Array) -> Array:
    """(N, 3) joints, and points along the bones between them."""
    child = np.flatnonzero(np.asarray(skeleton.parents) >= 0)
    parent = np.asarray(skeleton.parents)[child]
    return np.concatenate([joints, *(joints[parent] + a * (joints[child] - joints[parent]) for a in _ALONG)])


def _inside(uv: Array, size: tuple[int, int]) -> Array:
    """Those of the points (N, 2) px that lie in a picture of size (w, h)."""
    with np.errstate(invalid="ignore"):
        return uv[(uv >= 0).all(1) & (uv <= np.array(size) - 1).all(1)]

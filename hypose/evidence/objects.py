"""Which object of the masks is whom in the other views, by the rays through its middle, its top and its bottom.

Programs that make masks number objects view by view, each in its own way. That an object is the same person all the
time is theirs to say; who is who across views is found here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.evidence.association import clusters
from hypose.evidence.ray_matching import Views, between_rays
from hypose.geometry import Array

_TOGETHER = 0.35  # m, mean distance of rays up to which two views' objects are one person: outlines are no points
_LIMIT = 1.0
_LEAST = 6


def object_points(mask: NDArray[np.uint8]) -> Array:
    """(3, 2) px: the middle of a mask (h, w), of its top tenth and of its bottom tenth; NaN when it is empty."""
    rows = np.flatnonzero(mask.any(1))
    if not len(rows):
        return np.full((3, 2), np.nan)
    tenth = max(1, (rows[-1] - rows[0] + 1) // 10)
    out, first, last = [], rows[0], rows[-1] + 1
    for part in (slice(first, last), slice(first, first + tenth), slice(last - tenth, last)):
        v, u = np.nonzero(mask[part])
        out.append([u.mean(), v.mean() + part.start])
    return np.array(out)


def people_of_objects(points: Sequence[Mapping[str, Array]], rig: CameraRig) -> list[dict[int, str]]:
    """People as {view: object}, those seen in most views and frames first; an object that no other view shows is a
    person of its own.

    points: per view and object (S, 3, 2) undistorted px of the pinhole `rig` in S common frames (`object_points`), NaN
    where it is not there."""
    at = [(c, name) for c, view in enumerate(points) for name in view]
    if not at:
        return []
    found = np.stack([np.reshape(points[c][name], (-1, 2)) for c, name in at])
    known = np.isfinite(found[..., 0])
    found = np.concatenate([np.nan_to_num(found), known[..., None].astype(np.float64)], -1)
    which = np.array([c for c, _ in at], dtype=np.int64)
    apart = between_rays(Views(rig), which, found, _LIMIT, _LEAST)
    groups = clusters(apart, _TOGETHER)
    alone = [[i] for i in range(len(at)) if not any(i in g for g in groups)]
    there = known.sum(1)
    ordered = sorted([*groups, *alone], key=lambda g: (-len(g) * int(there[g].sum()), at[g[0]]))
    return [{at[i][0]: at[i][1] for i in sorted(g)} for g in ordered]

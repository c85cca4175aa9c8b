"""What poses cost by depth maps, for the search: how far the drawn body lies before or behind what was seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.evidence.depth_evidence import Depth
from hypose.fitting.depth_surface import shrunk
from hypose.geometry import Array
from hypose.tracking.frame_evidence import PreparedFrame

SHARE = 1.0
"""What a pixel at the wrong depth costs against one outside the mask. Chosen on the seeds 0 to 9 (benchmark
`depth`)."""
MOST_M = 0.15
"""m: a pixel that is further off costs no more"""
TALL = 60
"""px: how tall a person is in the pictures that are compared, at least"""
_SEEN = "seen depth"


def depth_cost(
    body: Body, poses: Array, frame: PreparedFrame, moving: NDArray[np.bool_] | None = None, rough: bool = False
) -> Array:
    """(N,) of poses (N, D): mean difference of depth over the pixels of the person that the body covers, sum over the
    sensors; what is not covered is the silhouettes' affair. moving: as for `SilhouetteXor`; rough: about
    that, and faster (`compute.depth_energy`); 0 without depth."""
    if frame.frame.depth is None:
        return np.zeros(len(poses))
    seen = _seen(frame, frame.frame.depth)
    energy = compute.depth_energy(poses, body.skeleton.tree, body.coarse.arrays, seen, MOST_M, moving, rough)
    return SHARE * energy.sum(1)


def depth_views(frame: PreparedFrame) -> int:
    """How many sensors show the person; at least 1."""
    return 1 if frame.frame.depth is None else max(len(_seen(frame, frame.frame.depth).maps), 1)


def _seen(frame: PreparedFrame, depth: Depth) -> compute.SeenDepth:
    seen: compute.SeenDepth | None = frame.shared.get(_SEEN)
    if seen is None:
        seen = frame.shared[_SEEN] = seen_depth(depth)
    return seen


def seen_depth(depth: Depth, tall: int = TALL) -> compute.SeenDepth:
    """The person's pixels of a frame's maps, so small that the person is still `tall` px, and cut to its box."""
    used = np.flatnonzero(depth.usable & (depth.person > 0).any((1, 2)))
    maps, projections, counts = [], [], []
    step = 1
    if len(used):
        heights = [np.ptp(np.flatnonzero(depth.person[c].any(1))) + 1 for c in used]
        step = max(1, int(min(heights)) // tall)
    for c in used:
        small = np.where(depth.person[c, ::step, ::step] > 0, depth.maps[c, ::step, ::step], 0.0)
        rows, columns = np.flatnonzero(small.any(1)), np.flatnonzero(small.any(0))
        if not len(rows):
            continue
        box = small[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        p = shrunk(depth.rig.projections[c][None], step)[0]
        p[0] -= columns[0] * p[2]
        p[1] -= rows[0] * p[2]
        maps.append(box)
        projections.append(p)
        counts.append(int((box > 0).sum()))
    h, w = (max((m.shape[k] for m in maps), default=1) for k in (0, 1))
    out = np.zeros((len(maps), h, w), np.float32)
    for k, m in enumerate(maps):
        out[k, : m.shape[0], : m.shape[1]] = m
    sizes = np.array([m.shape[::-1] for m in maps], dtype=np.int64).reshape(len(maps), 2)
    stacked = np.array(projections, dtype=np.float64).reshape(len(maps), 3, 4)
    return compute.SeenDepth(out, sizes, stacked, np.array(counts, dtype=np.int64))

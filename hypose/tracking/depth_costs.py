"""What poses cost by depth maps, for the search: how far the drawn body lies before or behind what was seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.depth_surface import shrunk
from hypose.geometry import Array
from hypose.tracking.frame_evidence import PoseMemory, PreparedFrame

_SHARE = 1.0
"""What a pixel at the wrong depth costs against one outside the mask. Chosen on the seeds 0 to 9 (benchmark
`depth`)."""
MOST_M = 0.15
"""m: a pixel that is further off costs no more"""
_TALL = 60
"""px: how tall a person is in the pictures that are compared, at least"""
MEASURED, HOPEFUL = 16, 1.1
"""of many poses of a limb so many are drawn, and none that costs so much more than the limb as it is by a rough look.
Chosen on the seeds 0 to 15, and 0 to 29 (benchmark `depth`)."""
ARM_M2, ARM_REACH_M, EXPLAINED_M = 0.055, 0.75, 0.08
"""m^2 of an arm that is seen from its side; m from the shoulder; m between what was drawn and seen"""
LEAST_SHOWN, AGREED, _NEXT_TO = 0.7, 0.8, 0.4
"""shares of an arm: in sight; of what is in sight, where it was seen; seen in its reach, but no part of the body. An
arm that is so much in sight is looked for nowhere else. Chosen on the seeds 0 to 15 (benchmark `depth`)."""
_SEEN_DEPTH, DEPTH_COSTS = "seen depth", "depth costs"
_REMEMBERED_POSES = 12
"""sets of no more poses are remembered: the same pose is judged several times in a frame"""


def depth_cost(body: Body, poses: Array, frame: PreparedFrame) -> Array:
    """(N,) of poses (N, D): mean difference of depth over the pixels of the person that the body covers, sum over the
    sensors; what is not covered is the silhouettes' affair. 0 without depth."""
    if frame.frame.depth is None:
        return np.zeros(len(poses))
    seen = _seen(frame, frame.frame.depth)

    def measured(of: Array) -> Array:
        energy = compute.depth_energy(of, body.skeleton.tree, body.coarse.arrays, seen, MOST_M)
        return np.asarray(_SHARE * energy.sum(1))

    if len(poses) > _REMEMBERED_POSES:
        return measured(poses)
    memory: PoseMemory[float] = frame.shared.setdefault(DEPTH_COSTS, PoseMemory())
    return memory.all(body, poses, measured)


def with_limb_depth(
    body: Body,
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_],
    outlines: Callable[[float, float], Array],
    standing: compute.StandingDepth | None = None,
) -> Array:
    """(N,) what poses (N, D) cost whose joints `moving` (J,) alone differ, everything else as in the last one; infinite
    for those that are not worth a measurement: the first one is the limb as it is, and beside it only the best by a
    rough look are measured. outlines(slack, more): what all of them cost without depth, (N,), infinite where that is
    certainly above `slack` times what the first one costs, and `more`; standing: what does not move, where it has been
    drawn."""
    assert frame.frame.depth is not None
    seen = _seen(frame, frame.frame.depth)
    given = body.skeleton.tree, body.coarse.arrays, seen, MOST_M
    if standing is None:
        standing = compute.standing_depth(poses[-1], *given, moving)

    def limb(chosen: NDArray[np.intp], rough: bool = False) -> Array:
        return _SHARE * compute.limb_depth_energy(poses[chosen], *given, standing, rough).sum(1)

    out = np.full(len(poses), np.inf)
    here = limb(np.zeros(1, np.intp))
    alone = _SHARE * float((standing.cost / np.maximum(seen.counts, 1)).sum())
    before = outlines(HOPEFUL, HOPEFUL * float(here[0]) - alone)
    out[:1] = before[:1] + here
    most = HOPEFUL * out[0]
    chosen = 1 + np.flatnonzero(before[1:] + alone <= most)
    rough = before[chosen] + limb(chosen, rough=True)
    chosen = chosen[np.argsort(rough, kind="stable")[: min(MEASURED - 1, int((rough <= most).sum()))]]
    out[chosen] = before[chosen] + limb(chosen)
    return out


def without_limb(body: Body, pose: Array, frame: PreparedFrame, moving: NDArray[np.bool_]) -> compute.StandingDepth:
    """What depth cameras would see of a body at a pose (D,) without what the joints `moving` (J,) move."""
    assert frame.frame.depth is not None
    seen = _seen(frame, frame.frame.depth)
    return compute.standing_depth(pose, body.skeleton.tree, body.coarse.arrays, seen, MOST_M, moving)


def arm_is_seen(body: Body, frame: PreparedFrame, standing: compute.StandingDepth, shoulder: int) -> bool:
    """Whether depth cameras show an arm where it is in the pose that the rest of the body stands in (`without_limb`),
    and nothing in its reach that the body does not explain. shoulder: its joint."""
    assert frame.frame.depth is not None
    seen = _seen(frame, frame.frame.depth)
    at = standing.pose[:3] + standing.centres[shoulder]
    given = body.skeleton.tree, body.coarse.arrays, seen, standing, at, ARM_REACH_M, EXPLAINED_M
    in_sight, agreed, beside = compute.limb_shown(*given).T
    shown = (in_sight >= LEAST_SHOWN * ARM_M2) & (agreed >= AGREED * in_sight)
    return bool(shown.any() and (beside <= _NEXT_TO * ARM_M2).all())


def depth_views(frame: PreparedFrame) -> int:
    """How many sensors show the person; at least 1."""
    return 1 if frame.frame.depth is None else max(len(_seen(frame, frame.frame.depth).maps), 1)


def _seen(frame: PreparedFrame, depth: Depth) -> compute.SeenDepth:
    seen: compute.SeenDepth | None = frame.shared.get(_SEEN_DEPTH)
    if seen is None:
        seen = frame.shared[_SEEN_DEPTH] = seen_depth(depth)
    return seen


def seen_depth(depth: Depth, tall: int = _TALL) -> compute.SeenDepth:
    """The person's pixels of a frame's maps, so small that the person is still `tall` px, and cut to its box."""
    used = [c for c in np.flatnonzero(depth.usable) if depth.boxes[c][2] > 0]
    maps, projections, counts = [], [], []
    step = max(1, min((depth.boxes[c][3] - depth.boxes[c][1] for c in used), default=0) // tall)
    for c in used:
        x0, y0, x1, y1 = depth.boxes[c]
        every = slice(y0, y1, step), slice(x0, x1, step)
        box = np.where(depth.person[c][every] > 0, depth.maps[c][every], 0.0)
        p = depth.rig.projections[c].copy()
        p[0] -= x0 * p[2]
        p[1] -= y0 * p[2]
        maps.append(box)
        projections.append(shrunk(p[None], step)[0])
        counts.append(int((box > 0).sum()))
    h, w = (max((m.shape[k] for m in maps), default=1) for k in (0, 1))
    out = np.zeros((len(maps), h, w), np.float32)
    for k, m in enumerate(maps):
        out[k, : m.shape[0], : m.shape[1]] = m
    sizes = np.array([m.shape[::-1] for m in maps], dtype=np.int64).reshape(len(maps), 2)
    stacked = np.array(projections, dtype=np.float64).reshape(len(maps), 3, 4)
    return compute.SeenDepth(out, sizes, stacked, np.array(counts, dtype=np.int64))

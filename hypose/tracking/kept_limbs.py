"""Limbs of a clip that has been solved as a whole, where they were tracked in a frame whose evidence refutes the clip.

The clip's solve knows of a frame what a Gaussian about its pose tells. Where an arm goes fast, or is straight so that
its twist is free, the way between two frames that are right can lead through a third pose that neither masks nor key
points allow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.tracking.published_recipes import LIMB_LAYERS
from hypose.tracking.refinement import mismatch
from hypose.tracking.tracker import Tracker

MOVED_M = 0.1
"""m: what the clip's solve has moved by less is not looked at."""
WORSE = 0.05
"""by which the mismatch must be less with the limb as it was tracked. Less tells nothing: of 121 limbs that a clip's
solve had moved (masks, seeds 1150 and 1151; both, 1160 and 1161) 46 were better before, 54 were put right, and none
reaches it. 400 mm in a serve of which 60 % of the key points are missing (1194) is 0.17."""


def with_tracked_limbs(
    tracker: Tracker, tracked: Motion, solved: Motion, frames: Callable[[range], Iterable[Frame]]
) -> Motion:
    """The motion `solved`, of all frames together, with limbs from `tracked`, where they were one by one, in frames
    whose masks and key points tell that they were better there."""
    assert tracked.poses is not None and solved.poses is not None
    if tracker.settings.evidence == "silhouettes":
        return solved  # masks alone refute no limb so clearly
    body, poses = tracker.body, solved.poses.copy()
    known = ~(np.asarray(solved.lost) | np.asarray(solved.extrapolated))
    moved = np.linalg.norm(solved.joints - tracked.joints, axis=-1) > MOVED_M
    s = body.skeleton
    limbs = [(s.dofs_of(*joints), s.descendants(joints[0])[1:]) for _, joints in LIMB_LAYERS]
    for t in np.flatnonzero(moved.any(1) & known).tolist():
        far = [own for own, below in limbs if moved[t, below].any()]
        frame = next(iter(frames(range(t, t + 1)))) if far else None
        prepared = None if frame is None else tracker.prepare_frame(frame, tracked.poses[t])
        if prepared is None or prepared.masks is None:
            continue
        for own in far:
            other = poses[t].copy()
            other[own] = tracked.poses[t, own]
            cost = mismatch(np.stack([poses[t], other]), prepared, step_penalty=0.0)
            if cost[1] < cost[0] - WORSE:
                poses[t] = other
    if np.array_equal(poses, solved.poses):
        return solved
    return replace(solved, poses=poses, joints=body.joints(poses))

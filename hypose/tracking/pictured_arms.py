"""Arms where pictures show them: looked for about where they are held to be, before the trunk too.

What lies before the trunk has no outline. Its colours and the rims of its sleeves are in the pictures, and tell an arm
from one ten centimetres off, over which the masks are of two minds. So arms are drawn about their place, narrower and
narrower, and what the masks and the pictures like best holds the arm while the body is solved anew.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hypose.compute import reach
from hypose.fitting.articulated import PointTerm
from hypose.geometry import Array
from hypose.tracking.costs import frame_energy
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.part_colours import ColourSettings, colour_scores, known_colours
from hypose.tracking.reach_table import ArmReach


def pictured_arms(
    arms: Iterable[ArmReach], pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> tuple[Array, PointTerm] | None:
    """The pose (D,) with its arms where the masks and the pictures like them best near by, and points that hold them
    there in a solve; None when nothing is known of pictures, or nothing near by is better."""
    if known_colours(frame, settings) is None:
        return None
    found = pose
    for arm in arms:
        found = _one_arm(arm, found, frame, settings, rng)
    if found is pose:
        return None
    body, chains = frame.body, [arm.chain for arm in arms]
    joint = np.array([j for _, elbow, wrist in chains for j in (elbow, wrist, wrist)])
    offset = np.concatenate([[np.zeros(3), np.zeros(3), 0.6 * arm.tip] for arm in arms])
    rotations, centres = body.skeleton.forward(found)
    at = centres[joint] + np.einsum("kij,kj->ki", rotations[joint], offset)
    return found, PointTerm(at, np.full(len(joint), settings.strength), joint, offset, settings.hold)


def _one_arm(
    arm: ArmReach, pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> Array:
    """The pose (D,) with this arm where it is liked best; the pose itself when that is where it is."""
    assert frame.masks is not None
    body, o = frame.body, settings
    rest = reach.standing(pose, body.skeleton.tree, body.coarse.arrays, frame.masks, arm.moving)
    views = max(int(frame.masks.usable.sum()), 1)
    best, least, most = pose, np.inf, np.inf
    for step in o.steps:
        poses = np.repeat(best[None], 1 + o.draws, 0)
        poses[1:, arm.own] += step * rng.standard_normal((o.draws, len(arm.own)))
        poses = body.skeleton.clamp(poses)
        poses[0] = best
        energy = frame_energy(poses, frame, arm.moving, rest)
        most = min(most, o.ratio * energy[0])
        good = np.flatnonzero(energy <= most)
        score = energy[good] / views + o.weight * colour_scores(poses[good], frame, o)
        n = int(score.argmin())
        if good[n] and score[n] < least:
            best = poses[good[n]]
        least = min(least, float(score[n]))
    return best

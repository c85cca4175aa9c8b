"""Find frames in which left and right are exchanged: seen from behind, or with legs confused, the outline is nearly the
same.

A tracker that confused them goes on, limb by limb, on the wrong side: knees bend the wrong way, feet point backwards.
No local change helps, because several limbs have to change at once. So the whole body is turned around now and then, or
both legs exchanged; the limbs are put where the other side's were, solved, and compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.compute.threads import in_threads
from hypose.evidence.cues import KeypointEvidence
from hypose.evidence.keypoints import other_sides
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array, so3_exp, so3_log
from hypose.tracking.frame_evidence import PreparedFrame, agreement
from hypose.tracking.refinement import anatomical_prior, refine

_TO_JOINTS = SolveSettings(iterations=30, coarse_iterations=15)
_TO_MASKS = SolveSettings(iterations=12, coarse_iterations=8)
_PARTS = {"legs": ("hip", "knee", "ankle"), "arms": ("shoulder", "elbow", "wrist")}


def turned_around(body: Body, pose: Array) -> Array:
    """Turn a body back to front so that its joints, left and right exchanged, lie where those of `pose` (D,) lie.

    Returns: (D,) pose, exact as far as anatomy allows.
    """
    s = body.skeleton
    joints = body.joints(pose[None])[0]
    wanted = joints[other_sides(s.joint_names)]
    start = s.clamp(turn_pose(pose, np.pi))
    start[:3] += wanted.mean(0) - body.joints(start[None])[0].mean(0)
    return with_joints_at(body, wanted, start)


def limbs_exchanged(body: Body, pose: Array, limb: str = "legs", *, roots: bool = False) -> Array:
    """Exchange the limbs of a pose (D,): each knee and ankle ("legs"), or elbow and wrist ("arms"), goes where the
    other lies.

    roots: also exchange hips or shoulders.
    Returns: (D,) pose, all else unchanged, exact as far as anatomy allows.
    """
    s = body.skeleton
    parts = _PARTS[limb]
    moved = parts if roots else parts[1:]
    joints = body.joints(pose[None])[0]
    wanted = np.where([[n.endswith(moved)] for n in s.joint_names], joints[other_sides(s.joint_names)], joints)
    start = pose.copy()
    for part in parts:
        left, right = (s.dofs_of(f"{side}_{part}") for side in ("left", "right"))
        start[left], start[right] = pose[right], pose[left]
    return with_joints_at(body, wanted, s.clamp(start))


def strain(skeleton: Skeleton, poses: Array) -> Array:
    """Compute a penalty (N,) for poses (N, D) in which hips or spine turn further than people do, or legs are crossed.

    Returns: penalties in units of IoU; 0 for natural poses.
    Why: the limits of ball joints allow a body that sits back to front, with its thighs behind it.
    """
    out = np.zeros(len(poses))
    for name, (backward, back, aside) in _NATURAL.items():
        v = poses[:, skeleton.dofs_of(name)]
        over = np.stack([v[:, 0] * backward - back, np.abs(v[:, 1]) - aside, np.abs(v[:, 2]) - aside])
        out += _STRAIN * (np.maximum(over, 0.0) ** 2).sum(0)
    return out + _CROSSED * np.maximum(legs_crossed(skeleton, skeleton.forward(poses)[1]) - _FREE_M, 0.0)


def legs_crossed(skeleton: Skeleton, joints: Array) -> Array:
    """Compute how far, m, knees or ankles lie on the other leg's side, along the axis of the hips.

    joints: (N, J, 3) m.
    Returns: (N,) m, positive where the legs are crossed, negative where the legs stand apart.
    """

    def between(part: str) -> Array:
        return joints[:, skeleton.joint(f"left_{part}")] - joints[:, skeleton.joint(f"right_{part}")]

    across = between("hip")
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-6)
    return -np.minimum(*((between(part) * across).sum(-1) for part in ("knee", "ankle")))


_NATURAL = {"left_hip": (1.0, 0.5, 0.9), "right_hip": (1.0, 0.5, 0.9), "spine": (-1.0, 0.4, 0.6)}
"""Sign of a turn backwards; rad: natural range backwards, and about each of the two other axes."""
_STRAIN = 0.02
"""penalty per square radian beyond the range"""
_CROSSED, _FREE_M = 0.15, 0.05
"""penalty per metre by which legs are crossed, and the m that are free"""


def look_for_exchange(pose: Array, frame: PreparedFrame, /) -> tuple[float, Array]:
    """Test whether the body turned around, or with its legs exchanged, fits the masks better than `pose` (D,).

    frame: prepared, with masks.
    With key points, exchanged arms are tried as well, with and without shoulders, because detectors exchange their
    names. All poses are solved on the masks without key points, since points follow the sides by which they are named.
    Returns: gain of the best alternative in mean IoU minus `strain` (below zero: `pose` is better); the solved
        alternative (D,).
    """
    body, named = frame.body, frame.keypoints.seen
    if named:
        frame = frame.without(KeypointEvidence)

    def worth(q: Array) -> float:
        return agreement(body, q, frame) - float(strain(body.skeleton, q[None])[0])

    ways: list[Callable[[Body, Array], Array]] = [turned_around, limbs_exchanged]
    if named:
        ways += [partial(limbs_exchanged, limb="arms"), partial(limbs_exchanged, limb="arms", roots=True)]
        ways.append(lambda body, pose: pose)  # the pose itself, also solved without key points

    def solved(way: Callable[[Body, Array], Array]) -> Array:
        start = way(body, pose)
        return refine(body, start[None], replace(frame, prediction=start), _TO_MASKS)[0].pose

    tried = in_threads(solved, ways)
    now, best = worth(tried.pop() if named else pose), (-1.0, pose)
    for found in tried:
        gain = worth(found) - now
        if gain > best[0]:
            best = (gain, found)
    return best


def with_joints_at(body: Body, wanted: Array, start: Array, sd: float = 0.03) -> Array:
    """Solve for the pose (D,) whose joint centres lie at `wanted` (J, 3), m, from a start pose (D,).

    sd: m, distance beyond which a joint pulls less.
    """
    count = len(wanted)
    points = PointTerm(wanted, np.ones(count), np.arange(count), np.zeros((count, 3)), sd)
    return fit_pose(body, start, [points], priors=(anatomical_prior(body.skeleton),), options=_TO_JOINTS).pose


def turn_pose(pose: Array, heading: float) -> Array:
    """Turn a pose (D,) about the vertical through its root by a heading (rad)."""
    out = pose.copy()
    out[3:6] = so3_log(so3_exp([0, 0, heading]) @ so3_exp(pose[3:6]))
    return out

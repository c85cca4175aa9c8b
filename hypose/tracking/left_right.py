"""Left and right exchanged: seen from behind, or with its legs taken for each other, a person has nearly the same
outline.

A tracker that has mixed them up goes on following, limb by limb, on the wrong side: knees that cannot bend that way,
feet that point backwards. Nothing it tries from there is right, since several limbs have to change at once. So the
whole body is turned around now and then, or both legs exchanged, the limbs put where the other side's were, solved, and
compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.compute.threads import over_chunks
from hypose.evidence.cues import KeypointEvidence
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.tracking.costs import agreement
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.refinement import anatomical_prior, refine
from hypose.tracking.starts import turn_pose

_TO_JOINTS = SolveSettings(iterations=30, coarse_iterations=15)
_TO_MASKS = SolveSettings(iterations=12, coarse_iterations=8)
_PARTS = {"legs": ("hip", "knee", "ankle"), "arms": ("shoulder", "elbow", "wrist")}


def turned_around(body: Body, pose: Array) -> Array:
    """(D,) the pose in which the body stands back to front and its joints, left and right exchanged, lie where those of
    `pose` (D,) lie, as far as anatomy allows."""
    s = body.skeleton
    joints = body.joints(pose[None])[0]
    wanted = joints[[s.joint(_other_side(name)) for name in s.joint_names]]
    start = s.clamp(turn_pose(pose, np.pi))
    start[:3] += wanted.mean(0) - body.joints(start[None])[0].mean(0)
    return _with_joints_at(body, wanted, start)


def limbs_exchanged(body: Body, pose: Array, limb: str = "legs", *, roots: bool = False) -> Array:
    """(D,) the pose in which each knee and ankle, or each elbow and wrist ("arms"), lies where the other one lies in
    `pose` (D,), with roots each hip or shoulder as well, all else as it is, as far as anatomy allows."""
    s = body.skeleton
    parts = _PARTS[limb]
    moved = parts if roots else parts[1:]
    joints = body.joints(pose[None])[0]
    wanted = joints[[s.joint(_other_side(n) if n.endswith(moved) else n) for n in s.joint_names]]
    start = pose.copy()
    for part in parts:
        left, right = (s.dofs_of(f"{side}_{part}") for side in ("left", "right"))
        start[left], start[right] = pose[right], pose[left]
    return _with_joints_at(body, wanted, s.clamp(start))


def strain(skeleton: Skeleton, poses: Array) -> Array:
    """(N,) what it costs to turn hips and spine further than people do in poses (N, D), and to cross the legs: the
    limits of balls leave room for a body that sits back to front, its thighs behind it."""
    out = np.zeros(len(poses))
    for name, (back, aside) in _NATURAL.items():
        v = poses[:, skeleton.dofs_of(name)]
        over = np.stack([v[:, 0] * _BACKWARD[name] - back, np.abs(v[:, 1]) - aside, np.abs(v[:, 2]) - aside])
        out += _STRAIN * (np.maximum(over, 0.0) ** 2).sum(0)
    return out + _CROSSED * np.maximum(legs_crossed(skeleton, skeleton.forward(poses)[1]) - _FREE_M, 0.0)


def legs_crossed(skeleton: Skeleton, joints: Array) -> Array:
    """(N,) m by which knees or ankles lie on the other leg's side, along the axis of the hips, of joints (N, J, 3) m;
    negative where the legs stand apart."""

    def between(part: str) -> Array:
        return joints[:, skeleton.joint(f"left_{part}")] - joints[:, skeleton.joint(f"right_{part}")]

    across = between("hip")
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-6)
    return -np.minimum(*((between(part) * across).sum(-1) for part in ("knee", "ankle")))


_NATURAL = {"left_hip": (0.5, 0.9), "right_hip": (0.5, 0.9), "spine": (0.4, 0.6)}
"""rad: how far backwards, and how far about the two other axes"""
_BACKWARD = {"left_hip": 1.0, "right_hip": 1.0, "spine": -1.0}
_STRAIN = 0.02
"""for a radian more"""
_CROSSED, _FREE_M = 0.15, 0.05
"""for a metre by which legs are crossed, and the m that cost nothing"""


def look_for_exchange(pose: Array, frame: PreparedFrame, /) -> tuple[float, Array]:
    """By how much the body turned around, or with its legs exchanged, overlaps the masks better than in `pose` (D,),
    mean IoU over the views less what it strains more (`strain`), and that pose (D,), solved on the frame. Below zero:
    `pose` is the better one.

    Where there are key points, arms are tried as well, on either girdle: a detector exchanges their names. Judged by
    the masks alone, `pose` solved on them, too: points follow the sides that they were named by."""
    body, named = frame.body, frame.keypoints.seen
    if named:
        frame = frame.without(KeypointEvidence)

    def worth(q: Array) -> float:
        return agreement(body, q, frame) - float(strain(body.skeleton, q[None])[0])

    ways: list[Callable[[Body, Array], Array]] = [turned_around, limbs_exchanged]
    if named:
        ways += [partial(limbs_exchanged, limb="arms"), partial(limbs_exchanged, limb="arms", roots=True), _as_it_is]
    tried = [pose] * len(ways)

    def work(first: int, last: int) -> None:
        for n in range(first, last):
            start = ways[n](body, pose)
            tried[n] = refine(body, start[None], replace(frame, prediction=start), _TO_MASKS)[0].pose

    over_chunks(work, len(ways), None)
    now, best = worth(tried.pop() if named else pose), (-1.0, pose)
    for found in tried:
        gain = worth(found) - now
        if gain > best[0]:
            best = (gain, found)
    return best


def _as_it_is(body: Body, pose: Array) -> Array:
    return pose


def _with_joints_at(body: Body, wanted: Array, start: Array) -> Array:
    """(D,) solved from a pose (D,) so that the joint centres lie at `wanted` (J, 3) m."""
    count = len(wanted)
    points = PointTerm(wanted, np.ones(count), np.arange(count), np.zeros((count, 3)), 0.03)
    return fit_pose(body, start, [points], priors=(anatomical_prior(body.skeleton),), options=_TO_JOINTS).pose


def _other_side(name: str) -> str:
    if name.startswith("left"):
        return name.replace("left", "right", 1)
    return name.replace("right", "left", 1) if name.startswith("right") else name

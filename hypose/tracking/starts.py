"""Find start poses: from triangulated key points, from a known pose at the visual hull, or again after a loss."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.errors import EvidenceError, InputError
from hypose.evidence.hull import Hull
from hypose.evidence.people import occupied_space
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import PoseFit, SolveSettings, fit_pose
from hypose.geometry import Array, procrustes, rotation_between, so3_exp, so3_log
from hypose.tracking.frame_evidence import PreparedFrame, evidence_energy
from hypose.tracking.refinement import SETTLING, anatomical_prior, refine

# direction of the upper arm in each known pose, for the left side (x = the subject's left, y backward, z up)
_ARM_DIRECTION = {
    "t": (1.0, 0.0, 0.0),
    "standing": (0.15, 0.0, -1.0),
    "hands-up": (0.3, 0.0, 1.0),
}
KNOWN_POSES = ("a", *_ARM_DIRECTION)
"""Poses that a person may be asked to take at the start; 'a' is the body's rest pose."""


def known_pose(body: Body, name: str) -> Array:
    """Build a known pose (D,) at the origin, facing -y: 'a', 't', 'standing' (arms hanging) or 'hands-up'; arms
    straight.

    Raises: InputError that lists the known poses where the name is unknown.
    """
    s = body.skeleton
    pose = np.zeros(s.dof)
    if name not in KNOWN_POSES:
        raise InputError(f"There is no known pose {name!r}; the known poses are {', '.join(KNOWN_POSES)}.")
    if name in _ARM_DIRECTION:
        joints = s.rest_joints
        for side, mirror in (("left", 1.0), ("right", -1.0)):
            shoulder, elbow, wrist = (s.joint(f"{side}_{n}") for n in ("shoulder", "elbow", "wrist"))
            upper, fore = joints[elbow] - joints[shoulder], joints[wrist] - joints[elbow]
            direction = np.array(_ARM_DIRECTION[name]) * (mirror, 1, 1)
            pose[s.dofs_of(f"{side}_shoulder")] = so3_log(rotation_between(upper, direction))
            straight = np.arccos(np.clip(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore), -1, 1))
            pose[s.dofs_of(f"{side}_elbow")] = -straight
    return s.clamp(pose)


def start_from_keypoints(
    body: Body, points_world: Array, joint: NDArray[np.int64], offset: Array, *, weight: Array | None = None
) -> PoseFit:
    """Fit a pose to 3D points of one frame by bounded inverse kinematics.

    Several arm poses and headings are tried; the solution with the least cost is returned.
    points_world: (K, 3) m; NaN where missing.
    joint: (K,) joint of each point; offset: (K, 3) its position in the joint's frame, m.
    weight: (K,) weight of the points (default 1).
    Raises: EvidenceError where fewer than 6 points are known.
    """
    known = np.asarray(np.isfinite(points_world).all(1))
    if known.sum() < 6:
        raise EvidenceError(
            f"Only {int(known.sum())} of {len(points_world)} key points could be triangulated; at least 6 are "
            "needed to start: choose another start frame or check the calibration with `hypose check`."
        )
    term = PointTerm(points_world, np.ones(len(points_world)) if weight is None else weight, joint, offset, 0.03)
    best: PoseFit | None = None
    for root in _root_guesses(body, points_world, joint, offset, known):
        for name in ("standing", "t"):
            start = known_pose(body, name)
            start[:6] = root
            fit = fit_pose(
                body,
                start,
                [term],
                priors=(anatomical_prior(body.skeleton),),
                options=SolveSettings(iterations=40, coarse_iterations=20),
            )
            if best is None or fit.cost < best.cost:
                best = fit
    assert best is not None
    return best


def _root_guesses(
    body: Body, points: Array, joint: NDArray[np.int64], offset: Array, known: NDArray[np.bool_]
) -> list[Array]:
    """Estimate root poses (6,): a rigid fit of the trunk's points where there are enough, else four headings at the
    centroid.

    points: (K, 3) m; joint, offset: as for `start_from_keypoints`; known: (K,) points that are there.
    """
    s = body.skeleton
    rest = s.rest_joints[joint] + offset
    trunk_joints = [
        s.joint(n)
        for n in (
            "pelvis",
            "chest",
            "neck",
            "left_clavicle",
            "right_clavicle",
            "left_shoulder",
            "right_shoulder",
            "left_hip",
            "right_hip",
        )
    ]
    trunk = known & np.isin(joint, trunk_joints)
    centre = points[known].mean(0) - rest[known].mean(0)
    if trunk.sum() >= 3:
        # the trunk is nearly rigid: its points give position and heading at once
        motion, _ = procrustes(rest[trunk], points[trunk])
        return [np.concatenate([motion[:3, 3], so3_log(motion[:3, :3])])]
    return [np.concatenate([centre, [0, 0, yaw]]) for yaw in np.arange(4) * np.pi / 2]


def start_in_pose(body: Body, frame: PreparedFrame, names: Sequence[str]) -> PoseFit:
    """Find the known pose and the heading that explain the silhouettes best, placed at the visual hull and solved.

    frame: prepared, with masks; names: known poses to try, each in 16 headings.
    Raises: EvidenceError where the views have no common hull.
    Source: Alcoverro 2014, section 2.3.3 step 1.
    """
    hull = hull_of(frame)
    candidates = [
        _centred(body, turn_pose(known_pose(body, name), heading), hull)
        for name in names
        for heading in np.arange(16) * np.pi / 8
    ]
    return _best_refined(body, np.stack(candidates), frame)


def turn_pose(pose: Array, heading: float) -> Array:
    """Turn a pose (D,) about the vertical through its root by a heading (rad)."""
    out = pose.copy()
    out[3:6] = so3_log(so3_exp([0, 0, heading]) @ so3_exp(pose[3:6]))
    return out


_TRIED, _KEPT = 16, 4
"""numbers of poses that are solved in the first and in the second round of a search"""
RECOVERY_REACH = 1.3
"""m: how far from the last pose a lost person is searched for; further away it is another person."""


def recover(pose: Array, last: Array, frame: PreparedFrame, /) -> Array:
    """Find the pose (D,) of a lost person: the given pose, moved to the hull and turned, or a known pose, refined.

    last: (D,) last pose in which the person was seen. Only the space within RECOVERY_REACH of it is searched.
    Returns: the best pose; the given one where there is no person in reach, or the solution is further away, so that
        another person in view is not taken for the one who left.
    """
    body = frame.body
    try:
        hull = hull_of(frame, np.stack([last[:3] - RECOVERY_REACH, last[:3] + RECOVERY_REACH]))
    except EvidenceError:
        return pose
    candidates = [pose]
    for base in (pose, known_pose(body, "standing"), known_pose(body, "a")):
        for heading in np.arange(8) * np.pi / 4:
            candidates.append(_centred(body, turn_pose(base, heading), hull))
    found = _best_refined(body, np.stack(candidates), frame).pose
    return found if np.linalg.norm(found[:3] - last[:3]) <= RECOVERY_REACH else pose


def hull_of(frame: PreparedFrame, bounds: Array | None = None) -> Hull:
    """Compute the visual hull of a frame, or the space behind depth maps, inside bounds (2, 3), m (default: the common
    view).

    Raises: EvidenceError, naming the frame, where nothing is left of it.
    """
    if not frame.silhouettes.seen:
        raise EvidenceError(f"Frame {frame.frame.index} has no usable silhouette to start from; choose another frame.")
    hull = occupied_space(frame.frame, bounds)
    if len(hull.points) == 0:
        raise EvidenceError(
            f"Frame {frame.frame.index}: the silhouettes of the views have no common volume; check the calibration and "
            "the masks, or start from key points."
        )
    return hull


def _centred(body: Body, pose: Array, hull: Hull) -> Array:
    """Move a pose so that the mesh's centre lies at the hull's."""
    vertices = body.skin(pose)
    middle = 0.5 * (vertices.min(0) + vertices.max(0))
    target = 0.5 * (hull.points.min(0) + hull.points.max(0))
    out = pose.copy()
    out[:3] += 0.5 * (target - middle) + 0.5 * (hull.centroid - vertices.mean(0))
    return out


def _best_refined(body: Body, candidates: Array, frame: PreparedFrame) -> PoseFit:
    """Solve the best of many candidate poses (N, D) in two rounds; return the one with the least evidence energy.

    frame: prepared.
    The _TRIED best are solved briefly, the _KEPT best of these at length. Why: a wrong heading may overlap better
    than the right one until the limbs have moved.
    """
    order = np.argsort(evidence_energy(body, candidates, frame.evidence), kind="stable")[:_TRIED]
    brief = SolveSettings(iterations=8, coarse_iterations=8)
    moved = np.stack([f.pose for f in refine(body, candidates[order], frame, brief)])
    order = np.argsort(evidence_energy(body, moved, frame.evidence), kind="stable")[:_KEPT]
    fits = refine(body, moved[order], frame, SETTLING)
    return fits[int(np.argmin(evidence_energy(body, np.stack([f.pose for f in fits]), frame.evidence)))]

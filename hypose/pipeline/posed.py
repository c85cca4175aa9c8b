"""Fused points to poses: the 36-dof body through the fused skeleton of a clip, for every writer that needs poses.

Bones' lengths and where a sensor's joints sit on the body come from the clip itself (as for triangulated key points),
then all frames are fitted together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.fitting import PointTerm, fit_clip
from hypose.fusion.point_motion import common_positions
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.subject import subject_from_keypoints

# the 15 common joints by the names of key points; the torso is no point of the body that could be told from the spine
NAMES = (
    "head",
    "neck",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "torso",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_hip",
    "right_knee",
    "right_ankle",
)


def pose_fused(fused: Motion, body: Body | None = None, smoothness: float = 1.0) -> tuple[Body, Motion]:
    """The body with the person's bone lengths, and its motion (T, 36) along fused joints.

    fused: a motion of points (fusion.fuse.Fused.motion) in a world with z up, m. smoothness: strength of the penalty on
    acceleration. Frames in which the person is lost are bridged and stay marked as lost. An InputError when too little
    was seen to find a pose."""
    points = common_positions(fused)
    points[np.asarray(fused.lost)] = np.nan
    if np.isfinite(points).all(-1).sum(1).max(initial=0) < 8:
        raise InputError("No frame of the fused motion has 8 joints; poses cannot be found from so few.")
    subject = subject_from_keypoints(body or human(), points, NAMES)
    model = subject.keypoints
    known = np.flatnonzero(model.known)
    solved = np.flatnonzero(np.isfinite(subject.poses).all(1))
    nearest = solved[np.abs(np.arange(len(points))[:, None] - solved).argmin(1)]
    terms = [
        PointTerm(p[known], np.ones(len(known)), model.joint[known], model.offset[known], 0.03)
        if np.isfinite(p).any()
        else None
        for p in points
    ]
    prior = anatomical_prior(subject.body.skeleton)
    poses = fit_clip(subject.body, subject.poses[nearest], points=terms, acceleration=smoothness, priors=(prior,))
    skeleton = subject.body.skeleton
    joints = subject.body.joints(poses)
    names = [NAMES[k] for k in known if NAMES[k] in skeleton.joint_names]
    # the fused joints of a motion start at the torso; look each up by its name there
    own = [fused.skeleton.joint(n.replace("wrist", "hand").replace("ankle", "foot")) for n in names]
    there = [skeleton.joint(n) for n in names]
    known_of_joints = {
        "joint_covariance": np.nan,
        "systematic_covariance": np.nan,
        "p_wrong": np.nan,
        "doubtful_joints": False,
    }
    arrays = {}
    for name, unknown in known_of_joints.items():
        if (given := getattr(fused, name)) is not None:
            arrays[name] = np.full((*joints.shape[:2], *given.shape[2:]), unknown, given.dtype)
            arrays[name][:, there] = given[:, own]
    return subject.body, replace(fused, skeleton=skeleton, joints=joints, poses=poses, **arrays)

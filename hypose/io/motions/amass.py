"""Turns of a humanoid's joints, as SMPL names them, from a T pose (limbs straight, arms level, palms down).

What one joint of ours does and several of SMPL's share (trunk, neck) is divided evenly.

Source: Loper et al. 2015, SMPL (joints and their order).
"""

from __future__ import annotations

import numpy as np

from hypose.body.joint_angles import neutral_frames
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, so3_exp, so3_log

SMPL_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""smpl_from_model: x left, y up, z forwards from x left, y backwards, z up."""
_JOINTS = 52  # of SMPL-H, 30 of them in the hands
BODY_JOINTS = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
"""SMPL's first 22 joints, in its order."""
# (joints of SMPL that share it, in order from the root; our joint; our joint that it is measured against)
_SHARED = (
    (("spine1", "spine2", "spine3"), "chest", "pelvis"),
    (("neck", "head"), "head", "chest"),
    *(
        ((f"{side}_{theirs}",), f"{side}_{ours}", f"{side}_{above}" if above not in ("pelvis", "chest") else above)
        for side in ("left", "right")
        for theirs, ours, above in (
            ("collar", "clavicle", "chest"),
            ("shoulder", "shoulder", "clavicle"),
            ("elbow", "elbow", "shoulder"),
            ("hip", "hip", "pelvis"),
            ("knee", "knee", "hip"),
            ("ankle", "ankle", "knee"),
        )
    ),
)


def t_pose_frames(skeleton: Skeleton) -> dict[str, Array]:
    """model_from_joint rotation (3, 3) of every joint in SMPL's pose of zeros, by joint name."""
    frames = dict(neutral_frames(skeleton))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        level = so3_exp(np.array([0.0, sign * np.pi / 2, 0.0]))  # the hanging arm lifted sideways
        for joint in ("shoulder", "elbow", "wrist"):
            frames[f"{side}_{joint}"] = level @ frames[f"{side}_{joint}"]
    return frames


def smpl_rotations(skeleton: Skeleton, poses: Array) -> Array:
    """(T, 52, 3) rad: rotation vectors of SMPL-H's joints against their parents, of poses (T, D); the root's turns
    SMPL's model (y up) into the world (z up). An InputError when the skeleton lacks one of the human joints."""
    rotations, _ = skeleton.forward(poses)
    frames = t_pose_frames(skeleton)

    def world_from(joint: str) -> Array:
        return rotations[:, skeleton.joint(joint)] @ frames[joint].T @ SMPL_AXES.T

    out = np.zeros((len(poses), _JOINTS, 3))
    out[:, 0] = so3_log(world_from("pelvis"))
    for shared, joint, above in _SHARED:
        turn = so3_log(np.swapaxes(world_from(above), -1, -2) @ world_from(joint))
        for name in shared:
            out[:, BODY_JOINTS.index(name)] = turn / len(shared)
    return out

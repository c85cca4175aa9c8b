"""Turns of a VRM humanoid's bones: what programs that move avatars are sent.

The rest is VRM's T pose without rotations (arms level, palms down, facing +z, y up). What one joint of ours does and
two bones share (trunk, neck) is divided between them; hands, toes, fingers and face do not move.

Source: VRM Consortium, VRMC_vrm 1.0 (humanoid bones and their parents).
"""

from __future__ import annotations

import numpy as np

from hypose.body.body import Body
from hypose.body.joint_angles import neutral_frames
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, so3_exp, so3_log
from hypose.io.motions.animation import Y_UP

_VRM_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from x left, y backwards, z up
# parent; our joint whose place it has; our joint that turns it, against which other one, and the bone's share of that
_Bone = tuple[str, str, str, str, float]
_TRUNK: dict[str, _Bone] = {
    "hips": ("", "pelvis", "pelvis", "", 1.0),
    "spine": ("hips", "spine", "chest", "pelvis", 1 / 3),
    "chest": ("spine", "chest", "chest", "pelvis", 2 / 3),
    "neck": ("chest", "neck", "head", "chest", 1 / 2),
    "head": ("neck", "head", "head", "chest", 1 / 2),
}
_LIMBS = (
    ("Shoulder", "chest", "clavicle", "chest", 1.0),
    ("UpperArm", "Shoulder", "shoulder", "clavicle", 1.0),
    ("LowerArm", "UpperArm", "elbow", "shoulder", 1.0),
    ("Hand", "LowerArm", "wrist", "elbow", 0.0),
    ("UpperLeg", "hips", "hip", "pelvis", 1.0),
    ("LowerLeg", "UpperLeg", "knee", "hip", 1.0),
    ("Foot", "LowerLeg", "ankle", "knee", 1.0),
)
BONES: dict[str, _Bone] = _TRUNK | {
    f"{side}{bone}": (
        *(above if above in _TRUNK else f"{side}{above}", f"{side}_{ours}", f"{side}_{ours}"),
        *(against if against in ("chest", "pelvis") else f"{side}_{against}", share),
    )
    for side in ("left", "right")
    for bone, above, ours, against, share in _LIMBS
}
"""Bones in an order in which parents come first."""


def bone_turns(skeleton: Skeleton, poses: Array) -> tuple[Array, Array]:
    """Of poses (T, D): places of the hips (T, 3) m, y up, and rotations (T, B, 3, 3) of every bone against its parent
    in VRM's T pose, in the order of `BONES`; the hips' turns the avatar into the world. An InputError when the skeleton
    lacks one of the human joints."""
    rotations, joints = skeleton.forward(poses)
    rest = {name: _VRM_AXES @ frame for name, frame in _t_pose(skeleton).items()}
    world = {name: rotations[:, skeleton.joint(name)] @ frame.T for name, frame in rest.items()}
    out = np.empty((len(poses), len(BONES), 3, 3))
    for k, (_, _, joint, against, share) in enumerate(BONES.values()):
        turn = np.swapaxes(world[against], -1, -2) @ world[joint] if against else Y_UP @ world[joint]
        out[:, k] = turn if share == 1 else so3_exp(share * so3_log(turn))
    return joints[:, skeleton.joint("pelvis")] @ Y_UP.T, out


def rest_offsets(body: Body) -> Array:
    """(B, 3) m from every bone's parent to it in VRM's T pose (x left, y up, z forwards), in the order of `BONES`; of
    the hips from the ground, the soles at y = 0."""
    skeleton, names = body.skeleton, body.skeleton.joint_names
    frames, places = _t_pose(skeleton), np.zeros((len(names), 3))
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            places[j] = places[parent] + _VRM_AXES @ frames[names[parent]] @ skeleton.rest_offsets[j]
    marks = body.landmarks
    soles = [
        places[j] + _VRM_AXES @ frames[names[j]] @ offset
        for j, offset, name in zip(marks.joint, marks.offset, marks.names, strict=True)
        if name.endswith("_sole_heel")
    ]
    ground = np.array([0.0, min(p[1] for p in soles or places), 0.0])
    at = {name: places[skeleton.joint(bone[1])] for name, bone in BONES.items()}
    return np.stack([at[name] - (at[bone[0]] if bone[0] else ground) for name, bone in BONES.items()])


def _t_pose(skeleton: Skeleton) -> dict[str, Array]:
    """model_from_joint rotation (3, 3) of every joint in the T pose, by joint name."""
    frames = dict(neutral_frames(skeleton))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        level = so3_exp(np.array([0.0, sign * np.pi / 2, 0.0]))  # the hanging arm lifted sideways
        for joint in ("shoulder", "elbow", "wrist"):
            frames[f"{side}_{joint}"] = level @ frames[f"{side}_{joint}"]
    return frames

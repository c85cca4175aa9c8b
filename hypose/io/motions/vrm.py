"""VRM animations (.vrma): the motion on the bones that every VRM avatar has, for programs that play it on one.

A glTF file of nodes alone, whose rest is VRM's T pose without rotations (arms level, palms down, facing +z, y up), with
the extension VRMC_vrm_animation that says which node is which bone. Hips are moved and turned, all other bones turned;
players scale the way of the hips by the heights of hips. Rotations are those of `hypose.io.motions.amass`, in the same
axes: what one joint of ours does and two bones of VRM's share (trunk, neck) is divided evenly. Hands, toes, fingers and
face do not move.

Source: VRM Consortium, VRMC_vrm_animation 1.0, and VRMC_vrm 1.0 (humanoid bones and their parents).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pygltflib import (
    GLTF2,
    Animation,
    AnimationChannel,
    AnimationChannelTarget,
    AnimationSampler,
    Asset,
    Buffer,
    Node,
    Scene,
)

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, quaternion_from_matrix, so3_exp
from hypose.io.files import atomic_path
from hypose.io.motions.amass import BODY_JOINTS, SMPL_AXES, smpl_rotations, t_pose_frames
from hypose.io.motions.animation import Y_UP, filled_poses, without_flips
from hypose.io.motions.gltf import BinaryBuffer

EXTENSION = "VRMC_vrm_animation"
# VRM's bone: its parent, our joint whose place it has, and the joints of SMPL whose turns it makes, from the root on
_TRUNK: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "hips": ("", "pelvis", ("pelvis",)),
    "spine": ("hips", "spine", ("spine1",)),
    "chest": ("spine", "chest", ("spine2", "spine3")),
    "neck": ("chest", "neck", ("neck",)),
    "head": ("neck", "head", ("head",)),
}
_LIMBS = (
    ("Shoulder", "chest", "clavicle", "collar"),
    ("UpperArm", "Shoulder", "shoulder", "shoulder"),
    ("LowerArm", "UpperArm", "elbow", "elbow"),
    ("Hand", "LowerArm", "wrist", "wrist"),
    ("UpperLeg", "hips", "hip", "hip"),
    ("LowerLeg", "UpperLeg", "knee", "knee"),
    ("Foot", "LowerLeg", "ankle", "ankle"),
)
BONES: dict[str, tuple[str, str, tuple[str, ...]]] = _TRUNK | {
    f"{side}{bone}": (above if above in _TRUNK else f"{side}{above}", f"{side}_{ours}", (f"{side}_{theirs}",))
    for side in ("left", "right")
    for bone, above, ours, theirs in _LIMBS
}
"""Bones in an order in which parents come first."""


def write_vrma(path: str | Path, motion: Motion, body: Body) -> None:
    """Write a motion with poses; frames without one hold the last. An InputError when it has none."""
    poses = filled_poses(motion, path)
    hips, turns = bone_turns(motion.skeleton, poses)
    offsets, store = rest_offsets(body), BinaryBuffer()
    names = list(BONES)
    nodes = [
        Node(
            name=name,
            translation=offsets[k].tolist(),
            children=[c for c, other in enumerate(names) if BONES[other][0] == name],
        )
        for k, name in enumerate(names)
    ]
    clock = store.add(np.arange(len(poses)) / motion.frame_rate, "SCALAR", limits=True)
    whole = Animation(name="motion", samplers=[], channels=[])

    def channel(node: int, what: str, values: Array, kind: str) -> None:
        target = AnimationChannelTarget(node=node, path=what)
        whole.channels.append(AnimationChannel(sampler=len(whole.samplers), target=target))
        whole.samplers.append(AnimationSampler(input=clock, output=store.add(values, kind), interpolation="LINEAR"))

    channel(0, "translation", hips, "VEC3")
    for k in range(len(names)):
        quaternions = without_flips(quaternion_from_matrix(turns[:, k]))
        channel(k, "rotation", quaternions[:, [1, 2, 3, 0]], "VEC4")
    bones = {name: {"node": k} for k, name in enumerate(names)}
    gltf = GLTF2(
        asset=Asset(version="2.0", generator="hypose"),
        scene=0,
        scenes=[Scene(name="motion", nodes=[0])],
        nodes=nodes,
        animations=[whole],
        accessors=store.accessors,
        bufferViews=store.views,
        buffers=[Buffer(byteLength=len(store.data))],
        extensionsUsed=[EXTENSION],
        extensions={EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
    )
    gltf.set_binary_blob(bytes(store.data))
    with atomic_path(path) as temporary:
        gltf.save_binary(str(temporary))


def bone_turns(skeleton: Skeleton, poses: Array) -> tuple[Array, Array]:
    """Of poses (T, D): places of the hips (T, 3) m, y up, and rotations (T, B, 3, 3) of every bone against its parent
    in VRM's T pose, in the order of `BONES`; the hips' turns the avatar into the world. An InputError when the skeleton
    lacks one of the human joints."""
    turns = so3_exp(smpl_rotations(skeleton, poses))
    out = np.empty((len(poses), len(BONES), 3, 3))
    for k, (_, _, joints) in enumerate(BONES.values()):
        turn = np.broadcast_to(np.eye(3), (len(poses), 3, 3))
        for joint in joints:
            turn = turn @ turns[:, BODY_JOINTS.index(joint)]
        out[:, k] = turn
    out[:, 0] = Y_UP @ out[:, 0]  # world_from_hips
    return skeleton.forward(poses)[1][:, skeleton.joint("pelvis")] @ Y_UP.T, out


def rest_offsets(body: Body) -> Array:
    """(B, 3) m from every bone's parent to it in VRM's T pose (x left, y up, z forwards), in the order of `BONES`; of
    the hips from the ground, the soles at y = 0."""
    skeleton, frames = body.skeleton, t_pose_frames(body.skeleton)
    places = np.zeros((len(skeleton.joint_names), 3))
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            above = frames[skeleton.joint_names[parent]]
            places[j] = places[parent] + SMPL_AXES @ above @ skeleton.rest_offsets[j]
    soles = [
        places[j] + SMPL_AXES @ frames[skeleton.joint_names[j]] @ offset
        for j, offset, name in zip(body.landmarks.joint, body.landmarks.offset, body.landmarks.names, strict=True)
        if name.endswith("_sole_heel")
    ]
    floor = min(p[1] for p in soles) if soles else places[:, 1].min()
    at = {name: places[skeleton.joint(ours)] for name, (_, ours, _) in BONES.items()}
    ground = np.array([0.0, floor, 0.0])
    return np.stack([at[name] - (at[above] if above else ground) for name, (above, _, _) in BONES.items()])

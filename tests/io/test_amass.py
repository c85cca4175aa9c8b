"""Turns of SMPL's joints: played on a T pose with our lengths they give back the limbs of the tracked body."""

import numpy as np

from hypose.body.ready_bodies import human
from hypose.geometry import so3_exp
from hypose.io.motions.amass import BODY_JOINTS, smpl_rotations, t_pose_frames

# SMPL's tree, in its order of joints (Loper et al. 2015)
_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
_BONES = tuple((f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle")))
_BONES += tuple(
    (f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in (("shoulder", "elbow"), ("elbow", "wrist"))
)


def _global(rotations):
    """(T, 22, 3, 3) world_from_smpl of every joint."""
    local = so3_exp(rotations[:, :22])
    out = np.empty_like(local)
    for j, p in enumerate(_PARENTS):
        out[:, j] = local[:, j] if p < 0 else out[:, p] @ local[:, j]
    return out


def test_limbs_point_where_the_tracked_ones_do():
    skeleton, rng = human().skeleton, np.random.default_rng(2)
    poses = rng.uniform(np.maximum(skeleton.lower, -1), np.minimum(skeleton.upper, 1), (20, skeleton.dof))
    turned = _global(smpl_rotations(skeleton, poses))
    joints = skeleton.forward(poses)[1]
    frames = t_pose_frames(skeleton)
    for upper, lower in _BONES:
        rest = frames[upper] @ skeleton.rest_offsets[skeleton.joint(lower)]
        in_smpl = np.array([rest[0], rest[2], -rest[1]])  # x left, y up, z forwards
        got = turned[:, BODY_JOINTS.index(upper)] @ in_smpl
        want = joints[:, skeleton.joint(lower)] - joints[:, skeleton.joint(upper)]
        np.testing.assert_allclose(got, want, atol=1e-9)


def test_the_t_pose_is_zeros_with_level_arms():
    skeleton = human().skeleton
    frames = t_pose_frames(skeleton)
    for side, sign in (("left", 1), ("right", -1)):
        arm = frames[f"{side}_shoulder"] @ skeleton.rest_offsets[skeleton.joint(f"{side}_elbow")]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [sign, 0, 0], atol=1e-9)
        thigh = frames[f"{side}_hip"] @ skeleton.rest_offsets[skeleton.joint(f"{side}_knee")]
        np.testing.assert_allclose(thigh / np.linalg.norm(thigh), [0, 0, -1], atol=1e-9)


def test_an_upright_person_stands_upright_in_the_world():
    skeleton = human().skeleton
    root = so3_exp(smpl_rotations(skeleton, np.zeros((1, skeleton.dof)))[0, 0])
    np.testing.assert_allclose(root @ [0, 1, 0], [0, 0, 1], atol=1e-12)  # SMPL's up is the world's z
    np.testing.assert_allclose(root @ [0, 0, 1], [0, -1, 0], atol=1e-12)  # and faces as the body does at rest

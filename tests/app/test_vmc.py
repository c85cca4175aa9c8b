"""Avatars by VMC: packets decoded as a receiver does, the bones point where the limbs do."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hypose.app.live.osc import VMC_BONES, osc_bundles, vmc_messages
from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from tests.osc_packets import parse_osc

UNITY_BONES = ["Hips", "Spine", "Chest", "Neck", "Head"] + [
    f"{s}{b}"
    for s in ("Left", "Right")
    for b in ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
]
LIMBS = [
    (f"{s}{a}", f"{s}{b}", f"{s.lower()}_{c}", f"{s.lower()}_{d}")
    for s in ("Left", "Right")
    for a, b, c, d in (
        ("UpperArm", "LowerArm", "shoulder", "elbow"),
        ("LowerArm", "Hand", "elbow", "wrist"),
        ("UpperLeg", "LowerLeg", "hip", "knee"),
        ("LowerLeg", "Foot", "knee", "ankle"),
    )
]


class Avatar:
    """What a receiver makes of one frame: local (place, turn) of every bone, in Unity's axes."""

    def __init__(self, messages):
        found = [m for packet in osc_bundles(messages) for m in parse_osc(packet)]
        one = {address: values for address, values in found if address != "/VMC/Ext/Bone/Pos"}
        assert set(one) == {"/VMC/Ext/OK", "/VMC/Ext/T", "/VMC/Ext/Root/Pos"}
        assert one["/VMC/Ext/Root/Pos"] == ["root", 0, 0, 0, 0, 0, 0, 1]
        self.tracked, (self.seconds,) = one["/VMC/Ext/OK"][3], one["/VMC/Ext/T"]
        assert one["/VMC/Ext/OK"][:3] == [1, 3, 0]
        bones = [values for address, values in found if address == "/VMC/Ext/Bone/Pos"]
        assert [b[0] for b in bones] == [n[0] for n in VMC_BONES]
        self.place, self.turn = {}, {}
        for (name, *values), (_, above, *_) in zip(bones, VMC_BONES, strict=True):
            turn = Rotation.from_quat(values[3:])
            self.place[name] = (self.place[above] + self.turn[above].apply(values[:3])) if above else values[:3]
            self.turn[name] = self.turn[above] * turn if above else turn


def unity(points):
    """World (x, y, z up) -> Unity's left-handed axes; who looks along -y of the world looks along +z there."""
    return points @ np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.fixture(scope="module")
def moving():
    body, rng = human(), np.random.default_rng(4)
    s = body.skeleton
    poses = rng.uniform(np.maximum(s.lower, -1), np.minimum(s.upper, 1), (6, s.dof))
    lost, joints = np.arange(6) == 3, body.joints(poses)
    sds = isotropic(np.full(joints.shape[:2], 0.01))
    return Motion(s, np.arange(6) / 30, joints, poses, sds, lost, ~lost & False, np.full(6, 4), np.zeros(6)), body


def test_bones_are_where_the_tracked_joints_are(moving):
    motion, body = moving
    for k, pose in enumerate(motion.poses):
        avatar = Avatar(vmc_messages(body, pose, k / 30, k != 3))
        joints = unity(motion.joints[k])
        at = {n: joints[i] for i, n in enumerate(motion.skeleton.joint_names)}
        assert sorted(avatar.place) == sorted(UNITY_BONES)
        assert avatar.tracked == (k != 3) and avatar.seconds == pytest.approx(k / 30)
        np.testing.assert_allclose(avatar.place["Hips"], at["pelvis"], atol=1e-5)
        for upper, lower, a, b in LIMBS:
            got = np.subtract(avatar.place[lower], avatar.place[upper])
            np.testing.assert_allclose(got, at[b] - at[a], atol=1e-5)

"""Avatars by VMC: packets decoded as a receiver does, the bones point where the limbs do."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hypose.app.commands.commands_results import play_motion
from hypose.app.live.osc import VMC_BONES, osc_bundles
from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.evidence.frame import SensorJoints
from hypose.fusion.fuse import fuse_clip
from hypose.fusion.joints import COMMON
from hypose.geometry import transform
from hypose.io.motions.results import save_body, save_motion
from tests.app.conftest import fails
from tests.depth_sensors import camera, walker
from tests.osc_packets import parse_osc, udp_sink

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
    poses[3] = np.nan
    lost = np.isnan(poses).any(1)
    joints = body.joints(np.where(lost[:, None], 0, poses))
    sds = isotropic(np.full(joints.shape[:2], 0.01))
    return Motion(s, np.arange(6) / 30, joints, poses, sds, lost, ~lost & False, np.full(6, 4), np.zeros(6)), body


class Time:
    def __init__(self):
        self.now = 100.0

    def wait(self, seconds):
        self.now += seconds


def played(motion, body, **options):
    out, time = [], Time()
    play_motion(
        motion, body, lambda m: out.append((time.now, Avatar(m))), wait=time.wait, clock=lambda: time.now, **options
    )
    return out


def test_bones_are_where_the_tracked_joints_are(moving):
    motion, body = moving
    frames = played(motion, body)
    assert sorted(frames[0][1].place) == sorted(UNITY_BONES)
    for k, (_, avatar) in enumerate(frames):
        joints = unity(motion.joints[k if k != 3 else 2])  # the lost frame holds the last pose
        at = {n: joints[i] for i, n in enumerate(motion.skeleton.joint_names)}
        np.testing.assert_allclose(avatar.place["Hips"], at["pelvis"], atol=1e-5)
        for upper, lower, a, b in LIMBS:
            got = np.subtract(avatar.place[lower], avatar.place[upper])
            np.testing.assert_allclose(got, at[b] - at[a], atol=1e-5)
    assert [a.tracked for _, a in frames] == [1, 1, 1, 0, 1, 1]


def test_frames_come_at_their_pace_and_late_ones_are_left_out(moving):
    frames = played(*moving, speed=2.0)
    np.testing.assert_allclose([t - 100 for t, _ in frames], np.arange(6) / 60)
    np.testing.assert_allclose([a.seconds for _, a in frames], np.arange(6) / 60, atol=1e-6)
    time, sent = Time(), []

    def slow(messages):
        time.now += 0.05  # three frames' time for two
        sent.append(Avatar(messages).seconds)
        if len(sent) == 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        play_motion(*moving, slow, loop=True, wait=time.wait, clock=lambda: time.now)
    assert np.ptp(np.diff(sent)) < 0.04 and sent[-1] == pytest.approx(39 * 0.05, abs=0.05)


def test_the_command_plays_results(moving, tmp_path, hypose):
    motion, body = moving
    save_motion(motion, tmp_path / "motion.npz")
    save_body(body, tmp_path / "body.npz")
    packets = []
    with udp_sink(packets) as address:
        code, out, _ = hypose("play", tmp_path, "--vmc", address, "--speed", 10)
    assert code == 0 and "6 frames at 30 Hz" in out
    assert parse_osc(packets[0])[0] == ("/VMC/Ext/OK", [1, 3, 0, 1])


def test_results_of_depth_sensors_are_posed_first(tmp_path, hypose):
    state, shown = np.full((1, 15), 2), [transform(camera(0), walker(n / 30))[None] for n in range(12)]
    frames = [SensorJoints(p, state, np.array([n / 30]), COMMON, ("s0",)) for n, p in enumerate(shown)]
    save_motion(fuse_clip(frames).motion, tmp_path / "motion.npz")
    code, out, _ = hypose("play", tmp_path, "--speed", 10)
    assert code == 0 and "12 frames" in out


def test_what_cannot_be_played_is_told(moving, tmp_path, hypose):
    for place in ("anna", "ben", "rec/results/default"):
        save_motion(moving[0], tmp_path / place / "motion.npz")
    fails(hypose("play", tmp_path), "holds the results of anna, ben")
    fails(hypose("play", tmp_path / "rec"), "holds the results of results/default")
    fails(hypose("play", tmp_path / "anna"), "body.npz")

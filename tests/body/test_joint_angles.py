"""Joint angles: zero in the neutral, known rotations give known angles with OpenSim's signs, no jumps."""

import numpy as np
import pytest

from hypose.body.default_body import JOINT_NAMES, human_skeleton
from hypose.body.joint_angles import (
    ANGLE_NAMES,
    BODY_AXES,
    GROUND_AXES,
    continuous_euler_zxy,
    is_length,
    joint_angles,
    neutral_frames,
    straight_offset,
)
from hypose.errors import InputError
from hypose.geometry import so3_exp, so3_log
from tests import missing

LEFT = {
    "clavicle": (0.02, 0.00, 0.44),
    "shoulder": (0.18, 0.02, 0.47),
    "elbow": (0.37, 0.04, 0.28),
    "wrist": (0.54, -0.02, 0.11),
    "hip": (0.09, 0.01, -0.03),
    "knee": (0.11, 0.00, -0.44),
    "ankle": (0.12, 0.04, -0.86),
}
MIDDLE = {"pelvis": (0, 0, 0), "spine": (0, 0.01, 0.1), "chest": (0, 0.02, 0.28), "neck": (0, 0.02, 0.52)}
DOWN, FORWARD, TO_LEFT = np.array([0, 0, -1.0]), np.array([0, -1.0, 0]), np.array([1.0, 0, 0])
SIDES = [("l", "left", -1), ("r", "right", 1)]


@pytest.fixture(scope="module")
def skeleton():
    places = {**MIDDLE, "head": (0, -0.01, 0.62)}
    for joint, place in LEFT.items():
        places[f"left_{joint}"] = place
        places[f"right_{joint}"] = np.array(place) * [-1, 1, 1]
    return human_skeleton(np.array([places[n] for n in JOINT_NAMES], dtype=float))


@pytest.fixture(scope="module")
def neutral(skeleton):
    """The pose of the anatomical neutral, facing -y."""
    q = np.zeros(skeleton.dof)
    frames = neutral_frames(skeleton)
    for _, side, _ in SIDES:
        for joint in ("hip", "shoulder"):
            q[skeleton.dofs_of(f"{side}_{joint}")] = so3_log(frames[f"{side}_{joint}"])
        for joint in ("knee", "elbow"):
            q[skeleton.dofs_of(f"{side}_{joint}")] = -straight_offset(skeleton, f"{side}_{joint}")
        # the two hinges x, y of the ankle that bring the foot flat again
        r = frames[f"{side}_knee"].T
        q[skeleton.dofs_of(f"{side}_ankle")] = np.arctan2(r[2, 1], r[1, 1]), np.arctan2(r[0, 2], r[0, 0])
    return q


def named(skeleton, *poses):
    names, values = joint_angles(skeleton, np.array(poses))
    return {n: np.degrees(v) if not is_length(n) else v for n, v in zip(names, values.T, strict=True)}


def turned(skeleton, pose, joint, axis, degrees):
    """The pose with one ball joint turned further about an axis of the model frame (after its neutral
    rotation)."""
    q, d = pose.copy(), skeleton.dofs_of(joint)[-3:]
    q[d] = so3_log(so3_exp(np.radians(degrees) * np.asarray(axis, float)) @ so3_exp(q[d]))
    return q


def test_all_angles_are_zero_in_the_neutral(skeleton, neutral):
    got = named(skeleton, neutral)
    for name in ANGLE_NAMES:
        if name == "pelvis_rotation":  # the body faces world -y, which is ground -X
            assert abs(got[name][0]) == pytest.approx(180)
        elif name.startswith(("ankle", "subtalar")):  # two hinges cannot undo the shank's third angle
            assert abs(got[name][0]) < 0.1
        else:
            assert got[name][0] == pytest.approx(0, abs=1e-6), name


@pytest.mark.parametrize(("s", "side", "sign"), SIDES)
def test_signs_seen_on_the_body(skeleton, neutral, s, side, sign):
    """The signs again, from where the limb goes rather than from axes."""
    pelvis = skeleton.forward(neutral)[1]
    out = {"left": 1, "right": -1}[side]

    def place(q, joint):
        return skeleton.forward(q)[1][skeleton.joint(f"{side}_{joint}")] - pelvis[skeleton.joint(f"{side}_{joint}")]

    # found by trying both directions of each rotation and looking at the angle's sign
    for joint, end, axis, name, direction in (
        ("hip", "knee", TO_LEFT, f"hip_flexion_{s}", FORWARD),
        ("hip", "knee", FORWARD, f"hip_adduction_{s}", -out * TO_LEFT),
        ("shoulder", "elbow", TO_LEFT, f"arm_flex_{s}", FORWARD),
        ("shoulder", "elbow", FORWARD, f"arm_add_{s}", -out * TO_LEFT),
    ):
        for turn in (-20, 20):
            q = turned(skeleton, neutral, f"{side}_{joint}", axis, turn)
            assert np.sign(named(skeleton, q)[name][0]) == np.sign(place(q, end) @ direction), name
    # with the elbow bent, inward rotation takes the hand towards the midline
    bent = neutral.copy()
    bent[skeleton.dofs_of(f"{side}_elbow")] += np.radians(90)
    q = turned(skeleton, bent, f"{side}_shoulder", [0, 0, 1], 25)
    start = skeleton.forward(bent)[1][skeleton.joint(f"{side}_wrist")]
    moved = skeleton.forward(q)[1][skeleton.joint(f"{side}_wrist")] - start
    assert np.sign(named(skeleton, q)[f"arm_rot_{s}"][0]) == np.sign(moved @ (-out * TO_LEFT))
    # a bent elbow brings the hand forwards, a bent knee the foot backwards
    for joint, end, name, direction in (
        ("elbow", "wrist", f"elbow_flex_{s}", FORWARD),
        ("knee", "ankle", f"knee_angle_{s}", -FORWARD),
    ):
        q = neutral.copy()
        q[skeleton.dofs_of(f"{side}_{joint}")] += np.radians(40)
        assert named(skeleton, q)[name][0] == pytest.approx(40, abs=1e-9)
        assert place(q, end) @ direction > 0.1
    # toes up is dorsiflexion, sole inwards inversion
    d = skeleton.dofs_of(f"{side}_ankle")
    for dof, degrees, name in ((d[0], -15, f"ankle_angle_{s}"), (d[1], 15 * out, f"subtalar_angle_{s}")):
        q = neutral.copy()
        q[dof] += np.radians(degrees)
        rotation = skeleton.forward(q)[0][skeleton.joint(f"{side}_ankle")]
        assert (rotation @ FORWARD)[2] > 0.2 if dof == d[0] else (rotation @ DOWN) @ (-out * TO_LEFT) > 0.2
        assert named(skeleton, q)[name][0] == pytest.approx(15, abs=0.1)


def test_trunk_and_neck(skeleton, neutral):
    for joint, part in (("spine", "lumbar"), ("neck", "neck")):
        for axis, angle in (((1, 0, 0), "extension"), ((0, -1, 0), "bending"), ((0, 0, 1), "rotation")):
            q = turned(skeleton, neutral, joint, axis, -25)
            got = named(skeleton, q)
            expected = 25 if angle == "extension" else -25
            assert got[f"{part}_{angle}"][0] == pytest.approx(expected, abs=1e-6), (part, angle)
    # leaning back takes the head backwards
    back = turned(skeleton, neutral, "spine", (1, 0, 0), -25)
    head = skeleton.joint("head")
    assert (skeleton.forward(back)[1][head] - skeleton.forward(neutral)[1][head]) @ FORWARD < -0.1


def test_pelvis_in_the_ground_frame(skeleton, neutral):
    q = neutral.copy()
    q[:3] = [0.3, -0.2, 0.95]
    q[3:6] = so3_log(GROUND_AXES.T @ _zxy(np.radians([12, -8, 40])) @ BODY_AXES)
    got = named(skeleton, q)
    assert [got[f"pelvis_{k}"][0] for k in ("tilt", "list", "rotation")] == pytest.approx([12, -8, 40])
    # ground X = world y, Y = world z, Z = world x
    assert [got[f"pelvis_t{k}"][0] for k in "xyz"] == pytest.approx([-0.2, 0.95, 0.3])


def _zxy(angles):
    z, x, y = np.moveaxis(np.asarray(angles), -1, 0)
    rz, rx, ry = (so3_exp(a[..., None] * np.eye(3)[k]) for a, k in ((z, 2), (x, 0), (y, 1)))
    return rz @ rx @ ry


def test_arm_raised_sideways_past_the_gimbal_lock(skeleton, neutral, rng):
    """Abduction to 160 degrees and back, with tracking noise: the angle follows, and the arm that hangs
    again is at 0."""
    lift = np.concatenate([np.linspace(0, 160, 60), np.linspace(160, 0, 60)])
    noise = np.radians(1.0) * rng.standard_normal((len(lift), 3))
    q = np.tile(neutral, (len(lift), 1))
    frame = neutral_frames(skeleton)["right_shoulder"]
    d = skeleton.dofs_of("right_shoulder")
    for t in range(len(lift)):
        raised = so3_exp(np.radians(lift[t]) * np.array([0, 1.0, 0]))  # out to the right about model y
        q[t, d] = so3_log(so3_exp(noise[t]) @ raised @ frame)
    got = named(skeleton, *q)
    np.testing.assert_allclose(got["arm_add_r"], -lift, atol=6)
    for name in ("arm_flex_r", "arm_rot_r"):
        assert np.abs(got[name][np.abs(lift - 90) > 30]).max() < 10, name


def test_euler_angles_give_back_the_rotation_even_locked(rng):
    r = so3_exp(rng.normal(0, 2, (50, 3, 3)))
    r[10:20, 1] = _zxy(np.stack([rng.normal(size=10), np.full(10, np.pi / 2), rng.normal(size=10)], -1))
    r[20:30, 2] = _zxy(np.stack([rng.normal(size=10), np.full(10, -np.pi / 2), np.zeros(10)], -1))
    np.testing.assert_allclose(_zxy(continuous_euler_zxy(r)), r, atol=1e-8)


def test_frames_without_a_pose_are_nan_and_disturb_nothing(skeleton, neutral):
    q = np.tile(neutral, (5, 1))
    q[:, 5] += np.linspace(0, 1, 5)
    whole = joint_angles(skeleton, q)[1]
    q[2, 7] = np.nan
    holed = joint_angles(skeleton, q)[1]
    assert np.isnan(holed[2]).all()
    np.testing.assert_array_equal(np.delete(holed, 2, 0), np.delete(whole, 2, 0))


def test_wrong_shape_is_one_sentence(skeleton):
    with pytest.raises(InputError, match=r"shape \(frames, 36\), got \(36,\)"):
        joint_angles(skeleton, np.zeros(36))


def test_opensim_model_agrees_on_every_sign_and_order(skeleton, neutral, rng, shared_data):
    """Random coordinates posed by OpenSim's own full-body model: our angles of its body rotations are the
    same."""
    osim = missing.module("opensim", "agreement with OpenSim", "pip install opensim")
    path = shared_data("pose2sim_balancing/opensim_v0.8.4/Model_Pose2Sim_body25b_scaled.osim")
    osim.Logger.setLevelString("Off")
    model = osim.Model(str(path))
    state = model.initSystem()
    names = [f"{n}_{s}" for s in "lr" for n in ("hip_flexion", "hip_adduction", "hip_rotation")]
    names += [f"{n}_{s}" for s in "lr" for n in ("arm_flex", "arm_add", "arm_rot")]
    pelvis = ["pelvis_tilt", "pelvis_list", "pelvis_rotation"]
    neck = {
        "neck_extension": "neck_flexion",
        "neck_bending": "neck_bending",
        "neck_rotation": "neck_rotation",
    }
    frames = neutral_frames(skeleton)

    def rotation(body):
        m = model.getBodySet().get(body).getTransformInGround(state).R().asMat33()
        return np.array([[m.get(i, j) for j in range(3)] for i in range(3)])

    for _ in range(5):
        wanted = {n: float(rng.uniform(-0.6, 0.6)) for n in [*names, *pelvis, *neck]}
        for name, value in wanted.items():
            model.updCoordinateSet().get(neck.get(name, name)).setValue(state, value, False)
        model.realizePosition(state)
        q = neutral.copy()
        q[3:6] = so3_log(GROUND_AXES.T @ rotation("pelvis") @ BODY_AXES)
        for joint, parent, child in (
            ("left_hip", "pelvis", "femur_l"),
            ("right_hip", "pelvis", "femur_r"),
            ("left_shoulder", "torso", "humerus_l"),
            ("right_shoulder", "torso", "humerus_r"),
            ("neck", "torso", "head"),
        ):
            r = BODY_AXES.T @ rotation(parent).T @ rotation(child) @ BODY_AXES
            q[skeleton.dofs_of(joint)] = so3_log(r @ frames[joint])
        got = named(skeleton, q)
        for name, value in wanted.items():
            assert got[name][0] == pytest.approx(np.degrees(value), abs=1e-4), name

"""Landmark sets: the points of sensors and data sets on our body, and the joint names of other programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.body import Body, Shape, deform
from hypose.body.joint_names import MIXAMO, OPENSIM_BODIES, OPENSIM_JOINTS, match_rig, renamed_body
from hypose.body.landmark_sets import LANDMARK_SETS, landmark_set
from hypose.body.ready_bodies import JOINT_NAMES, PARENTS, human
from hypose.errors import InputError
from hypose.evidence.keypoints import BODY_25, landmark_of


def with_set(body: Body, name: str) -> Body:
    return replace(body, landmarks=landmark_set(body, name))


@pytest.mark.parametrize("name", LANDMARK_SETS)
def test_every_point_is_mirrored_and_moves_with_its_joint(name, rng):
    body = with_set(human(), name)
    names, at_rest = body.landmarks.names, body.landmark_points(np.zeros(36))
    assert len(names) == {"OPENNI_15": 15, "BODY_25": 25, "HUMANEVA_15": 15, "IXMAS_5": 5}[name]
    for k, n in enumerate(names):
        if n.startswith("left_"):
            np.testing.assert_allclose(at_rest[names.index("right_" + n[5:])], at_rest[k] * [-1, 1, 1], atol=1e-5)
            assert at_rest[k, 0] > 0.01
    pose = body.skeleton.clamp(0.3 * rng.standard_normal(36))
    rotations, joints = body.skeleton.forward(pose)
    moved = body.landmark_points(pose)
    for k, j in enumerate(body.landmarks.joint):
        back = rotations[j].T @ (moved[k] - joints[j])
        np.testing.assert_allclose(back, body.landmarks.offset[k], atol=1e-12)


def test_body_25_are_the_points_that_the_key_point_reader_uses():
    body = human()
    marks = landmark_set(body, "body_25")
    assert marks.names == BODY_25
    joint, offset, known = landmark_of(BODY_25, body)
    assert known.all()
    np.testing.assert_array_equal(marks.joint, joint)
    np.testing.assert_allclose(marks.offset, offset, atol=1e-5)


def test_points_lie_where_sensors_and_annotators_put_them():
    body = human()
    points = {
        name: dict(zip(b.landmarks.names, b.landmark_points(np.zeros(36)), strict=True))
        for name in LANDMARK_SETS
        for b in [with_set(body, name)]
    }
    top, feet = body.fine.vertices[:, 2].max(), body.fine.vertices[:, 2].min()
    head = points["OPENNI_15"]["head"]
    assert 0.05 < top - head[2] < 0.16  # the middle of the skull
    assert points["OPENNI_15"]["neck"][2] > points["OPENNI_15"]["torso"][2] > points["OPENNI_15"]["left_hip"][2]
    assert points["IXMAS_5"]["left_foot"][2] - feet < 0.06
    wrist, knuckle = (
        body.skeleton.rest_joints[8],
        body.landmark_points(np.zeros(36))[body.landmarks.index("left_knuckle")],
    )
    palm = points["IXMAS_5"]["left_hand"]
    np.testing.assert_allclose(palm, wrist + (knuckle - wrist) * 2 / 3, atol=1e-9)


def test_points_follow_the_shape_of_the_body():
    tall = deform(human(), Shape(scale=1.1))
    for name in LANDMARK_SETS:
        np.testing.assert_allclose(landmark_set(tall, name).offset, 1.1 * landmark_set(human(), name).offset, atol=1e-9)


def test_unknown_sets_and_missing_points_are_named():
    with pytest.raises(InputError, match="OPENNI_15, BODY_25"):
        landmark_set(human(), "COCO")
    bare = replace(human(), landmarks=replace(human().landmarks, names=("x",) * len(human().landmarks.names)))
    with pytest.raises(InputError, match="has no left_ear, which OPENNI_15's point 'head'"):
        landmark_set(bare, "OPENNI_15")


def test_names_of_other_programs_are_one_to_one():
    assert set(MIXAMO) == set(JOINT_NAMES)
    for table in (MIXAMO, OPENSIM_JOINTS, OPENSIM_BODIES):
        assert set(table) <= set(JOINT_NAMES)
        assert len(set(table.values())) == len(table)
    body = renamed_body(human(), MIXAMO)
    assert body.skeleton.joint_names[6] == "LeftArm"
    np.testing.assert_array_equal(body.joints(np.zeros(36)), human().joints(np.zeros(36)))
    with pytest.raises(InputError, match="would be called 'a'"):
        renamed_body(human(), {"pelvis": "a", "spine": "a"})


RIGIFY = {
    "pelvis": "spine",
    "spine": "spine.001",
    "chest": "spine.003",
    "neck": "spine.004",
    "head": "head",
    **{
        f"{side}_{ours}": f"{theirs}.{side[0].upper()}"
        for side in ("left", "right")
        for ours, theirs in {
            "clavicle": "shoulder",
            "shoulder": "upper_arm",
            "elbow": "forearm",
            "wrist": "hand",
            "hip": "thigh",
            "knee": "shin",
            "ankle": "foot",
        }.items()
    },
}


@pytest.mark.parametrize(
    "names",
    [
        JOINT_NAMES,
        [f"mixamorig:{MIXAMO[n]}" for n in JOINT_NAMES],
        [RIGIFY[n] if n not in ("pelvis", "neck") else {"pelvis": "hips", "neck": "neck"}[n] for n in JOINT_NAMES],
        [n.replace("left_", "L_").replace("right_", "R_").replace("clavicle", "Collar") for n in JOINT_NAMES],
    ],
    ids=["own", "mixamo", "rigify", "sided"],
)
def test_rigs_of_other_programs_are_recognised(names):
    joints = human().skeleton.rest_joints
    rig = match_rig(names, PARENTS, joints, np.eye(19), "file")
    np.testing.assert_array_equal(rig.weights, np.eye(19))
    np.testing.assert_allclose(rig.joints, joints, atol=1e-12)
    assert rig.absent == ()


def test_fingers_go_to_the_hand_and_missing_joints_are_placed():
    body = human()
    keep = [k for k, n in enumerate(JOINT_NAMES) if "clavicle" not in n and n != "chest"]
    names = [JOINT_NAMES[k] for k in keep] + ["left_index_1", "left_index_2"]
    place = {k: i for i, k in enumerate(keep)}

    def above(k: int) -> int:
        p = int(PARENTS[k])
        while p >= 0 and p not in place:
            p = int(PARENTS[p])
        return place.get(p, -1)

    wrist = place[JOINT_NAMES.index("left_wrist")]
    parents = [above(k) for k in keep] + [wrist, len(keep)]
    joints = np.concatenate([body.skeleton.rest_joints[keep], np.zeros((2, 3))])
    rig = match_rig(names, parents, joints, np.eye(len(names)), "file")
    assert set(rig.absent) == {"chest", "left_clavicle", "right_clavicle"}
    assert (rig.weights[-2:, JOINT_NAMES.index("left_wrist")] == 1).all()
    np.testing.assert_allclose(rig.joints, body.skeleton.rest_joints, atol=1e-6)


def test_rigs_without_limbs_or_weights_are_refused():
    joints = human().skeleton.rest_joints
    with pytest.raises(InputError, match=r"avatar.glb: the rig's joints left_wrist were not recognised"):
        match_rig(
            [n if n != "left_wrist" else "tentacle" for n in JOINT_NAMES], PARENTS, joints, np.eye(19), "avatar.glb"
        )
    with pytest.raises(InputError, match="1 vertices have no skinning weight"):
        match_rig(JOINT_NAMES, PARENTS, joints, np.zeros((1, 19)), "avatar.glb")

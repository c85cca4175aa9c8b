"""The joint names of other programs, and their rigs read as ours."""

import numpy as np
import pytest

from hypose.body.default_body import JOINT_NAMES, PARENTS, human
from hypose.body.joint_names import MIXAMO, match_rig, renamed_body
from hypose.errors import InputError


def test_names_of_other_programs_are_one_to_one():
    assert set(MIXAMO) == set(JOINT_NAMES)
    assert len(set(MIXAMO.values())) == len(MIXAMO)
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

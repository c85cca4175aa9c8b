"""An avatar of the body's own lengths, turned by its bones, has its limbs where the tracked body has them."""

import numpy as np

from hypose.app.live.humanoid_bones import BONES, bone_turns, rest_offsets
from hypose.body.ready_bodies import human

LIMBS = [
    (f"{s}{upper}", f"{s}{lower}", f"{s}_{a}", f"{s}_{b}")
    for s in ("left", "right")
    for upper, lower, a, b in (
        ("UpperArm", "LowerArm", "shoulder", "elbow"),
        ("LowerArm", "Hand", "elbow", "wrist"),
        ("UpperLeg", "LowerLeg", "hip", "knee"),
        ("LowerLeg", "Foot", "knee", "ankle"),
    )
]


def test_bones_point_where_the_limbs_do():
    body, rng = human(), np.random.default_rng(4)
    s = body.skeleton
    poses = rng.uniform(np.maximum(s.lower, -1), np.minimum(s.upper, 1), (12, s.dof))
    hips, turns = bone_turns(s, poses)
    places, world = {}, {}
    for k, (name, (parent, *_)) in enumerate(BONES.items()):  # parents come first
        world[name] = world[parent] @ turns[:, k] if parent else turns[:, k]
        places[name] = places[parent] + world[parent] @ rest_offsets(body)[k] if parent else hips
    y_up = body.joints(poses)[..., [0, 2, 1]] * [1, 1, -1]
    for upper, lower, a, b in LIMBS:
        limb = y_up[:, s.joint(b)] - y_up[:, s.joint(a)]
        np.testing.assert_allclose(places[lower] - places[upper], limb, atol=1e-9)
    facing = -s.forward(poses)[0][:, 0, :, 1]  # the body looks along -y at rest
    np.testing.assert_allclose(world["hips"][:, :, 2], facing[:, [0, 2, 1]] * [1, 1, -1], atol=1e-9)


def test_the_rest_is_a_t_pose_on_the_ground():
    place = {}
    for (name, (parent, *_)), offset in zip(BONES.items(), rest_offsets(human()), strict=True):
        place[name] = offset + (place[parent] if parent else 0)
    for upper, lower in (("UpperArm", "LowerArm"), ("LowerArm", "Hand")):
        for side, sign in (("left", 1), ("right", -1)):
            bone = place[f"{side}{lower}"] - place[f"{side}{upper}"]
            np.testing.assert_allclose(bone / np.linalg.norm(bone), [sign, 0, 0], atol=1e-6)
    leg = place["leftFoot"] - place["leftUpperLeg"]
    np.testing.assert_allclose(leg / np.linalg.norm(leg), [0, -1, 0], atol=0.01)
    assert 0.8 < place["hips"][1] < 1.1 and 0.04 < place["leftFoot"][1] < 0.12
    assert place["head"][1] > place["neck"][1] > place["chest"][1] > place["spine"][1] > place["hips"][1]

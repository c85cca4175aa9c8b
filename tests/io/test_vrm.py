"""VRM animations: read back node by node, the avatar's bones point where the tracked limbs do."""

import numpy as np
import pytest
from pygltflib import GLTF2
from scipy.spatial.transform import Rotation

from hypose.body.motion import Motion, isotropic
from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.io.motions.vrm import BONES, EXTENSION, write_vrma

# VRMC_vrm 1.0: bones that every humanoid has
REQUIRED = ["hips", "spine", "head"] + [
    f"{s}{b}" for s in ("left", "right") for b in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
]
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


@pytest.fixture(scope="module")
def moving():
    body, rng = human(), np.random.default_rng(4)
    s = body.skeleton
    poses = rng.uniform(np.maximum(s.lower, -1), np.minimum(s.upper, 1), (12, s.dof))
    none = np.zeros(12, bool)
    joints = body.joints(poses)
    sds = isotropic(np.full(joints.shape[:2], 0.01))
    return Motion(s, np.arange(12) / 30, joints, poses, sds, none, none, np.full(12, 4), np.zeros(12)), body


def values(gltf, number):
    a = gltf.accessors[number]
    view = gltf.bufferViews[a.bufferView]
    columns = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[a.type]
    return np.frombuffer(gltf.binary_blob(), "<f4", a.count * columns, view.byteOffset).reshape(-1, columns)


def played(gltf):
    """{node name: (T, 3)} places and {name: (T, 3, 3)} world rotations of the animation."""
    channels = {
        (c.target.node, c.target.path): gltf.animations[0].samplers[c.sampler] for c in gltf.animations[0].channels
    }
    frames = len(values(gltf, gltf.animations[0].samplers[0].input))
    places, turns = {}, {}

    def walk(node, place, turn):
        n = gltf.nodes[node]
        moved = channels.get((node, "translation"))
        offset = values(gltf, moved.output) if moved else np.broadcast_to(n.translation, (frames, 3))
        assert n.rotation is None or np.allclose(n.rotation, [0, 0, 0, 1])  # the T pose needs none
        xyzw = values(gltf, channels[node, "rotation"].output)
        place = place + np.einsum("tab,tb->ta", turn, offset)
        turn = turn @ Rotation.from_quat(xyzw).as_matrix()
        places[n.name], turns[n.name] = place, turn
        for child in n.children:
            walk(child, place, turn)

    walk(gltf.scenes[0].nodes[0], np.zeros((frames, 3)), np.broadcast_to(np.eye(3), (frames, 3, 3)))
    return places, turns


def test_bones_point_where_the_limbs_do(moving, tmp_path):
    motion, body = moving
    write_vrma(tmp_path / "m.vrma", motion, body)
    gltf = GLTF2.load_binary(str(tmp_path / "m.vrma"))
    places, turns = played(gltf)
    y_up = motion.joints @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, z, -y)
    joint = motion.skeleton.joint
    np.testing.assert_allclose(places["hips"], y_up[:, joint("pelvis")], atol=1e-5)
    for upper, lower, a, b in LIMBS:
        got, want = places[lower] - places[upper], y_up[:, joint(b)] - y_up[:, joint(a)]
        np.testing.assert_allclose(got, want, atol=1e-5)
    facing = -motion.skeleton.forward(motion.poses)[0][:, 0, :, 1]  # the body looks along -y at rest
    np.testing.assert_allclose(turns["hips"][:, :, 2], facing[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5)


def test_the_extension_names_every_required_bone_once_with_its_parent_above(moving, tmp_path):
    write_vrma(tmp_path / "m.vrma", *moving)
    gltf = GLTF2.load_binary(str(tmp_path / "m.vrma"))
    assert gltf.extensionsUsed == [EXTENSION]
    extension = gltf.extensions[EXTENSION]
    bones = {name: bone["node"] for name, bone in extension["humanoid"]["humanBones"].items()}
    assert extension["specVersion"] == "1.0" and set(REQUIRED) <= set(bones)
    assert sorted(bones.values()) == list(range(len(gltf.nodes)))
    above = {child: k for k, n in enumerate(gltf.nodes) for child in n.children}
    for name, (parent, _, _) in BONES.items():
        assert above.get(bones[name]) == (bones[parent] if parent else None)


def test_the_rest_is_a_t_pose_on_the_ground(moving, tmp_path):
    write_vrma(tmp_path / "m.vrma", *moving)
    gltf = GLTF2.load_binary(str(tmp_path / "m.vrma"))
    place = {}
    for name, (parent, _, _) in BONES.items():  # parents come first
        node = next(n for n in gltf.nodes if n.name == name)
        place[name] = np.array(node.translation) + (place[parent] if parent else 0)
    for upper, lower, way in (("UpperArm", "LowerArm", [1, 0, 0]), ("LowerArm", "Hand", [1, 0, 0])):
        for side, sign in (("left", 1), ("right", -1)):
            bone = place[f"{side}{lower}"] - place[f"{side}{upper}"]
            np.testing.assert_allclose(bone / np.linalg.norm(bone), sign * np.array(way), atol=1e-6)
    leg = place["leftFoot"] - place["leftUpperLeg"]
    np.testing.assert_allclose(leg / np.linalg.norm(leg), [0, -1, 0], atol=0.01)
    assert 0.8 < place["hips"][1] < 1.1 and 0.04 < place["leftFoot"][1] < 0.12
    assert place["head"][1] > place["neck"][1] > place["chest"][1] > place["spine"][1] > place["hips"][1]


def test_a_motion_without_poses_is_refused(moving, tmp_path):
    motion, body = moving
    with pytest.raises(InputError, match="no poses"):
        write_vrma(tmp_path / "m.vrma", Motion(**{**motion.__dict__, "poses": None}), body)
    assert not list(tmp_path.iterdir())

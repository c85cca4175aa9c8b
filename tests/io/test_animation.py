"""BVH: an independent reader (bvhio) and a small one here find the joints where the motion has them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pygltflib import GLTF2
from scipy.spatial.transform import Rotation

from hypose.body.default_body import human_skeleton
from hypose.errors import InputError
from hypose.io.motions.animation import Y_UP, write_bvh, write_glb
from tests import missing


@pytest.fixture(scope="module")
def written(small_motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("bvh") / "a.bvh"
    write_bvh(path, small_motion)
    return path


def read(path):
    """The values of every frame of a BVH file."""
    motion = path.read_text().partition("\nMOTION\n")[2].splitlines()
    assert motion[0] == "Frames: 60" and float(motion[1].split()[2]) == pytest.approx(1 / 30, abs=1e-6)
    return np.array([[float(w) for w in row.split()] for row in motion[2:]])


def test_bvhio_agrees_to_a_tenth_of_a_millimetre(written, small_motion):
    bvhio = missing.module("bvhio", "agreement with bvhio", "pip install bvhio")
    root = bvhio.readAsHierarchy(str(written))
    for t in range(0, len(small_motion), 7):
        root.loadPose(t)
        for j, name in enumerate(small_motion.skeleton.joint_names):
            joint = root.filter(name, isEqual=True)[0]
            got = np.array(joint.PositionWorld) / 100
            np.testing.assert_allclose(got, Y_UP @ small_motion.joints[t, j], atol=1e-4, err_msg=f"{name} {t}")


def test_angles_are_continuous_though_the_body_turns_once(written):
    frames = read(written)
    assert np.abs(np.diff(frames[:, 3:], axis=0)).max() < 90
    assert abs(abs(frames[-1, 5] - frames[0, 5]) - 360) < 60


def test_frames_without_a_pose_hold_the_last(tmp_path, small_motion, written):
    poses = small_motion.poses.copy()
    poses[[0, 9, 10]] = np.nan
    write_bvh(tmp_path / "b.bvh", replace(small_motion, poses=poses))
    whole, held = read(written), read(tmp_path / "b.bvh")
    assert len(held) == len(whole) and np.isfinite(held).all()
    np.testing.assert_allclose(held[[0, 9, 10], :3], whole[[1, 8, 8], :3], atol=1e-5)


@pytest.mark.parametrize(
    ("poses", "message"), [(None, "no poses"), (np.full((60, 36), np.nan), "no frame with a finite pose")]
)
def test_a_motion_without_poses_is_one_sentence(tmp_path, small_motion, poses, message):
    with pytest.raises(InputError, match=message):
        write_bvh(tmp_path / "a.bvh", replace(small_motion, poses=poses))


# ---- test gltf -----------------------------------------------------------------------------------------------------
# GLB: a small evaluator of the specification finds joints and skin where the body has them; trimesh
# loads the mesh.


@pytest.fixture(scope="module")
def written_glb(small_motion, small_body, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    write_glb(path, small_motion, small_body)
    return path


class Glb:
    """Evaluates a GLB by the specification alone (accessors of section 3.6, skins of 3.7.3)."""

    TYPES = {5121: "<u1", 5125: "<u4", 5126: "<f4"}
    WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}

    def __init__(self, path):
        file = GLTF2().load(path)
        self.json, self.binary = json.loads(file.to_json()), file.binary_blob()

    def array(self, index):
        a = self.json["accessors"][index]
        view = self.json["bufferViews"][a["bufferView"]]
        width, kind = self.WIDTH[a["type"]], self.TYPES[a["componentType"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        assert start % np.dtype(kind).itemsize == 0
        out = np.frombuffer(self.binary, kind, a["count"] * width, start).reshape(a["count"], width)
        if "min" in a:
            np.testing.assert_allclose([out.min(0), out.max(0)], [a["min"], a["max"]], rtol=1e-6)
        return out

    def globals(self, frame):
        """world_from_node (4, 4) of every node at a key frame."""
        nodes = self.json["nodes"]
        values = [{k: n[k] for k in ("translation", "rotation") if k in n} for n in nodes]
        animation = self.json["animations"][0]
        for c in animation["channels"]:
            sampler = animation["samplers"][c["sampler"]]
            values[c["target"]["node"]][c["target"]["path"]] = self.array(sampler["output"])[frame]
        out = [None] * len(nodes)

        def walk(i, parent):
            m = np.eye(4)
            m[:3, :3] = Rotation.from_quat(values[i].get("rotation", [0, 0, 0, 1])).as_matrix()
            m[:3, 3] = values[i].get("translation", [0, 0, 0])
            out[i] = parent @ m
            for child in nodes[i].get("children", []):
                walk(child, out[i])

        for root in self.json["scenes"][0]["nodes"]:
            walk(root, np.eye(4))
        return out

    def skinned(self, frame):
        world, skin = self.globals(frame), self.json["skins"][0]
        attributes = self.json["meshes"][0]["primitives"][0]["attributes"]
        inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        bones = np.stack([world[j] for j in skin["joints"]]) @ inverse
        v = np.c_[self.array(attributes["POSITION"]), np.ones(self.array(attributes["POSITION"]).shape[0])]
        index, weight = self.array(attributes["JOINTS_0"]), self.array(attributes["WEIGHTS_0"])
        np.testing.assert_allclose(weight.sum(1), 1, atol=1e-6)
        return np.einsum("vk,vkij,vj->vi", weight, bones[index], v)[:, :3]


FRAMES = (0, 13, 37, 59)


@pytest.mark.parametrize("frame", FRAMES)
def test_joints_and_skin_are_the_body_s(written_glb, small_motion, small_body, frame):
    expected = small_body.skin(small_motion.poses[frame], small_body.fine) @ Y_UP.T
    glb = Glb(written_glb)
    np.testing.assert_allclose(glb.skinned(frame), expected, atol=1e-5)
    places = {node["name"]: m[:3, 3] for node, m in zip(glb.json["nodes"], glb.globals(frame), strict=True)}
    joints = [places[name] for name in small_motion.skeleton.joint_names]
    np.testing.assert_allclose(joints, small_motion.joints[frame] @ Y_UP.T, atol=1e-5)


def test_trimesh_loads_the_resting_mesh(written_glb, small_body):
    mesh = trimesh.load(written_glb, force="mesh", process=False)
    assert len(mesh.faces) == len(small_body.fine.faces)
    vertices = small_body.fine.vertices @ Y_UP.T
    np.testing.assert_allclose(mesh.bounds, [vertices.min(0), vertices.max(0)], atol=1e-6)
    assert mesh.volume == pytest.approx(small_body.fine.volume, rel=1e-5)  # same sign: faces still look outward


def test_quaternions_are_unit_and_never_take_the_long_way(written_glb):
    glb = Glb(written_glb)
    animation = glb.json["animations"][0]
    rotations = [c for c in animation["channels"] if c["target"]["path"] == "rotation"]
    assert len(rotations) == 15  # the joints that move
    for c in rotations:
        q = glb.array(animation["samplers"][c["sampler"]]["output"])
        np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-6)
        assert ((q[1:] * q[:-1]).sum(1) > 0).all()
    times = glb.array(animation["samplers"][0]["input"])[:, 0]
    assert times[0] == 0 and (np.diff(times) > 0).all() and times[-1] == pytest.approx(59 / 30)


def test_weights_name_each_joint_once_and_joint_zero_when_unused(written_glb):
    glb = Glb(written_glb)
    attributes = glb.json["meshes"][0]["primitives"][0]["attributes"]
    weight, index = glb.array(attributes["WEIGHTS_0"]), glb.array(attributes["JOINTS_0"])
    assert not index[weight == 0].any()
    for i, w in zip(index, weight, strict=True):  # the test's mesh names the pelvis twice
        assert len(set(i[w > 0])) == (w > 0).sum()


def test_another_body_s_motion_is_refused(tmp_path, small_motion, small_body):
    longer = human_skeleton(small_body.skeleton.rest_joints * 1.1)
    with pytest.raises(InputError, match="not the body's"):
        write_glb(tmp_path / "a.glb", replace(small_motion, skeleton=longer), small_body)
    assert not list(tmp_path.iterdir())

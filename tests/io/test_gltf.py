"""GLB: a small evaluator of the specification finds joints and skin where the body has them; trimesh
loads the mesh."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from hypose.body.ready_bodies import human_skeleton
from hypose.errors import InputError
from hypose.io.motions.animation import Y_UP
from hypose.io.motions.gltf import write_glb


@pytest.fixture(scope="module")
def written(small_motion, small_body, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    write_glb(path, small_motion, small_body)
    return path


class Glb:
    """Reads a GLB by the specification alone (containers of section 4.4, accessors of 3.6, skins of
    3.7.3)."""

    TYPES = {5121: "<u1", 5125: "<u4", 5126: "<f4"}
    WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert magic == b"glTF" and version == 2 and length == len(data)
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.json = json.loads(data[20 : 20 + size])
        size2, kind2 = struct.unpack_from("<I4s", data, 20 + size)
        assert kind2 == b"BIN\0" and size2 % 4 == 0
        self.binary = data[28 + size : 28 + size + size2]

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
        values = [{k: n.get(k) for k in ("translation", "rotation")} for n in nodes]
        animation = self.json["animations"][0]
        for c in animation["channels"]:
            sampler = animation["samplers"][c["sampler"]]
            values[c["target"]["node"]][c["target"]["path"]] = self.array(sampler["output"])[frame]
        out = [None] * len(nodes)

        def walk(i, parent):
            m = np.eye(4)
            if values[i]["rotation"] is not None:
                x, y, z, w = np.asarray(values[i]["rotation"], dtype=float)
                m[:3, :3] = [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            if values[i]["translation"] is not None:
                m[:3, 3] = values[i]["translation"]
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
def test_nodes_are_where_the_joints_are(written, small_motion, frame):
    glb = Glb(written)
    world = glb.globals(frame)
    for j, name in enumerate(small_motion.skeleton.joint_names):
        node = next(i for i, n in enumerate(glb.json["nodes"]) if n["name"] == name)
        np.testing.assert_allclose(world[node][:3, 3], Y_UP @ small_motion.joints[frame, j], atol=1e-5)


@pytest.mark.parametrize("frame", FRAMES)
def test_skin_is_the_body_s(written, small_motion, small_body, frame):
    expected = small_body.skin(small_motion.poses[frame], small_body.fine) @ Y_UP.T
    np.testing.assert_allclose(Glb(written).skinned(frame), expected, atol=1e-5)


def test_trimesh_loads_the_resting_mesh(written, small_body):
    mesh = trimesh.load(written, force="mesh", process=False)
    assert len(mesh.faces) == len(small_body.fine.faces)
    vertices = small_body.fine.vertices @ Y_UP.T
    np.testing.assert_allclose(mesh.bounds, [vertices.min(0), vertices.max(0)], atol=1e-6)
    assert mesh.volume == pytest.approx(small_body.fine.volume, rel=1e-5)  # same sign: faces still look outward


def test_quaternions_are_unit_and_never_take_the_long_way(written):
    glb = Glb(written)
    animation = glb.json["animations"][0]
    rotations = [c for c in animation["channels"] if c["target"]["path"] == "rotation"]
    assert len(rotations) == 15  # the joints that move
    for c in rotations:
        q = glb.array(animation["samplers"][c["sampler"]]["output"])
        np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-6)
        assert ((q[1:] * q[:-1]).sum(1) > 0).all()
    times = glb.array(animation["samplers"][0]["input"])[:, 0]
    assert times[0] == 0 and (np.diff(times) > 0).all() and times[-1] == pytest.approx(59 / 30)


def test_weights_name_each_joint_once_and_joint_zero_when_unused(written):
    glb = Glb(written)
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

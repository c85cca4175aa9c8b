"""Writing of BVH and glTF (GLB) files: Y-up axes, poses without gaps, rotations relative to parents.

Axes: file (x, y, z) = world (x, z, -y). The body then faces +z of the file, as glTF requires. Blender's importers of
    both formats undo this rotation, so Blender shows the world's own coordinates.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hypose.body.body import Body, Mesh
from hypose.body.joint_angles import continuous_euler_zxy
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.body.skin_weights import vertex_normals
from hypose.compute.arrays import FIXED
from hypose.errors import InputError
from hypose.geometry import Array, quaternion_from_matrix
from hypose.io.files import write_bytes, write_text

# file_from_world
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def filled_poses(motion: Motion, path: str | Path) -> Array:
    """Fill the frames of a motion that have no usable pose.

    Each takes the last usable pose before it; frames at the start take the first usable pose.

    path: file to be written, for the error messages.
    Returns: (T, D) poses.
    Raises: InputError where the motion has no usable pose.
    Why: animation files cannot leave a frame out.
    """
    if motion.poses is None:
        raise InputError(
            f"{path}: this motion holds joint positions but no poses, which the format needs; write TRC or C3D instead."
        )
    good = np.isfinite(motion.poses).all(1)
    if not good.any():
        raise InputError(f"{path}: the motion has no frame with a finite pose, so there is nothing to animate.")
    index = np.maximum.accumulate(np.where(good, np.arange(len(motion)), -1))
    return motion.poses[np.where(index >= 0, index, int(good.argmax()))]


def local_joint_rotations(skeleton: Skeleton, poses: Array) -> Array:
    """Compute the rotation of each joint relative to its parent, in the axes of animation files (y up).

    skeleton: the skeleton with J joints.
    poses: (T, D) pose vectors, rad and m.
    Returns: (T, J, 3, 3) parent_from_joint; world_from_joint for the root.
    """
    world_from_joint, _ = skeleton.forward(poses)
    local = world_from_joint.copy()
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            local[:, j] = np.swapaxes(world_from_joint[:, p], -1, -2) @ world_from_joint[:, j]
    return Y_UP @ local @ Y_UP.T


def without_flips(quaternions: Array) -> Array:
    """Choose the signs of a series of quaternions so that neighbours differ least (q and -q are the same rotation).

    quaternions: (T, 4).
    Returns: (T, 4).
    Why: players would otherwise interpolate the long way round.
    """
    flips = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0, -1.0, 1.0))
    return np.concatenate([quaternions[:1], quaternions[1:] * flips[:, None]])


# ---- bvh -----------------------------------------------------------------------------------------------------------
# BVH animation: the skeleton with Euler channels, centimetres, Y up (axes: see the module).
#
# The rest pose of the file is the body's rest pose, not a T pose: the OFFSETs are its bones and all channels
# zero is its stance, at the origin. The root has its position and rotation, every other joint three rotations Z
# X Y (R = Rz Rx Ry, moving axes), continuous in time. Nothing is left out, so the file's joint centres are
# those of the poses.


_CM = 100.0
# model-frame directions of the bones beyond the last joints, for display only: up, and forwards for feet
_UP, _FORWARD = np.array([0.0, 0.0, 0.12]), np.array([0.0, -0.15, -0.05])


def write_bvh(path: str | Path, motion: Motion) -> None:
    """Write the poses of a motion as a BVH file; frames without a pose repeat the last one.

    Raises: InputError where the motion has no usable pose.
    """
    poses = filled_poses(motion, path)
    skeleton = motion.skeleton
    order: list[int] = []
    lines = ["HIERARCHY"]
    _joint(skeleton, 0, 0, lines, order)
    local = local_joint_rotations(skeleton, poses)[:, order]
    # a body's heading is unbounded, so the root's branch is judged by its second angle and the others' by
    # their twist
    root = continuous_euler_zxy(local[:, :1], prior_axis=1)
    euler = np.concatenate([root, continuous_euler_zxy(local[:, 1:])], axis=1)
    position = skeleton.forward(poses)[1][:, 0] @ Y_UP.T * _CM
    channels = np.concatenate([position, np.degrees(euler).reshape(len(poses), -1)], axis=1)
    lines += ["MOTION", f"Frames: {len(poses)}", f"Frame Time: {1 / motion.frame_rate:.9f}"]
    lines += [" ".join(f"{v:.6f}" for v in row) for row in channels.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _joint(skeleton: Skeleton, j: int, depth: int, lines: list[str], order: list[int]) -> None:
    """Append a joint and the joints below it to the lines of the file.

    j: number of the joint.
    depth: its distance from the root in joints, for the indent.
    lines: lines of the file, which are extended.
    order: numbers of the joints in the order of their channels, which is extended.
    """
    indent = "\t" * depth
    root = skeleton.parents[j] < 0
    order.append(j)
    offset = np.zeros(3) if root else Y_UP @ skeleton.rest_offsets[j] * _CM
    position = "6 Xposition Yposition Zposition" if root else "3"
    lines += [
        f"{indent}{'ROOT' if root else 'JOINT'} {skeleton.joint_names[j]}",
        f"{indent}{{",
        f"{indent}\tOFFSET {_vector(offset)}",
        f"{indent}\tCHANNELS {position} Zrotation Xrotation Yrotation",
    ]
    below = np.flatnonzero(skeleton.parents == j).tolist()
    for child in below:
        _joint(skeleton, child, depth + 1, lines, order)
    if not below:
        end, name = f"{indent}\t", skeleton.joint_names[j]
        # a hand goes on in the forearm's direction
        model = _UP if name == "head" else _FORWARD if name.endswith("ankle") else 0.5 * skeleton.rest_offsets[j]
        lines += [f"{end}End Site", f"{end}{{", f"{end}\tOFFSET {_vector(Y_UP @ model * _CM)}", f"{end}}}"]
    lines.append(f"{indent}}}")


def _vector(v: Array) -> str:
    return " ".join(f"{x:.6f}" for x in v)


# ---- gltf ----------------------------------------------------------------------------------------------------------
# GLB files (binary glTF 2.0) with the fine mesh, skinned and animated, in metres with Y up.
#
# Mesh, joints and motion are all rotated to Y-up, so no node has a correcting rotation and the skinned mesh is a root
# node, as the specification recommends. Node defaults are the rest pose at the origin. Rotations are quaternions,
# interpolated between frames; the root has a translation as well. All numbers are float32.
# Source: Khronos glTF 2.0 specification, sections 3.6 (accessors), 3.7.3 (skins), 3.11 (animations).


# numbers of the specification
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER, _TRIANGLES = 34962, 34963, 4
_COMPONENTS = {"f4": 5126, "u1": 5121, "u4": 5125}
_SKIN = {
    "pbrMetallicRoughness": {"baseColorFactor": [0.80, 0.66, 0.56, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8},
    "emissiveFactor": [0.0, 0.0, 0.0],
    "alphaMode": "OPAQUE",
    "doubleSided": False,
    "name": "skin",
}


def write_glb(path: str | Path, motion: Motion, body: Body) -> None:
    """Write the motion of a body as a GLB file; frames without a pose repeat the last one.

    Raises: InputError where the motion has no poses or its skeleton is not that of the body.
    """
    write_people_glb(path, [("", motion, body)])


def write_people_glb(path: str | Path, people: Sequence[tuple[str, Motion, Body]]) -> None:
    """Write the motions of several people as one GLB file with one animation.

    people: name, motion and body of each person. Nodes are named NAME.JOINT, or JOINT where the name is "".
    Raises: InputError as `write_glb`.
    """
    store = _BinaryBuffer()
    nodes: list[dict[str, Any]] = []
    roots: list[int] = []
    meshes: list[dict[str, Any]] = []
    skins: list[dict[str, Any]] = []
    whole: dict[str, Any] = {"name": "motion", "channels": [], "samplers": []}
    for person, motion, body in people:
        prefix = person and f"{person}."
        poses = filled_poses(motion, path)
        skeleton, first = motion.skeleton, len(nodes)
        if skeleton.joint_names != body.skeleton.joint_names or not np.allclose(
            skeleton.rest_offsets, body.skeleton.rest_offsets, atol=1e-6
        ):
            raise InputError(f"{path}: the motion's skeleton is not the body's; give the body that was tracked.")
        joints = len(skeleton.joint_names)
        for j, name in enumerate(skeleton.joint_names):
            at = (Y_UP @ skeleton.rest_offsets[j]).tolist() if j else [0.0, 0.0, 0.0]
            below = (first + np.flatnonzero(skeleton.parents == j)).tolist()
            node = {"rotation": [0.0, 0.0, 0.0, 1.0], "translation": at, "children": below, "name": f"{prefix}{name}"}
            nodes.append({k: v for k, v in node.items() if v})
        nodes.append({"mesh": len(meshes), "skin": len(skins), "name": f"{prefix}{body.name}"})
        roots += [first, first + joints]
        rest = (skeleton.rest_joints - skeleton.rest_joints[0]) @ Y_UP.T
        inverse = np.tile(np.eye(4), (joints, 1, 1))
        inverse[:, :3, 3] = -rest
        # glTF matrices are stored column by column
        matrices = store.add(np.swapaxes(inverse, 1, 2).reshape(-1, 16), "MAT4")
        nodes_of_skin = list(range(first, first + joints))
        skin = {
            "inverseBindMatrices": matrices,
            "skeleton": first,
            "joints": nodes_of_skin,
            "name": f"{prefix}skeleton",
        }
        skins.append(skin)
        meshes.append({"primitives": [_primitive(store, body.fine, joints)], "name": f"{prefix}{body.name}"})
        _animate(whole, store, motion, poses, first)
    document = {
        "accessors": store.accessors,
        "animations": [whole],
        "asset": {"generator": "hypose", "version": "2.0"},
        "bufferViews": store.views,
        "buffers": [{"byteLength": len(store.data)}],
        "materials": [_SKIN],
        "meshes": meshes,
        "nodes": nodes,
        "scene": 0,
        "scenes": [{"name": "motion", "nodes": roots}],
        "skins": skins,
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    parts = [text + b" " * (-len(text) % 4), bytes(store.data) + bytes(-len(store.data) % 4)]
    file = struct.pack("<4sII", b"glTF", 2, 12 + sum(8 + len(p) for p in parts))
    for kind, part in zip((b"JSON", b"BIN\0"), parts, strict=True):
        file += struct.pack("<I4s", len(part), kind) + part
    write_bytes(path, file)


class _BinaryBuffer:
    """The binary buffer of a GLB file, with one view and one accessor per array."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, kind: str, target: int | None = None, limits: bool = False) -> int:
        """Append an array whose rows are the elements; float64 is stored as float32.

        values: (N, ...) the elements.
        kind: type of an element: SCALAR, VEC3, VEC4 or MAT4.
        target: use of the array, a number of the specification; None where it needs none.
        limits: store the smallest and largest values, as the specification requires for positions and times.
        Returns: number of its accessor.
        """
        array = np.ascontiguousarray(values.astype("<f4") if values.dtype == np.float64 else values)
        self.data.extend(b"\0" * (-len(self.data) % 4))  # accessors start at multiples of their component size
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        component = _COMPONENTS[array.dtype.str[1:]]
        accessor = {"bufferView": len(self.views), "byteOffset": 0, "componentType": component, "normalized": False}
        accessor |= {"count": len(array), "type": kind}
        if limits:
            flat = array.reshape(len(array), -1)
            accessor |= {"max": flat.max(0).tolist(), "min": flat.min(0).tolist()}
        self.data.extend(array.tobytes())
        self.views.append(view if target is None else view | {"target": target})
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _primitive(store: _BinaryBuffer, mesh: Mesh, joints: int) -> dict[str, Any]:
    """Store a skinned mesh, with the four largest weights of each vertex, and describe it. joints: their number."""
    vertices = mesh.vertices @ Y_UP.T
    # a vertex must not name a joint twice, and unused slots must name joint 0
    dense = mesh.dense_weights(joints)
    index = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, index, 1)
    index = np.where(weights > 0, index, 0).astype(np.uint8)
    weights = weights / weights.sum(1, keepdims=True)
    attributes = {
        "POSITION": store.add(vertices, "VEC3", _ARRAY_BUFFER, limits=True),
        "NORMAL": store.add(vertex_normals(vertices, mesh.faces), "VEC3", _ARRAY_BUFFER),
        "JOINTS_0": store.add(index, "VEC4", _ARRAY_BUFFER),
        "WEIGHTS_0": store.add(weights, "VEC4", _ARRAY_BUFFER),
    }
    indices = store.add(mesh.faces.astype("<u4").ravel(), "SCALAR", _ELEMENT_ARRAY_BUFFER)
    return {"attributes": attributes, "indices": indices, "mode": _TRIANGLES, "material": 0}


def _animate(whole: dict[str, Any], store: _BinaryBuffer, motion: Motion, poses: Array, first: int) -> None:
    """Add the motion of a skeleton to an animation.

    whole: the animation, which is extended.
    store: buffer of the file.
    poses: (T, D) pose vectors of `motion`, without gaps.
    first: number of the node of the skeleton's root.
    """
    skeleton = motion.skeleton
    # frames at equal steps: time stamps of real files may repeat, which glTF forbids
    times = np.arange(len(poses)) / motion.frame_rate
    clock = store.add(times, "SCALAR", limits=True)
    local = local_joint_rotations(skeleton, poses)

    def channel(node: int, what: str, values: Array, kind: str) -> None:
        target = {"node": first + node, "path": what}
        whole["channels"].append({"sampler": len(whole["samplers"]), "target": target})
        output = store.add(values, kind)
        whole["samplers"].append({"input": clock, "interpolation": "LINEAR", "output": output})

    _, centres = skeleton.forward(poses)
    channel(0, "translation", centres[:, 0] @ Y_UP.T, "VEC3")
    for j in np.flatnonzero(skeleton.tree.kind != FIXED):
        wxyz = without_flips(quaternion_from_matrix(local[:, j]))
        channel(int(j), "rotation", wxyz[:, [1, 2, 3, 0]], "VEC4")

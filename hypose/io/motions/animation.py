"""BVH files, and the parts that BVH and glTF have in common: Y-up axes, poses without gaps, rotations relative to
parents.

Axes: file (x, y, z) = world (x, z, -y). The body then faces +z of the file, as glTF requires. Blender's importers of
    both formats undo this rotation, so Blender shows the world's own coordinates.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.body.joint_angles import continuous_euler_zxy
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import write_text

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


def children(skeleton: Skeleton, joint: int) -> list[int]:
    """List the indices of a joint's children."""
    return [int(c) for c in np.flatnonzero(skeleton.parents == joint)]


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
    channels = _channels(skeleton, poses, order)
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
    below = children(skeleton, j)
    for child in below:
        _joint(skeleton, child, depth + 1, lines, order)
    if not below:
        end = f"{indent}\t"
        lines += [f"{end}End Site", f"{end}{{", f"{end}\tOFFSET {_vector(_end(skeleton, j))}", f"{end}}}"]
    lines.append(f"{indent}}}")


def _end(skeleton: Skeleton, j: int) -> Array:
    """Compute the offset (3,), cm, from joint j, the last of its limb, to the end of its bone, in the file's axes."""
    name = skeleton.joint_names[j]
    if name == "head":
        model = _UP
    elif name.endswith("ankle"):
        model = _FORWARD
    else:  # a hand goes on in the forearm's direction
        model = 0.5 * skeleton.rest_offsets[j]
    return Y_UP @ model * _CM


def _channels(skeleton: Skeleton, poses: Array, order: list[int]) -> Array:
    """Compute the channels (T, 3 + 3 J) of all frames: the root's position, cm, and the Euler angles Z X Y, degrees.

    poses: (T, D) pose vectors.
    order: numbers of the joints in the order of their channels.
    """
    local = local_joint_rotations(skeleton, poses)[:, order]
    # a body's heading is unbounded, so the root's branch is judged by its second angle and the others' by
    # their twist
    root = continuous_euler_zxy(local[:, :1], prior_axis=1)
    euler = np.concatenate([root, continuous_euler_zxy(local[:, 1:])], axis=1)
    _, centres = skeleton.forward(poses)
    position = centres[:, 0] @ Y_UP.T * _CM
    return np.concatenate([position, np.degrees(euler).reshape(len(poses), -1)], axis=1)


def _vector(v: Array) -> str:
    return " ".join(f"{x:.6f}" for x in v)

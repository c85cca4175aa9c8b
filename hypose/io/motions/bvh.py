"""BVH animation: the skeleton with Euler channels, centimetres, Y up (axes: see io.animation).

The rest pose of the file is the body's rest pose, not a T pose: the OFFSETs are its bones and all channels
zero is its stance, at the origin. The root has its position and rotation, every other joint three rotations Z
X Y (R = Rz Rx Ry, moving axes), continuous in time. Nothing is left out, so the file's joint centres are
those of the poses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.body.joint_angles import continuous_euler_zxy
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array
from hypose.io.files import write_text
from hypose.io.motions.animation import Y_UP, children, filled_poses, local_rotations

_CM = 100.0
# model-frame directions of the bones beyond the last joints, for display only: up, and forwards for feet
_UP, _FORWARD = np.array([0.0, 0.0, 0.12]), np.array([0.0, -0.15, -0.05])


def write_bvh(path: str | Path, motion: Motion) -> None:
    """Write the poses of a motion. Frames without a pose hold the last one; an InputError when there are
    no poses."""
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
    """Append joint j and its subtree; `order` collects the joints in the order of their channels."""
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
    """File-frame offset (cm) of the end site of a leaf joint."""
    name = skeleton.joint_names[j]
    if name == "head":
        model = _UP
    elif name.endswith("ankle"):
        model = _FORWARD
    else:  # a hand goes on in the forearm's direction
        model = 0.5 * skeleton.rest_offsets[j]
    return Y_UP @ model * _CM


def _channels(skeleton: Skeleton, poses: Array, order: list[int]) -> Array:
    local = local_rotations(skeleton, poses)[:, order]
    # a body's heading is unbounded, so the root's branch is judged by its second angle and the others' by
    # their twist
    root = continuous_euler_zxy(local[:, :1], prior_axis=1)
    euler = np.concatenate([root, continuous_euler_zxy(local[:, 1:])], axis=1)
    _, centres = skeleton.forward(poses)
    position = centres[:, 0] @ Y_UP.T * _CM
    return np.concatenate([position, np.degrees(euler).reshape(len(poses), -1)], axis=1)


def _vector(v: Array) -> str:
    return " ".join(f"{x:.6f}" for x in v)

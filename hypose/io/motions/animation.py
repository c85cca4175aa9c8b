"""What BVH and glTF share: Y-up axes, gap-free poses, and rotations relative to the parent.

Axes: file (x, y, z) = world (x, z, -y). The body then faces +z of the file, as glTF wants, and Blender's
importers of both formats, which turn the file back, show the world's own coordinates.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.geometry import Array

# file_from_world
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def filled_poses(motion: Motion, path: str | Path) -> Array:
    """Poses (T, D) of a motion, unusable frames replaced by the last usable pose (at the start by the first
    one).

    Animation files cannot leave a frame out. An InputError when the motion has no usable pose at all.
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


def local_rotations(skeleton: Skeleton, poses: Array) -> Array:
    """parent_from_joint rotations (T, J, 3, 3) in the file's axes; for the root world_from_joint."""
    world_from_joint, _ = skeleton.forward(poses)
    local = world_from_joint.copy()
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            local[:, j] = np.swapaxes(world_from_joint[:, p], -1, -2) @ world_from_joint[:, j]
    return Y_UP @ local @ Y_UP.T


def without_flips(quaternions: Array) -> Array:
    """Quaternions (T, 4) with signs (q and -q are one rotation) such that neighbours lie on one side: players would
    interpolate the long way round."""
    flips = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0, -1.0, 1.0))
    return np.concatenate([quaternions[:1], quaternions[1:] * flips[:, None]])


def children(skeleton: Skeleton, joint: int) -> list[int]:
    """Indices of a joint's children."""
    return [int(c) for c in np.flatnonzero(skeleton.parents == joint)]

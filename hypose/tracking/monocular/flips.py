"""Mirror limb segments in depth: one view cannot tell whether a segment points towards the camera or away from it.

Mirrored poses must be optimised before they are ranked: unoptimised ones destroy a track.
Source: Sminchisescu & Triggs 2001, section 4.2 (the ambiguity of motions far from parallel with the image plane);
    Sminchisescu & Triggs 2003 (kinematic jumps).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.fitting.problem import Quadratic
from hypose.geometry import Array
from hypose.tracking.monocular.points import held_dofs

CHAINS = tuple(
    tuple(f"{side}_{part}" for part in parts)
    for parts in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
    for side in ("left", "right")
)
"""Joints of each limb, from the trunk outwards; two neighbours are the ends of a segment."""
LEAST_DEPTH = 0.06
"""m: a segment whose ends differ by less in depth is not mirrored"""
_LOOSE = 0.02
"""1 / rad^2: weight that chooses among poses with the same joint centres the one nearest to the start."""
_TO_JOINTS = SolveSettings(iterations=20, damping=1e-3)
REACHED = 0.06
"""m: largest distance allowed between the limb's joints and their mirrored places; joint limits may prevent a closer
fit"""


def mirrored(body: Body, camera: Camera, pose: ArrayLike, active: NDArray[np.int64]) -> Array:
    """Compute the poses that look nearly the same in the camera because one limb segment is mirrored in depth.

    Each result has one segment of one limb mirrored; the joints further out on the limb are moved with it.
    pose: (D,) the pose to mirror.
    active: (A,) indices of the dof that may change, within the joint limits.
    Returns: (M, D) poses; mirror images that the joint limits do not allow are left out.
    """
    q = np.asarray(pose, dtype=np.float64)
    s = body.skeleton
    joints = body.joints(q)
    held = held_dofs(s.dof, active)
    stay = Quadratic(q, np.maximum(held, _LOOSE))
    out = []
    for chain in CHAINS:
        limb = [s.joint(name) for name in chain]
        if not np.isin(s.joint_of_dof[active], limb).any():
            continue
        for k in range(len(limb) - 1):
            sight = joints[limb[k]] - camera.position
            sight = sight / np.linalg.norm(sight)
            depth = float((joints[limb[k + 1]] - joints[limb[k]]) @ sight)
            if abs(depth) < LEAST_DEPTH:
                continue
            target = joints.copy()
            target[s.descendants(chain[k + 1])] -= 2 * depth * sight
            term = PointTerm(target, np.ones(len(target)), np.arange(len(target)), np.zeros((len(target), 3)), 0.05)
            fit = np.where(held > 0, q, fit_pose(body, q, [term], priors=(stay,), options=_TO_JOINTS).pose)
            if np.linalg.norm((body.joints(fit) - target)[limb], axis=1).max() < REACHED:
                out.append(fit)
    return np.array(out).reshape(-1, s.dof)

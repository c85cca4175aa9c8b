"""numba: covariances of the joint centres of a solved pose. The definition is in compute.joint_covariances."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import joint_frames


@kernel
def joint_covariances(q, tree, hessian, ridge, out):
    """out (J, 3, 3) = G H^-1 G^T, G (3, D) the derivative of the joint centre: X^T X with X = L^-1 G^T by forward
    substitution, H + ridge = L L^T. Plain loops: LAPACK's threads may change the last bits."""
    n_dof, n_joints = q.shape[0], tree.parents.shape[0]
    rotations, centres, twists = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3)), np.empty((n_dof, 6))
    joint_frames(q, tree, rotations, centres, twists)
    factor = np.zeros((n_dof, n_dof))
    for i in range(n_dof):
        for j in range(i + 1):
            s = hessian[i, j] + (ridge if i == j else 0.0)
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(max(s, 1e-12)) if i == j else s / factor[j, j]
    moves = np.zeros(n_joints, np.uint8)
    x = np.empty((3, n_dof))
    for j in range(n_joints):
        moves[:] = 0
        a = j
        while a >= 0:
            moves[a] = 1
            a = tree.parents[a]
        for axis in range(3):
            b, c = (axis + 1) % 3, (axis + 2) % 3
            for d in range(n_dof):
                s = 0.0
                if moves[tree.joint_of_dof[d]]:
                    t = twists[d]
                    s = t[b] * centres[j, c] - t[c] * centres[j, b] + t[3 + axis]
                for k in range(d):
                    s -= factor[d, k] * x[axis, k]
                x[axis, d] = s / factor[d, d]
            for other in range(axis + 1):
                s = 0.0
                for d in range(n_dof):
                    s += x[axis, d] * x[other, d]
                out[j, axis, other] = out[j, other, axis] = s

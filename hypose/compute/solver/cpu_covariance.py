"""numba: covariances of the joint centres of a solved pose. The definition is in compute.joint_covariances."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import joint_frames
from hypose.compute.solver.cpu_cholesky import dot, factorise, forward


@kernel
def joint_covariances(q, tree, hessian, ridge, out):
    """out (J, 3, 3) = G H^-1 G^T, G (3, D) the derivative of the joint centre, the root's rotation as a small turn in
    the world: X^T X with X = L^-1 G^T by forward substitution, H + ridge = L L^T."""
    n_dof, n_joints = q.shape[0], tree.parents.shape[0]
    rotations, centres, twists = np.empty((n_joints, 3, 3)), np.empty((n_joints, 3)), np.empty((n_dof, 6))
    joint_frames(q, tree, rotations, centres, twists)
    x0, y0, z0 = centres[0]
    twists[3:6] = 0.0  # the root turns about the axes of the world
    for k in range(3):
        twists[3 + k, k] = 1.0
    twists[3, 4], twists[3, 5] = z0, -y0
    twists[4, 3], twists[4, 5] = -z0, x0
    twists[5, 3], twists[5, 4] = y0, -x0
    factor = hessian.copy()
    for d in range(n_dof):
        factor[d, d] += ridge
    factorise(factor, n_dof, 1e-12)
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
                x[axis, d] = s
            forward(factor, n_dof, x[axis])
            for other in range(axis + 1):
                out[j, axis, other] = out[j, other, axis] = dot(x[axis], x[other], n_dof)

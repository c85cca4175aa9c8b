"""Compute joint frames, world twists and skinned vertices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hypose.compute.arrays import BALL, HINGES, MeshArrays, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.geometry import Array


@kernel
def so3_exp_and_jacobian(x, y, z, rotation, jacobian):
    """Compute the rotation (3, 3) of the rotation vector (x, y, z), and its left Jacobian (3, 3)."""
    a, b, c, t2 = _rodrigues(x, y, z)
    _turning(x, y, z, t2, a, b, rotation)
    _turning(x, y, z, t2, b, c, jacobian)


@kernel
def _rodrigues(x, y, z):
    """Return sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3 and t^2 for a rotation vector of length t.

    x, y, z: the rotation vector, rad.
    """
    t2 = x * x + y * y + z * z
    t = math.sqrt(t2)
    if t < 1e-3:  # series: the error of the next term is below 1e-15
        return 1 - t2 / 6 + t2 * t2 / 120, 0.5 - t2 / 24 + t2 * t2 / 720, 1 / 6 - t2 / 120 + t2 * t2 / 5040, t2
    a = math.sin(t) / t
    h = math.sin(0.5 * t) / t
    return a, 2 * h * h, (1 - a) / t2, t2  # (1 - cos t) / t^2 without cancellation


@kernel
def _turning(x, y, z, t2, p, s, m):
    """Compute m (3, 3) = 1 + p V + s V^2, V the matrix of the cross product with (x, y, z), whose
    squared length is t2.
    """
    m[0, 0] = 1 + s * (x * x - t2)
    m[1, 1] = 1 + s * (y * y - t2)
    m[2, 2] = 1 + s * (z * z - t2)
    m[0, 1] = -p * z + s * x * y
    m[1, 0] = p * z + s * x * y
    m[0, 2] = p * y + s * x * z
    m[2, 0] = -p * y + s * x * z
    m[1, 2] = -p * x + s * y * z
    m[2, 1] = p * x + s * y * z


@kernel
def multiply(a, b, out):
    """Compute out = a @ b for (3, 3); out must be another array."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def joint_frames(q, tree, rotations, centres, twists):
    """Compute frames and twists of one pose q (D,), relative to the root's position.

    tree: of the body.
    rotations: (J, 3, 3) gets the rotations.
    centres: (J, 3) gets the centres minus q[0:3].
    twists: (D, 6) gets (w, v): a point x (minus q[0:3]) moves with w x x + v per unit of the dof.
    """
    twists[:] = 0.0
    for i in range(3):
        for k in range(3):
            twists[i, 3 + k] = tree.axes[i, k]
    frames_of(q, tree, np.arange(tree.parents.shape[0]), rotations, centres, twists)


@kernel
def frames_of(q, tree, joints, rotations, centres, twists):
    """Compute frames and twists of some joints, from known frames of all others; see `joint_frames`.

    q: (D,) pose.
    tree: of the body.
    rotations, centres, twists: as in `joint_frames`, in part filled before.
    joints: (K,) indices, parents before their children.
    """
    local = np.empty((3, 3))
    jacobian = np.empty((3, 3))
    turned = np.empty((3, 3))
    frame = np.empty((3, 3))
    for m in range(joints.shape[0]):
        j = joints[m]
        a = tree.parents[j]
        if a < 0:
            for i in range(3):
                centres[j, i] = 0.0
                for k in range(3):
                    frame[i, k] = 1.0 if i == k else 0.0
        else:
            dx = tree.joints[j, 0] - tree.joints[a, 0]
            dy = tree.joints[j, 1] - tree.joints[a, 1]
            dz = tree.joints[j, 2] - tree.joints[a, 2]
            for i in range(3):
                centres[j, i] = (
                    centres[a, i] + rotations[a, i, 0] * dx + rotations[a, i, 1] * dy + rotations[a, i, 2] * dz
                )
                for k in range(3):
                    frame[i, k] = rotations[a, i, k]
        first = tree.dof_start[j]
        if tree.kind[j] == BALL:
            so3_exp_and_jacobian(q[first], q[first + 1], q[first + 2], local, jacobian)
            multiply(frame, jacobian, turned)
            for n in range(3):
                for i in range(3):
                    twists[first + n, i] = turned[i, n]
            multiply(frame, local, rotations[j])
        elif tree.kind[j] == HINGES:
            for n in range(tree.dof_count[j]):
                d = first + n
                ax, ay, az = tree.axes[d, 0], tree.axes[d, 1], tree.axes[d, 2]
                for i in range(3):
                    twists[d, i] = frame[i, 0] * ax + frame[i, 1] * ay + frame[i, 2] * az
                so3_exp_and_jacobian(q[d] * ax, q[d] * ay, q[d] * az, local, jacobian)
                multiply(frame, local, rotations[j])
                for i in range(3):
                    for k in range(3):
                        frame[i, k] = rotations[j, i, k]
        else:
            for i in range(3):
                for k in range(3):
                    rotations[j, i, k] = frame[i, k]
        for n in range(tree.dof_count[j]):
            s = twists[first + n]
            s[3] = centres[j, 1] * s[2] - centres[j, 2] * s[1]
            s[4] = centres[j, 2] * s[0] - centres[j, 0] * s[2]
            s[5] = centres[j, 0] * s[1] - centres[j, 1] * s[0]


@kernel
def _forward_kinematics(poses, tree, rotations, centres):
    """Compute the joint frames of poses (N, D): rotations (N, J, 3, 3), centres (N, J, 3) in the world."""
    twists = np.empty((poses.shape[1], 6))
    for n in range(poses.shape[0]):
        joint_frames(poses[n], tree, rotations[n], centres[n], twists)
        for j in range(centres.shape[1]):
            for i in range(3):
                centres[n, j, i] += poses[n, i]


@kernel
def bone_map(rotation, centre, joint, out):
    """Compute the map out (12,), row by row (3, 4), that carries a vertex of the resting body with a joint.

    rotation, centre: frame of the joint, (3, 3) and (3,).
    joint: (3,) its centre at rest.
    """
    for i in range(3):
        x, y, z = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        out[4 * i] = x
        out[4 * i + 1] = y
        out[4 * i + 2] = z
        out[4 * i + 3] = centre[i] - x * joint[0] - y * joint[1] - z * joint[2]


@kernel
def skin_vertices(maps, mesh, chosen, out):
    """Skin some vertices of one pose by linear blend skinning, in the numbers of the maps.

    maps: (J, 12) f4 or f8 of `bone_map`.
    mesh: of the body.
    chosen: indices of the vertices.
    out: (V, 3) m gets them; other rows stay.
    """
    b = np.empty(12, maps.dtype)
    for n in range(chosen.shape[0]):
        v = chosen[n]
        w = mesh.skin_weight[v, 0]
        m = maps[mesh.skin_index[v, 0]]
        for i in range(12):
            b[i] = w * m[i]
        for k in range(1, mesh.skin_count[v]):
            w = mesh.skin_weight[v, k]
            m = maps[mesh.skin_index[v, k]]
            for i in range(12):
                b[i] += w * m[i]
        x, y, z = mesh.vertices[v, 0], mesh.vertices[v, 1], mesh.vertices[v, 2]
        out[v, 0] = b[0] * x + b[1] * y + b[2] * z + b[3]
        out[v, 1] = b[4] * x + b[5] * y + b[6] * z + b[7]
        out[v, 2] = b[8] * x + b[9] * y + b[10] * z + b[11]


@kernel
def skin_about_root(rotations, centres, tree, mesh, out):
    """Skin one pose in float32 relative to the root's position, where float32 is accurate to 1e-4 mm.

    rotations, centres: (J, 3, 3) and (J, 3) m, joint frames about the root.
    tree, mesh: of the body.
    out: (V, 3) f4 gets the vertices minus the root's position, m.
    """
    n_joints = rotations.shape[0]
    maps = np.empty((n_joints, 12), np.float32)
    for j in range(n_joints):
        bone_map(rotations[j], centres[j], tree.joints[j], maps[j])
    skin_vertices(maps, mesh, np.arange(mesh.vertices.shape[0]), out)


@kernel
def _skin(rotations, centres, tree, mesh, out):
    """Skin N poses in float64; see `skin`."""
    maps, every = np.empty((tree.parents.shape[0], 12)), np.arange(mesh.vertices.shape[0])
    for n in range(rotations.shape[0]):
        for j in range(maps.shape[0]):
            bone_map(rotations[n, j], centres[n, j], tree.joints[j], maps[j])
        skin_vertices(maps, mesh, every, out[n])


@kernel
def camera_about_root(projection, q, out):
    """Convert a projection of points in the world to one of points about the root of a pose.

    projection: (3, 4) f8.
    q: (D,) pose, whose first three numbers are the root's position, m.
    out: (3, 4) f4 gets the projection.
    """
    for r in range(3):
        for c in range(3):
            out[r, c] = projection[r, c]
        out[r, 3] = projection[r, 0] * q[0] + projection[r, 1] * q[1] + projection[r, 2] * q[2] + projection[r, 3]


def forward_kinematics(poses: ArrayLike, tree: TreeArrays) -> tuple[Array, Array]:
    """Compute the rotations world_from_joint (N, J, 3, 3) and joint centres (N, J, 3) m of poses (N, D)."""
    q = plain(poses, np.float64)
    n, j = len(q), len(tree.parents)
    rotations, centres = np.empty((n, j, 3, 3)), np.empty((n, j, 3))
    _forward_kinematics(q, tidy(tree), rotations, centres)
    return rotations, centres


def skin(rotations: ArrayLike, centres: ArrayLike, tree: TreeArrays, mesh: MeshArrays) -> Array:
    """Compute the vertices of N poses by linear blend skinning.

    rotations, centres: (N, J, 3, 3) and (N, J, 3) m, joint frames in the world.
    tree, mesh: of the body.
    Returns: (N, V, 3) m, world.
    """
    r, c = plain(rotations, np.float64), plain(centres, np.float64)
    out = np.empty((len(r), len(mesh.vertices), 3))
    _skin(r, c, tidy(tree), tidy(mesh), out)
    return out

"""Compute joint frames, world twists and skinned vertices.

J: number of joints, D: number of degrees of freedom (dof) of a pose, V: number of vertices. A joint frame is a rotation
world_from_joint and the centre of the joint. Twists are the derivatives of the frames by the pose.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hypose.compute.arrays import BALL, HINGES, MeshArrays, TreeArrays, plain, tidy
from hypose.compute.compiled import kernel
from hypose.geometry import Array


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
    """Compute 1 + p V + s V^2, where V is the matrix of the cross product with a vector.

    x, y, z: the vector.
    t2: its squared length.
    p, s: factors.
    m: (3, 3) gets the result.
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
    """Multiply two matrices: out = a @ b.

    a, b: (3, 3).
    out: (3, 3) gets the product; it must not be a or b.
    """
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def _copy(a, out):
    """Copy a matrix (3, 3); a loop compiles much faster than a slice."""
    for i in range(3):
        for k in range(3):
            out[i, k] = a[i, k]


@kernel
def joint_frames(q, tree, rotations, centres, twists):
    """Compute the joint frames and twists of one pose, with the root's position as the origin.

    q: (D,) pose; q[0:3] is the position of the root in the world, m.
    tree: joint tree of the body.
    rotations: (J, 3, 3) gets the rotations world_from_joint.
    centres: (J, 3) gets the joint centres in the world minus q[0:3], m.
    twists: (D, 6) gets the twist (w, v) of each dof: a point at x (in the world minus q[0:3], m) that moves with the
        dof has the derivative w x x + v by it.
    """
    twists[:] = 0.0
    for i in range(3):
        for k in range(3):
            twists[i, 3 + k] = tree.axes[i, k]
    frames_of(q, tree, np.arange(tree.parents.shape[0]), rotations, centres, twists)


@kernel
def frames_of(q, tree, joints, rotations, centres, twists):
    """Compute the frames and twists of some joints of one pose; the frames of their parents must be known.

    q: (D,) pose.
    tree: joint tree of the body.
    joints: (K,) indices of the joints to compute, parents before their children.
    rotations, centres, twists: (J, 3, 3) world_from_joint, (J, 3) m and (D, 6), as `joint_frames` describes them;
        the rows of these joints and of their dof are filled, other rows stay as they are. twists may be None.
    """
    work = np.empty((4, 3, 3))
    local, jacobian, turned, frame = work[0], work[1], work[2], work[3]
    for m in range(joints.shape[0]):
        j = joints[m]
        up = tree.parents[j]
        if up < 0:
            for i in range(3):
                centres[j, i] = 0.0
                for k in range(3):
                    frame[i, k] = 1.0 if i == k else 0.0
        else:
            _copy(rotations[up], frame)
            dx = tree.joints[j, 0] - tree.joints[up, 0]
            dy = tree.joints[j, 1] - tree.joints[up, 1]
            dz = tree.joints[j, 2] - tree.joints[up, 2]
            for i in range(3):
                centres[j, i] = centres[up, i] + frame[i, 0] * dx + frame[i, 1] * dy + frame[i, 2] * dz
        first = tree.dof_start[j]
        if tree.kind[j] == BALL:
            x, y, z = q[first], q[first + 1], q[first + 2]
            a, b, c, t2 = _rodrigues(x, y, z)
            _turning(x, y, z, t2, a, b, local)
            if twists is not None:
                _turning(x, y, z, t2, b, c, jacobian)
                multiply(frame, jacobian, turned)
                for n in range(3):
                    for i in range(3):
                        twists[first + n, i] = turned[i, n]
            multiply(frame, local, rotations[j])
        elif tree.kind[j] == HINGES:
            for n in range(tree.dof_count[j]):
                d = first + n
                ax, ay, az = tree.axes[d, 0], tree.axes[d, 1], tree.axes[d, 2]
                if twists is not None:
                    for i in range(3):
                        twists[d, i] = frame[i, 0] * ax + frame[i, 1] * ay + frame[i, 2] * az
                x, y, z = q[d] * ax, q[d] * ay, q[d] * az
                a, b, c, t2 = _rodrigues(x, y, z)
                _turning(x, y, z, t2, a, b, local)
                multiply(frame, local, rotations[j])
                _copy(rotations[j], frame)
        else:
            _copy(frame, rotations[j])
        if twists is not None:
            for n in range(tree.dof_count[j]):
                s = twists[first + n]
                s[3] = centres[j, 1] * s[2] - centres[j, 2] * s[1]
                s[4] = centres[j, 2] * s[0] - centres[j, 0] * s[2]
                s[5] = centres[j, 0] * s[1] - centres[j, 1] * s[0]


@kernel
def _forward_kinematics(poses, tree, rotations, centres):
    """Compute the joint frames of N poses; see `forward_kinematics`.

    poses: (N, D) pose vectors, rad and m.
    tree: joint tree of the body.
    rotations, centres: (N, J, 3, 3) and (N, J, 3) get the rotations world_from_joint and the centres in the world, m.
    """
    twists = np.empty((poses.shape[1], 6))
    for n in range(poses.shape[0]):
        joint_frames(poses[n], tree, rotations[n], centres[n], twists)
        for j in range(centres.shape[1]):
            for i in range(3):
                centres[n, j, i] += poses[n, i]


@kernel
def bone_map(rotation, centre, joint, out):
    """Compute the affine map that moves vertices of the resting body rigidly with a joint.

    rotation, centre: frame of the joint in the pose, (3, 3) and (3,) m.
    joint: (3,) centre of the joint at rest, m.
    out: (12,) gets the matrix (3, 4) of the map, row by row.
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

    maps: (J, 12) float32 or float64, map of each joint as `bone_map` computes it.
    mesh: mesh at rest with its skinning weights.
    chosen: (K,) indices of the vertices to skin.
    out: (V, 3) gets the positions of these vertices, m, in the frame of the maps; other rows stay as they are.
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
    """Skin one pose in float32, with the root's position as the origin.

    rotations, centres: (J, 3, 3) and (J, 3) m, joint frames as `joint_frames` computes them.
    tree: joint tree of the body.
    mesh: mesh at rest with its skinning weights.
    out: (V, 3) float32 gets the vertices in the world minus the root's position, m.
    Why about the root: there float32 is accurate to 1e-4 mm, however far the person is from the origin of the world.
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
    """Convert the projection matrix of a camera to one for points relative to the root of a pose.

    projection: (3, 4) float64, pinhole projection of points in the world, m, to pixels.
    q: (D,) pose; q[0:3] is the position of the root in the world, m.
    out: (3, 4) float32 gets the projection of points x - q[0:3].
    """
    for r in range(3):
        for c in range(3):
            out[r, c] = projection[r, c]
        out[r, 3] = projection[r, 0] * q[0] + projection[r, 1] * q[1] + projection[r, 2] * q[2] + projection[r, 3]


def forward_kinematics(poses: ArrayLike, tree: TreeArrays) -> tuple[Array, Array]:
    """Compute the joint frames of N poses (forward kinematics).

    poses: (N, D), rad and m.
    tree: joint tree of the body.
    Returns: rotations world_from_joint (N, J, 3, 3), and joint centres in the world (N, J, 3), m.
    """
    q = plain(poses, np.float64)
    n, j = len(q), len(tree.parents)
    rotations, centres = np.empty((n, j, 3, 3)), np.empty((n, j, 3))
    _forward_kinematics(q, tidy(tree), rotations, centres)
    return rotations, centres


def skin(rotations: ArrayLike, centres: ArrayLike, tree: TreeArrays, mesh: MeshArrays) -> Array:
    """Compute the vertices of N poses by linear blend skinning.

    rotations, centres: joint frames as `forward_kinematics` returns them, (N, J, 3, 3) and (N, J, 3) m.
    tree: joint tree of the body.
    mesh: mesh at rest with its skinning weights.
    Returns: (N, V, 3) vertices in the world, m.
    """
    r, c = plain(rotations, np.float64), plain(centres, np.float64)
    out = np.empty((len(r), len(mesh.vertices), 3))
    _skin(r, c, tidy(tree), tidy(mesh), out)
    return out

"""Skeleton: the joint tree, its degrees of freedom, forward kinematics and the Jacobian.

A pose is a vector q (..., D). q[0:3] is the root's position in the world (m), q[3:6] its rotation vector. Every other
joint is fixed, a ball (rotation vector in its parent's frame: the exponential map, which has no singularity inside +-2
pi), or one or two hinges. At q = 0 the body is in its rest pose, and all joint frames are parallel to the model frame.
Source: Alcoverro 2014, eq. 2.11 (product of exponentials); see `Skeleton.forward`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import BALL, FIXED, HINGES, TreeArrays
from hypose.compute.kinematics import forward_kinematics, joint_frames
from hypose.errors import InputError, refuse
from hypose.geometry import Array, nearest_branch

GRID = 2.0**20
"""Steps per metre and radian to which `Skeleton.clamp` rounds poses (a micrometre, a fifth of an arc second)."""


def check_shapes(owner: object, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError where an array of an object, by the name of its field, has another shape than the given one."""
    for name, shape in shapes.items():
        if (given := np.shape(getattr(owner, name))) != shape:
            raise InputError(f"{type(owner).__name__}.{name} has shape {given}, {shape} is needed.")


@dataclass(frozen=True)
class Skeleton:
    """Joint tree of J joints (parent < child) with D degrees of freedom.

    joint_names: (J).
    parents: (J,) index of the parent, -1 for the root.
    rest_offsets: (J, 3) m, joint centre minus that of its parent at rest (zeros for the root).
    ball: (J,) whether the joint is a ball.
    axes: (D, 3) rotation axis of each dof in the model frame (direction of translation for the first three).
    joint_of_dof: (D,) joint to which each dof belongs.
    dof_names: (D).
    lower, upper: (D,) limits, rad and m.
    sigma: (D,) usual motion per frame at 25 fps (1 sd), rad and m.
    Raises: InputError where shapes do not fit, parents are not ordered, or a lower limit exceeds the upper one.
    """

    joint_names: tuple[str, ...]
    parents: NDArray[np.int64]
    rest_offsets: Array
    ball: NDArray[np.bool_]
    axes: Array
    joint_of_dof: NDArray[np.int64]
    dof_names: tuple[str, ...]
    lower: Array
    upper: Array
    sigma: Array

    def __post_init__(self) -> None:
        j, d = len(self.joint_names), len(self.dof_names)
        of_dofs = {"axes": (d, 3), "joint_of_dof": (d,), "lower": (d,), "upper": (d,), "sigma": (d,)}
        check_shapes(self, {"parents": (j,), "rest_offsets": (j, 3), "ball": (j,), **of_dofs})
        root, others, crossed = self.parents[0], self.parents[1:], self.lower > self.upper
        faults = {
            ".parents must hold -1 for the root and a smaller index for every other joint": (
                root != -1 or (others >= np.arange(1, j)).any() or (others < 0).any()
            ),
            f" limits of {self.dof_names[int(np.argmax(crossed))]}: the lower one exceeds the upper one": crossed.any(),
        }
        refuse("Skeleton", faults)

    @property
    def dof(self) -> int:
        """Number D of degrees of freedom."""
        return len(self.dof_names)

    def joint(self, name: str) -> int:
        """Return the index of a joint by name; raises InputError with the list of names where there is none."""
        try:
            return self.joint_names.index(name)
        except ValueError:
            raise InputError(f"There is no joint {name!r}; the joints are {', '.join(self.joint_names)}.") from None

    def dofs_of(self, *names: str) -> NDArray[np.int64]:
        """Return the indices, ascending, of the degrees of freedom of the named joints (for the root: all six)."""
        joints = np.array([self.joint(n) for n in names], dtype=np.int64)
        return np.flatnonzero((self.joint_of_dof[:, None] == joints).any(1))

    def descendants(self, name: str) -> NDArray[np.int64]:
        """Return the indices, ascending, of the named joint and of all joints below it in the tree."""
        return np.flatnonzero(self.above[self.joint(name)])

    @cached_property
    def above(self) -> NDArray[np.bool_]:
        """(J, J) whether the joint of the row is that of the column or above it in the tree."""
        out = np.eye(len(self.parents), dtype=bool)
        for j, p in enumerate(self.parents[1:], 1):
            out[:, j] |= out[:, p]
        return out

    @cached_property
    def rest_joints(self) -> Array:
        """(J, 3) m, joint centres in the model frame at rest."""
        out = np.zeros_like(self.rest_offsets)
        for j, p in enumerate(self.parents):
            out[j] = self.rest_offsets[j] + (out[p] if p >= 0 else 0)
        return out

    @cached_property
    def tree(self) -> TreeArrays:
        """Joint tree as flat arrays for compiled code."""
        # the root's translations are handled separately
        own = self.joint_of_dof[3:] == np.arange(len(self.joint_names))[:, None]
        count = own.sum(1).astype(np.int64)
        start = np.where(count > 0, 3 + own.argmax(1), 0).astype(np.int64)
        kind = np.where(count > 0, np.where(self.ball, BALL, HINGES), FIXED).astype(np.int64)
        return TreeArrays(
            self.parents.astype(np.int64),
            kind,
            start,
            count,
            np.ascontiguousarray(self.axes, dtype=np.float64),
            np.ascontiguousarray(self.rest_joints - self.rest_joints[0]),
            self.joint_of_dof.astype(np.int64),
        )

    @cached_property
    def ball_starts(self) -> NDArray[np.int64]:
        """(B,) index of the first of the three dof of each ball joint, the root included."""
        return self.tree.dof_start[self.tree.kind == BALL]

    def rest_pose(self) -> Array:
        """Return the pose (D,) of zeros, moved into the limits."""
        return np.clip(np.zeros(self.dof), self.lower, self.upper)

    def forward(self, poses: ArrayLike) -> tuple[Array, Array]:
        """Compute the joint frames and joint centres of poses (forward kinematics).

        poses: (..., D) pose vectors, rad and m.
        Returns: world_from_joint rotations (..., J, 3, 3), and joint centres (..., J, 3) m.
        Raises: InputError where the poses do not have D numbers.
        Source: Alcoverro 2014, eq. 2.11, the product of exponentials along the chain. Deviations: the root's
            translation and rotation are separate, instead of one twist. A ball joint is one exponential of a rotation
            vector, instead of three successive axes, and has no gimbal lock.
        """
        q = np.asarray(poses, dtype=np.float64)
        if q.shape[-1] != self.dof:
            raise InputError(f"A pose of this skeleton has {self.dof} numbers, got shape {q.shape}.")
        r, p = forward_kinematics(np.ascontiguousarray(q.reshape(-1, self.dof)), self.tree)
        j = len(self.joint_names)
        return r.reshape(*q.shape[:-1], j, 3, 3), p.reshape(*q.shape[:-1], j, 3)

    def points(self, joint: NDArray[np.int64], offset: Array, poses: ArrayLike) -> Array:
        """Compute the world positions (..., P, 3), m, of points fixed to joints, for poses (..., D).

        joint: (P,) joint that carries each point.
        offset: (P, 3) position in that joint's frame, m.
        """
        rotations, centres = self.forward(poses)
        return centres[..., joint, :] + np.einsum("...kab,kb->...ka", rotations[..., joint, :, :], offset)

    def world_twists(self, poses: ArrayLike) -> Array:
        """Compute the twist of each dof in the world: the derivative of the body's motion by the dof.

        poses: (..., D) pose vectors, rad and m.
        Returns: (..., D, 6) twists (w, v): a point at x (world, m) that moves with the dof has the derivative
            w x x + v. For ball joints these are the derivatives by the components of the rotation vector, not
            rotations about fixed axes.
        """
        q, n = np.array(poses, dtype=np.float64), len(self.joint_names)
        out, rotations, centres = np.empty((*q.shape, 6)), np.empty((n, 3, 3)), np.empty((n, 3))
        for pose, twists in zip(q.reshape(-1, self.dof), out.reshape(-1, self.dof, 6), strict=True):
            joint_frames(pose, self.tree, rotations, centres, twists)
        out[..., 3:] -= np.cross(out[..., :3], q[..., None, :3])  # from turns about the root to turns about the origin
        return out

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """(D, J) whether a dof moves the frame of a joint."""
        return self.above[self.joint_of_dof]

    def jacobian(self, pose: ArrayLike, joint: int, points_world: ArrayLike) -> Array:
        """Compute the derivatives (N, 3, D) of points on the body by the pose.

        pose: (D,) pose vector, rad and m.
        joint: index of the joint to which the points are rigidly attached.
        points_world: (N, 3) m.
        """
        p = np.asarray(points_world, dtype=np.float64)
        s = self.world_twists(pose)
        rows = np.cross(s[None, :, :3], p[:, None]) + s[None, :, 3:]
        rows[:, ~self.moves[:, joint]] = 0
        return np.swapaxes(rows, 1, 2)

    def joint_jacobians(self, pose: ArrayLike) -> Array:
        """Compute the derivatives (J, 3, D) of the joint centres by a pose (D,).

        The columns 3 to 5 are derivatives by a small rotation of the root about the axes of the world, not by the
        components of its rotation vector.
        """
        q, n = np.array(pose, dtype=np.float64), len(self.joint_names)
        rotations, centres, twists = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((self.dof, 6))
        joint_frames(q, self.tree, rotations, centres, twists)
        twists[3:6] = np.eye(3, 6)
        turn, shift, at = twists.T[:3], twists.T[3:], centres[..., None]
        out = np.empty((n, 3, self.dof))
        for i in range(3):  # much faster than np.cross
            b, c = (i + 1) % 3, (i + 2) % 3
            out[:, i] = turn[b] * at[:, c] - turn[c] * at[:, b] + shift[i]
        return np.where(self.moves.T[:, None], out, 0.0)

    def joint_covariances(self, pose: ArrayLike, covariance: ArrayLike) -> Array:
        """Compute the covariances (J, 3, 3) m^2 of the joint centres from that of the pose, to first order.

        pose: (D,) pose vector, rad and m.
        covariance: (D, D) covariance of the pose; rows 3 to 5 are a small rotation of the root about the axes of the
            world.
        """
        jacobian = self.joint_jacobians(pose)
        # einsum, not @: threaded BLAS costs more than matrices of this size
        half = np.einsum("jad,de->jae", jacobian, np.asarray(covariance, dtype=np.float64))
        return np.einsum("jae,jbe->jab", half, jacobian)

    def informed_joint_covariances(self, pose: ArrayLike, information: Array, ridge: float = 1e-9) -> Array:
        """Compute the covariances (J, 3, 3) m^2 of the joint centres from the information on a pose, to first order.

        pose: (D,) pose vector, rad and m.
        information: (D, D) inverse covariance of the pose; rows 3 to 5 are a small rotation of the root about the axes
            of the world.
        ridge: share of the information's diagonal, counted as 1 at least, that is added to it. Why: it makes the
            matrix positive definite where a dof is not determined.
        """
        jacobian = self.joint_jacobians(pose)
        known = information + np.diag(ridge * np.maximum(information.diagonal(), 1.0))
        spread = np.linalg.solve(known, jacobian.reshape(-1, self.dof).T).T.reshape(jacobian.shape)
        return np.einsum("jad,jbd->jab", jacobian, spread)

    def step_sigma(self, frame_rate: float) -> Array:
        """Return the usual motion per frame (D,) at a frame rate (Hz): `sigma`, which is for 25 Hz, times the ratio of
        the durations of a frame, limited to 0.4 to 2.
        """
        return self.sigma * float(np.clip(25.0 / frame_rate, 0.4, 2.0))

    def clamp(self, poses: ArrayLike) -> Array:
        """Move poses (..., D) into the joint limits, and round them to multiples of 2^-20 m and rad.

        Why: numerical libraries differ between processors in the last digits. Without the grid this difference would
        grow from frame to frame, until another pose of an arm is found.
        """
        on_grid = np.rint(np.asarray(poses, dtype=np.float64) * GRID) / GRID
        return np.minimum(np.maximum(on_grid, self.lower), self.upper)  # np.clip takes twice as long for one pose

    def on_branch(self, poses: ArrayLike, reference: ArrayLike) -> Array:
        """Replace the root's rotation vector in poses by the equal rotation nearest to that of a reference pose.

        poses: (..., D) pose vectors, rad and m.
        reference: (D,), or (..., D) for each pose.
        Returns: (..., D); the root's vectors differ from the old ones by whole turns. Other joints stay, because only
            the root turns by more than half a turn.
        """
        q, ref = np.array(poses, dtype=np.float64), np.asarray(reference, dtype=np.float64)
        q[..., 3:6] = nearest_branch(q[..., 3:6], ref[..., 3:6])
        return q

    def unwound(self, pose: ArrayLike, reference: ArrayLike | None = None) -> Array:
        """Replace the rotation vectors of all balls but the root by the equal rotations nearest to a reference pose.

        pose: (D,) pose vector, rad and m.
        reference: (D,); None: all zeros.
        Returns: (D,); a ball stays as it is where the nearest vector is outside the joint limits.
        """
        q = np.array(pose, dtype=np.float64)
        ref = np.zeros(self.dof) if reference is None else np.asarray(reference, dtype=np.float64)
        for s in self.ball_starts[1:]:
            own = slice(s, s + 3)
            other = nearest_branch(q[own], ref[own])
            if (other >= self.lower[own]).all() and (other <= self.upper[own]).all():
                q[own] = other
        return q

    def canonical(self, pose: ArrayLike) -> Array:
        """Replace the root's rotation vector of a pose (D,) by the equal rotation of length <= pi."""
        return self.on_branch(pose, np.zeros(self.dof))

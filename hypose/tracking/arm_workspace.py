"""Tabulate the poses of an arm over its whole reach, once per body; each pose is a few points on the arm's axis.

A local solve and diffusion cannot find a lost arm again. The table can: thousands of arms per frame are compared with
the masks as points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.compute import reach
from hypose.compute.arrays import Standing
from hypose.geometry import Array
from hypose.tracking.frame_evidence import PreparedFrame

_POSES = 4096
"""poses per arm; twice as many find nothing more"""
_ALONG = ((0.4, 0.7, 1.0), (0.33, 0.67, 1.0), (0.5, 0.9))
"""positions of the points on the axes of upper arm, forearm and hand; none near the shoulder, where other parts
overlap"""
_PART = np.repeat(np.arange(len(_ALONG)), [len(at) for at in _ALONG])
_SHARE = np.concatenate(_ALONG)[:, None]
_WIDTH = (0.09, 0.07, 0.06)
"""m, width of upper arm, forearm and hand; a point stands for its share of the part's area"""
_ENDS = [2, 5, 7]
"""indices of the points at elbow, wrist, and near the tip of the hand"""


@dataclass(frozen=True)
class ArmReach:
    """Table of an arm's poses over its whole reach.

    body: the body of the arm.
    own: (d,) the arm's coordinates.
    parent: joint that carries the arm (the chest); chain: indices of shoulder, elbow and wrist.
    tip: (3,) tip of the hand in the wrist's frame, m.
    moving: (J,) true for the arm's joints.
    poses: (N, d) values of the coordinates.
    points: (N, 8, 3) points of the arm in these poses, in the parent's frame, m.
    area: (8,) area that each point stands for, m^2.
    """

    body: Body
    own: NDArray[np.int64]
    parent: int
    chain: tuple[int, int, int]
    tip: Array
    moving: NDArray[np.bool_]
    poses: Array
    points: Array
    area: Array

    @cached_property
    def ends(self) -> Array:
        """Positions (N, 3, 3) of elbow, wrist and hand in all poses of the table, in the parent's frame, m."""
        return np.ascontiguousarray(ends(self.points))

    def here(self, poses: Array) -> Array:
        """Compute the arm's points (N, 8, 3), m, in the poses (N, D) of a body, in the parent's frame."""
        return _points(self.body, poses[:, self.own], self.own, self.parent, self.chain, self.tip)

    def score(self, points: Array, pose: Array, frame: PreparedFrame, rest: Standing, cutoff: float) -> Array:
        """Compute how badly arms at given points fit the masks of a frame, in m^2, summed over the views.

        It is the area of the arm outside the masks minus the mask area that only this arm explains.
        points: (N, 8, 3) in the parent's frame, m; pose: (D,) pose of the rest of the body; rest: what does not move,
            drawn before.
        cutoff: points are no longer counted once the score is above it.
        Returns: (N,) scores, exact up to the cutoff; larger ones are only known to be above it.
        """
        rotation, centre = self.body.skeleton.forward(pose)
        place = rotation[self.parent], centre[self.parent]
        return reach.score_points(points, self.area, *place, frame.silhouettes.masks, rest, cutoff)


def in_practice(skeleton: Skeleton) -> tuple[Array, Array]:
    """Return the range of joint angles that people use: 60 % of the limits of ball joints, 0 for the root.

    Returns: lower and upper end of the range, (D,) each.

    Why: poses in the corners of a ball's limits are unnatural.
    """
    lower, upper = skeleton.lower.copy(), skeleton.upper.copy()
    lower[:6] = upper[:6] = 0
    for start in skeleton.ball_starts[1:]:
        lower[start : start + 3] *= 0.6
        upper[start : start + 3] *= 0.6
    return lower, upper


def ends(points: Array) -> Array:
    """Select elbow, wrist and hand (N, 3, 3) from an arm's points (N, 8, 3)."""
    return points[:, _ENDS]


def arm_ends(arms: Sequence[ArmReach], poses: Array) -> Array:
    """Compute elbow, wrist and hand (N, A, 3, 3), m, of the arms of one body in poses (N, D), in the frames of the
    arms' parents.
    """
    if not arms:
        return np.zeros((len(poses), 0, 3, 3))
    rotations, centres = arms[0].body.skeleton.forward(poses)
    parents = [arm.parent for arm in arms]
    wrists = [arm.chain[2] for arm in arms]
    at = centres[:, [arm.chain[1:] + arm.chain[2:] for arm in arms]]  # elbow, wrist, hand (from the wrist)
    at[:, :, 2] += _ALONG[2][1] * np.einsum("naij,aj->nai", rotations[:, wrists], np.stack([a.tip for a in arms]))
    return np.einsum("naji,nakj->naki", rotations[:, parents], at - centres[:, parents, None])


def arm_reach(body: Body, joints: tuple[str, ...], lower: Array, upper: Array, count: int = _POSES) -> ArmReach:
    """Build the table of an arm's poses over its whole reach.

    lower, upper: (D,) range of the pose, between which the arm's coordinates are spread evenly.

    joints: names of the arm's joints: clavicle, shoulder, elbow of one side.
    count: number of poses.
    """
    s, side = body.skeleton, joints[0].split("_")[0]
    own = s.dofs_of(*joints)
    a, b, c = (s.joint(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist"))
    parent = int(s.parents[min(s.joint(name) for name in joints)])
    mark = body.landmarks.index(f"{side}_hand_tip")
    tip = body.landmarks.offset[mark]
    poses = lower[own] + (upper - lower)[own] * _evenly_spread(count, len(own))
    bones = s.rest_joints[[b, c]] - s.rest_joints[[a, b]]
    lengths = [*np.linalg.norm(bones, axis=1), np.linalg.norm(tip)]
    area = [width * length / len(at) for width, length, at in zip(_WIDTH, lengths, _ALONG, strict=True) for _ in at]
    moving = np.isin(np.arange(len(s.joint_names)), [s.joint(name) for name in joints])
    points = _points(body, poses, own, parent, (a, b, c), tip)
    return ArmReach(body, own, parent, (a, b, c), tip, moving, poses, points, np.array(area))


@lru_cache(4)
def _evenly_spread(count: int, dimension: int) -> Array:
    """Compute the Halton sequence (N, d) in [0, 1): n in the base of the k-th prime, with its digits mirrored at the
    point.

    count: N; dimension: d.
    Source: Halton 1960.
    """
    out = np.zeros((count, dimension))
    primes = [p for p in range(2, 100) if all(p % q for q in range(2, p))][:dimension]
    for k, base in enumerate(primes):
        n, share = np.arange(1, count + 1), 1.0
        while n.any():
            share /= base
            out[:, k] += share * (n % base)
            n = n // base
    return out


def _points(
    body: Body, values: Array, own: NDArray[np.int64], parent: int, chain: tuple[int, int, int], tip: Array
) -> Array:
    """Compute the arm's points (N, 8, 3), m, in the parent's frame, for values (N, d) of its coordinates.

    own: (d,) indices of the coordinates; chain: shoulder, elbow, wrist; tip: (3,) of the hand in the wrist's frame, m.
    """
    poses = np.zeros((len(values), body.skeleton.dof))
    poses[:, own] = values
    # nothing else is turned, so the parent's frame is that of the world
    rotations, centres = body.skeleton.forward(poses)
    at = centres[:, [*chain, chain[2]]]
    at[:, 3] += np.einsum("nij,j->ni", rotations[:, chain[2]], tip)
    begin = at[:, _PART]
    return np.ascontiguousarray(begin + _SHARE * (at[:, _PART + 1] - begin) - centres[:, None, parent])

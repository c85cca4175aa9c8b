"""Tabulate the poses of an arm over its whole reach, once per body; each pose is a few points on the arm's axis.

A local solve and diffusion cannot find a lost arm again. The table can: thousands of arms per frame are compared with
the masks as points.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

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


class ArmReach:
    """Table of an arm's poses over its whole reach.

    body: the body of the arm.
    joints: names of the arm's joints: clavicle, shoulder, elbow of one side.
    lower, upper: (D,) range of the pose, between which the arm's coordinates are spread evenly.
    count: number N of poses.
    Attributes: body, and
    own: (d,) the arm's coordinates.
    parent: joint that carries the arm (the chest); chain: indices of shoulder, elbow and wrist.
    tip: (3,) tip of the hand in the wrist's frame, m.
    moving: (J,) true for the arm's joints.
    poses: (N, d) values of the coordinates.
    points: (N, 8, 3) points of the arm in these poses, in the parent's frame, m; ends: (N, 3, 3) elbow, wrist and hand.
    area: (8,) area that each point stands for, m^2.
    """

    def __init__(self, body: Body, joints: tuple[str, ...], lower: Array, upper: Array, count: int = _POSES) -> None:
        s, side = body.skeleton, joints[0].split("_")[0]
        index = [s.joint(name) for name in joints]
        self.body, self.own, self.parent = body, s.dofs_of(*joints), int(s.parents[min(index)])
        self.chain = a, b, c = tuple(s.joint(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist"))
        self.tip: Array = body.landmarks.offset[body.landmarks.index(f"{side}_hand_tip")]
        self.moving = np.isin(np.arange(len(s.joint_names)), index)
        spread = _evenly_spread(count, len(self.own))
        self.poses: Array = lower[self.own] + (upper - lower)[self.own] * spread
        bones = s.rest_joints[[b, c]] - s.rest_joints[[a, b]]
        lengths = [*np.linalg.norm(bones, axis=1), np.linalg.norm(self.tip)]
        area = [width * length / len(at) for width, length, at in zip(_WIDTH, lengths, _ALONG, strict=True) for _ in at]
        self.area, self.points = np.array(area), self._points(self.poses)
        self.ends = np.ascontiguousarray(ends(self.points))

    def _points(self, values: Array) -> Array:
        """Compute the arm's points (N, 8, 3), m, in the parent's frame, for values (N, d) of its coordinates."""
        poses = np.zeros((len(values), self.body.skeleton.dof))
        poses[:, self.own] = values
        # nothing else is turned, so the parent's frame is that of the world
        rotations, centres = self.body.skeleton.forward(poses)
        at = centres[:, [*self.chain, self.chain[2]]]
        at[:, 3] += np.einsum("nij,j->ni", rotations[:, self.chain[2]], self.tip)
        begin = at[:, _PART]
        found = begin + _SHARE * (at[:, _PART + 1] - begin) - centres[:, None, self.parent]
        return np.ascontiguousarray(found)

    def here(self, poses: Array) -> Array:
        """Compute the arm's points (N, 8, 3), m, in the poses (N, D) of a body, in the parent's frame."""
        return self._points(poses[:, self.own])

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
    rotations, centres = arms[0].body.skeleton.forward(poses)
    parents = [arm.parent for arm in arms]
    wrists = [arm.chain[2] for arm in arms]
    at = centres[:, [arm.chain[1:] + arm.chain[2:] for arm in arms]]  # elbow, wrist, hand (from the wrist)
    at[:, :, 2] += _ALONG[2][1] * np.einsum("naij,aj->nai", rotations[:, wrists], np.stack([a.tip for a in arms]))
    return np.einsum("naji,nakj->naki", rotations[:, parents], at - centres[:, parents, None])


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

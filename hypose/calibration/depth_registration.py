"""Where depth cameras stand to each other, from the person who moves before them: no board, no common sight.

Each sensor tracks the person alone; the two motions tell the clocks and, rigidly brought together, the rough place.
Then the poses of the common body and the places of the sensors are solved for together, with the measured points of all
sensors as rows: what one sensor sees of the front and another one of the back meets in the body.
Source: rough places as for skeletons (Asteriadis et al. 2013, section 2.1, over a clip); the joint solve is bundle
adjustment (Triggs et al. 2000) with an articulated body in place of points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.compute import SharedEquations, weighted_squares
from hypose.errors import CalibrationError
from hypose.evidence.depth_evidence import SurfacePoints
from hypose.fitting import DepthTerm
from hypose.fitting.depth_surface import BODY_SD, SCALE_M
from hypose.fitting.least_squares import Rule, descend
from hypose.fusion.clocks import offset_by_movement
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_exp, transform
from hypose.tracking.depth_shape_rows import depth_shape_rows
from hypose.tracking.refinement import anatomical_prior

SURE, AGREE_M = 0.5, 0.25
"""Correlation of the two movements, and how far apart (m) the two motions may lie, for a registration to be believed"""
_WEIGHT = 1.0
_ON_FLOOR = np.array([False, False, True, True, True, False])
"""of turns and steps along x, y and z"""
_POSE_SD = 0.5
"""rad: how far a pose may turn from where it was tracked"""


@dataclass(frozen=True)
class CoarseAlignment:
    """a_from_b (4, 4); seconds to add to b's times; apart m: median distance of the
    joints then."""

    a_from_b: Array
    seconds: float
    apart: float


def rough_registration(times_a: Array, joints_a: Array, times_b: Array, joints_b: Array) -> CoarseAlignment:
    """From the same person's joints as two sensors alone see them: times (T,) s of each sensor's own clock, joints
    (T, J, 3) m in each sensor's own world, in which the floor is z = 0: the motion searched turns about the vertical
    and moves along the floor. A CalibrationError when the movements do not belong together."""
    seconds, correlation = offset_by_movement(times_a, joints_a, times_b, joints_b)
    tb = np.asarray(times_b) + seconds
    inside = np.flatnonzero((times_a >= tb[0]) & (times_a <= tb[-1]))
    if correlation < SURE or len(inside) < 10:
        raise CalibrationError(
            f"The movements that two depth cameras saw do not belong together (correlation {correlation:.2f}); record "
            "somebody who walks about and turns before all of them, for at least ten seconds."
        )
    flat = joints_b.reshape(len(tb), -1)
    at = np.stack([np.interp(times_a[inside], tb, column) for column in flat.T], 1).reshape(len(inside), -1, 3)
    a, b = joints_a[inside].reshape(-1, 3), at.reshape(-1, 3)
    weight = np.ones(len(a))
    motion = np.eye(4)
    away = weight
    for _ in range(8):  # lost limbs count less
        motion = _level(b, a, weight)
        away = np.linalg.norm(transform(motion, b) - a, axis=1)
        weight = 1 / (1 + (away / 0.05) ** 2)
    apart = float(np.median(away))
    if apart > AGREE_M:
        raise CalibrationError(
            f"What two depth cameras saw does not fit together ({1000 * apart:.0f} mm apart); one of them took the "
            "front for the back: record somebody who walks about and turns before all of them."
        )
    return CoarseAlignment(motion, seconds, apart)


def _level(source: Array, target: Array, weight: Array) -> Array:
    """(4, 4): the turn about the vertical and the step along the floor that take points (N, 3) to others best."""
    flat = [np.concatenate([p[:, :2], np.zeros((len(p), 1))], 1) for p in (source, target)]
    return procrustes(flat[0], flat[1], weight)[0]


@dataclass(frozen=True)
class DepthRegistration:
    """camera_from_world (C, 4, 4); poses (F, D) of the body."""

    camera_from_world: Array
    poses: Array


def refine_registration(
    body: Body,
    poses: Array,
    seen: Sequence[Sequence[SurfacePoints]],
    camera_from_world: Array,
    iterations: int = 12,
) -> DepthRegistration:
    """Places of sensors and poses (F, D) together. seen: per sensor, per frame, what it measured, in the CAMERA's own
    frame; camera_from_world (C, 4, 4): where to begin; the first is held, the others turn about the vertical and move
    along the floor, for each knows the floor better than a body can tell. Poses are eliminated frame by frame."""
    problem = _Problem(body, np.asarray(poses, dtype=np.float64), seen)
    start = np.array(camera_from_world, dtype=np.float64), np.array(poses, dtype=np.float64)
    found = descend(start, problem.evaluate, problem.propose, iterations, Rule(slack=1.002, moved=1e-4))
    cameras, solved = found.state
    return DepthRegistration(cameras, solved)


class _Problem:
    def __init__(self, body: Body, anchor: Array, seen: Sequence[Sequence[SurfacePoints]]) -> None:
        self.body, self.anchor, self.seen = body, anchor, seen
        joints = len(body.skeleton.joint_names)
        self.moves = body.coarse.dense_weights(joints) @ body.skeleton.moves.T.astype(np.float64)
        # rows of a frame err together: as in the pose solver the anatomy counts with that weight
        self.pose_weight = anatomical_prior(body.skeleton).weight
        self.anchor_weight = np.full(body.skeleton.dof, _POSE_SD**-2)
        self.anchor_weight[:6] = 0

    def evaluate(self, state: tuple[Array, Array]) -> tuple[float, Callable[[], SharedEquations]]:
        cameras, q = state
        (f, d), c = q.shape, len(cameras)
        k = 6 * max(c - 1, 0)
        hessian, gradient = 1e-6 * np.eye(max(k, 1)), np.zeros(max(k, 1))
        own, own_gradient, cross = np.empty((f, d, d)), np.empty((f, d)), np.zeros((f, d, max(k, 1)))
        off = q - self.anchor
        cost = 0.5 * float((self.pose_weight * q**2).sum() + (self.anchor_weight * off**2).sum())
        vertices = self.body.skin(q)
        for t in range(f):
            twists = self.body.skeleton.world_twists(q[t])
            own[t] = np.diag(self.pose_weight + self.anchor_weight)
            own_gradient[t] = self.pose_weight * q[t] + self.anchor_weight * off[t]
            # a sensor that turns and moves a little in the world moves its points; the residual is seen the other way
            x = vertices[t]
            zero = np.zeros(len(x))
            turns = [[zero, x[:, 2], -x[:, 1]], [-x[:, 2], zero, x[:, 0]], [x[:, 1], -x[:, 0], zero]]
            fields = np.stack([*(np.stack(r, 1) for r in turns), *(np.tile(-e, (len(x), 1)) for e in np.eye(3))], 1)
            for s in range(c):
                term = _term(self.seen[s][t], cameras[s])
                if term is None:
                    continue
                r = depth_shape_rows(self.body.coarse, x, fields, twists, self.moves, term, 1.0, _WEIGHT)
                cost += r.cost
                h, g = weighted_squares(*r[:3])
                own[t] += h[:d, :d]
                own_gradient[t] += g[:d]
                if s > 0:
                    at = slice(6 * (s - 1), 6 * s)
                    hessian[at, at] += h[d:, d:]
                    gradient[at] += g[d:]
                    cross[t, :, at] = h[:d, d:]
        return cost, lambda: SharedEquations(hessian, gradient, own, own_gradient, cross)

    def propose(
        self, state: tuple[Array, Array], equations: SharedEquations, damping: float
    ) -> tuple[tuple[Array, Array], float] | None:
        reduced = equations.reduced(damping)
        step = reduced.step(np.tile(_ON_FLOOR, len(state[0]) - 1))
        if step is None:
            return None
        step = step * min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-9))
        dq = reduced.own_steps(step)
        dq *= np.minimum(1, 0.3 / np.maximum(np.abs(dq[:, 3:]).max(1, keepdims=True), 1e-9))
        cameras, q = state
        moved = cameras.copy()
        for s in range(1, len(cameras)):
            xi = step[6 * (s - 1) : 6 * s]
            world_moves = se3(so3_exp(xi[:3]), xi[3:])
            moved[s] = cameras[s] @ se3_inverse(world_moves)
        return (moved, self.body.skeleton.clamp(q + dq)), float(np.abs(step).max())


def _term(seen: SurfacePoints, camera_from_world: Array) -> DepthTerm | None:
    if not len(seen.points):
        return None
    world_from_camera = se3_inverse(camera_from_world)
    weight = BODY_SD**2 / (BODY_SD**2 + seen.sd**2)
    return DepthTerm(
        transform(world_from_camera, seen.points),
        seen.normals @ world_from_camera[:3, :3].T,
        0.1 * weight,
        np.array([0, len(seen.points)]),
        world_from_camera[None, :3, 3],
        np.zeros((1, 1, 1), np.float32),
        np.ones((1, 2), np.int64),
        np.zeros((1, 3, 4)),
        SCALE_M,
    )


def in_camera(surface: SurfacePoints, camera_from_world: Array) -> SurfacePoints:
    """The points of a surface of the world in a camera's frame."""
    points = transform(camera_from_world, surface.points)
    return replace(surface, points=points, normals=surface.normals @ camera_from_world[:3, :3].T)


def place_error(found: Array, true: Array, at: Array) -> tuple[float, float]:
    """(degrees, m): how far a sensor found at camera_from_world (4, 4) in the first one's world turns and stands off
    its true place; m: of a point (3,) where the person is, which is what matters for bringing measurements together."""
    difference = found @ se3_inverse(true)
    angle = np.degrees(np.arccos(np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1)))
    moved = transform(se3_inverse(found), transform(true, at[None])) - at
    return float(angle), float(np.linalg.norm(moved))

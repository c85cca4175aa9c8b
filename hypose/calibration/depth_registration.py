"""Where depth cameras stand to each other, from the person who moves before them: no board, no common sight.

Each sensor tracks the person alone; the two motions tell the clocks and, rigidly brought together, the rough place.
Then the poses of the common body and the places of the sensors are solved for together, with the measured points of all
sensors as rows: what one sensor sees of the front and another one of the back meets in the body.
Source: rough places as for skeletons (Asteriadis et al. 2013, section 2.1, over a clip); the joint solve is bundle
adjustment (Triggs et al. 2000) with an articulated body in place of points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.errors import CalibrationError
from hypose.evidence.depth_evidence import SurfacePoints
from hypose.evidence.depth_surface import BODY_SD, SCALE_M, DepthTerm
from hypose.fitting.problem import Cue, Posed, PoseProblem, Quadratic, Rows, Rule
from hypose.fitting.rows import rows_of_depth
from hypose.fusion.clocks import offset_by_movement
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_exp, transform
from hypose.tracking.refinement import anatomical_prior

SURE, AGREE_M = 0.5, 0.25
"""Correlation of the two movements, and how far apart (m) the two motions may lie, for a registration to be believed"""
_ON_FLOOR = [2, 3, 4]
"""of turns and steps along x, y and z: about the vertical, and along the floor"""
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
    weight = np.full(body.skeleton.dof, _POSE_SD**-2)
    weight[:6] = 0
    # rows of a frame err together: as in the pose solver the anatomy counts with that weight
    usual = Quadratic(np.zeros(body.skeleton.dof), anatomical_prior(body.skeleton).weight)
    anchor = Quadratic(np.array(poses, dtype=np.float64), weight)
    frames = [[_cue(sensor[f], s) for s, sensor in enumerate(seen)] for f in range(len(poses))]
    start = np.array(camera_from_world, dtype=np.float64), anchor.centre
    problem = _SensorProblem(body, frames, [usual, anchor], len(camera_from_world))
    return DepthRegistration(*problem.solve(start, iterations, Rule(slack=1.002, moved=1e-4)).state)


def _cue(seen: SurfacePoints, sensor: int) -> Cue[Array]:
    """What one sensor measured in one frame, wherever the sensor stands."""

    def rows(at: Posed, cameras: Array, factor: float) -> Iterable[Rows]:
        parts = rows_of_depth(at, _term(seen, cameras[sensor]), factor) if len(seen.points) else ()
        return (part._replace(view=part.view + sensor) for part in parts)

    return rows


class _SensorProblem(PoseProblem[Array]):
    """The sensors' places, camera_from_world (C, 4, 4), are what the frames share: of each a turn about the vertical
    and a step along the floor."""

    largest = 0.1

    def __init__(
        self, body: Body, frames: Sequence[Sequence[Cue[Array]]], priors: Sequence[Quadratic], sensors: int
    ) -> None:
        super().__init__(body, frames, priors)
        self.free = np.repeat(np.arange(sensors) > 0, len(_ON_FLOOR))

    def shared_cost(self, shared: Array, body: Body) -> float:
        return 0.0

    def shared_moved(self, shared: Array, step: Array) -> Array:
        xi = np.zeros((len(shared), 6))
        xi[:, _ON_FLOOR] = step.reshape(len(shared), -1)
        return shared @ se3_inverse(se3(so3_exp(xi[:, :3]), xi[:, 3:]))

    def shared_rows(
        self, shared: Array, posed: Sequence[Posed], rows: Sequence[Rows]
    ) -> tuple[Array, Array, Sequence[Array]]:
        by_frame = []
        for r in rows:
            # a sensor that turns and moves in the world moves its points: the residual sees it the other way
            by_all = np.zeros((len(r.view), len(shared), len(_ON_FLOOR)))
            wrench = np.concatenate([np.cross(r.point, r.slope), r.slope], 1)
            by_all[np.arange(len(r.view)), r.view] = -wrench[:, _ON_FLOOR]
            by_frame.append(by_all.reshape(len(r.view), -1))
        count = len(self.free)
        return 1e-6 * np.eye(count), np.zeros(count), by_frame


def _term(seen: SurfacePoints, camera_from_world: Array) -> DepthTerm:
    """Its points in the world, seen by a sensor that stands there."""
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

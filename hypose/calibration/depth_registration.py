"""Registration of depth cameras from a person who moves in front of them, without a board or a common field of view.

Each sensor tracks the person alone. The two motions give the offset of the clocks and a rough rigid registration. Then
the poses of the common body and the registration of the sensors are solved together, with the measured points of all
sensors as rows, so that front and back of the person, seen by different sensors, are joined by the body model.
Source: rough registration as for skeletons (Asteriadis et al. 2013, section 2.1, over a clip); the joint solve is
    bundle adjustment (Triggs et al. 2000) with an articulated body in place of points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.errors import CalibrationError
from hypose.evidence.depth_evidence import SurfacePoints
from hypose.evidence.terms import BODY_SD, DepthTerm
from hypose.fitting.problem import Cue, Posed, PoseProblem, Quadratic, Rows, Rule
from hypose.fitting.rows import rows_of_depth
from hypose.fusion.align import offset_by_movement
from hypose.fusion.register import robust_motion
from hypose.geometry import Array, se3, se3_inverse, so3_exp, transform
from hypose.tracking.refinement import anatomical_prior

SURE, AGREE_M = 0.5, 0.25
"""Least correlation of the two movements, and largest distance (m) of the two motions, for a registration to be
accepted."""
_ON_FLOOR = [2, 3, 4]
"""Free components of a twist (rotations and translations along x, y, z): about the vertical, and along the floor."""
_POSE_SD = 0.5
"""Standard deviation of the change of a pose from the tracked pose, rad."""


@dataclass(frozen=True)
class CoarseAlignment:
    """A rough registration of two sensors, a and b.

    a_from_b: (4, 4) rigid motion, m.
    seconds: seconds to add to the times of b, so that both clocks agree.
    apart: median distance of the joints after the alignment, m.
    """

    a_from_b: Array
    seconds: float
    apart: float


def rough_registration(times_a: Array, joints_a: Array, times_b: Array, joints_b: Array) -> CoarseAlignment:
    """Estimate clock offset and rigid motion between two sensors from the joints of the same person.

    The motion rotates about the vertical and moves along the floor.

    times_a, times_b: (T,) s of each sensor's own clock.
    joints_a, joints_b: (T, J, 3) in each sensor's own world with the floor at z = 0, m.
    Raises: CalibrationError where the movements do not agree.
    """
    seconds, correlation = offset_by_movement(times_a, joints_a, times_b, joints_b)
    tb = np.asarray(times_b) + seconds
    inside = np.flatnonzero((times_a >= tb[0]) & (times_a <= tb[-1]))
    if correlation < SURE or len(inside) < 10:
        raise CalibrationError(
            f"The movements that two depth cameras saw do not belong together (correlation {correlation:.2f}); record "
            "a person who walks about and turns in front of all of them, for at least ten seconds."
        )
    flat = joints_b.reshape(len(tb), -1)
    at = np.stack([np.interp(times_a[inside], tb, column) for column in flat.T], 1).reshape(len(inside), -1, 3)
    a, b = joints_a[inside].reshape(-1, 3), at.reshape(-1, 3)
    flat_a, flat_b = (np.column_stack([p[:, :2], np.zeros(len(p))]) for p in (a, b))
    motion, _ = robust_motion(flat_b, flat_a, np.ones(len(a)), 8)
    apart = float(np.median(np.linalg.norm(transform(motion, b) - a, axis=1)))
    if apart > AGREE_M:
        raise CalibrationError(
            f"What two depth cameras saw does not fit together ({1000 * apart:.0f} mm apart); one of them took the "
            "front for the back: record a person who walks about and turns in front of all of them."
        )
    return CoarseAlignment(motion, seconds, apart)


def refine_registration(
    body: Body,
    poses: Array,
    seen: Sequence[Sequence[SurfacePoints]],
    camera_from_world: Array,
    iterations: int = 12,
) -> Array:
    """Refine the poses of depth sensors and the poses of the body together. The first sensor is fixed.

    poses: (F, D) start poses of the body.
    seen: per sensor and frame, the measured points in the CAMERA's frame.
    camera_from_world: (C, 4, 4) at the start.
    iterations: largest number of iterations.
    Returns: (C, 4, 4) camera_from_world.
    Why: sensors only rotate about the vertical and move along the floor, because each measures the floor better than a
        body can. Poses are eliminated frame by frame.
    """
    weight = np.full(body.skeleton.dof, _POSE_SD**-2)
    weight[:6] = 0
    # the errors of a frame's rows are correlated, so the anatomical prior has the same weight as in the pose solver
    usual = Quadratic(np.zeros(body.skeleton.dof), anatomical_prior(body.skeleton).weight)
    anchor = Quadratic(np.array(poses, dtype=np.float64), weight)
    frames = [[_cue(sensor[f], s) for s, sensor in enumerate(seen)] for f in range(len(poses))]
    start = np.array(camera_from_world, dtype=np.float64), anchor.centre
    problem = _SensorProblem(body, frames, [usual, anchor], len(camera_from_world))
    return problem.solve(start, iterations, Rule(slack=1.002, moved=1e-4)).state[0]


def _cue(seen: SurfacePoints, sensor: int) -> Cue[Array]:
    """Make the function that gives the rows of one sensor's points in one frame, for any pose of the sensor."""

    def rows(at: Posed, cameras: Array, factor: float) -> Iterable[Rows]:
        parts = rows_of_depth(at, _term(seen, cameras[sensor]), factor) if len(seen.points) else ()
        return (part._replace(view=part.view + sensor) for part in parts)

    return rows


class _SensorProblem(PoseProblem[Array]):
    """Least-squares problem of `refine_registration`; shared by all frames is camera_from_world (C, 4, 4).

    Each sensor has three unknowns: rotation about the vertical, and translation along the floor.
    """

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
            # a moving sensor moves its points in the world, so the derivative has the opposite sign
            by_all = np.zeros((len(r.view), len(shared), len(_ON_FLOOR)))
            by_all[np.arange(len(r.view)), r.view] = -np.c_[np.cross(r.point, r.slope), r.slope][:, _ON_FLOOR]
            by_frame.append(by_all.reshape(len(r.view), -1))
        count = len(self.free)
        return 1e-6 * np.eye(count), np.zeros(count), by_frame


def _term(seen: SurfacePoints, camera_from_world: Array) -> DepthTerm:
    """Transform the points of a sensor with the given pose to the world, as a depth term."""
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
    )


def in_camera(surface: SurfacePoints, camera_from_world: Array) -> SurfacePoints:
    """Transform the points of a surface from the world to a camera's frame."""
    points = transform(camera_from_world, surface.points)
    return replace(surface, points=points, normals=surface.normals @ camera_from_world[:3, :3].T)


def place_error(found: Array, true: Array, at: Array) -> tuple[float, float]:
    """Compute the error of a sensor's registration against the truth.

    found, true: (4, 4) camera_from_world in the first sensor's world.
    at: (3,) a point at the person, m.
    Returns: rotation error in degrees, and displacement of the point in m, which is what matters when measurements are
        combined.
    """
    difference = found @ se3_inverse(true)
    angle = np.degrees(np.arccos(np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1)))
    return float(angle), float(np.linalg.norm(transform(se3_inverse(found), transform(true, at[None])) - at))

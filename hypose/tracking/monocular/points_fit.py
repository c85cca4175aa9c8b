"""Fit poses and proportions together to the points of one or several pictures (stage 1 of the start).

One picture cannot tell a short limb from one that points at the camera; in further pictures the limb has another
direction.
Source: Sminchisescu & Triggs 2001, section 5 (points, prior intervals, joint limits, mirrored sides). Deviation: more
    than one picture can be used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.compute.losses import lorentzian
from hypose.compute.mono_terms import FloorArrays
from hypose.compute.solver import bounded_step
from hypose.fitting.problem import Problem, Rule
from hypose.geometry import Array
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.proportions import INTERNAL, Proportions, shaped, skeleton_only
from hypose.tracking.refinement import anatomical_prior

PointsOn = Callable[[Body], MonoPoints]
"""Function that places the points of one picture on a body, with their pixels; for example points.clicked_joints or
points.points_from_keypoints with the other arguments given."""
_STEP = 0.01
"""step of a factor's logarithm for its numeric derivative"""


def points_on_body(body: Body, pose: Array, points: MonoPoints | FloorArrays) -> Array:
    """Compute the world positions (P, 3), m, of points on joints of the body at a pose (D,)."""
    rotations, centres = body.skeleton.forward(pose)
    return centres[points.joint] + np.einsum("pab,pb->pa", rotations[points.joint], points.offset)


def fit_proportions(
    template: Body,
    camera: Camera,
    pictures: Sequence[PointsOn],
    poses: Sequence[Array],
    factors: Array,
    prior: Proportions,
    active: NDArray[np.int64],
    floor: FloorArrays | None = None,
) -> tuple[Array, Array, float]:
    """Fit one body to all M pictures: poses and proportions together, by a bounded Newton search.

    template: body that is deformed.
    camera: of the pictures.
    prior: of the proportions.
    pictures: M functions that place the points of a picture on a body.
    poses: M start poses (D,).
    factors: (K,) start values of the proportions, logarithms; only those that move joints change.
    active: (A,) dof of every pose that may change.
    floor: the soles and the floor they stand on. Why: without it one view cannot tell long legs that point away from
        shorter ones that do not.
    Returns: poses (M, D), factors (K,), cost.
    """
    start = np.array(poses, dtype=np.float64), np.array(factors, dtype=np.float64)
    problem = _PointsProblem(template, camera, pictures, start, prior, active, floor)
    found = problem.solve(problem.begin, 30, Rule(1e-3, easier=9, least=1e-9, gain=1e-5))
    return *problem.unpack(found.state), found.cost


class _PointsProblem(Problem[Array, tuple[Array, Array]]):
    """Least-squares problem over the active dof of every picture's pose and the joint-moving factors, one vector (M
    A + I,)."""

    def __init__(
        self,
        template: Body,
        camera: Camera,
        pictures: Sequence[PointsOn],
        start: tuple[Array, Array],
        prior: Proportions,
        active: NDArray[np.int64],
        floor: FloorArrays | None,
    ) -> None:
        self.bare, self.camera, self.pictures, self.start = skeleton_only(template), camera, pictures, start
        self.active, self.floor = active, floor
        s, pull, m = template.skeleton, anatomical_prior(template.skeleton), len(pictures)
        self.centre = np.concatenate([np.tile(pull.centre[active], m), prior.centre[INTERNAL]])
        self.stiffness = np.concatenate([np.tile(pull.weight[active], m), prior.sd[INTERNAL] ** -2])
        self.lower = np.concatenate([np.tile(s.lower[active], m), prior.lower[INTERNAL]])
        self.upper = np.concatenate([np.tile(s.upper[active], m), prior.upper[INTERNAL]])
        first = np.concatenate([start[0][:, active].ravel(), start[1][INTERNAL]])
        self.begin = np.clip(first, self.lower, self.upper)

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Split the vector into poses (M, D) and factors (K,)."""
        (q, f), known = (a.copy() for a in self.start), len(self.pictures) * len(self.active)
        q[:, self.active], f[INTERNAL] = x[:known].reshape(len(q), -1), x[known:]
        return q, f

    def evaluate(self, state: Array) -> tuple[float, Callable[[], tuple[Array, Array]]]:
        """Compute the cost of a vector (M A + I,), and its gradient and Hessian; see `Problem`."""
        (q, f), x, active, floor = self.unpack(state), state, self.active, self.floor
        body, camera, (m, a) = shaped(self.bare, f), self.camera, (len(self.pictures), len(self.active))
        moved = [shaped(self.bare, f + _STEP * (np.arange(len(f)) == i)) for i in INTERNAL]
        value, gradient, hessian = 0.0, np.zeros(len(x)), np.zeros((len(x), len(x)))
        for k, points_on in enumerate(self.pictures):
            points = points_on(body)
            r = _residuals(body, camera, points, q[k])
            by_pose = image_jacobian(body, camera, points, q[k])[:, :, active] / points.scale_px[:, None, None]
            by_factor = [(_residuals(b, camera, points_on(b), q[k]) - r) / _STEP for b in moved]
            rows = np.concatenate([by_pose, np.stack(by_factor, axis=-1)], axis=2)
            length, confidence = np.linalg.norm(r, axis=1), points.confidence
            if floor is not None:
                above, of_floor = _above_floor(body, moved, q[k], floor, active)
                length = np.append(length, np.abs(above))
                confidence = np.append(confidence, np.full(len(above), floor.weight))
                r = np.concatenate([r, np.column_stack([above, np.zeros(len(above))])])
                rows = np.concatenate([rows, np.stack([of_floor, np.zeros_like(of_floor)], axis=1)])
            rho, weight, _ = lorentzian(0.25 * length**2, confidence)  # a tail from 2 sd on, as for key points
            at = np.concatenate([np.arange(k * a, (k + 1) * a), np.arange(m * a, len(x))])
            value += 2 * float((confidence * rho).sum())
            gradient[at] += np.einsum("p,pxd,px->d", weight, rows, r)
            hessian[np.ix_(at, at)] += np.einsum("p,pxd,pxe->de", weight, rows, rows)
        pull = self.stiffness * (x - self.centre)
        value += 0.5 * float(pull @ (x - self.centre))
        return value, lambda: (gradient + pull, hessian + np.diag(self.stiffness))

    def propose(self, state: Array, equations: tuple[Array, Array], damping: float) -> tuple[Array, float] | None:
        """Propose the next vector within the bounds, and its largest change; see `Problem`."""
        step = bounded_step(equations[1], equations[0], state, self.lower, self.upper, damping)
        return None if step is None else (np.clip(state + step, self.lower, self.upper), float(np.abs(step).max()))


def _residuals(body: Body, camera: Camera, points: MonoPoints, pose: Array) -> Array:
    """Compute the residuals (P, 2) of the points, in standard deviations; 0 for points that are not seen.

    body, camera: the body, and the camera of the picture.
    points, pose: placed on the body, and its pose (D,).
    """
    shown = camera.project_pinhole(points_on_body(body, pose, points))
    apart = (shown - points.pixels) / points.scale_px[:, None]
    return np.where(points.confidence[:, None] > 0, apart, 0.0)


def image_jacobian(body: Body, camera: Camera, points: MonoPoints, pose: Array) -> Array:
    """Compute the derivative (P, 2, D) of the points' pixels with respect to the pose (D,), px per unit.

    body, camera: the body, and the camera of the picture.
    """
    world, by_pose = points_on_body(body, pose, points), _jacobian(body, pose, points)
    p = camera.projection
    h = world @ p[:, :3].T + p[:, 3]
    shown = h[:, :2] / h[:, 2:]
    by_point = (p[None, :2, :3] - shown[..., None] * p[None, None, 2, :3]) / h[:, 2, None, None]
    return np.einsum("pxa,pad->pxd", by_point, by_pose)


def _above_floor(
    body: Body, moved: Sequence[Body], pose: Array, floor: FloorArrays, active: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Compute heights of the soles above the floor, in standard deviations, and their derivatives.

    body, pose: the body and its pose (D,).
    floor: soles and floor.
    active: (A,) dof that may change.

    Only the lowest sole point and those under the floor count (F).
    moved: one body per factor that moves joints, changed by one step.
    Returns: heights (F,); derivatives (F, A + I) with respect to the active dof and these factors.
    """
    height = points_on_body(body, pose, floor)[:, 2] - floor.height
    on = np.flatnonzero((height < 0) | (np.arange(len(height)) == height.argmin()))
    low = floor._replace(joint=floor.joint[on], offset=floor.offset[on])
    by_pose = _jacobian(body, pose, low)[:, 2, active]
    by_factor = [(points_on_body(b, pose, low)[:, 2] - floor.height - height[on]) / _STEP for b in moved]
    return height[on] / floor.scale, np.concatenate([by_pose, np.stack(by_factor, axis=1)], axis=1) / floor.scale


def _jacobian(body: Body, pose: Array, points: MonoPoints | FloorArrays) -> Array:
    """Compute the derivative (P, 3, D) by the pose (D,) of the world positions of points on joints of the body."""
    twists = body.skeleton.world_twists(pose)
    world = points_on_body(body, pose, points)
    out = np.cross(twists[None, :, :3], world[:, None]) + twists[None, :, 3:]
    out[~body.skeleton.moves.T[points.joint]] = 0.0
    return np.swapaxes(out, 1, 2)

"""Find the first hypotheses from one picture with clicked joints or a detector's key points.

Three stages: (1) pose and skeleton lengths from the points, with equal left and right sides, prior intervals and hard
joint limits; several headings are tried, mirrored limbs are optimised before they are ranked, alternatives are kept;
(2) volumes of the parts from contours, everything else fixed; (3) everything. The alternatives with the covariances of
stage 3 are the first hypotheses. Source: Sminchisescu & Triggs 2001, section 5; deviations: see `initialise`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.anthropometry import body_of
from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame
from hypose.evidence.terms import KeypointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.fitting.problem import Quadratic
from hypose.geometry import Array, so3_exp, so3_log
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.resampling import distinct
from hypose.tracking.monocular.flips import mirrored
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.points import PointsOn, fit_proportions, held_dofs, seen_points
from hypose.tracking.monocular.problem import checked_picture, floor_of
from hypose.tracking.monocular.proportions import INTERNAL, VOLUMETRIC, proportions, search_factors
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.start_search import known_pose

LEAST_CLICKS = 6
_YAWS = np.arange(8) * np.pi / 4
"""rad, headings that are tried"""
DISTINCT_M = 0.06
"""m: poses are different alternatives when at least one joint lies further apart than this."""
FLIP_ROUNDS = 2
JOINT_FITS = 3
"""Number of the best alternatives that get proportions of their own before one body is chosen."""


@dataclass(frozen=True)
class InitialFit:
    """First hypotheses of a person in one picture, and the body fitted with them.

    body: the template with the person's proportions.
    hypotheses: alternative poses, best first, with covariances and the column `cost`.
    factors: (K,) logarithms of the proportions, in the order of SHAPE_FACTORS.
    residual_px: root mean square distance of the best pose to the points, px.
    """

    body: Body
    hypotheses: Hypotheses
    factors: Array
    residual_px: float


def initialise(
    template: Body,
    points_on: PointsOn,
    frame: Frame,
    *,
    later: Sequence[PointsOn] = (),
    settings: MonoSettings | None = None,
    height: float | None = None,
    fixed_body: bool = False,
    active: NDArray[np.int64] | None = None,
    rivals: int = 8,
    floor: float | None = None,
) -> InitialFit:
    """Estimate the first hypotheses and the body proportions from the points and the picture of one frame.

    points_on: function of a body that returns the term of the points seen in the picture, placed on this body.
    frame: the frame with the picture.
    later: such functions for further pictures of the same camera; the lengths are fitted to all pictures.
    height: body height, m; None: unknown, then the distance to the camera stays as uncertain as people's heights
        are.
    fixed_body: the template is the person's own body; only poses are estimated.
    active: (A,) dof to estimate (default: the 30 of `body_dofs`).
    rivals: largest number of hypotheses.
    floor: height in the world of the floor that the person stands on, m; None: unknown.
    Raises: EvidenceError where fewer than 6 points are seen.
    Deviation: several headings and mirrored limbs are tried; the paper has one start. In stages 2 and 3 the proportions
        are searched one after the other, because the contour's cost has jumps.
    """
    camera = checked_picture(frame).camera
    chosen = body_dofs(template.skeleton) if active is None else np.asarray(active, dtype=np.int64)
    count = seen_points(points_on(template))
    if count < LEAST_CLICKS:
        raise EvidenceError(
            f"Frame {frame.index}: only {count} points of the body are seen; at least {LEAST_CLICKS} are needed to "
            "start: click more joints or start at another frame."
        )
    prior = proportions(template, height)
    factors = np.zeros(len(prior.centre)) if fixed_body else prior.centre.copy()
    body = template if fixed_body else body_of(template, factors)
    poses = rival_poses(body, camera, points_on(body), chosen, rivals)
    settings = settings or MonoSettings()
    if not fixed_body:
        ground = floor_of(body, floor, settings)
        pictures = [points_on, *later]
        others = [_later_pose(body, camera, seen_later(body), poses[0], chosen) for seen_later in later]
        fits = [
            fit_proportions(template, pictures, [q, *others], factors, prior, chosen, ground)
            for q in poses[: 1 if later else JOINT_FITS]
        ]
        factors = min(fits, key=lambda f: f[2])[1]
        body = body_of(template, factors)
        poses = _distinct(*_solved(body, points_on(body), poses, chosen), body, rivals)
    search = PictureSearch(body, settings, chosen, floor=floor)
    found = search.optimise(poses, frame, points_on(body))
    if not fixed_body:
        # lengths fitted to many pictures are not changed by the contours of one
        last = VOLUMETRIC if later else np.r_[INTERNAL, VOLUMETRIC]
        for which, rounds in ((VOLUMETRIC, 2), (last, 1)):
            cost = _contour_cost(template, search, points_on, frame, found.values[0])
            factors = search_factors(cost, factors, which, prior, rounds)
            body = body_of(template, factors)
            search = replace(search, body=body)
            found = search.optimise(found.values, frame, points_on(body))
    found, points = found.take(distinct(body.joints(found.values), rivals, DISTINCT_M)), points_on(body)
    seen = points.points[0, :, 2] > 0
    world = body.skeleton.points(points.joint, points.offset, found.values[0])[seen]
    square = ((camera.project_pinhole(world) - points.points[0, seen, :2]) ** 2).sum(1)
    return InitialFit(body, found, factors, float(np.sqrt(square.mean())))


def rival_poses(body: Body, camera: Camera, points: KeypointTerm, active: NDArray[np.int64], count: int) -> Array:
    """Find distinct poses that explain the points, from several headings and with mirrored limbs.

    body, camera: the body, and the camera of the picture.
    points: seen in the picture.
    active: (A,) dof that may change.

    All poses are optimised before they are compared.
    count: largest number of poses.
    Returns: (M, D) poses, M <= count, best first.
    """
    starts = np.stack([_placed(body, camera, points, yaw, name) for yaw in _YAWS for name in ("standing", "a")])
    poses, costs = _solved(body, points, starts, active)
    poses = _distinct(poses, costs, body, count)
    for _ in range(FLIP_ROUNDS):
        flipped = [mirrored(body, camera, q, active) for q in poses[: max(2, count // 4)]]
        together = np.concatenate([poses, *flipped])
        poses = _distinct(*_solved(body, points, together, active), body, count)
    return poses


def _later_pose(body: Body, camera: Camera, points: KeypointTerm, near: Array, active: NDArray[np.int64]) -> Array:
    """Find the best pose (D,) on the points of another picture, from the pose `near` (D,) and from several headings.

    body, camera, points: the body, and the camera and points of the picture.
    active: (A,) dof that may change.

    Which mirror image it is does not matter, since only the lengths are used.
    """
    starts = [near, *(_placed(body, camera, points, yaw, "standing") for yaw in _YAWS)]
    poses, costs = _solved(body, points, np.stack(starts), active)
    return poses[int(costs.argmin())]


def _placed(body: Body, camera: Camera, points: KeypointTerm, yaw: float, name: str) -> Array:
    """Build a start pose (D,): a known posture with a heading, placed where its points lie nearest to the seen ones.

    body, camera, points: the body, and the camera and points of the picture.
    The placing uses a scaled orthographic camera: the depth comes from the size of the figure.
    yaw: heading, rad.
    name: name of the posture ("standing" or "a").
    """
    pose = known_pose(body, name)
    pose[3:6] = so3_log(so3_exp([0, 0, yaw]) @ so3_exp(pose[3:6]))
    pixels, seen = points.points[0, :, :2], points.points[0, :, 2] > 0
    world = body.skeleton.points(points.joint, points.offset, pose)[seen]
    rotation = camera.camera_from_world[:3, :3]
    flat = (world - world.mean(0)) @ rotation.T
    rays = np.column_stack([pixels[seen], np.ones(int(seen.sum()))]) @ np.linalg.inv(camera.K).T
    middle = rays.mean(0)
    spread = rays[:, :2] - middle[:2]
    share = float((spread * flat[:, :2]).sum() / max((flat[:, :2] ** 2).sum(), 1e-9))
    # a different posture makes the figure seem far away; its extent bounds the distance
    extent = float(np.linalg.norm(np.ptp(spread, axis=0)) / max(np.linalg.norm(np.ptp(flat[:, :2], axis=0)), 1e-9))
    depth = 1 / max(share, 0.7 * extent, 1e-3)
    centre = (middle * depth - camera.camera_from_world[:3, 3]) @ rotation
    pose[:3] += centre - world.mean(0)
    return pose


def _solved(body: Body, points: KeypointTerm, starts: Array, active: NDArray[np.int64]) -> tuple[Array, Array]:
    """Fit poses to 2D points, from several starts.

    body, points: the body, and the points of the picture.
    starts: (M, D) start poses.
    active: coordinates of the pose that may change; the others are held at their start.
    Returns: poses (M, D), costs (M,).
    """
    held, options = held_dofs(body.skeleton.dof, active), SolveSettings(iterations=60, coarse_iterations=20)
    fits = []
    for start in starts:
        priors = (anatomical_prior(body.skeleton), Quadratic(start, held))
        fits.append(fit_pose(body, start, [points], priors=priors, options=options))
    return np.stack([f.pose for f in fits]), np.array([f.cost for f in fits])


def _distinct(poses: Array, costs: Array, body: Body, count: int) -> Array:
    """Select the best poses (M, D), by costs (M,), that differ from all better ones; at most count."""
    order = np.argsort(costs, kind="stable")
    return poses[order][distinct(body.joints(poses[order]), count, DISTINCT_M)]


def _contour_cost(
    template: Body, search: PictureSearch, points_on: PointsOn, frame: Frame, pose: Array
) -> Callable[[Array], float]:
    """Build the function that gives the cost of factors (K,) at a fixed pose, on the picture's contours and the
    points.

    template: body whose proportions are unknown.
    search: settings of the cost.
    points_on: places the picture's points on a body.
    frame: with the picture.
    pose: (D,) pose vector, rad and m.
    """
    template.coarse.arrays  # noqa: B018 - builds the edges once, before the copies
    light = replace(template, fine=template.coarse)  # contours need the coarse mesh only

    def cost(x: Array) -> float:
        body = body_of(light, x)
        found = replace(search, body=body).optimise(pose[None], frame, points_on(body), iterations=0)
        return float(found.columns["cost"][0])

    return cost

"""The first set of hypotheses from one picture: clicked joints or a detector's key points.

Three stages. (1) Pose and internal proportions from the points, with mirrored sides, prior intervals and hard joint
limits; several headings are tried, mirrored limbs are optimised before they are ranked, rivals are kept. (2) The
parts' volumes from contours, everything else held. (3) Everything. The rivals with the covariances of the last stage
are the first hypotheses. Source: Sminchisescu & Triggs 2001, section 5. Deviations: headings and mirrored limbs are
tried, where the paper has one start; in stages 2 and 3 the proportions are searched one after the other, because the
contour's cost has jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError
from hypose.fitting.articulated import KeypointTerm, Quadratic, SolveOptions, fit_pose
from hypose.geometry import Array, so3_exp, so3_log
from hypose.inference.newton import minimise
from hypose.inference.robust import Lorentzian
from hypose.monocular.flips import mirrored
from hypose.monocular.models import body_dofs
from hypose.monocular.proportions import (
    INTERNAL,
    VOLUMETRIC,
    Proportions,
    proportions,
    search_factors,
    shaped,
    skeleton_only,
    without_display,
)
from hypose.monocular.settings import MonoSettings
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import MonoFrame, MonoHypotheses, MonoPoints
from hypose.tracking.initialise import known_pose
from hypose.tracking.refinement import anatomical_prior

LEAST_POINTS = 6
HEADINGS = 8
DISTINCT_M = 0.06
"""Poses are rivals when a joint lies at least so far apart."""
FLIP_ROUNDS = 2
JOINT_FITS = 3
"""So many of the best rivals get proportions of their own before one body is chosen."""
_HELD = 1e6

PointsOn = Callable[[Body], MonoPoints]
"""Where the points sit on a body, with their pixels: types.clicked_joints or types.points_from_keypoints."""


@dataclass(frozen=True)
class InitialFit:
    """body: the template with the person's proportions; hypotheses: the rivals with covariances, best first; factors
    (K,): logarithms of the proportions (proportions.NAMES); residual_px: root mean square distance of the best rival to
    the points, px; tried: how many distinct poses were compared."""

    body: Body
    hypotheses: MonoHypotheses
    factors: Array
    residual_px: float
    tried: int


def initialise(
    template: Body,
    camera: Camera,
    points_on: PointsOn,
    frame: MonoFrame,
    *,
    settings: MonoSettings | None = None,
    height: float | None = None,
    fixed_body: bool = False,
    active: NDArray[np.int64] | None = None,
    rivals: int = 8,
) -> InitialFit:
    """The first hypotheses of a picture (frame; its points are not used) of a pinhole camera.

    height in m: of the person, None if not known: then the distance to the camera stays as uncertain as people's
    heights. fixed_body: the template is the person's own body; only poses are looked for. active: dof to estimate (by
    default the body's 30). An EvidenceError when fewer than 6 points are seen.
    """
    chosen = body_dofs(template.skeleton) if active is None else np.asarray(active, dtype=np.int64)
    seen = int((points_on(template).confidence > 0).sum())
    if seen < LEAST_POINTS:
        raise EvidenceError(
            f"Frame {frame.index}: only {seen} points of the body are seen; at least {LEAST_POINTS} are needed to "
            "start: click more joints or start at another frame."
        )
    prior = proportions(template, height)
    factors = np.zeros(len(prior.centre)) if fixed_body else prior.centre.copy()
    body = template if fixed_body else shaped(template, factors)
    poses = rival_poses(body, camera, points_on(body), chosen, rivals)
    tried = len(poses)
    if not fixed_body:
        fits = [_with_proportions(template, camera, points_on, q, factors, prior, chosen) for q in poses[:JOINT_FITS]]
        factors = min(fits, key=lambda f: f[2])[1]
        body = shaped(template, factors)
        poses = _distinct(*_solved(body, camera, points_on(body), poses, chosen), body, rivals)
    still = replace(frame, points=points_on(body))
    tracker = MonoTracker(body, camera, settings or MonoSettings(), chosen)
    found = tracker.optimise(MonoHypotheses.at(poses), still)
    if not fixed_body:
        for which, rounds in ((VOLUMETRIC, 2), (np.arange(len(factors)), 1)):
            cost = _contour_cost(template, tracker, points_on, still, found.poses[0])
            factors = search_factors(cost, factors, which, prior, rounds)
            body = shaped(template, factors)
            still = replace(frame, points=points_on(body))
            tracker = replace(tracker, body=body)
            found = tracker.optimise(found, still)
    keep = _distinct_indices(body.joints(found.poses), rivals)
    return InitialFit(body, _subset(found, keep), factors, _residual(body, camera, still, found.poses[0]), tried)


def rival_poses(body: Body, camera: Camera, points: MonoPoints, active: NDArray[np.int64], count: int) -> Array:
    """Distinct poses (M, D), M <= count, that explain points, best first: from several headings, and with mirrored
    limbs; all are optimised before they are compared."""
    starts = np.stack([_placed(body, camera, points, yaw, name) for yaw in _yaws() for name in ("standing", "a")])
    poses, costs = _solved(body, camera, points, starts, active)
    poses = _distinct(poses, costs, body, count)
    for _ in range(FLIP_ROUNDS):
        flipped = [mirrored(body, camera, q, active) for q in poses[: max(2, count // 4)]]
        together = np.concatenate([poses, *flipped])
        poses = _distinct(*_solved(body, camera, points, together, active), body, count)
    return poses


def _yaws() -> Array:
    return np.arange(HEADINGS) * 2 * np.pi / HEADINGS


def _placed(body: Body, camera: Camera, points: MonoPoints, yaw: float, name: str) -> Array:
    """(D,) a known pose with a heading, placed where its points lie nearest to the seen ones under a scaled
    orthographic camera: its depth comes from the size of the figure."""
    pose = known_pose(body, name)
    pose[3:6] = so3_log(so3_exp([0, 0, yaw]) @ so3_exp(pose[3:6]))
    seen = points.confidence > 0
    world = _on_body(body, pose, points)[seen]
    rotation = camera.camera_from_world[:3, :3]
    flat = (world - world.mean(0)) @ rotation.T
    rays = np.column_stack([points.pixels[seen], np.ones(int(seen.sum()))]) @ np.linalg.inv(camera.K).T
    middle = rays.mean(0)
    spread = rays[:, :2] - middle[:2]
    share = float((spread * flat[:, :2]).sum() / max((flat[:, :2] ** 2).sum(), 1e-9))
    # an unlike posture makes the figure look far away; its extent bounds the distance
    extent = float(np.linalg.norm(np.ptp(spread, axis=0)) / max(np.linalg.norm(np.ptp(flat[:, :2], axis=0)), 1e-9))
    depth = 1 / max(share, 0.7 * extent, 1e-3)
    centre = (middle * depth - camera.camera_from_world[:3, 3]) @ rotation
    pose[:3] += centre - world.mean(0)
    return pose


def _on_body(body: Body, pose: Array, points: MonoPoints) -> Array:
    """(P, 3) m: the points on the body at a pose (D,), world."""
    rotations, centres = body.skeleton.forward(pose)
    return centres[points.joint] + np.einsum("pab,pb->pa", rotations[points.joint], points.offset)


def _solved(
    body: Body, camera: Camera, points: MonoPoints, starts: Array, active: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Poses (M, D) solved on the points from starts (M, D), and their costs (M,)."""
    scale = float(np.median(points.scale_px))
    confidence = points.confidence * (scale / points.scale_px) ** 2
    term = KeypointTerm(
        np.column_stack([points.pixels, confidence])[None],
        camera.projection[None],
        np.asarray(points.joint, dtype=np.int64),
        points.offset,
        scale,
        min_confidence=1e-6,
    )
    held = np.full(body.skeleton.dof, _HELD)
    held[active] = 0.0
    options = SolveOptions(iterations=60, coarse_iterations=20)
    fits = []
    for start in starts:
        priors = (anatomical_prior(body.skeleton), Quadratic(start, held))
        fits.append(fit_pose(body, start, keypoints=term, priors=priors, options=options))
    return np.stack([f.pose for f in fits]), np.array([f.cost for f in fits])


def _distinct(poses: Array, costs: Array, body: Body, count: int) -> Array:
    order = np.argsort(costs, kind="stable")
    return poses[order][_distinct_indices(body.joints(poses[order]), count)]


def _distinct_indices(joints: Array, count: int) -> list[int]:
    """Of sets of joint centres (M, J, 3) m, best first, those that differ from all better ones; at most count."""
    keep: list[int] = []
    for i in range(len(joints)):
        if all(np.linalg.norm(joints[i] - joints[k], axis=1).max() > DISTINCT_M for k in keep):
            keep.append(i)
        if len(keep) == count:
            break
    return keep


def _subset(h: MonoHypotheses, keep: list[int]) -> MonoHypotheses:
    weights = h.weights[keep] / h.weights[keep].sum()
    return MonoHypotheses(
        h.poses[keep],
        h.velocities[keep],
        h.covariances[keep],
        weights,
        h.costs[keep],
        h.evidence[keep] - h.evidence[keep].min(),
        h.labels[keep],
    )


def _with_proportions(
    template: Body,
    camera: Camera,
    points_on: PointsOn,
    pose: Array,
    factors: Array,
    prior: Proportions,
    active: NDArray[np.int64],
) -> tuple[Array, Array, float]:
    """Stage 1: pose (D,), factors (K,) and cost, both found together from the points (bounded Newton)."""
    bare = skeleton_only(template)
    loss, pull = Lorentzian(2.0), anatomical_prior(template.skeleton)
    a = len(active)

    def unpack(x: Array) -> tuple[Array, Array]:
        q, f = pose.copy(), factors.copy()
        q[active], f[INTERNAL] = x[:a], x[a:]
        return q, f

    def residuals(q: Array, f: Array) -> tuple[Array, Body, MonoPoints]:
        body = shaped(bare, f)
        points = points_on(body)
        shown = camera.project_pinhole(_on_body(body, q, points))
        return (shown - points.pixels) / points.scale_px[:, None], body, points

    def cost(x: Array) -> tuple[float, Array, Array]:
        q, f = unpack(x)
        r, body, points = residuals(q, f)
        rows = np.zeros((len(r), 2, len(x)))
        rows[:, :, :a] = _image_jacobian(body, camera, points, q)[:, :, active] / points.scale_px[:, None, None]
        for k, i in enumerate(INTERNAL):
            moved = f.copy()
            moved[i] += 0.01
            rows[:, :, a + k] = (residuals(q, moved)[0] - r) / 0.01
        length = np.linalg.norm(r, axis=1)
        weight = points.confidence * loss.weight(length)
        value = float((points.confidence * loss.rho(length)).sum())
        gradient = np.einsum("p,pxd,px->d", weight, rows, r)
        hessian = np.einsum("p,pxd,pxe->de", weight, rows, rows)
        centre = np.concatenate([pull.centre[active], prior.centre[INTERNAL]])
        stiffness = np.concatenate([pull.weight[active], prior.sd[INTERNAL] ** -2])
        away = x - centre
        value += 0.5 * float(stiffness @ away**2)
        return value, gradient + stiffness * away, hessian + np.diag(stiffness)

    s = template.skeleton
    found = minimise(
        cost,
        np.concatenate([pose[active], factors[INTERNAL]]),
        np.concatenate([s.lower[active], prior.lower[INTERNAL]]),
        np.concatenate([s.upper[active], prior.upper[INTERNAL]]),
        max_iterations=30,
        cost_tolerance=1e-5,
    )
    return *unpack(found.x), found.cost


def _image_jacobian(body: Body, camera: Camera, points: MonoPoints, pose: Array) -> Array:
    """(P, 2, D) px: derivative of the points' pixels by the pose."""
    world = _on_body(body, pose, points)
    twists = body.skeleton.world_twists(pose)
    by_pose = np.cross(twists[None, :, :3], world[:, None]) + twists[None, :, 3:]
    by_pose[~body.skeleton.moves.T[points.joint]] = 0.0
    p = camera.projection
    h = world @ p[:, :3].T + p[:, 3]
    shown = h[:, :2] / h[:, 2:]
    by_point = (p[None, :2, :3] - shown[..., None] * p[None, None, 2, :3]) / h[:, 2, None, None]
    return np.einsum("pxa,pda->pxd", by_point, by_pose)


def _contour_cost(
    template: Body, tracker: MonoTracker, points_on: PointsOn, frame: MonoFrame, pose: Array
) -> Callable[[Array], float]:
    """What factors (K,) cost on the picture's contours and the points, at a pose."""
    light = without_display(template)
    at = MonoHypotheses.at(pose)

    def cost(x: Array) -> float:
        body = shaped(light, x)
        still = replace(frame, points=points_on(body))
        return float(replace(tracker, body=body).optimise(at, still, iterations=0).costs[0])

    return cost


def _residual(body: Body, camera: Camera, frame: MonoFrame, pose: Array) -> float:
    points = frame.points
    assert points is not None
    seen = points.confidence > 0
    apart = camera.project_pinhole(_on_body(body, pose, points)[seen]) - points.pixels[seen]
    return float(np.sqrt((apart**2).sum(1).mean()))

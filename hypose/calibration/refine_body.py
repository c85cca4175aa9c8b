"""Cameras and poses from the person's silhouettes and key points: the tracked body is the calibration object.

Unknowns are one pose per frame and six numbers per camera (seven with the focal length). Rows are those of the shape
and pose solvers: two-way contour distances with a Geman-McClure weight, key points with a Cauchy weight. A row depends
on the pose of its frame and on its own camera, so poses are eliminated frame by frame (Schur complement) and a step
solves one small system for all cameras. The body is fixed, and with it the scale.
Sources: Geman & McClure 1985; contour rows as in Gall et al. 2009; no published method refines extrinsics from
silhouettes of an articulated body in this way, the nearest is Sinha & Pollefeys 2010 (frontier points).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks
from hypose.calibration.refine_points import CameraUnknowns, apply_parameters, by_camera, pinhole_derivative
from hypose.cameras.camera import Camera, CameraRig
from hypose.compute import SharedEquations, geman_mcclure, lorentzian, weighted_squares
from hypose.errors import EvidenceError
from hypose.fitting.articulated import ContourTerm, KeypointTerm
from hypose.fitting.least_squares import Rule, descend
from hypose.geometry import Array, transform
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.shape_refinement import outlines_of

_State = tuple[list[Camera], Array]
"""cameras, poses (F, D)"""


@dataclass(frozen=True)
class BodySettings:
    """coarse: factors of the contour scale, one stage each; iterations: of each stage; contour_weight: of a contour row
    at the reference density; keypoint_weight; focal: focal lengths too; normals: rows whose outlines point further
    apart than this cosine are left out."""

    coarse: tuple[float, ...] = (4.0, 2.0, 1.0)
    iterations: tuple[int, ...] = (5, 6, 6)
    contour_weight: float = 0.1
    keypoint_weight: float = 1.0
    focal: bool = False
    normals: float = 0.3


@dataclass(frozen=True)
class BodyAdjustment:
    """rig at the size of the one given, poses (F, D), cost before and after (of the last stage's scale)."""

    rig: CameraRig
    poses: Array
    cost_before: float
    cost: float


@dataclass(frozen=True)
class _Rows:
    """Rows of one frame: residual r (R,), weight w (R,), camera (R,), by_pose (R, D), by_camera (R, P), cost."""

    r: Array
    w: Array
    camera: NDArray[np.int64]
    by_pose: Array
    by_camera: Array
    cost: float


def adjust_with_body(
    body: Body,
    rig: CameraRig,
    poses: Array,
    contours: Sequence[ContourTerm | None] | None,
    keypoints: Sequence[KeypointTerm | None] | None = None,
    options: BodySettings | None = None,
    free: NDArray[np.bool_] | None = None,
) -> BodyAdjustment:
    """Refines a rig of pinhole cameras and the poses (F, D) of a body in F frames.

    rig: at the working size, whose pixels those of the evidence are (the projections inside the terms are not used);
    contours, keypoints: one term (or None) per frame. free (C,): cameras that may move. An EvidenceError when no frame
    has evidence."""
    o = options or BodySettings()
    n = len(poses)
    none: list[None] = [None] * n
    problem = _BodyProblem(body, rig, list(contours or none), list(keypoints or none), o, free)
    if n == 0 or all(c is None and k is None for c, k in zip(problem.contours, problem.keypoints, strict=True)):
        raise EvidenceError("No frame has silhouettes or key points to refine the calibration with; choose others.")
    q, cameras = np.array(poses, dtype=np.float64), list(rig)
    before = problem.linearise(cameras, q, o.coarse[-1])[1]
    stages = zip(o.coarse, o.iterations, strict=True) if contours is not None else [(1.0, sum(o.iterations))]
    for factor, iterations in stages:
        cameras, q = problem.solve(cameras, q, iterations, factor)
    cost = problem.linearise(cameras, q, o.coarse[-1])[1]
    return BodyAdjustment(CameraRig(tuple(cameras)), q, before, cost)


class _BodyProblem:
    """Evidence and priors of one refinement."""

    def __init__(
        self,
        body: Body,
        rig: CameraRig,
        contours: list[ContourTerm | None],
        keypoints: list[KeypointTerm | None],
        options: BodySettings,
        free: NDArray[np.bool_] | None,
    ) -> None:
        marks = Landmarks((), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        self.body = replace(body, fine=body.coarse, landmarks=marks)
        self.contours, self.keypoints, self.o = contours, keypoints, options
        joints = len(body.skeleton.joint_names)
        self.moves = body.coarse.dense_weights(joints) @ body.skeleton.moves.T.astype(np.float64)
        prior = anatomical_prior(body.skeleton)
        self.centre, self.pull = prior.centre, prior.weight
        self.cameras = CameraUnknowns(rig, options.focal, free)
        self.unknowns = self.cameras.count

    def linearise(self, cameras: list[Camera], q: Array, factor: float) -> tuple[list[_Rows], float]:
        """Rows of all frames and the whole cost."""
        projections = np.stack([c.projection for c in cameras])
        skins = self.body.skin(q)
        rows = []
        for f in range(len(q)):
            parts = [*self._contour_rows(f, q[f], skins[f], cameras, projections, factor)]
            parts += self._keypoint_rows(f, q[f], cameras)
            rows.append(_joined(parts, len(self.pull), self.unknowns))
        cost = sum(r.cost for r in rows) + 0.5 * float((self.pull * (q - self.centre) ** 2).sum())
        return rows, cost + self.cameras.held(cameras)[1]

    def _contour_rows(
        self, f: int, pose: Array, vertices: Array, cameras: list[Camera], projections: Array, factor: float
    ) -> list[_Rows]:
        term = self.contours[f]
        if term is None:
            return []
        term = replace(term, projections=projections)
        twists = self.body.skeleton.world_twists(pose)
        scale, out = term.scale_px * factor, []
        for c in np.flatnonzero(term.usable):
            made = outlines_of(self.body.coarse, vertices, term, int(c), term.row_spacing_px, self.o.normals)
            if made is None:
                continue
            r, point, by_pose = made.residual, made.points(vertices), made.jacobian(vertices, twists, self.moves)
            camera = cameras[c]
            turn = camera.camera_from_world[:3, :3]
            by_cam = by_camera(transform(camera.camera_from_world, point), made.gradient @ turn.T, self.unknowns)
            w0 = self.o.contour_weight * made.weight
            rho, slope, _ = geman_mcclure((r / scale) ** 2, w0 / scale**2)
            cost = 0.5 * float((w0 * rho).sum())
            out.append(_Rows(r, slope, np.full(len(r), c), by_pose, by_cam, cost))
        return out

    def _keypoint_rows(self, f: int, pose: Array, cameras: list[Camera]) -> list[_Rows]:
        term = self.keypoints[f]
        if term is None:
            return []
        rotations, centres = self.body.skeleton.forward(pose)
        point = centres[term.joint] + np.einsum("kab,kb->ka", rotations[term.joint], term.offset)
        twists = self.body.skeleton.world_twists(pose)
        motion = np.cross(twists[None, :, :3], point[:, None]) + twists[None, :, 3:]  # (K, D, 3)
        motion = motion * self.body.skeleton.moves.T[term.joint][..., None]
        scale, out = 2 * term.scale_px, []
        for c, camera in enumerate(cameras):
            seen = np.flatnonzero(term.points[c, :, 2] > term.min_confidence)
            p = transform(camera.camera_from_world, point[seen])
            seen, p = seen[p[:, 2] > 0.05], p[p[:, 2] > 0.05]
            if len(seen) == 0:
                continue
            offset, d = pinhole_derivative(camera, p)
            r = offset + camera.K[:2, 2] - term.points[c, seen, :2]
            weight = self.o.keypoint_weight * term.points[c, seen, 2]
            world = d @ camera.camera_from_world[:3, :3]
            by_pose = np.einsum("kxa,kda->kxd", world, motion[seen]).reshape(-1, len(pose))
            by_cam = by_camera(np.repeat(p, 2, 0), d.reshape(-1, 3), self.unknowns)
            rho, slope, _ = lorentzian((r**2).sum(1) / scale**2, 4 * weight / scale**2)
            cost = 2 * float((weight * rho).sum())
            out.append(_Rows(r.ravel(), np.repeat(slope, 2), np.full(2 * len(seen), c), by_pose, by_cam, cost))
        return out

    def equations(self, rows: list[_Rows], cameras: list[Camera], q: Array) -> SharedEquations:
        """Of the cameras' unknowns (C P,), shared by the frames' poses."""
        n, p, dof = len(cameras), self.unknowns, q.shape[1]
        hold = self.cameras.hold
        hessian, gradient = np.diag(np.tile(hold, n)), (hold * self.cameras.held(cameras)[0]).ravel()
        own, own_gradient = np.empty((len(q), dof, dof)), np.empty(q.shape)
        cross = np.empty((len(q), dof, n * p))
        for f, row in enumerate(rows):
            by_all = np.zeros((len(row.r), dof + n * p))
            by_all[:, :dof] = row.by_pose
            by_all[np.arange(len(row.r))[:, None], dof + p * row.camera[:, None] + np.arange(p)] = row.by_camera
            h, g = weighted_squares(by_all, row.w, row.r)
            own[f], cross[f] = h[:dof, :dof] + np.diag(self.pull), h[:dof, dof:]
            own_gradient[f] = g[:dof] + self.pull * (q[f] - self.centre)
            hessian += h[dof:, dof:]
            gradient += g[dof:]
        return SharedEquations(hessian, gradient, own, own_gradient, cross)

    def solve(self, cameras: list[Camera], q: Array, iterations: int, factor: float) -> tuple[list[Camera], Array]:
        def evaluate(state: _State) -> tuple[float, Callable[[], SharedEquations]]:
            rows, cost = self.linearise(*state, factor)
            return cost, partial(self.equations, rows, *state)

        # contour costs jump when the outline changes
        return descend((cameras, q), evaluate, self.propose, iterations, Rule(slack=1.002, moved=1e-4)).state

    def propose(self, state: _State, equations: SharedEquations, damping: float) -> tuple[_State, float] | None:
        cameras, q = state
        reduced = equations.reduced(damping)
        x = reduced.step(self.cameras.free)
        if x is None:
            return None
        each = x.reshape(len(cameras), -1)
        x *= min(1.0, 0.1 / max(float(np.abs(each[:, :3]).max()), 1e-9))
        dq = reduced.own_steps(x)
        dq *= np.minimum(1, 0.3 / np.maximum(np.abs(dq[:, 3:]).max(1, keepdims=True), 1e-9))
        trial = [apply_parameters(c, d) for c, d in zip(cameras, each, strict=True)]
        moved = max(float(np.abs(x).max()), float(np.abs(dq).max()) / 20)
        return (trial, self.body.skeleton.clamp(q + dq)), moved


def _joined(parts: list[_Rows], dof: int, unknowns: int) -> _Rows:
    if not parts:
        zero = np.zeros(0)
        return _Rows(zero, zero, np.zeros(0, np.int64), np.zeros((0, dof)), np.zeros((0, unknowns)), 0.0)
    return _Rows(
        np.concatenate([p.r for p in parts]),
        np.concatenate([p.w for p in parts]),
        np.concatenate([p.camera for p in parts]),
        np.concatenate([p.by_pose for p in parts]),
        np.concatenate([p.by_camera for p in parts]),
        sum(p.cost for p in parts),
    )

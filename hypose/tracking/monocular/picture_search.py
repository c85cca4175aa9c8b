"""Search for the pose in one picture, layer by layer: predict, find edges and flow, optimise, mirror, sample, prune.

Source: Sminchisescu & Triggs 2001, figure 4; recipe.py puts the layers together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes
from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.evidence.edges_flow import Flow, optical_flow
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.evidence.terms import KeypointTerm
from hypose.fitting.articulated import turned
from hypose.geometry import Array, so3_left_jacobian
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.monocular.flips import mirrored
from hypose.tracking.monocular.points import keypoints_on
from hypose.tracking.monocular.pool import (
    MIRRORED,
    OPTIMISED,
    SAMPLED,
    best_of,
    candidates,
    hessian_covariance,
    pooled,
    prune,
    uncertain_samples,
)
from hypose.tracking.monocular.problem import (
    Fixed,
    MonoSolution,
    PictureEvidence,
    checked_picture,
    frame_evidence,
    grey,
    newton_descent,
    score,
)
from hypose.tracking.monocular.settings import MonoSettings, body_dofs
from hypose.tracking.refinement import PoseUncertainty, packed

_MARGIN = 40
"""px around the person in which flow is computed"""
_LOST_SHARE = 0.2
"""the track is lost when a smaller share of the contour's nodes finds an edge"""
CONTOUR, ASSIGNED, FLOW = 0, 1, 2
"""Indices into a candidate's node counts: visible contour nodes; contour nodes with an edge; inner nodes with usable
flow."""


@dataclass(frozen=True)
class PictureSearch:
    """The layers of the monocular search, for one body; its methods are the kernels of the recipe's layers.

    body: its coarse mesh is compared with the pictures. Lens distortion is ignored: give undistorted pictures.
    settings: options of costs and search.
    active: (A,) dof to estimate (default: the 30 of `body_dofs`); the others keep their start values.
    floor: height in the world of the floor that the person stands on, m; None: unknown.
    points: function that makes the term of the key points of the view on a body; None: none are used.
    The kernels of one frame share edges and problem by `PreparedFrame.shared`.
    """

    body: Body
    settings: MonoSettings = MonoSettings()
    active: NDArray[np.int64] | None = None
    floor: float | None = None
    points: Callable[[Keypoints, Body], KeypointTerm | None] = keypoints_on
    _places: list[Fixed] = field(default_factory=list, init=False, compare=False, repr=False)

    def predicted(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Predict every hypothesis by its own velocity, and build the frame's evidence: edges, flow from the previous
        picture, mask and key points.

        Raises: InputError or EvidenceError, naming the frame, where picture, mask or points do not fit the camera.
        """
        picture, seen = checked_picture(frame.frame), frame.frame.keypoints
        fixed = self._at(picture.camera)
        velocities = h.columns.get("velocity", np.zeros_like(h.values))
        poses = h.values + self.settings.velocity * velocities
        poses[:, fixed.active] = np.clip(poses[:, fixed.active], fixed.lower, fixed.upper)
        flow = self._flow(picture, np.concatenate([h.values, poses]))
        points = None if seen is None else self.points(seen, self.body)
        frame.shared["evidence"] = frame_evidence(fixed, picture, points, flow)
        columns = {"velocity": velocities, "before": h.values, "evidence": -h.relative_log_weights}
        return replace(h, values=poses, columns=columns)

    def optimised(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Optimise every hypothesis from its prediction by a Newton search; return the results as candidates."""
        settings, before = self.settings, h.columns["before"]
        evidence: PictureEvidence = frame.shared["evidence"]
        found = self._solved(evidence, h.values, before, settings.coarse_iterations, settings.iterations)
        # the way of a start or a sample to its optimum is no motion: it keeps its first velocity
        moved = np.stack([s.pose for s in found]) - before
        velocities = np.where(h.has(OPTIMISED)[:, None], moved, h.columns["velocity"])
        history = settings.search.memory * h.columns["evidence"]
        return self._candidates(OPTIMISED, evidence.fixed, found, velocities, h.values, history)

    def mirror_now(self, h: Hypotheses, frame: PreparedFrame, /) -> bool:
        """Decide whether mirrored limbs are tried in this frame."""
        search = self.settings.search
        wanted = bool(frame.frame.of(Keypoints)) if search.flips is None else search.flips
        return wanted and frame.done % search.flip_every == 0

    def mirror(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Add optimised mirrored limbs of the best candidate to the candidates; the added ones have velocity 0."""
        settings, best = self.settings, best_of(h)
        evidence: PictureEvidence = frame.shared["evidence"]
        fixed, still = evidence.fixed, evidence._replace(flow=None)
        poses = mirrored(self.body, fixed.camera, h.values[best], fixed.active)
        if len(poses) == 0:
            return pooled(h)
        found = self._solved(still, poses, poses, settings.coarse_iterations, settings.iterations)
        history = np.full(len(found), _history(h)[best])
        return pooled(h, self._candidates(MIRRORED, fixed, found, np.zeros_like(poses), poses, history))

    def sampled(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Add to the candidates samples along the directions in which the cost of each candidate is flattest.

        Each sample keeps the prediction and the accumulated evidence of the candidate from which it was drawn.
        """
        if self.settings.search.hypotheses == 1:
            return pooled(h)
        evidence: PictureEvidence = frame.shared["evidence"]
        fixed, history, sets = evidence.fixed, _history(h), [h]
        for k in range(h.count):
            hessian, free = h.columns["hessian"][k], h.columns["free"][k]
            limits = (fixed.active, fixed.spread, fixed.lower, fixed.upper)
            poses = uncertain_samples(h.values[k], hessian, free, *limits, self.settings.search)
            own = evidence.predicted(h.columns["prediction"][k])
            cost = np.array([score(pose, own) for pose in poses])
            columns = {name: np.repeat(column[k : k + 1], len(poses), 0) for name, column in h.columns.items()}
            sets.append(candidates(SAMPLED, poses, **{**columns, "cost": cost, "evidence": history[k] + cost}))
        return pooled(*sets)

    def pruned(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """Keep the best distinct candidates, with their velocities, as the hypotheses of the next frame."""
        kept = prune(h, self.body, self.settings.search)
        return replace(kept, columns={"velocity": kept.columns["velocity"]})

    def uncertainty(self, pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> PoseUncertainty:
        """Compute the uncertainty of the frame's result: all distinct optimised candidates as modes, with covariances.

        Returns: joint covariances (J, 3, 3) of the best candidate, inflated, and the modes. The packed matrix of the
            pose is zero: the modes hold more than one matrix could.
        """
        fixed, s = self._at(checked_picture(frame.frame).camera), self.body.skeleton
        found = prune(h.take(np.flatnonzero(~h.has(SAMPLED))), self.body, self.settings.search)
        covariances = turned(self._covariances(fixed, found), so3_left_jacobian(found.values[:, 3:6]))
        around = s.joint_covariances(found.values[0], covariances[0])
        sight = self.body.joints(found.values[0]) - fixed.camera.position
        sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        depth = np.einsum("ja,jab,jb->j", sight, around, sight)
        modes = Modes(
            found.values[None],
            self.body.joints(found.values)[None],
            found.weights[None],
            found.columns["cost"][None],
            covariances[None].astype(np.float32),
            around[None],
            np.sqrt(np.maximum(depth, 0.0))[None],
            np.array([found.count]),
        )
        # the modes hold more information than one matrix could
        return PoseUncertainty(around.astype(np.float32), packed(np.zeros((s.dof, s.dof))), modes)

    def lost(self, pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> bool:
        """Decide whether the track is lost: hardly any contour node of the best candidate finds an edge, or none is
        visible.
        """
        nodes = h.columns["nodes"][best_of(h)]
        return self.settings.edges and bool(nodes[ASSIGNED] < _LOST_SHARE * max(nodes[CONTOUR], 1))

    def optimise(
        self, poses: Array, frame: Frame, points: KeypointTerm | None = None, *, iterations: int = 20
    ) -> Hypotheses:
        """Optimise poses on one still picture (edges, silhouette, points; no flow, no prediction).

        frame: frame with the picture.
        points: key points seen in the picture; None: there are none.

        Used for initialisation and for mirrored poses.
        poses: (N, D) start poses.
        iterations: number of iterations of the Newton search.
        Returns: hypotheses, best first, each with its covariance and its column `cost`; the costs can be compared.
        Raises: InputError where a pose has the wrong number of values or is not finite.
        """
        picture, dof = checked_picture(frame), self.body.skeleton.dof
        if poses.shape[1] != dof or not np.isfinite(poses).all():
            raise InputError(f"Start poses need {dof} finite numbers each, got {poses.shape[1]}; fit the first again.")
        fixed = self._at(picture.camera)
        evidence = frame_evidence(fixed, picture, points)
        found = self._solved(evidence, poses, poses, iterations // 2, iterations, predict=False)
        found = sorted(found, key=lambda s: s.evidence)
        cost, where = np.array([s.evidence for s in found]), np.stack([s.pose for s in found])
        still = np.zeros_like(where)
        pool = self._candidates(OPTIMISED, fixed, found, still, where, np.zeros(len(found)))
        columns = {"cost": cost, "covariance": self._covariances(fixed, pool)}
        return Hypotheses(where, cost[0] - cost, columns=columns)

    def _at(self, camera: Camera) -> Fixed:
        """Return the parts of the problem that stay the same as long as the camera does not change."""
        if not self._places or self._places[0].camera is not camera:
            active = body_dofs(self.body.skeleton) if self.active is None else np.asarray(self.active, dtype=np.int64)
            self._places[:] = [Fixed(self.body, camera, active, self.settings, self.floor)]
        return self._places[0]

    def _flow(self, picture: Picture, poses: Array) -> Flow | None:
        """Compute the flow around the moving parts at all poses (N, D); None without a previous picture, or
        where they are outside the picture.
        """
        if picture.before is None:
            return None
        moving = self._at(picture.camera).moving
        points = self.body.skin(poses)[:, moving].reshape(-1, 3)
        uv = picture.camera.project_pinhole(points)
        uv = uv[np.isfinite(uv).all(1)]
        w, h = picture.camera.size
        if len(uv) == 0:
            return None
        low = np.clip(uv.min(0) - _MARGIN, 0, (w, h)).astype(int)
        high = np.clip(uv.max(0) + _MARGIN, 0, (w, h)).astype(int)
        if (high <= low).any():
            return None
        box = (int(low[0]), int(high[0]), int(low[1]), int(high[1]))
        return optical_flow(grey(picture.before), grey(picture.image), box)

    def _solved(
        self,
        evidence: PictureEvidence,
        starts: Array,
        before: Array,
        coarse: int,
        iterations: int,
        *,
        predict: bool = True,
    ) -> list[MonoSolution]:
        """Optimise every start (N, D).

        evidence: evidence of the frame.
        starts, before: (N, D) start poses, and poses in the previous picture.
        coarse, iterations: as in `newton_descent`.
        predict: add to each a pull to its own start as the prediction.
        Returns: N solutions.
        """
        own = (evidence.predicted(start) if predict else evidence for start in starts)
        every = zip(starts, before, own, strict=True)
        return [newton_descent(start, then, one, coarse, iterations) for start, then, one in every]

    def _candidates(
        self,
        role: str,
        fixed: Fixed,
        found: Sequence[MonoSolution],
        velocities: Array,
        predictions: Array,
        history: Array,
    ) -> Hypotheses:
        """Make candidates from N solutions.

        role: origin of the candidates.
        fixed: fixed parts of the problem.
        found: the solutions.
        velocities, predictions: (N, D) columns of the candidates.
        history: (N,) cost accumulated before this frame.
        """
        poses, gradient = np.stack([s.pose for s in found]), np.stack([s.gradient for s in found])
        at, cost = poses[:, fixed.active], np.array([s.evidence for s in found])
        held = ((at <= fixed.lower + 1e-6) & (gradient > 0)) | ((at >= fixed.upper - 1e-6) & (gradient < 0))
        return candidates(
            role,
            poses,
            velocity=velocities,
            prediction=predictions,
            hessian=np.stack([s.hessian for s in found]),
            free=~held,
            cost=cost,
            evidence=history + cost,
            nodes=np.stack([s.counts for s in found]),
        )

    def _covariances(self, fixed: Fixed, h: Hypotheses) -> Array:
        """Compute the inflated covariances (N, D, D) of candidates."""
        dof, inflation = self.body.skeleton.dof, self.settings.inflation
        each = (hessian_covariance(m, fixed.spread, fixed.active, dof, inflation) for m in h.columns["hessian"])
        return np.stack(list(each))


def _history(h: Hypotheses) -> Array:
    """Compute the accumulated cost (N,) of candidates before this frame."""
    return h.columns["evidence"] - h.columns["cost"]

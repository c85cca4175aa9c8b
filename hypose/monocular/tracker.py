"""The monocular tracker: one frame at a time, from a set of hypotheses to the next.

Source: Sminchisescu & Triggs 2001, figure 4. Deviations: a constant-velocity prediction (without it nothing keeps
track), evidence accumulated over frames, mirrored limbs as an option; see also pool.py and cpu_mono_cues.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import Camera
from hypose.compute import MonoProblem, MonoWorkspace, default_threads, mono, over_chunks
from hypose.errors import InputError
from hypose.evidence.flow import Flow, optical_flow
from hypose.geometry import Array
from hypose.monocular.evidence import check_frame, grey
from hypose.monocular.flips import mirrored
from hypose.monocular.models import body_dofs
from hypose.monocular.pool import Candidate, as_hypotheses, pose_covariance, prune, uncertain_samples
from hypose.monocular.problem import Fixed, field_of, fixed_parts, frame_problem, with_prediction
from hypose.monocular.settings import MonoSettings
from hypose.monocular.types import (
    FLIPPED,
    OPTIMISED,
    SAMPLED,
    MonoEstimate,
    MonoFrame,
    MonoHypotheses,
    MonoState,
    Nodes,
    StageTimes,
)

MARGIN = 40
"""px around the person in which flow is computed"""
LOST_SHARE = 0.2
"""lost when a smaller share of the contour's nodes finds an edge"""


@dataclass(frozen=True)
class MonoTracker:
    """The tracker of figure 4. Deviation: a constant-velocity prediction comes before the optimisation; without it
    nothing keeps track.

    A body, whose coarse mesh is compared with the picture, the camera (lens distortion is ignored: give undistorted
    pictures), settings, the dof to estimate (default `body_dofs`: 30; the others keep their start values), how many
    threads share the hypotheses (default: the machine's; any number gives the same results), and the height in the
    world of the floor that the person stands on, m (default: not known). clock: what the stages' seconds are read from
    (time.process_time: the processor's)."""

    body: Body
    camera: Camera
    settings: MonoSettings = MonoSettings()
    active: NDArray[np.int64] | None = None
    threads: int | None = None
    floor: float | None = None
    clock: Callable[[], float] = time.perf_counter

    def start(self, hypotheses: MonoHypotheses, frame: MonoFrame | None = None) -> MonoState:
        """The state before the first step; with a frame (the one the hypotheses belong to) flow is used at once."""
        self._check(hypotheses)
        if frame is not None:
            check_frame(frame, self.camera)
        return MonoState(0, hypotheses, None if frame is None else grey(frame.image))

    def step(self, state: MonoState, frame: MonoFrame, rng: np.random.Generator) -> tuple[MonoState, MonoEstimate]:
        """One frame: predict, optimise every hypothesis, sample along uncertain directions, pool and prune.

        Raises InputError or EvidenceError, naming the frame, for a picture, mask or points that do not fit the camera.
        """
        check_frame(frame, self.camera)
        clock = [self.clock()]
        settings, before = self.settings, state.hypotheses
        predictions = self._predict(before)
        field = field_of(frame, settings)
        clock.append(self.clock())
        now = grey(frame.image)
        flow = self._flow(state.grey, now, np.concatenate([before.poses, predictions]))
        clock.append(self.clock())
        problem = frame_problem(self._fixed, frame, field, flow, settings)
        solutions = self._search(problem, predictions, before.poses, settings.coarse_iterations, settings.iterations)
        # where a start or a sample settles is no motion: it keeps the velocity it was born with
        settled = before.labels == OPTIMISED
        moved = np.stack([s.pose for s in solutions]) - before.poses
        velocities = np.where(settled[:, None], moved, before.velocities)
        optimised = [
            self._candidate(s, velocities[k], predictions[k], before.evidence[k], OPTIMISED)
            for k, s in enumerate(solutions)
        ]
        if settings.search.flips and state.frames % settings.search.flip_every == 0:
            optimised += self._optimised_flips(problem, optimised)
        clock.append(self.clock())
        samples = self._samples(problem, optimised, rng) if settings.search.hypotheses > 1 else []
        best = min(range(len(optimised)), key=lambda k: optimised[k].evidence)
        others = [c for k, c in enumerate(optimised) if k != best]
        following = prune([optimised[best], *others, *samples], self.body, settings.search)
        clock.append(self.clock())
        modes = prune([optimised[best], *others], self.body, settings.search)
        posterior = self._with_covariances(modes)
        none = np.zeros((len(following), *posterior.covariances.shape[1:]))
        counts = solutions[best].counts if best < len(solutions) else solutions[0].counts
        covariance = self.body.skeleton.joint_covariances(posterior.poses[0], posterior.covariances[0])
        clock.append(self.clock())
        estimate = self._estimate(posterior, covariance, counts, StageTimes(*np.diff(clock).tolist()))
        return MonoState(state.frames + 1, as_hypotheses(following, none), now), estimate

    def optimise(self, hypotheses: MonoHypotheses, frame: MonoFrame, *, iterations: int = 20) -> MonoHypotheses:
        """Poses optimised on one still picture (edges, silhouette, points; no flow, no prediction), best first, each
        with its covariance: for initialisation and for mirrored poses. Their costs are comparable."""
        check_frame(frame, self.camera)
        self._check(hypotheses)
        problem = frame_problem(self._fixed, frame, field_of(frame, self.settings), None, self.settings)
        solutions = self._search(
            problem, hypotheses.poses, hypotheses.poses, iterations // 2, iterations, predict=False
        )
        still = np.zeros(self.body.skeleton.dof)
        found = [
            replace(self._candidate(s, still, s.pose, 0.0, int(hypotheses.labels[k])), cost=s.cost, evidence=s.cost)
            for k, s in enumerate(solutions)
        ]
        return self._with_covariances(sorted(found, key=lambda c: c.cost))

    @cached_property
    def _fixed(self) -> Fixed:
        active = body_dofs(self.body.skeleton) if self.active is None else np.asarray(self.active, dtype=np.int64)
        return fixed_parts(self.body, self.body.coarse, self.camera, active, self.settings, self.floor)

    @cached_property
    def _workspaces(self) -> list[MonoWorkspace]:
        w, h = self.camera.size
        count = self.threads if self.threads is not None else default_threads()
        return [mono.workspace(self._fixed.model, h, w) for _ in range(max(1, count))]

    def _check(self, hypotheses: MonoHypotheses) -> None:
        if hypotheses.poses.shape[1] != self.body.skeleton.dof or not np.isfinite(hypotheses.poses).all():
            raise InputError(
                f"Start poses need {self.body.skeleton.dof} finite numbers each, got {hypotheses.poses.shape[1]}; fit "
                "the first frame again."
            )

    def _predict(self, h: MonoHypotheses) -> Array:
        poses = h.poses + self.settings.velocity * h.velocities
        active = self._fixed.model.active
        poses[:, active] = np.clip(poses[:, active], self._fixed.lower, self._fixed.upper)
        return poses

    def _flow(self, previous: NDArray[np.uint8] | None, now: NDArray[np.uint8], poses: Array) -> Flow | None:
        """Flow around the moving parts at all poses (N, D); None when it is not used or they are out of the picture."""
        if previous is None or not (self.settings.flow.use or self.settings.edge.motion_boundaries):
            return None
        moving = self._fixed.model.moving_vertices
        points = self.body.skin(poses)[:, moving].reshape(-1, 3)
        uv = self.camera.project_pinhole(points)
        uv = uv[np.isfinite(uv).all(1)]
        w, h = self.camera.size
        if len(uv) == 0:
            return None
        low = np.clip(uv.min(0) - MARGIN, 0, (w, h)).astype(int)
        high = np.clip(uv.max(0) + MARGIN, 0, (w, h)).astype(int)
        if (high <= low).any():
            return None
        return optical_flow(previous, now, (int(low[0]), int(high[0]), int(low[1]), int(high[1])))

    def _search(
        self,
        problem: MonoProblem,
        starts: Array,
        before: Array,
        coarse: int,
        iterations: int,
        *,
        predict: bool = True,
    ) -> list[mono.MonoSolution]:
        """Every start (N, D) optimised, with its own prediction when asked for; over threads."""
        solutions: list[mono.MonoSolution | None] = [None] * len(starts)
        free = list(self._workspaces)

        def work(first: int, last: int) -> None:
            ws = free.pop()
            for n in range(first, last):
                own = with_prediction(problem, starts[n], self._fixed.spread) if predict else problem
                solutions[n] = mono.search(starts[n], before[n], own, coarse, iterations, ws)
            free.append(ws)

        over_chunks(work, len(starts), len(free))
        return [s for s in solutions if s is not None]

    def _candidate(
        self, s: mono.MonoSolution, velocity: Array, prediction: Array, evidence: float, label: int
    ) -> Candidate:
        fixed, at = self._fixed, s.pose[self._fixed.model.active]
        held = ((at <= fixed.lower + 1e-6) & (s.gradient > 0)) | ((at >= fixed.upper - 1e-6) & (s.gradient < 0))
        total = self.settings.search.memory * float(evidence) + s.evidence
        return Candidate(s.pose, velocity, prediction, s.hessian, ~held, s.evidence, total, label)

    def _samples(self, problem: MonoProblem, optimised: list[Candidate], rng: np.random.Generator) -> list[Candidate]:
        """Samples of all candidates, each with the history and the prediction of the one it was drawn from."""
        fixed, out = self._fixed, []
        for parent in optimised:
            poses = uncertain_samples(
                parent, fixed.model.active, fixed.spread, fixed.lower, fixed.upper, self.settings.search, rng
            )
            history = parent.evidence - parent.cost
            own = with_prediction(problem, parent.prediction, fixed.spread)
            for pose, cost in zip(poses, mono.score(poses, own, self._workspaces[0]), strict=True):
                drawn = replace(parent, pose=pose, cost=float(cost), evidence=history + float(cost), label=SAMPLED)
                out.append(drawn)
        return out

    def _optimised_flips(self, problem: MonoProblem, optimised: list[Candidate]) -> list[Candidate]:
        """Mirrored limbs of the best candidate, optimised; they start at rest."""
        best = min(optimised, key=lambda c: c.evidence)
        poses = mirrored(self.body, self.camera, best.pose, self._fixed.model.active)
        if len(poses) == 0:
            return []
        still = problem._replace(flow=problem.flow._replace(flow=problem.flow.flow[:0]))
        found = self._search(still, poses, poses, self.settings.coarse_iterations, self.settings.iterations)
        history = best.evidence - best.cost
        return [
            replace(self._candidate(s, np.zeros_like(q), q, 0.0, FLIPPED), evidence=history + s.evidence)
            for s, q in zip(found, poses, strict=True)
        ]

    def _with_covariances(self, candidates: list[Candidate]) -> MonoHypotheses:
        fixed, dof = self._fixed, self.body.skeleton.dof
        covariances = [
            pose_covariance(c.hessian, fixed.spread, fixed.model.active, dof, self.settings.inflation)
            for c in candidates
        ]
        return as_hypotheses(candidates, np.stack(covariances))

    def _estimate(
        self, posterior: MonoHypotheses, covariance: Array, counts: NDArray[np.int64], seconds: StageTimes
    ) -> MonoEstimate:
        pose = posterior.poses[0]
        sight = self.body.joints(pose) - self.camera.position
        sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        depth = np.einsum("ja,jab,jb->j", sight, covariance, sight)
        sd = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
        nodes = Nodes(*(int(n) for n in counts[:6]))
        lost = self.settings.edges and nodes.assigned < LOST_SHARE * max(nodes.contour, 1)
        return MonoEstimate(
            pose,
            covariance,
            sd,
            np.sqrt(np.maximum(depth, 0.0)),
            float(posterior.costs[0]),
            posterior,
            len(posterior),
            lost,
            nodes,
            seconds,
        )

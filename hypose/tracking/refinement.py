"""Refine poses on contours and key points: a kernel that solves for the pose and moves the set onto the solution.

Resampling cannot bring a lost limb back, and the mean of a set is noisy; a few robust Gauss-Newton steps on two-way
contours cure both. It can follow any recipe; its result is the estimate, and the set is shifted with it (feedback).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.fitting.articulated import PoseFit, SolveSettings, fit_poses
from hypose.fitting.problem import Quadratic
from hypose.geometry import Array
from hypose.inference.estimates import TangentMean
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import PreparedFrame, frame_energy, mean_overlap

SOLVED, COMPOSITE, RIVAL = "solved", "composite", "rival"
"""Roles: the solved hypothesis, the one that a search of single limbs composes, and other solved ones that are kept."""
LUMBAR_SD = 0.28
"""rad: usual flexion of the spine: root mean square over captured walking, running and boxing (7.8, 7.7 and 25 degrees,
CMU 02_01, 02_03 and 02_05, equal shares). Bending to the ground takes three times as much and is still found, since the
shoulders show it (Vazirian et al. 2016, lumbopelvic rhythm in the sagittal plane).
"""
KEYPOINT_SHARE = 0.003
"""Weight of the key points' log-likelihood relative to the masks' energy. Chosen on scenes with corrupted key points
(walk, box, serve; seeds 700 and 701)."""
DEPTH_TRIES = 2
"""largest number of damping trials of a step with depth: this cost jumps with the nearest faces, and more damping
seldom helps. Chosen on the seeds 0 to 9 (benchmark `depth`)."""
SETTLING = SolveSettings(iterations=24, coarse_iterations=12)
"""Settings for solves from far: of a start that may be centimetres off, and after a loss."""


def anatomical_prior(skeleton: Skeleton, keypoints: bool = False) -> Quadratic:
    """Build a quadratic prior that weakly pulls every joint angle to the rest pose, more strongly where silhouettes
    hardly show the joint.

    Weights, in units of the robust rows' cost: 0.09 for limbs, 1 for spine and neck, 4 for clavicles and ankles, 0 for
    the root.
    keypoints: the evidence has key points. Then LUMBAR_SD holds the flexion of the spine, because two points at the
        hips do not determine how the pelvis turns about them, and small errors of theirs turn it far.
    """
    weight = _anatomical_weights(skeleton.dof_names).copy()
    if keypoints:
        weight[[n == "spine_rx" for n in skeleton.dof_names]] = LUMBAR_SD**-2
    return Quadratic(np.zeros(skeleton.dof), weight)


@lru_cache(8)
def _anatomical_weights(dof_names: tuple[str, ...]) -> Array:
    """Compute the weights (D,) of `anatomical_prior` without key points, from the names of the coordinates."""
    weight = np.full(len(dof_names), 0.3)
    weight[:6] = 0
    for n, name in enumerate(dof_names):
        if name.startswith(("spine", "neck")):
            weight[n] = 1.0
        elif "clavicle" in name or "ankle" in name:
            weight[n] = 2.0
    return weight**2


def prediction_prior(prediction: Array, weight: float) -> Quadratic:
    """Build a quadratic prior that pulls a solve to the predicted pose (D,) with a weight (1 / rad^2), so that body
    parts that no view sees keep moving.

    The weight must stay small: at 3 per rad^2 and 25 fps it held back arms that particles had found half a radian
        away, whose contour rows together are worth about one unit of cost.
    """
    return Quadratic(prediction, np.full(len(prediction), weight))


def settled_start(pose: Array, frame: PreparedFrame, /) -> Array:
    """Solve a start pose (D,) on a frame's evidence with many iterations, from a pose that may be centimetres off."""
    return refine(frame.body, pose[None], frame, SETTLING)[0].pose


@dataclass(frozen=True)
class ContourRefinement:
    """Search kernel that refines a few hypotheses by contour solves, and shifts the whole set by the step of the
    best one.

    Refined are the set's mean, the hypothesis of least energy, and the prediction; the one with the least `mismatch`
    wins. All hypotheses move by its step from the mean and keep their spread; the winner replaces the first one, with
    the role SOLVED.
    """

    options: SolveSettings = SolveSettings()

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Return the refined and shifted set."""
        s = frame.body.skeleton
        mean = pose_mean(s)(h)
        best = h.values[frame_energy(h.values, frame).argmin()]
        candidates = s.on_branch(np.stack([mean, frame.prediction, best]), frame.prediction)
        winner = best_fit(refine(frame.body, candidates, frame, self.options), frame).pose
        values = s.clamp(h.values + (winner - mean))
        values[0] = winner
        return replace(h, values=values).marked(SOLVED, [0])


class LaterLayer(Protocol):
    """Interface of a layer that can start parts of its work before its turn, in parallel with other layers."""

    def before_solve(self, frame: PreparedFrame, /) -> None:
        """Start, in the background, the work that depends only on the last frame."""
        ...

    def before_search(self, h: Hypotheses, frame: PreparedFrame, /) -> None:
        """Start, in the background, the work that depends on the hypothesis with the role SOLVED, not on the search of
        limbs.

        h: hypotheses after the first solve; frame: prepared frame; its `shared` gets the result.
        """
        ...


@dataclass(frozen=True)
class SolvePrediction:
    """Search kernel that solves a pose from the prediction and sets all hypotheses to the solution, as the start of
    a search of single limbs.

    One hypothesis gets the role SOLVED, another COMPOSITE, to which the search adds limb by limb.
    later: a layer that may run in parallel with this one and the next ones.
    """

    options: SolveSettings = SolveSettings()
    later: LaterLayer | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Return the set with all hypotheses at the solved pose."""
        if self.later is not None:
            self.later.before_solve(frame)
        pose = refine(frame.body, frame.prediction[None], frame, self.options)[0].pose
        moved = _all_at(pose, h).marked(COMPOSITE, [min(1, h.count - 1)])
        if self.later is not None:
            self.later.before_search(moved, frame)
        return moved


@dataclass(frozen=True)
class InTurn:
    """Condition that decides when a limb is searched: in its turn, and in unsettled frames.

    turn, period: searched in frames whose number modulo `period` is `turn`.
    unsettled: also searched where 1 - IoU of the solved body is above this many times its usual value in the recording.
    seldom: with depth the turn comes this many times less often, because depth mostly resolves what masks leave open.
    Why: a lost limb hardly changes the overlap; neither overlap nor cost shows in which frames a search pays (area
        under the curve 0.6). Turns also cost the same time in every frame.
    """

    turn: int
    period: int
    unsettled: float = 1.15
    seldom: int = 1

    def __call__(self, h: Hypotheses, frame: PreparedFrame) -> bool:
        """Decide whether the limb is searched in this frame."""
        if not frame.silhouettes.seen:
            return False  # particles are weighed by silhouettes only
        times = self.seldom if frame.depth.seen else 1
        if frame.frame.index % (self.period * times) == self.turn * times:
            return True
        pose = member(h, SOLVED)
        key = "settled", self.unsettled, pose.tobytes()  # the result is the same for every limb
        settled: bool | None = frame.shared.get(key)
        if settled is None:
            settled = frame.shared[key] = self._is_settled(pose, frame)
        return not settled

    def _is_settled(self, pose: Array, frame: PreparedFrame) -> bool:
        """Decide whether a solved pose (D,) overlaps the masks about as well as usual; false where the usual value is
        unknown.
        """
        if not np.isfinite(frame.usual_iou):
            return False
        return 1 - mean_overlap(frame.body, pose, frame) <= self.unsettled * (1 - frame.usual_iou)


def member(h: Hypotheses, role: str) -> Array:
    """Return the value (D,) of the hypothesis with a role."""
    return h.values[h.has(role).argmax()]


def _all_at(pose: Array, h: Hypotheses) -> Hypotheses:
    """Move all hypotheses to one pose (D,); the first one gets the role SOLVED."""
    return h.at(np.repeat(pose[None], h.count, 0)).marked(SOLVED, [0])


def mismatch(poses: Array, frame: PreparedFrame, step_penalty: float = 0.002, expected: Array | None = None) -> Array:
    """Compute the score (N,) by which solved poses are compared, low is good.

    It is the mean energy over the views (eq. 2.8 / views) + step_penalty x mean squared step from the expected pose, in
    units of three usual motions + KEYPOINT_SHARE x cost of the key points.
    expected: (N, D) pose expected of each (default: the prediction).
    Why: the penalty keeps a limb from jumping where silhouettes are equal; the key points' cost keeps a pose that
        overlaps the masks better from leaving confident key points.
    """
    views = max(int(frame.silhouettes.views.sum()), 1)
    skeleton = frame.body.skeleton
    expected = frame.prediction if expected is None else expected
    step = (skeleton.on_branch(poses, expected) - expected) / (3 * skeleton.sigma)
    cost = frame_energy(poses, frame) / views + step_penalty * (step[:, 3:] ** 2).mean(1)
    return cost + KEYPOINT_SHARE * frame.keypoints.cost(frame.body, poses)


def best_fit(fits: list[PoseFit], frame: PreparedFrame) -> PoseFit:
    """Choose the fit with the least mismatch; the least cost where there are no silhouettes.

    fits: at least one; frame: prepared.
    """
    if len(fits) == 1:
        return fits[0]
    if not frame.silhouettes.seen:
        return fits[int(np.argmin([f.cost for f in fits]))]
    return fits[int(np.argmin(mismatch(np.stack([f.pose for f in fits]), frame)))]


def refine(body: Body, starts: Array, frame: PreparedFrame, options: SolveSettings) -> list[PoseFit]:
    """Solve from the starts (N, D) independently on a frame's evidence, with anatomical and prediction priors; store
    the results in `frame.fits`.

    Returns: one result per start.
    """
    fits = solve_poses(body, starts, frame, options)
    keep_fits(frame, fits, body)
    return fits


def keep_fits(frame: PreparedFrame, fits: Sequence[PoseFit], body: Body | None = None) -> None:
    """Store results of solves in a frame, from which the uncertainty is computed later.

    body: body that was solved; None: the body of the frame.
    """
    for fit in fits:
        frame.fits.keep(body or frame.body, fit.pose, fit)


def solve_poses(body: Body, starts: Array, frame: PreparedFrame, options: SolveSettings) -> list[PoseFit]:
    """Solve from the starts (N, D) as `refine` does, without storing the fits.

    frame: prepared; options: options of the solve. With depth at most DEPTH_TRIES damping trials are made.
    """
    trunk = anatomical_prior(body.skeleton, frame.keypoints.seen)
    priors = (trunk, prediction_prior(frame.prediction, frame.prediction_weight))
    if frame.depth.seen:
        options = options._replace(tries=min(options.tries, DEPTH_TRIES))
    return fit_poses(body, starts, frame.terms, priors=priors, options=options)


def pose_mean(skeleton: Skeleton) -> TangentMean:
    """Build the estimate by weighted mean pose; rotation vectors are averaged on SO(3), never as raw angles across
    +-pi.
    """
    return TangentMean(tuple(int(s) for s in skeleton.ball_starts))


def solved(h: Hypotheses, /) -> Array:
    """Return the hypothesis (D,) with the role SOLVED as the estimate."""
    return member(h, SOLVED).copy()

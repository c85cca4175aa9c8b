"""Contour refinement: a kernel that solves for the pose on contours and key points and moves the set onto the solution.

Resampling cannot bring a limb back and the mean of a set is noisy; a few robust Gauss-Newton steps on two-way contours
cure both. It is usable after any recipe; its result is the estimate, and the set is shifted with it (feedback).
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
from hypose.tracking.costs import frame_energy, mean_overlap
from hypose.tracking.frame_evidence import PreparedFrame

SOLVED, COMPOSITE, RIVAL = "solved", "composite", "rival"
"""Roles: the hypothesis that a solve put in, the one that a search of single limbs puts together, and another solved
one that is alive next to the first."""
LUMBAR_SD = 0.28
"""rad: how far the spine is flexed or extended, as a rule: root mean square over captured walking, running and boxing
(7.8, 7.7 and 25 degrees, CMU 02_01, 02_03 and 02_05, equal shares). Bending to the ground takes three times as much,
and is still found, since the shoulders tell it (Vazirian et al. 2016, lumbopelvic rhythm in the sagittal plane)."""
KEYPOINT_SHARE = 0.003
"""What a difference of 1 in the log-likelihood of key points is in shares of the masks. Chosen on scenes with spoilt
key points (walk, box, serve; seeds 700 and 701)."""
DEPTH_TRIES = 2
"""of a step where depth cameras see: their cost jitters with the nearest faces, and more damping seldom helps. Chosen
on the seeds 0 to 9 (benchmark `depth`)."""
SETTLING = SolveSettings(iterations=24, coarse_iterations=12)
"""For a solve from far: of a start that may be centimetres off, and of where a lost person is found again."""


def anatomical_prior(skeleton: Skeleton, keypoints: bool = False) -> Quadratic:
    """Weak pull of every joint angle to the rest pose, stronger where silhouettes hardly see the joint.

    Weights are those of a joint in units of the robust rows' cost: 0.09 for limbs, 1 for spine and neck, 4 for
    clavicles and ankles, 0 for the root. keypoints: the evidence has key points, in which two points of the hips leave
    open how the pelvis turns about them, and a small fault of theirs turns it far: LUMBAR_SD holds the flexion of the
    spine.
    """
    weight = _anatomical_weights(skeleton.dof_names).copy()
    if keypoints:
        weight[[n == "spine_rx" for n in skeleton.dof_names]] = LUMBAR_SD**-2
    return Quadratic(np.zeros(skeleton.dof), weight)


@lru_cache(8)
def _anatomical_weights(dof_names: tuple[str, ...]) -> Array:
    weight = np.full(len(dof_names), 0.3)
    weight[:6] = 0
    for n, name in enumerate(dof_names):
        if name.startswith(("spine", "neck")):
            weight[n] = 1.0
        elif "clavicle" in name or "ankle" in name:
            weight[n] = 2.0
    return weight**2


def prediction_prior(prediction: Array, weight: float) -> Quadratic:
    """Pull to the predicted pose (D,), so that what no view sees keeps moving as it did.

    It must stay weak: at 3 per rad^2 and 25 fps it held arms back that particles had found half a radian away, whose
    contour rows together are worth about one unit of cost."""
    return Quadratic(prediction, np.full(len(prediction), weight))


def settled_start(pose: Array, frame: PreparedFrame, /) -> Array:
    """Start: the pose (D,) of a long solve from the one that is given, which may be centimetres off."""
    return refine(frame.body, pose[None], frame, SETTLING)[0].pose


@dataclass(frozen=True)
class ContourRefinement:
    """Kernel: refines a few members of the set and shifts the whole set by the step of the best.

    Members refined: the set's mean, the hypothesis of least energy, and the prediction. The winner has the least
    `mismatch`. All hypotheses move by its step from the mean and keep their spread; the winner itself becomes one of
    them, in the role SOLVED.
    """

    options: SolveSettings = SolveSettings()

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Moves h; see the class."""
        s = frame.body.skeleton
        mean = pose_mean(s)(h)
        best = h.values[frame_energy(h.values, frame).argmin()]
        candidates = s.on_branch(np.stack([mean, frame.prediction, best]), frame.prediction)
        winner = best_fit(refine(frame.body, candidates, frame, self.options), frame).pose
        values = s.clamp(h.values + (winner - mean))
        values[0] = winner
        return replace(h, values=values).marked(SOLVED, [0])


class LaterLayer(Protocol):
    """A layer that can begin with parts of its work before its turn, in parallel with the others."""

    def before_solve(self, frame: PreparedFrame, /) -> None:
        """Begins with what depends on the last frame alone."""
        ...

    def before_search(self, h: Hypotheses, frame: PreparedFrame, /) -> None:
        """Begins with what depends on the hypothesis in the role SOLVED, but on no search of limbs."""
        ...


@dataclass(frozen=True)
class SolvePrediction:
    """Kernel: solves from the prediction and puts all hypotheses there: where a search of single limbs wants to start.

    One of them is in the role SOLVED, and one in the role COMPOSITE, to which the search adds limb by limb. later: a
    layer that may run in parallel with this one and the next ones.
    """

    options: SolveSettings = SolveSettings()
    later: LaterLayer | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """All hypotheses at the solution."""
        if self.later is not None:
            self.later.before_solve(frame)
        pose = refine(frame.body, frame.prediction[None], frame, self.options)[0].pose
        moved = _all_at(pose, h).marked(COMPOSITE, [min(1, h.count - 1)])
        if self.later is not None:
            self.later.before_search(moved, frame)
        return moved


@dataclass(frozen=True)
class InTurn:
    """When a limb is searched: in the frames whose number modulo `period` is `turn`, and in unsettled ones, in which
    the solved body overlaps the masks clearly worse than usual in this recording (1 - IoU above `unsettled` times its
    usual value).

    A lost limb hardly changes the overlap with the masks: neither the overlap nor the cost of the solve tells the
    frames in which a search pays (area under the curve 0.6), so each limb has its turn, which also costs the same in
    every frame. With depth a limb's turn comes seldom times later: what a mask leaves open depth mostly tells the
    solve."""

    turn: int
    period: int
    unsettled: float = 1.15
    seldom: int = 1

    def __call__(self, h: Hypotheses, frame: PreparedFrame) -> bool:
        """True when the limb is to be searched in this frame."""
        if not frame.silhouettes.seen:
            return False  # particles are weighed by silhouettes only
        times = self.seldom if frame.depth.seen else 1
        if frame.frame.index % (self.period * times) == self.turn * times:
            return True
        pose = member(h, SOLVED)
        key = "settled", self.unsettled, pose.tobytes()  # every limb asks the same
        settled: bool | None = frame.shared.get(key)
        if settled is None:
            settled = frame.shared[key] = self._is_settled(pose, frame)
        return not settled

    def _is_settled(self, pose: Array, frame: PreparedFrame) -> bool:
        if not np.isfinite(frame.usual_iou):
            return False
        return 1 - mean_overlap(frame.body, pose, frame) <= self.unsettled * (1 - frame.usual_iou)


def member(h: Hypotheses, role: str) -> Array:
    """(D,) the value of the hypothesis in a role that one of h has."""
    return h.values[h.has(role).argmax()]


def _all_at(pose: Array, h: Hypotheses) -> Hypotheses:
    return h.at(np.repeat(pose[None], h.count, 0)).marked(SOLVED, [0])


def mismatch(poses: Array, frame: PreparedFrame, step_penalty: float = 0.002, expected: Array | None = None) -> Array:
    """(N,) mean energy over the views (eq. 2.8 / views) + step_penalty x mean squared step from the prediction (or from
    where each was expected (N, D)) in large steps (three usual motions) + KEYPOINT_SHARE x what the key points cost:
    what chooses between solved poses. The penalty keeps equal silhouettes from flipping a limb, and what overlaps the
    masks better may not leave key points that are sure of themselves."""
    views = max(int(frame.silhouettes.views.sum()), 1)
    skeleton = frame.body.skeleton
    expected = frame.prediction if expected is None else expected
    step = (skeleton.on_branch(poses, expected) - expected) / (3 * skeleton.sigma)
    cost = frame_energy(poses, frame) / views + step_penalty * (step[:, 3:] ** 2).mean(1)
    return cost + KEYPOINT_SHARE * frame.keypoints.cost(frame.body, poses)


def best_fit(fits: list[PoseFit], frame: PreparedFrame) -> PoseFit:
    """The fit of least mismatch; of least cost when there are no silhouettes."""
    if len(fits) == 1:
        return fits[0]
    if not frame.silhouettes.seen:
        return fits[int(np.argmin([f.cost for f in fits]))]
    return fits[int(np.argmin(mismatch(np.stack([f.pose for f in fits]), frame)))]


def refine(body: Body, starts: Array, frame: PreparedFrame, options: SolveSettings) -> list[PoseFit]:
    """Independent robust solves from starts (N, D) on a frame's evidence, with anatomical and prediction priors."""
    fits = solve_poses(body, starts, frame, options)
    keep_fits(frame, fits, body)
    return fits


def keep_fits(frame: PreparedFrame, fits: Sequence[PoseFit], body: Body | None = None) -> None:
    """Keeps the fits with the frame, where its uncertainty is read off; body: other than the frame's."""
    body = body or frame.body
    for fit in fits:  # poses go on clamped, by less than the last digits of a Hessian
        frame.fits.keep(body, body.skeleton.clamp(fit.pose), fit)


def solve_poses(body: Body, starts: Array, frame: PreparedFrame, options: SolveSettings) -> list[PoseFit]:
    """`refine` without keeping anything."""
    trunk = anatomical_prior(body.skeleton, frame.keypoints.seen)
    priors = (trunk, prediction_prior(frame.prediction, frame.prediction_weight))
    if frame.depth.seen:
        options = replace(options, tries=min(options.tries, DEPTH_TRIES))
    return fit_poses(body, starts, frame.terms, priors=priors, options=options)


def pose_mean(skeleton: Skeleton) -> TangentMean:
    """Estimate: weighted mean pose, rotation vectors averaged on SO(3), never as raw angles across +-pi."""
    return TangentMean(tuple(int(s) for s in skeleton.ball_starts))


def solved(h: Hypotheses, /) -> Array:
    """Estimate: (D,) the hypothesis in the role SOLVED."""
    return member(h, SOLVED).copy()

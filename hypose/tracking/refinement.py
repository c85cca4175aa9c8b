"""Contour refinement: a kernel that solves for the pose on contours and key points and moves the set onto the solution.

Resampling cannot bring a limb back and the mean of a set is noisy; a few robust Gauss-Newton steps on two-way contours
cure both. It is usable after any recipe; its result is the estimate, and the set is shifted with it (feedback).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.fitting.articulated import PoseFit, Quadratic, SolveOptions, fit_poses
from hypose.geometry import Array
from hypose.inference.estimates import TangentMean
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.costs import silhouette_iou, xor_energy
from hypose.tracking.evidence import PreparedFrame

REFINED, SETTLED = 1, 2
"""Labels: REFINED is the hypothesis that a refinement put in; in a settled frame the others are SETTLED, else 0."""


def anatomical_prior(skeleton: Skeleton) -> Quadratic:
    """Weak pull of every joint angle to the rest pose, stronger where silhouettes hardly see the joint.

    Weights are those of a joint in units of the robust rows' cost: 0.09 for limbs, 1 for spine and neck, 4 for
    clavicles and ankles, 0 for the root.
    """
    return Quadratic(np.zeros(skeleton.dof), _anatomical_weights(skeleton.dof_names).copy())


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


@dataclass(frozen=True)
class ContourRefinement:
    """Kernel: refines a few members of the set and shifts the whole set by the step of the best.

    Members refined: the set's mean (`from_mean`), its `best` highest weighted hypotheses, and the prediction
    (`from_prediction`). The winner has the least `mismatch`. All hypotheses move by its step from the mean and keep
    their spread; the winner itself becomes the first hypothesis and carries the label REFINED. Without evidence the set
    is left alone.
    """

    body: Body
    options: SolveOptions = SolveOptions()
    best: int = 0
    from_prediction: bool = False
    from_mean: bool = True

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Moves h; see the class."""
        labels = np.zeros_like(h.label)
        if not frame.usable:
            return replace(h, label=labels)
        mean = pose_mean(self.body.skeleton)(h)
        fits = refine(self.body, self._candidates(h, mean, frame), frame, self.options)
        winner = best_fit(self.body, fits, frame).pose
        values = self.body.skeleton.clamp(h.values + (winner - mean))
        values[0] = winner
        labels[0] = REFINED
        return replace(h, values=values, label=labels)

    def _candidates(self, h: Hypotheses, mean: Array, frame: PreparedFrame) -> Array:
        rows = [mean] if self.from_mean else []
        if self.from_prediction:
            rows.append(frame.prediction)
        if self.best:
            energy = xor_energy(self.body, h.values, frame)
            rows += list(h.values[np.argsort(energy, kind="stable")[: self.best]])
        return self.body.skeleton.on_branch(np.stack(rows), frame.prediction)


@dataclass(frozen=True)
class SolvePrediction:
    """Kernel: solves from the prediction and puts all hypotheses there: where a search of single limbs wants to start.

    The first carries REFINED. The others carry SETTLED unless the solved body overlaps the masks clearly worse than
    usual in this recording (1 - IoU above `unsettled` times its usual value).
    """

    body: Body
    options: SolveOptions = SolveOptions()
    unsettled: float = 1.15

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """All hypotheses at the solution."""
        labels = np.zeros_like(h.label)
        if not frame.usable:
            return replace(h, label=labels)
        winner = refine(self.body, frame.prediction[None], frame, self.options)[0].pose
        if self._is_settled(winner, frame):
            labels[:] = SETTLED
        labels[0] = REFINED
        return replace(h, values=np.repeat(winner[None], h.count, 0), label=labels)

    def _is_settled(self, pose: Array, frame: PreparedFrame) -> bool:
        if frame.masks is None:
            return True  # particles are weighed by silhouettes only
        if not np.isfinite(frame.usual_iou):
            return False
        iou = float(np.nanmean(silhouette_iou(self.body, pose, frame)))
        return 1 - iou <= self.unsettled * (1 - frame.usual_iou)


@dataclass(frozen=True)
class InTurn:
    """When a limb is searched: in the frames whose number modulo `period` is `turn`, and in unsettled ones.

    A lost limb hardly changes the overlap with the masks: neither the overlap nor the cost of the solve tells the
    frames in which a search pays (area under the curve 0.6), so each limb has its turn, which also costs the same in
    every frame."""

    turn: int
    period: int

    def __call__(self, h: Hypotheses, frame: PreparedFrame) -> bool:
        """True when the limb is to be searched in this frame."""
        if frame.masks is None:
            return False
        return h.label[-1] != SETTLED or frame.frame.index % self.period == self.turn


@dataclass(frozen=True)
class RefineComposite:
    """Kernel: refines the second hypothesis, which a limb search put together, and keeps it if it beats the first.

    All hypotheses become the winner; the first carries REFINED. Nothing is solved when the search lowered the energy by
    less than the share `margin`, which chance alone does.
    """

    body: Body
    options: SolveOptions = SolveOptions()
    margin: float = 0.02

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """The set at the winner."""
        if not frame.usable:
            return h
        winner, composite = h.values[0], h.values[1]
        if self._is_better(winner, composite, frame):
            solved = refine(self.body, composite[None], frame, self.options)[0].pose
            both = np.stack([winner, solved])
            winner = both[int(np.argmin(mismatch(self.body, both, frame)))]
        labels = np.zeros_like(h.label)
        labels[0] = REFINED
        return replace(h, values=np.repeat(winner[None], h.count, 0), label=labels)

    def _is_better(self, winner: Array, composite: Array, frame: PreparedFrame) -> bool:
        if np.array_equal(winner, composite):
            return False
        energy = xor_energy(self.body, np.stack([winner, composite]), frame)
        return bool(energy[1] < (1 - self.margin) * energy[0])


def mismatch(body: Body, poses: Array, frame: PreparedFrame, step_penalty: float = 0.002) -> Array:
    """(N,) mean XOR share over the views (eq. 2.8 / views) + step_penalty x mean squared step from the prediction in
    large steps (three usual motions): what chooses between solved poses. The penalty keeps equal silhouettes from
    flipping a limb."""
    assert frame.masks is not None
    views = max(int(frame.masks.usable.sum()), 1)
    skeleton = body.skeleton
    step = (skeleton.on_branch(poses, frame.prediction) - frame.prediction) / (3 * skeleton.sigma)
    return xor_energy(body, poses, frame) / views + step_penalty * (step[:, 3:] ** 2).mean(1)


def best_fit(body: Body, fits: list[PoseFit], frame: PreparedFrame) -> PoseFit:
    """The fit of least mismatch; of least cost when there are no silhouettes."""
    if len(fits) == 1:
        return fits[0]
    if frame.masks is None:
        return fits[int(np.argmin([f.cost for f in fits]))]
    return fits[int(np.argmin(mismatch(body, np.stack([f.pose for f in fits]), frame)))]


def refine(body: Body, starts: Array, frame: PreparedFrame, options: SolveOptions) -> list[PoseFit]:
    """Independent robust solves from starts (N, D) on a frame's evidence, with anatomical and prediction priors."""
    priors = (anatomical_prior(body.skeleton), prediction_prior(frame.prediction, frame.prediction_weight))
    fits = fit_poses(body, starts, contours=frame.contours, keypoints=frame.keypoints, priors=priors, options=options)
    for fit in fits:
        frame.hessians.keep(body, fit.pose, fit.hessian)
    return fits


def pose_mean(skeleton: Skeleton) -> TangentMean:
    """Estimate: weighted mean pose, rotation vectors averaged on SO(3), never as raw angles across +-pi."""
    return TangentMean(tuple(int(s) for s in skeleton.ball_starts))


@dataclass(frozen=True)
class RefinedEstimate:
    """Estimate: the refined hypothesis when the last layer made one, else the weighted mean."""

    skeleton: Skeleton

    def __call__(self, h: Hypotheses, /) -> Array:
        """(D,) pose."""
        refined = np.flatnonzero(h.label == REFINED)
        return h.values[refined[0]].copy() if len(refined) else pose_mean(self.skeleton)(h)

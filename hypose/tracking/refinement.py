"""Contour refinement: a kernel that solves for the pose on contours and key points and moves the set onto the solution.

Resampling cannot bring a limb back and the mean of a set is noisy; a few robust Gauss-Newton steps on two-way contours
cure both. It is usable after any recipe; its result is the estimate, and the set is shifted with it (feedback).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.fitting.articulated import PoseFit, Quadratic, SolveOptions, fit_poses
from hypose.geometry import Array
from hypose.inference.estimates import TangentMean
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.costs import xor_energy
from hypose.tracking.evidence import PreparedFrame

REFINED = 1
"""Label of the hypothesis that the refinement put in; all others carry 0."""


def anatomical_prior(skeleton: Skeleton) -> Quadratic:
    """Weak pull of every joint angle to the rest pose, stronger where silhouettes hardly see the joint.

    Weights are those of a joint in units of the robust rows' cost: 0.09 for limbs, 1 for spine and neck, 4 for
    clavicles and ankles, 0 for the root.
    """
    weight = np.full(skeleton.dof, 0.3)
    weight[:6] = 0
    for n, name in enumerate(skeleton.dof_names):
        if name.startswith(("spine", "neck")):
            weight[n] = 1.0
        elif "clavicle" in name or "ankle" in name:
            weight[n] = 2.0
    return Quadratic(np.zeros(skeleton.dof), weight**2)


def prediction_prior(prediction: Array, weight: float) -> Quadratic:
    """Pull to the predicted pose (D,), so that what no view sees keeps moving as it did.

    It must stay weak: at 3 per rad^2 and 25 fps it held arms back that particles had found half a radian away, whose
    contour rows together are worth about one unit of cost."""
    return Quadratic(prediction, np.full(len(prediction), weight))


@dataclass(frozen=True)
class ContourRefinement:
    """Kernel: refines a few members of the set and shifts the whole set by the step of the best.

    Members refined: the set's mean, its `best` highest weighted hypotheses, and the prediction when `from_prediction`.
    The winner is the refined pose of least E (eq. 2.8) / views + 0.002 x mean squared step from the prediction in
    usual motions (0.002 keeps equal silhouettes from flipping a limb). With `collapse` all hypotheses become the
    winner, which is where a layered search of single limbs wants to start; otherwise they keep their spread. The
    winner itself becomes the first hypothesis and carries the label REFINED. Without evidence the set is left alone.
    """

    body: Body
    options: SolveOptions = SolveOptions()
    best: int = 0
    from_prediction: bool = False
    from_mean: bool = True
    collapse: bool = False
    step_penalty: float = 0.002

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Moves h; see the class."""
        labels = np.zeros_like(h.label)
        if not frame.usable:
            return replace(h, label=labels)
        mean = pose_mean(self.body.skeleton)(h)
        winner = self.refine(self._candidates(h, mean, frame), frame).pose
        if self.collapse:
            values = np.repeat(winner[None], h.count, 0)
        else:
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

    def refine(self, starts: Array, frame: PreparedFrame) -> PoseFit:
        """The best refined pose from starts (N, D)."""
        fits = refine(self.body, starts, frame, self.options)
        if len(fits) == 1:
            return fits[0]
        poses = np.stack([f.pose for f in fits])
        views = 1 if frame.masks is None else max(int(frame.masks.usable.sum()), 1)
        step = (self.body.skeleton.on_branch(poses, frame.prediction) - frame.prediction) / _spread(self.body.skeleton)
        measure = xor_energy(self.body, poses, frame) / views if frame.masks is not None else _costs(fits)
        return fits[int(np.argmin(measure + self.step_penalty * (step[:, 3:] ** 2).mean(1)))]


def refine(body: Body, starts: Array, frame: PreparedFrame, options: SolveOptions) -> list[PoseFit]:
    """Independent robust solves from starts (N, D) on a frame's evidence, with anatomical and prediction priors."""
    priors = (anatomical_prior(body.skeleton), prediction_prior(frame.prediction, frame.prediction_weight))
    return list(
        fit_poses(body, starts, contours=frame.contours, keypoints=frame.keypoints, priors=priors, options=options)
    )


def _costs(fits: list[PoseFit]) -> Array:
    return np.array([f.cost for f in fits])


def _spread(skeleton: Skeleton) -> Array:
    return 3 * skeleton.sigma  # a fast movement, not the usual one, is what the penalty should begin to notice


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

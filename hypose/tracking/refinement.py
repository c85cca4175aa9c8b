"""Refine poses on contours and key points: a kernel that solves for the pose and moves the set onto the solution.

Resampling cannot bring a lost limb back, and the mean of a set is noisy; a few robust Gauss-Newton steps on two-way
contours cure both. It can follow any recipe; its result is the estimate, and the set is shifted with it (feedback).

The uncertainty of a pose follows from the curvature of the solved cost, or from the spread of a weighted set.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes
from hypose.body.skeleton import Skeleton
from hypose.fitting.articulated import PoseFit, SolveSettings, fit_poses
from hypose.fitting.problem import Quadratic
from hypose.geometry import Array, so3_exp, so3_log
from hypose.inference.estimates import tangent_mean
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Estimate
from hypose.tracking.frame_evidence import PreparedFrame, frame_energy, mean_overlap

SOLVED, COMPOSITE, RIVAL = "solved", "composite", "rival"
"""Roles: the solved hypothesis, the one that a search of single limbs composes, and other solved ones that are kept."""
LUMBAR_SD = 0.28
"""rad: usual flexion of the spine: root mean square over captured walking, running and boxing (7.8, 7.7 and 25 degrees,
CMU 02_01, 02_03 and 02_05, equal shares). Bending to the ground takes three times as much and is still found, since the
shoulders show it (Vazirian et al. 2016, lumbopelvic rhythm in the sagittal plane).
"""
_HELD = {"spine": 1.0, "neck": 1.0, "clavicle": 4.0, "ankle": 4.0}
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
    names = skeleton.dof_names
    weight = np.array([next((w for part, w in _HELD.items() if part in name), 0.09) for name in names])
    weight[:6] = 0
    if keypoints:
        weight[[n == "spine_rx" for n in names]] = LUMBAR_SD**-2
    return Quadratic(np.zeros(skeleton.dof), weight)


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
        fits = refine(frame.body, candidates, frame, self.options)
        poses = np.stack([f.pose for f in fits])
        worth = mismatch(poses, frame) if frame.silhouettes.seen else [f.cost for f in fits]
        winner = poses[np.argmin(worth)]
        values = s.clamp(h.values + (winner - mean))
        values[0] = winner
        return replace(h, values=values).marked(SOLVED, [0])


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
        # where the usual value is unknown a limb is searched as well
        apart = 1 - mean_overlap(frame.body, member(h, SOLVED), frame)
        return not apart <= self.unsettled * (1 - frame.usual_iou)


def member(h: Hypotheses, role: str) -> Array:
    """Return the value (D,) of the hypothesis with a role."""
    return h.values[h.has(role).argmax()]


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
    The pull to the prediction keeps body parts moving that no view sees. Its weight must stay small: at 3 per rad^2 and
    25 fps it held back arms that particles had found half a radian away, whose contour rows together are worth about
    one unit of cost.
    """
    weight = np.full(body.skeleton.dof, frame.prediction_weight)
    priors = (anatomical_prior(body.skeleton, frame.keypoints.seen), Quadratic(frame.prediction, weight))
    if frame.depth.seen:
        options = options._replace(tries=min(options.tries, DEPTH_TRIES))
    return fit_poses(body, starts, frame.terms, priors=priors, options=options)


def pose_mean(skeleton: Skeleton) -> Estimate:
    """Build the estimate by weighted mean pose; rotation vectors are averaged on SO(3), never as raw angles across
    +-pi.
    """
    return partial(tangent_mean, rotations=skeleton.ball_starts)


def solved(h: Hypotheses, /) -> Array:
    """Return the hypothesis (D,) with the role SOLVED as the estimate."""
    return member(h, SOLVED).copy()


# ---- uncertainty of a pose ------------------------------------------------------------------------------------------


# Rows of one contour err together, so do detections in neighbouring frames, a body is only nearly right, and lost limbs
# make tails: how far the curvature is from the truth is measured, not derived. With these factors the 90 % regions
# (ellipsoids) held the truth in 90 % of the joints of each group on synthetic scenes (walk, box, run, combo): from
# silhouettes on 64 scenes of the seeds 20 to 35, without the six worst for arms and legs, where a limb is lost; the
# others on 24 of the seeds 20 to 25. Those with silhouettes belong to the default weight of a contour row (0.05).
CURVATURE_FACTOR: Mapping[str, Mapping[str, float]] = {
    "silhouettes": {"torso": 0.70, "arms": 0.58, "legs": 0.49, "head": 0.14},
    "keypoints": {"torso": 0.48, "arms": 0.44, "legs": 0.42, "head": 0.60},
    "both": {"torso": 0.55, "arms": 0.51, "legs": 0.41, "head": 0.63},
    # with depth cameras the whole calibration is that of hypose.tracking.covariance_calibration
    "depth": {"torso": 0.5, "arms": 0.5, "legs": 0.5, "head": 0.5},
}
FLOOR = 0.004
"""m; smallest sd of a joint centre. With more, the regions of a head seen in silhouettes would hold more than 90 %."""
_SET_FLOOR = 0.02
"""rad, m; smallest sd of a coordinate of a weighted set, however few of its members survived."""


@dataclass(frozen=True)
class PoseUncertainty:
    """Uncertainty of one frame's pose; arrays are float32, since long recordings have many frames.

    joint_covariance: (J, 3, 3) covariance of each joint centre, m^2, world.
    information: (D (D + 1) / 2,) lower triangle of the inverse covariance of the pose from this frame alone, without
        the pull to the prediction, with the root's rotation as a small rotation in the world; for solving whole
        clips.
        Zero: no information.
    modes: the distinct poses that the frame allows (one row); None for methods without them.
    """

    joint_covariance: NDArray[np.float32]
    information: NDArray[np.float32]
    modes: Modes | None = None


def uncertainty_of_pose(pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> PoseUncertainty:
    """Compute the uncertainty of a solved pose (D,) from the inverse of the cost's Hessian.

    h: hypotheses with the roles SOLVED and RIVAL; frame: prepared, with the fit of the pose.
    Covariance of the joints = factor^2 H^-1 (CURVATURE_FACTOR), with the priors in H, so a joint that no view sees
    keeps the prior's spread. Each hypothesis with the role RIVAL adds its weight times the square of its joints'
    distances.
    """
    body = frame.body
    fit = frame.fits.get(body, pose)
    if fit is None:
        fit = refine(body, pose[None], frame, SolveSettings(iterations=0, coarse_iterations=0))[0]
    information = fit.information - frame.prediction_weight * np.eye(len(pose))
    around = joint_covariance_of(body, pose, fit.information, frame.kind)
    if (rivals := h.has(RIVAL)).any():
        joints = body.joints(np.concatenate([pose[None], h.values[rivals]]))
        apart = joints[1:] - joints[0]
        around = around + np.einsum("n,nja,njb->jab", h.weights[rivals], apart, apart).astype(np.float32)
        for weight, other in zip(h.weights[rivals], h.values[rivals], strict=True):
            step = other - pose
            step[3:6] = so3_log(so3_exp(other[3:6]) @ so3_exp(pose[3:6]).T)
            # the covariance grows by weight x step step^T (Sherman & Morrison 1950)
            seen = information @ step
            information = information - np.outer(seen, seen) * (weight / (1 + weight * (seen @ step)))
    return PoseUncertainty(around, packed(information))


def joint_covariance_of(body: Body, pose: Array, information: Array, evidence: str) -> NDArray[np.float32]:
    """Compute the covariances (J, 3, 3) of the joint centres, m^2, at a solved pose (D,).

    information: (D, D) inverse covariance of the pose, see `PoseFit.information`.
    evidence: kind of evidence in the cost, a key of CURVATURE_FACTOR.
    """
    factor = np.array([CURVATURE_FACTOR[evidence][joint_group(name)] for name in body.skeleton.joint_names])
    curvature = body.skeleton.informed_joint_covariances(pose, information)
    return (factor[:, None, None] ** 2 * curvature + FLOOR**2 * np.eye(3)).astype(np.float32)


def from_neighbours(around: NDArray[np.float32], frame_rate: float) -> NDArray[np.float32]:
    """Bound the covariances of joints in a solved clip by those of neighbouring frames.

    frame_rate: Hz.
    Why: a joint that a frame hardly shows lies between its places in the neighbouring frames; the bound is their
        covariance plus how far the path may bend in between (NEIGHBOUR_M_S2).
    around: (T, J, 3, 3) covariances computed from each frame by itself, m^2; NaN where a frame has none.
    Returns: (T, J, 3, 3) m^2.
    """
    given, out = around.astype(np.float64), around.astype(np.float64)
    least = np.trace(out, axis1=2, axis2=3)
    least[np.isnan(least)] = np.inf
    for k in range(1, min(round(NEIGHBOUR_S * frame_rate), len(out) - 1) + 1):
        bend = (0.5 * NEIGHBOUR_M_S2 * (k / frame_rate) ** 2) ** 2 * np.eye(3)
        for at, there in ((slice(k, None), slice(None, -k)), (slice(None, -k), slice(k, None))):
            other = given[there] + bend
            size = np.trace(other, axis1=2, axis2=3)
            better = size < least[at]
            out[at][better], least[at][better] = other[better], size[better]
    return out.astype(np.float32)


NEIGHBOUR_S, NEIGHBOUR_M_S2 = 0.25, 20.0
"""s to the furthest neighbours that are used; m/s^2, usual acceleration of a limb's joint"""


def joint_group(name: str) -> str:
    """Return the group of a joint by its name: arms (elbow, wrist), legs (knee, ankle), head, or torso (all others)."""
    if name.endswith(("elbow", "wrist")):
        return "arms"
    if name.endswith(("knee", "ankle")):
        return "legs"
    return "head" if name == "head" else "torso"


def uncertainty_of_set(pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> PoseUncertainty:
    """Compute the uncertainty of a pose from the spread of a weighted set (N, D).

    h: the set with its weights; frame: prepared for the body.
    """
    joints = frame.body.joints(h.values)
    apart = joints - np.einsum("n,nja->ja", h.weights, joints)
    around = np.einsum("n,nja,njb->jab", h.weights, apart, apart) + FLOOR**2 * np.eye(3)
    off = h.values - h.weights @ h.values
    turned = so3_log(so3_exp(h.values[:, 3:6]) @ so3_exp(pose[3:6]).T)
    off[:, 3:6] = turned - h.weights @ turned
    covariance = np.einsum("n,nd,ne->de", h.weights, off, off) + _SET_FLOOR**2 * np.eye(off.shape[1])
    return PoseUncertainty(around.astype(np.float32), packed(np.linalg.inv(covariance)))


def packed(information: Array) -> NDArray[np.float32]:
    """Pack a symmetric matrix (D, D) as its lower triangle (D (D + 1) / 2,), float32."""
    return information[np.tril_indices(len(information))].astype(np.float32)


def unpacked(triangles: ArrayLike, dof: int) -> Array:
    """Unpack lower triangles (T, D (D + 1) / 2) to symmetric matrices (T, D, D)."""
    triangles = np.asarray(triangles, dtype=np.float64)
    rows, columns = np.tril_indices(dof)
    out = np.zeros((len(triangles), dof, dof))
    out[:, rows, columns] = out[:, columns, rows] = triangles
    return out

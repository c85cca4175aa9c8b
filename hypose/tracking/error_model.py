"""Estimate the probability that a joint of a frame is wrong by more than 100 mm, with a logistic model of audit
features.

A Gaussian covariance describes the uncertainty around the estimated pose; it cannot describe an arm that is at another
place. So this probability is kept apart from the covariance. The weights were fitted to scenes
(scripts/train_error_model.py), one set per kind of evidence and group of joints.

The features come from the audit of a frame, the frames nearby and the whole clip (`clip_features`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import Motion
from hypose.geometry import Array, interpolated
from hypose.tracking.covariance_calibration import with_fitted_joints
from hypose.tracking.joint_features import AUDITED
from hypose.tracking.left_right import legs_crossed

# ---- features -------------------------------------------------------------------------------------------------------


AROUND_S = 0.25
"""s before and after a frame that count as nearby: errors last"""
_HIDDEN_S = 1.0
_CLEAR = 0.05
"""IoU by which the body turned around, or with exchanged legs, is worse where there is no doubt"""
_SLOW, _USUAL_PACE = 0.05, 0.35
"""m/s relative to the pelvis: slower limbs are at rest; pace assumed for limbs of which only one frame is known"""
_USUAL_LOOSE_M = 0.01  # for arms that were not searched
_LITTLE_M2 = 3e-4  # of uncovered mask
OF_CLIP = ("cost", "bare_second", "outside_body", "loose")
"""Quantities whose mean over a clip is a feature: it says what kind of clip it is. The same area of uncovered mask
means much in a clip that fits well, and little where the person wears a coat."""
FEATURES = (
    *("sd_around", "accel", "still"),
    *("bare", "bare_second", "bare_relative", "exposed", "exposed_second", "outside", "loose", "exchanged"),
    *("points_around", "points_worst", "points_all", "points_agree", "points_contested"),
    *(f"{n}_of_clip" for n in OF_CLIP),
)
"""Names of the features of a joint; see `clip_features`. Chosen from 44 by taking away one after the other, on seeds
that do not judge; motions that were left out lost nothing by it."""
MOST_SD = np.array([2.0 if n.endswith("_of_clip") else 6.0 for n in FEATURES])
"""(F,) largest number of sd by which a feature can lower the log-odds of an error.

Why: the means over the clip only qualify the other features; that a person fits badly all the time must not make a
clearly wrong arm look right.
"""


def clip_features(motion: Motion, raw_joints: Array, audit: ArrayLike) -> Array:
    """Compute the features (T, J, len(FEATURES)) of the joints of a clip; see FEATURES for their order.

    motion: the clip after smoothing.
    raw_joints: (T, J, 3) joints as tracked frame by frame, m.
    audit: (T, J, A) see `joint_features.AUDITED`.
    Features ("nearby" is +-AROUND_S; areas and shares are square roots, distances of key points are logs):
        sd_around: log of the joint's sd, mean nearby.
        accel: log of the largest acceleration of the tracked joint, nearby.
        still: slowness relative to the pelvis. Why: the frames of a limb at rest have the same error and make each
            other too certain.
        bare, bare_second: area of mask near the joint that the body does not cover, over all views, and in the view
            with the second largest area; bare_relative: log of bare_second relative to the median of the clip.
        exposed, exposed_second: share of the joint's part that nothing else covers, nearby.
        outside: share of the part outside the masks.
        loose: how far an arm may turn while the masks hardly change, nearby.
        exchanged: how well the body with exchanged sides fits; 0 where it is clearly worse or was not tried.
        points_around, points_worst: distance of the joint's key points, largest nearby and largest over the views.
        points_all: distance of all points of the frame.
        points_agree: views whose point is near; points_contested: how far the views against outweigh those that agree
            (one against one says nothing, two against one does).
        cost_of_clip, bare_second_of_clip, outside_body_of_clip, loose_of_clip: mean over all joints and all frames in
            which the person was found; cost: 1 - IoU; outside_body: share of the body outside the masks.
    Features of evidence that the clip does not have are 0.
    """
    a = {n: np.asarray(audit, dtype=np.float64)[..., k] for k, n in enumerate(AUDITED)}
    points = np.isfinite(a["points_all"])
    known = np.isfinite(a["exchanged"]).any()
    a |= {n: interpolated(a[n]) for n in ("loose", "exchanged")}
    a["loose"] = np.where(np.isnan(a["loose"]), _USUAL_LOOSE_M, a["loose"])
    a = {n: np.nan_to_num(v) for n, v in a.items()}
    rate, count = motion.frame_rate, motion.joints.shape[:2]
    around = 2 * max(1, round(AROUND_S * rate)) + 1
    accel = np.zeros(count)
    if len(motion) > 2:
        accel[1:-1] = np.linalg.norm(np.diff(raw_joints, 2, axis=0), axis=-1) * rate**2
    log_sd = np.log(np.clip(np.nan_to_num(motion.joint_sd, nan=1.0), 0.001, 1.0))
    # frames without a point of the joint get the distance from nearby frames
    gone = (a["points_views"] == 0) & points & (seconds_away(a["points_views"] > 0, rate) <= AROUND_S)
    for n in ("points_median", "points_worst"):
        a[n] = np.where(gone, interpolated(np.where(a["points_views"] > 0, a[n], np.nan)), a[n])
    against = a["points_against"] / np.maximum(a["points_agree"] ** 2 + a["points_against"], 1.0)
    second = mean_nearby(a["bare_second"], around)
    found = {
        "cost": np.nan_to_num(motion.cost)[:, None] * np.ones(count),
        "sd_around": np.asarray(uniform_filter1d(log_sd, around, axis=0, mode="nearest")),
        "accel": np.log1p(_highest(accel, around)),
        "still": -np.log(np.maximum(_pace(motion.joints, rate, around), _SLOW)),
        "bare": np.sqrt(a["bare"]),
        "bare_second": np.sqrt(second),
        "bare_relative": np.log((second + _LITTLE_M2) / (np.median(a["bare_second"].mean(1)) + _LITTLE_M2)),
        "exposed": mean_nearby(a["exposed"], around),
        "exposed_second": mean_nearby(a["exposed_second"], around),
        "outside": np.sqrt(a["outside"]),
        "outside_body": np.sqrt(a["outside"].mean(1, keepdims=True)) * np.ones(count),
        "loose": mean_nearby(a["loose"], around),
        "exchanged": np.where(known, np.maximum(a["exchanged"] + _CLEAR, 0.0) / _CLEAR, 0.0),
        "points_around": np.log(0.005 + _highest(a["points_median"], around)) * points,
        "points_worst": np.log(0.005 + a["points_worst"]) * points,
        "points_all": np.log(0.005 + a["points_all"]) * points,
        "points_agree": np.minimum(mean_nearby(a["points_agree"], around), 3) * points,
        "points_contested": mean_nearby(against, around) * points,
    }
    there = ~motion.lost if not motion.lost.all() else motion.lost
    found |= {f"{n}_of_clip": np.full(count, found[n][there].mean()) for n in OF_CLIP}
    return np.stack([found[n] for n in FEATURES], -1)


def _highest(values: Array, size: int) -> Array:
    """Compute the largest of the values (T, ...) over `size` frames around each frame."""
    return np.asarray(maximum_filter1d(values, size, axis=0, mode="nearest"))


def mean_nearby(values: Array, size: int) -> Array:
    """Average values (T, ...) over a window of `size` frames around each frame; negative results become 0."""
    return np.maximum(uniform_filter1d(values, size, axis=0, mode="nearest"), 0.0)


def _pace(joints: Array, rate: float, size: int) -> Array:
    """Compute the joints' speed (T, J) relative to the pelvis, m/s, averaged over `size` frames; _USUAL_PACE for one
    frame.
    """
    about = joints - joints[:, :1]
    if len(about) < 2:
        return np.full(about.shape[:2], _USUAL_PACE)
    return mean_nearby(np.linalg.norm(np.gradient(about, axis=0), axis=-1) * rate, size)


def seconds_away(seen: NDArray[np.bool_], rate: float) -> Array:
    """Compute the time (T, J), s, to the nearest frame in which a joint is seen, at most _HIDDEN_S."""
    most = _HIDDEN_S * rate
    out = np.full(seen.shape, most)
    for order in (range(len(seen)), range(len(seen) - 1, -1, -1)):
        gap = np.full(seen.shape[1], most)
        for t in order:
            gap = np.where(seen[t], 0.0, np.minimum(gap + 1, most))
            out[t] = np.minimum(out[t], gap)
    return out / rate


# ---- error model ----------------------------------------------------------------------------------------------------


WRONG_M = 0.1
GROUPS = ("head", "shoulders", "hips", "elbows", "wrists", "knees", "ankles")
TRUNK = 3
"""GROUPS: joints that share weights. TRUNK: the number of the first groups that are of the trunk, whose joints are
seldom wrong."""
_PARTS = (
    *(("neck", "head"), ("shoulder", "clavicle", "chest"), ("hip", "pelvis", "spine")),
    *(("elbow",), ("wrist",), ("knee",), ("ankle",)),
)
_NEXT: dict[str, tuple[str, ...]] = {
    "pelvis": ("left_hip", "right_hip"),
    "spine": ("pelvis",),
    "chest": ("neck",),
    "neck": ("head", "left_shoulder", "right_shoulder"),
    "head": ("neck",),
    "clavicle": ("shoulder",),
    "shoulder": ("neck", "elbow"),
    "elbow": ("shoulder", "wrist"),
    "wrist": ("elbow",),
    "hip": ("pelvis", "knee"),
    "knee": ("hip", "ankle"),
    "ankle": ("knee",),
}
"""Neighbours of a joint, by their names, or by their names without the side."""


@cache
def groups_of(names: tuple[str, ...]) -> NDArray[np.int64]:
    """Look up the group of each joint by its name; return (J,) indices in GROUPS, the list of joint groups with a
    model each; unknown names get the last group of the trunk.
    """
    parts = [name.rpartition("_")[2] for name in names]
    return np.array([next((g for g, own in enumerate(_PARTS) if part in own), TRUNK - 1) for part in parts])


@cache
def _nearby(names: tuple[str, ...]) -> Array:
    """Build the matrix (J, J) that averages over each joint's neighbours; a joint without neighbours keeps its own
    value.
    """
    out = np.zeros((len(names), len(names)))
    for j, name in enumerate(names):
        side, _, part = name.rpartition("_")
        near = [names.index(n) for p in _NEXT.get(part, ()) for n in (p, f"{side}_{p}") if n in names] or [j]
        out[j, near] = 1 / len(near)
    return out


@dataclass(frozen=True)
class ErrorModel:
    """Logistic model of the error probability of joints, for one kind of evidence; G groups of joints, F features.

    middle, scale: (F,) centre and scale that normalise the features.
    weights: (G, F), offset: (G,): log-odds of a joint from its own features.
    in_clip: (G, 6) weights of the terms of `within_clip`, for the final log-odds.
    threshold: (G,) probability above which a joint has low confidence.
    The methods take the joints' names (J,).
    """

    middle: Array
    scale: Array
    weights: Array
    offset: Array
    in_clip: Array
    threshold: Array

    def of_joints(self, features: Array, names: tuple[str, ...]) -> Array:
        """Compute the log-odds (T, J) that each joint is wrong, from its own features (T, J, F) alone.

        names: names of the J joints.
        """
        z, groups = np.clip((features - self.middle) / self.scale, -6.0, 6.0), groups_of(names)
        weights = self.weights[groups]
        return np.maximum(z * weights, -MOST_SD * np.abs(weights)).sum(-1) + self.offset[groups]

    def within(self, odds: Array, names: tuple[str, ...], clip: ArrayLike) -> Array:
        """Correct the log-odds (T, J) of `of_joints` by the error level of the clip and the neighbouring joints.

        clip: error level of the clip (`error_level`), one number or (T,).
        Returns: (T, J) log-odds.
        """
        return (within_clip(odds, names, clip) * self.in_clip[groups_of(names)]).sum(-1)

    def log_odds(self, features: Array, names: tuple[str, ...]) -> Array:
        """Compute the log-odds (T, J) that the joints of one clip are wrong, from their features (T, J, F).

        names: names of the J joints.
        """
        odds = self.of_joints(features, names)
        return self.within(odds, names, error_level(odds, names))


BY_ITSELF = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""`ErrorModel.in_clip` of joints whose log-odds depend on their own features alone."""
_SUREST = 9.0  # log-odds of a neighbour


def within_clip(odds: Array, names: tuple[str, ...], clip: ArrayLike) -> Array:
    """Build the terms that `ErrorModel.in_clip` weights.

    odds: (T, J) log-odds of joints by their own features.
    clip: error level of the clip, one number or (T,).
    Returns: (T, J, 6): 1, level, odds, odds x level, mean odds of the neighbours, that mean x level.
    """
    level = np.broadcast_to(np.asarray(clip)[..., None], odds.shape)
    near = np.clip(odds, -_SUREST, _SUREST) @ _nearby(names).T
    return np.stack([np.ones(odds.shape), level, odds, odds * level, near, near * level], -1)


CALM_P = 0.06
"""Mean error probability over a clip up to which its error level is 0."""


def error_level(odds: Array, names: tuple[str, ...]) -> float:
    """Compute the error level of a clip: the log of its mean error probability relative to CALM_P, at least 0.

    odds: (T, J) log-odds of joints; the mean is over the groups' means.
    Why: where the body as a whole is wrong, single joints are right by chance, and their features say less.
    """
    p, groups = probability(odds), groups_of(names)
    return float(np.log(max(np.mean([p[:, groups == g].mean() for g in np.unique(groups)]) / CALM_P, 1.0)))


@cache
def error_models() -> Mapping[str, ErrorModel]:
    """Load the fitted error models.

    Returns: dictionary with one model per kind of evidence: "silhouettes", "keypoints", "both" and "depth".
    """
    kept = json.loads(files("hypose.assets").joinpath("error_model.json").read_text(encoding="utf-8"))
    if kept["features"] != list(FEATURES) or kept["groups"] != list(GROUPS):
        raise ValueError("assets/error_model.json was fitted to other features; run scripts/train_error_model.py")
    return {
        evidence: ErrorModel(*(np.array(m[k]) for k in (f.name for f in fields(ErrorModel))))
        for evidence, m in kept["models"].items()
    }


def evidence_of(audit: ArrayLike) -> str:
    """Find out from an audit (T, J, A) which evidence there was: "silhouettes", "keypoints" or "both"."""
    a = np.asarray(audit)
    masks = bool(np.isfinite(a[..., AUDITED.index("bare")]).any())
    points = bool(np.isfinite(a[..., AUDITED.index("points_all")]).any())
    return "both" if masks and points else "keypoints" if points else "silhouettes"


def judged(
    motion: Motion, raw_joints: Array, audit: ArrayLike, unsure: Array | None = None, known: str | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Compute the error probability of every joint and frame, and which joints have low confidence.

    motion: the smoothed clip of T frames.
    raw_joints: (T, J, 3) joints as tracked frame by frame, before smoothing, m.
    audit: (T, J, A) see `joint_features.AUDITED`.
    unsure: (2, J) probability that each joint is elsewhere at the start, from `Starts.unsure`: body turned around
        (later frames may decide that); another posture. Both hold until the person has taken another pose.
    known: "depth" for depth cameras, which the audit does not show; None: the evidence is found from the audit.
    Returns: (T, J) probabilities of an error above WRONG_M; (T, J) true for joints of low confidence.
    With key points alone, no joint is more certain than its covariance says, and joints for which the set has no point
        never have low confidence. In frames without the person the probability is at least 0.5 and all joints have low
        confidence.
    """
    names = motion.skeleton.joint_names
    evidence = known or evidence_of(audit)
    model = error_models()[evidence]
    p = probability(model.log_odds(clip_features(motion, raw_joints, audit), names))
    p = np.maximum(p, _by_twisted_trunk(motion))
    if evidence == "keypoints":  # sets without some joints; masks show the whole body
        spread = with_fitted_joints(motion, evidence).joint_covariance
        p = np.maximum.reduce([p, _by_few_views(motion, audit), probability_by_spread(spread)])
    if evidence == "silhouettes":  # evidence beyond outlines shows which leg is which
        p = np.maximum(p, _by_crossed_legs(motion))
    if unsure is not None:
        turned, otherwise = unsure
        held = _as_at_start(motion)[:, None]
        p = 1 - (1 - p) * (1 - _open(audit) * turned * held) * (1 - otherwise * held)
    p = np.where(motion.lost[:, None], np.maximum(p, 0.5), p)
    threshold = model.threshold[groups_of(names)]
    low_confidence = (p > threshold) & ~(not_in_set(audit) if evidence == "keypoints" else np.False_)
    return p.astype(np.float32), np.asarray(low_confidence | motion.lost[:, None])


def not_in_set(audit: ArrayLike) -> NDArray[np.bool_]:
    """Find the joints (J,) for which the clip's set of key points has no point, from its audit (T, J, A).

    Nothing that a frame shows makes them better or worse known.
    """
    a = np.asarray(audit, dtype=np.float64)
    some = np.isfinite(a[..., AUDITED.index("points_all")]).any()
    return np.asarray(some & np.isnan(a[..., AUDITED.index("points_views")]).all(0))


def needs_review(p: ArrayLike, joints: NDArray[np.bool_], evidence: str) -> NDArray[np.bool_]:
    """Select the frames that need a review.

    p: (T, J) error probabilities of the joints.
    joints: (T, J) true for joints of low confidence.
    evidence: "silhouettes", "keypoints" or "both".
    Returns: (T,) true for frames with a joint of low confidence; with masks alone, in which many joints are slightly
        suspect, only where the probabilities of these joints sum to LOOK_P or more.
    """
    any_joint = np.asarray(joints.any(1), dtype=np.bool_)
    if evidence != "silhouettes":
        return any_joint
    return np.asarray(any_joint & (np.where(joints, p, 0.0).sum(1) >= LOOK_P), dtype=np.bool_)


LOOK_P = 0.25
"""Expected number of wrong joints from which a frame needs a review.

Why: joints have low confidence long before they are likely wrong, so that few errors are missed. On the training scenes
6 % of the good frames reach it (16 % have a joint of low confidence), and 91 % of those with a wrong arm (95 %).
"""


def probability(odds: Array) -> Array:
    """Convert log-odds to probabilities, 1 / (1 + exp(-odds))."""
    return 1 / (1 + np.exp(-np.clip(odds, -30.0, 30.0)))


def as_mixture(motion: Motion) -> Motion:
    """Widen the covariances of joints of low confidence to those of two cases: the joint is right, or it is wrong.

    motion: with error probabilities and joints of low confidence.
    A wrong joint is ELSEWHERE_M away in any direction, with its error probability. The standard deviations of the
    angles that move such a joint are widened in the same way, by ELSEWHERE_RAD.
    """
    return _with_other_case(motion, 1.0)


def without_mixture(motion: Motion) -> Motion:
    """Remove the widening that `as_mixture` added to the motion's covariances, so that they can be fitted again."""
    return _with_other_case(motion, -1.0)


def _with_other_case(motion: Motion, times: float) -> Motion:
    """Add the spread of the case that a joint of low confidence is wrong to a motion's covariances, `times` as often.

    times: 1 adds it, -1 removes it.
    """
    p, low_confidence = motion.error_probability, motion.low_confidence_joints
    assert p is not None and low_confidence is not None
    wrong = times * np.where(low_confidence, p, 0.0)
    around = motion.joint_covariance + (wrong * ELSEWHERE_M**2 / 3)[..., None, None] * np.eye(3)
    sd = motion.angle_sd
    if sd is not None:
        names = list(motion.skeleton.joint_names)
        variance = np.asarray(sd, np.float64) ** 2
        for angle, name in enumerate(ANGLE_NAMES):
            turned = _TURNED.get(name.split("_")[0])
            joint = None if turned is None else f"{'right' if name.endswith('_r') else 'left'}_{turned}"
            if joint in names:
                variance[:, angle] += wrong[:, names.index(joint)] * ELSEWHERE_RAD**2
        sd = np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)
    return replace(motion, joint_covariance=around.astype(np.float32), angle_sd=sd)


def probability_by_spread(covariance: ArrayLike) -> Array:
    """Compute the probability (...) of an error above WRONG_M along the least certain axis of covariances (..., 3, 3),
    m^2.

    Why: what no evidence shows is not known just because nothing contradicts it.
    """
    from scipy.special import ndtr  # takes long to import

    around = np.nan_to_num(np.asarray(covariance, dtype=np.float64), nan=1.0, posinf=1.0)
    return 2 * ndtr(-WRONG_M / np.sqrt(np.maximum(np.linalg.eigvalsh(around)[..., -1], 1e-8)))


ONE_VIEW = {"elbow": 0.5, "wrist": 0.6, "knee": 0.3, "ankle": 0.4}
"""Error probability of a joint that only one view shows, by its name without the side.

One view shows the direction of a joint, not its distance. Measured shares of frames, on scenes whose points have a
detector's errors, with one limb in one view.
"""
TWO_VIEWS, _MORE_VIEWS = {"elbow": 0.2, "wrist": 0.3, "knee": 0.3, "ankle": 0.3}, 3
"""TWO_VIEWS: error probability of a joint that only two views show, where at least _MORE_VIEWS views show the trunk.

The joint is then outside the other pictures, and one of the two points may be guessed; two rays agree wherever one of
them was guessed along the other. On scenes (below seed 1024) .37 of elbows and .63 to .66 of the others were wrong,
where a view was guessed in seven of ten; half of that is used.
"""


def _by_few_views(motion: Motion, audit: ArrayLike) -> Array:
    """Look up ONE_VIEW or TWO_VIEWS (T, J) for joints that no more views show, nor in nearby frames; 0 for the others.

    audit: (T, J, A).
    """
    views = np.nan_to_num(np.asarray(audit, dtype=np.float64)[..., AUDITED.index("points_views")])
    names = motion.skeleton.joint_names
    trunk = np.median(views[:, [n.endswith(("hip", "shoulder")) for n in names]], axis=1)
    out = np.zeros(views.shape)
    for most, how, where in ((1, ONE_VIEW, True), (2, TWO_VIEWS, trunk[:, None] >= _MORE_VIEWS)):
        alone = (views > 0) & where & (seconds_away(views > most, motion.frame_rate) > AROUND_S)
        out = np.maximum(out, alone * np.array([how.get(n.partition("_")[2], 0.0) for n in names]))
    return out


TWISTED_P, TWISTED_RAD = 0.5, np.radians(43)
"""Error probability of limbs while the trunk is twisted against the pelvis to its limit, and the angle of that, rad.

Legs or arms have then changed sides, or the person wears a coat. Of 30 000 frames of scenes (below seed 1162), with all
kinds of evidence, 50 were twisted so far, all of them wrong; the others by at most 42 degrees. A golf swing may reach
it, and is then marked for review.
"""


def _by_twisted_trunk(motion: Motion) -> Array:
    """Compute (T, J): TWISTED_P for limbs where the trunk is twisted, or in nearby frames; 0 elsewhere."""
    s = motion.skeleton
    limbs = np.array([n.startswith(("left_", "right_")) for n in s.joint_names])
    if motion.poses is None or "spine_rz" not in s.dof_names:
        return np.zeros((len(motion), len(limbs)))
    twisted = np.abs(motion.poses[:, s.dof_names.index("spine_rz")]) >= TWISTED_RAD
    near = seconds_away(twisted[:, None], motion.frame_rate) <= AROUND_S
    return np.where(near & limbs, TWISTED_P, 0.0)


CROSSED_P, CROSSED_M = 0.5, (0.05, 0.12)
"""Error probability of knees and ankles on the other leg's side; m along the hips' axis where it begins, and where it
is full.

People do cross their legs, but in 11 600 frames of scenes masks alone had an ankle 6 cm across in 276, all of them
wrong: skirts and coats hide which leg is which. In walking, running, boxing or balancing the ankles stay 1.5 to 9 cm
apart, on their own sides.
"""


def _by_crossed_legs(motion: Motion) -> Array:
    """Compute (T, J): CROSSED_P for knees and ankles of crossed legs, averaged over nearby frames; 0 elsewhere."""
    crossed = legs_crossed(motion.skeleton, motion.joints.astype(np.float64))
    share = np.clip((crossed - CROSSED_M[0]) / (CROSSED_M[1] - CROSSED_M[0]), 0.0, 1.0)
    around = 2 * max(1, round(AROUND_S * motion.frame_rate)) + 1
    below = [n.endswith(("knee", "ankle")) for n in motion.skeleton.joint_names]
    return CROSSED_P * mean_nearby(share[:, None], around) * np.array(below)


ELSEWHERE_M, ELSEWHERE_RAD = 0.2, 0.5
"""m, rad: root mean square error of wrong joints, over the training scenes (0.18 from key points), and the angle that
corresponds to it for a limb of 0.4 m."""
_TURNED = {"hip": "knee", "knee": "ankle", "arm": "elbow", "elbow": "wrist"}
"""Joint that an angle moves, by the beginning of the angle's name."""


def _open(audit: ArrayLike) -> float:
    """Compute how undecided a clip is about left and right: 0 decided, 1 the exchanged body fits as well or was never
    tried.

    It is 0 where the body with exchanged sides, which is tried while tracking, is clearly worse in most frames.
    """
    gain = np.asarray(audit, dtype=np.float64)[..., AUDITED.index("exchanged")]
    known = gain[np.isfinite(gain)]
    return float(np.clip(1 + np.median(known) / _DECIDED, 0.0, 1.0)) if len(known) else 1.0


_DECIDED = 0.03
"""IoU by which the exchanged body is worse, median, from which a clip is decided; in 32 correct clips it was 0.03 to
0.11"""
_OTHER_POSE_M = 0.15
"""m, mean over the joints relative to the pelvis: a person who moved this far is in another pose"""


def _as_at_start(motion: Motion) -> Array:
    """Compute (T,), from 1 down to 0, how far the person is still in the pose of the start.

    A new pose decides what the start left open.
    """
    about = motion.joints - motion.joints[:, :1]
    moved = np.maximum.accumulate(np.linalg.norm(about - about[0], axis=-1).mean(1))
    return np.exp(-((moved / _OTHER_POSE_M) ** 2))

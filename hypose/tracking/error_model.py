"""How likely each joint of each frame is wrong by more than 100 mm: a logistic of what a clip's audit found.

The covariance of a joint is that of the pose that is believed; no Gaussian covers the arm that is elsewhere. So this
probability is kept apart from the covariance. Its weights were fitted to scenes (scripts/train_doubt.py), one set per
kind of evidence and group of joints.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.tracking.covariance_calibration import beyond_usual, with_fitted_joints
from hypose.tracking.error_features import AROUND_S, FEATURES, MOST_SD, clip_features, mean_nearby, seconds_away
from hypose.tracking.joint_features import AUDITED
from hypose.tracking.left_right import legs_crossed

WRONG_M = 0.1
GROUPS = ("head", "shoulders", "hips", "elbows", "wrists", "knees", "ankles")
TRUNK = 3
"""Joints that are judged by the same weights; so many of the groups are of the trunk, whose joints are seldom wrong."""
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
"""Joints next to a joint, by their names, or those of the same side."""


@cache
def groups_of(names: tuple[str, ...]) -> NDArray[np.int64]:
    """(J,) indices in GROUPS of joints by their names; others are of the trunk."""
    parts = [name.rpartition("_")[2] for name in names]
    return np.array([next((g for g, own in enumerate(_PARTS) if part in own), TRUNK - 1) for part in parts])


@cache
def _nearby(names: tuple[str, ...]) -> Array:
    """(J, J) what each joint's neighbours count in their mean, of who has none the joint itself."""
    out = np.zeros((len(names), len(names)))
    for j, name in enumerate(names):
        side, _, part = name.rpartition("_")
        near = [names.index(n) for p in _NEXT.get(part, ()) for n in (p, f"{side}_{p}") if n in names] or [j]
        out[j, near] = 1 / len(near)
    return out


@dataclass(frozen=True)
class ErrorModel:
    """Of one kind of evidence. middle, scale (F,) of the features; weights (G, F), offset (G,): log-odds of a group's
    joint by itself; in_clip (G, 6): what those in the clip are made of, a constant and `doubt_of_clip`, the joint's own
    and how they change with that, the mean of its neighbours' and how they change; threshold (G,): from which
    probability on a joint is doubtful. Joints (J,) are given by their names."""

    middle: Array
    scale: Array
    weights: Array
    offset: Array
    in_clip: Array
    threshold: Array

    def of_joints(self, features: Array, names: tuple[str, ...]) -> Array:
        """(T, J) log-odds of joints by themselves, from features (T, J, F)."""
        z, groups = np.clip((features - self.middle) / self.scale, -6.0, 6.0), groups_of(names)
        weights = self.weights[groups]
        return np.maximum(z * weights, -MOST_SD * np.abs(weights)).sum(-1) + self.offset[groups]

    def within(self, odds: Array, names: tuple[str, ...], clip: ArrayLike) -> Array:
        """(T, J) those of joints in their clip, from `of_joints` and the clip's doubt, one number or (T,)."""
        return (within_clip(odds, names, clip) * self.in_clip[groups_of(names)]).sum(-1)

    def log_odds(self, features: Array, names: tuple[str, ...]) -> Array:
        """(T, J) of features (T, J, F) of joints of one clip."""
        odds = self.of_joints(features, names)
        return self.within(odds, names, doubt_of_clip(odds, names))


BY_ITSELF = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""`ErrorModel.in_clip` of joints that are judged by themselves."""
_SUREST = 9.0  # log-odds of a neighbour


def within_clip(odds: Array, names: tuple[str, ...], clip: ArrayLike) -> Array:
    """(T, J, 6) what `ErrorModel.in_clip` weighs, from log-odds (T, J) of joints by themselves and the clip's doubt."""
    doubt = np.broadcast_to(np.asarray(clip)[..., None], odds.shape)
    near = np.clip(odds, -_SUREST, _SUREST) @ _nearby(names).T
    return np.stack([np.ones(odds.shape), doubt, odds, odds * doubt, near, near * doubt], -1)


CALM_P = 0.06
"""Mean probability over a clip up to which its joints are judged by themselves."""


def doubt_of_clip(odds: Array, names: tuple[str, ...]) -> float:
    """Log of how many times CALM_P the mean probability of a clip is, 0 at least, from its joints' log-odds (T, J): the
    mean of the means over the groups that there are. Where the body as a whole is wrong, joints are right by chance,
    and what speaks for or against one of them is worth less."""
    p, groups = probability(odds), groups_of(names)
    return float(np.log(max(np.mean([p[:, groups == g].mean() for g in np.unique(groups)]) / CALM_P, 1.0)))


@cache
def error_models() -> Mapping[str, ErrorModel]:
    """The fitted models by evidence; that of depth is the one of masks that `DepthErrorModel` was fitted to."""
    kept = json.loads(files("hypose.assets").joinpath("doubt.json").read_text(encoding="utf-8"))
    if kept["features"] != list(FEATURES) or kept["groups"] != list(GROUPS):
        raise ValueError("assets/doubt.json belongs to other features; run scripts/train_doubt.py")
    return {
        evidence: ErrorModel(*(np.array(m[k]) for k in (f.name for f in fields(ErrorModel))))
        for evidence, m in kept["models"].items()
    }


def evidence_of(audit: ArrayLike) -> str:
    """What an audit (T, J, A) had to go by: silhouettes, keypoints or both."""
    a = np.asarray(audit)
    masks = bool(np.isfinite(a[..., AUDITED.index("bare")]).any())
    points = bool(np.isfinite(a[..., AUDITED.index("points_all")]).any())
    return "both" if masks and points else "keypoints" if points else "silhouettes"


def judged(
    motion: Motion, raw_joints: Array, audit: ArrayLike, unsure: Array | None = None, known: str | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(T, J) probability that a joint is wrong by more than WRONG_M, and which joints are doubtful for that.

    unsure (2, J): how likely each is elsewhere at the start (`Starts.unsure`: turned around, which frames may decide;
    in another posture), which holds until the person has taken another pose; known: what the evidence was, where the
    audit does not tell (depth is one). With key points nothing is surer than its covariance says; alone, joints of
    which their set has no point are doubtful in no frame. Of frames in which the person was lost nothing is believed:
    0.5 at least, and doubtful."""
    names = motion.skeleton.joint_names
    groups, evidence = groups_of(names), evidence_of(audit)
    model = error_models()[known if known == "depth" else evidence]
    odds = model.log_odds(clip_features(motion, raw_joints, audit), names)
    threshold = model.threshold[groups]
    if known == "depth":
        odds = depth_error_model().log_odds(odds, groups, motion.n_views)
        threshold = np.full(len(groups), DEPTH_DOUBTFUL)
    p = probability(odds)
    p = np.maximum(p, _by_twisted_trunk(motion))
    if evidence == "keypoints":
        p = np.maximum(p, _by_few_views(motion, audit))
    if (known or evidence) in ("keypoints", "both"):  # sets without some joints; masks show the whole body
        p = np.maximum(p, _by_spread(with_fitted_joints(motion, evidence, beyond_usual(audit, evidence))))
    if (known or evidence) == "silhouettes":  # evidence beyond outlines shows which leg is which
        p = np.maximum(p, _by_crossed_legs(motion))
    if unsure is not None:
        turned, otherwise = unsure
        held = _as_at_start(motion)[:, None]
        p = 1 - (1 - p) * (1 - _open(audit) * turned * held) * (1 - _misfit(motion) * otherwise * held)
    p = np.where(motion.lost[:, None], np.maximum(p, 0.5), p)
    low_confidence = (p > threshold) & ~(not_in_set(audit) if evidence == "keypoints" else np.False_)
    return p.astype(np.float32), np.asarray(low_confidence | motion.lost[:, None])


def not_in_set(audit: ArrayLike) -> NDArray[np.bool_]:
    """(J,) joints of which the set of key points of a clip with this audit (T, J, A) has no point: nothing that a frame
    shows makes them better or worse known."""
    a = np.asarray(audit, dtype=np.float64)
    some = np.isfinite(a[..., AUDITED.index("points_all")]).any()
    return np.asarray(some & np.isnan(a[..., AUDITED.index("points_views")]).all(0))


def needs_review(p: ArrayLike, joints: NDArray[np.bool_], evidence: str) -> NDArray[np.bool_]:
    """(T,) the doubtful frames, of how likely joints are wrong (T, J) and which are doubtful (T, J): those with a
    doubtful joint; from masks alone, in which many joints are a little doubtful, those with LOOK_P wrong ones to be
    expected among them."""
    any_joint = np.asarray(joints.any(1), dtype=np.bool_)
    if evidence != "silhouettes":
        return any_joint
    return np.asarray(any_joint & (np.where(joints, p, 0.0).sum(1) >= LOOK_P), dtype=np.bool_)


LOOK_P = 0.25
"""wrong joints to be expected in a frame for it to be worth a look: joints are doubtful long before they are likely
wrong, so that little is missed. On the scenes that the weights were fitted to it is so in 6 % of the good frames, where
16 % have a doubtful joint, and in 91 % of those with a wrong arm (95 % have a doubtful joint)."""


def probability(odds: Array) -> Array:
    """Of log-odds."""
    return 1 / (1 + np.exp(-np.clip(odds, -30.0, 30.0)))


@dataclass(frozen=True)
class DepthErrorModel:
    """What the log-odds of the model of depth, which is one of silhouettes, are worth where depth cameras saw, which
    keep little else wrong than what they do not see: level (S, G) of a group's joint before one sensor, two, S or more;
    slope (G,)."""

    level: Array
    slope: Array

    def log_odds(self, odds: Array, groups: NDArray[np.int64], sensors: ArrayLike) -> Array:
        """(T, J) from those by silhouettes (T, J), of joints in groups (J,), with so many sensors (T,)."""
        row = np.clip(np.asarray(sensors, dtype=np.int64), 1, len(self.level)) - 1
        return self.level[row][:, groups] + self.slope[groups] * odds


DEPTH_DOUBTFUL = 0.2
"""probability from which on a joint is doubtful before depth cameras: there six of ten are wrong (seeds 20 to 29)"""


@cache
def depth_error_model() -> DepthErrorModel:
    """As scripts/train_depth_spread.py fitted it."""
    kept = json.loads(files("hypose.assets").joinpath("depth_doubt.json").read_text(encoding="utf-8"))
    return DepthErrorModel(np.array(kept["level"]), np.array(kept["slope"]))


def as_mixture(motion: Motion) -> Motion:
    """The motion with the covariances of its doubtful joints those of two cases: the joint is where it is believed to
    be, or, with the probability that it is wrong, ELSEWHERE_M away in any direction; likewise the sd of the angles
    that turn such a joint."""
    return _with_other_case(motion, 1.0)


def without_mixture(motion: Motion) -> Motion:
    """What `as_mixture` was given: for fitting again."""
    return _with_other_case(motion, -1.0)


def _with_other_case(motion: Motion, times: float) -> Motion:
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


def _by_spread(motion: Motion) -> Array:
    """(T, J) how likely joints are further than WRONG_M off along the least certain axis of their covariance alone:
    what no evidence shows is not known by what speaks against it."""
    from scipy.special import ndtr  # takes long to import

    around = np.nan_to_num(motion.joint_covariance.astype(np.float64), nan=1.0, posinf=1.0)
    return 2 * ndtr(-WRONG_M / np.sqrt(np.maximum(np.linalg.eigvalsh(around)[..., -1], 1e-8)))


ONE_VIEW = {"elbow": 0.5, "wrist": 0.6, "knee": 0.3, "ankle": 0.4}
"""How likely a joint is wrong that one view alone shows, by its name without the side: a view says where it is, and not
how far away. Shares of the frames of scenes whose points err like a detector's, one limb in one view."""
TWO_VIEWS, _MORE_VIEWS = {"elbow": 0.2, "wrist": 0.3, "knee": 0.3, "ankle": 0.3}, 3
"""The same of a joint that two views show, and so many the trunk: it is outside the pictures of the others, and of the
two one may be guessed, which the other does not show: two rays that meet agree wherever one of them was guessed along.
On scenes (below seed 1024) .37 of elbows and .63 to .66 of the others were wrong, where a view was guessed in seven of
ten; half of that."""


def _by_few_views(motion: Motion, audit: ArrayLike) -> Array:
    """(T, J) ONE_VIEW or TWO_VIEWS of the joints whose key points no more views show, nearby in time either; else 0."""
    views = np.nan_to_num(np.asarray(audit, dtype=np.float64)[..., AUDITED.index("points_views")])
    names = motion.skeleton.joint_names
    trunk = np.median(views[:, [n.endswith(("hip", "shoulder")) for n in names]], axis=1)
    out = np.zeros(views.shape)
    for most, how, where in ((1, ONE_VIEW, True), (2, TWO_VIEWS, trunk[:, None] >= _MORE_VIEWS)):
        alone = (views > 0) & where & (seconds_away(views > most, motion.frame_rate) > AROUND_S)
        out = np.maximum(out, alone * np.array([how.get(n.partition("_")[2], 0.0) for n in names]))
    return out


TWISTED_P, TWISTED_RAD = 0.5, np.radians(43)
"""How likely limbs are wrong while the trunk is turned against the pelvis as far as it goes, and from where on it is:
legs or arms have then changed sides, or stand in a coat. Of 30 000 frames of scenes (below seed 1162) 50 were turned so
far, from all kinds of evidence, and wrong without exception; the others by at most 42 degrees. Who swings a golf club
may be turned so far, and is worth a look then."""


def _by_twisted_trunk(motion: Motion) -> Array:
    """(T, J) TWISTED_P of the limbs where the trunk is twisted, or nearby in time; else 0."""
    s = motion.skeleton
    limbs = np.array([n.startswith(("left_", "right_")) for n in s.joint_names])
    if motion.poses is None or "spine_rz" not in s.dof_names:
        return np.zeros((len(motion), len(limbs)))
    twisted = np.abs(motion.poses[:, s.dof_names.index("spine_rz")]) >= TWISTED_RAD
    near = seconds_away(twisted[:, None], motion.frame_rate) <= AROUND_S
    return np.where(near & limbs, TWISTED_P, 0.0)


CROSSED_P, CROSSED_M = 0.5, (0.05, 0.12)
"""How likely knees and ankles are wrong that lie on the other leg's side, by m along the hips' axis from which it
counts, and counts fully. People cross their legs, but of 11 600 frames of scenes those 276 were all wrong in which
masks alone had an ankle 6 cm across: skirts and coats hide which leg is which. Who walks, runs, boxes or balances keeps
the ankles 1.5 to 9 cm apart, on their own sides."""


def _by_crossed_legs(motion: Motion) -> Array:
    """(T, J) CROSSED_P of the knees and ankles of crossed legs, mean nearby in time; else 0."""
    crossed = legs_crossed(motion.skeleton, motion.joints.astype(np.float64))
    share = np.clip((crossed - CROSSED_M[0]) / (CROSSED_M[1] - CROSSED_M[0]), 0.0, 1.0)
    around = 2 * max(1, round(AROUND_S * motion.frame_rate)) + 1
    below = [n.endswith(("knee", "ankle")) for n in motion.skeleton.joint_names]
    return CROSSED_P * mean_nearby(share[:, None], around) * np.array(below)


ELSEWHERE_M, ELSEWHERE_RAD = 0.2, 0.5
"""m, rad: how far off joints are that are wrong, root mean square over the scenes that are trained on (0.18 from key
points), and what that is of a limb of 0.4 m."""
_TURNED = {"hip": "knee", "knee": "ankle", "arm": "elbow", "elbow": "wrist"}
"""Which joint an angle moves, by the beginning of its name."""


def _open(audit: ArrayLike) -> float:
    """How far the whole clip leaves open which way round the body is: 0 where the body with its sides exchanged, which
    is looked at while tracking, is plainly worse in most frames, 1 where it fits as well, or where it
    was never checked."""
    gain = np.asarray(audit, dtype=np.float64)[..., AUDITED.index("exchanged")]
    known = gain[np.isfinite(gain)]
    return float(np.clip(1 + np.median(known) / _DECIDED, 0.0, 1.0)) if len(known) else 1.0


def _misfit(motion: Motion) -> float:
    """How far the whole clip leaves open which posture the person is in: 0 where the body fits the masks as a right one
    does, 1 where it fits as badly as a wrong one (POSTURE_COST)."""
    cost = motion.cost[np.isfinite(motion.cost)]
    low, high = POSTURE_COST
    return float(np.clip((np.median(cost) - low) / (high - low), 0.0, 1.0)) if len(cost) else 1.0


POSTURE_COST = (0.1, 0.2)
"""1 - IoU, median of a clip, from which starts in another posture count, and count fully. Bodies that are right have
0.05 to 0.12, a seated man whose knees are 200 mm off (uu4cam) 0.20."""
_DECIDED = 0.03
"""IoU by which the other way round is worse in most frames where the clip has decided; in 32 clips that were right it
was 0.03 to 0.11"""
_OTHER_POSE_M = 0.15
"""m, mean over the joints about the pelvis: the person who has moved so far is in another pose"""


def _as_at_start(motion: Motion) -> Array:
    """(T,) from 1 down to 0: has the person been in the pose of the start until now? What a start leaves open, another
    pose decides."""
    about = motion.joints - motion.joints[:, :1]
    moved = np.maximum.accumulate(np.linalg.norm(about - about[0], axis=-1).mean(1))
    return np.exp(-((moved / _OTHER_POSE_M) ** 2))

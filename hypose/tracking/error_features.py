"""Compute the features from which a joint's error probability is estimated: from the audit, nearby frames and the
clip."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.tracking.joint_features import AUDITED, more_than_body, views_apart

AROUND_S = 0.25
"""s before and after a frame that count as nearby: errors last"""
_HIDDEN_S = 1.0
_CLEAR = 0.05
"""IoU by which the body turned around, or with exchanged legs, is worse where there is no doubt"""
_SLOW, _USUAL_PACE = 0.05, 0.35
"""m/s relative to the pelvis: slower limbs are at rest; pace assumed for limbs of which only one frame is known"""
_USUAL_LOOSE_M = 0.01  # for arms that were not searched
_LITTLE = 3e-4  # m^2 of uncovered mask
_OF_BODIES_M2 = 0.0022  # m^2 of uncovered mask per joint and view, median over a clip, without clothes or bags
_EXPOSED_SHARE = 0.25  # least share of a part that is visible in two views
OF_CLIP = ("cost", "outside_body", "bare_body", "log_sd", "loose", "outside", "bare_second", "rival")
"""Features whose mean over a clip is a feature too: it says what kind of clip it is. The same area of uncovered mask
means much in a clip that fits well, and little where the person wears a coat."""
FEATURES = (
    *(
        "log_sd",
        "sd_around",
        "moved",
        "accel",
        "still",
        "bare",
        "bare_more",
        "bare_second",
        "bare_beside",
        "bare_reach",
        "bare_body",
    ),
    *("exposed", "exposed_second", "hidden", "outside", "outside_body", "rival", "rival_around", "cost", "cost_more"),
    *("elsewhere", "elsewhere_by", "loose", "exchanged"),
    *("points", "points_worst", "points_around", "points_few", "points_unseen", "points_all"),
    *("points_agree", "points_against", "points_contested", "points_renamed", "apart", "more_mask"),
    *(f"{n}_of_clip" for n in OF_CLIP),
)
"""Names of the features of a joint; see `clip_features`."""
MOST_SD = np.array([2.0 if n.endswith("_of_clip") else 6.0 for n in FEATURES])
"""(F,) largest number of sd by which a feature can lower the log-odds of an error.

Why: the means over the clip only qualify the other features; that a person fits badly all the time must not make a
clearly wrong arm look right.
"""


def clip_features(motion: Motion, raw_joints: Array, audit: ArrayLike) -> Array:
    """Compute the features (T, J, len(FEATURES)) of the joints of a clip; see FEATURES for their order.

    raw_joints: (T, J, 3) joints as tracked frame by frame, m; motion: the clip after smoothing.
    audit: (T, J, A) see `joint_features.AUDITED`.
    Features ("nearby" is +-AROUND_S; most are square roots or logs of the quantity named here):
        log_sd: of the joint's sd; sd_around: its mean nearby.
        moved: largest distance between the tracked and the smoothed joint, nearby.
        accel: largest acceleration of the tracked joint, nearby.
        still: slowness relative to the pelvis. Why: the frames of a limb at rest have the same error and make each
        other too certain.
        bare, bare_*: area of mask that the body does not cover: near the joint (bare), beyond the usual in the clip
            (more), in the second worst view (second), there relative to the median of the clip (bare_beside), in the
        reach of the limb (reach), over the whole body (body).
        exposed, exposed_second: share of the joint's part that nothing else covers, smoothed; hidden: s to the nearest
            frame in which it is visible.
        outside, outside_body: share of the part, of the body, outside the masks.
        rival, rival_around: distance of the alternative poses.
        elsewhere, elsewhere_by, loose: how far away an arm could be that fits the masks as well.
        cost, cost_more: 1 - IoU, and beyond the usual.
        exchanged: how well the body with exchanged sides fits.
        points, points_worst, points_around, points_all: distance of the joint's key points, and of all of the frame.
        points_few, points_unseen: lack of views with the point; s to the nearest frame with two views.
        points_agree, points_against: views whose point is near, and far; points_contested: how far the views against
            outweigh those that agree (one against one says nothing, two against one does).
        points_renamed: share of the views whose names put the limb on the other side.
        apart: contradiction between the views, in the clip.
        more_mask: log of the uncovered mask area relative to that of a body alone; limbs may have been fitted into it.
        *_of_clip: mean over all joints and all frames in which the person was found.
    """
    a = {n: np.asarray(audit, dtype=np.float64)[..., k] for k, n in enumerate(AUDITED)}
    masks, points = np.isfinite(a["bare"]), np.isfinite(a["points_all"])
    known = np.isfinite(a["exchanged"]).any()
    a |= {n: _carried(a[n]) for n in ("elsewhere", "elsewhere_by", "loose", "exchanged")}
    a["loose"] = np.where(np.isnan(a["loose"]), _USUAL_LOOSE_M, a["loose"])
    a = {n: np.nan_to_num(v) for n, v in a.items()}
    rate, count = motion.frame_rate, motion.joints.shape[:2]
    around = 2 * max(1, round(AROUND_S * rate)) + 1
    moved = np.linalg.norm(raw_joints - motion.joints, axis=-1)
    accel = np.zeros(count)
    if len(motion) > 2:
        accel[1:-1] = np.linalg.norm(np.diff(raw_joints, 2, axis=0), axis=-1) * rate**2
    log_sd = np.log(np.clip(np.nan_to_num(motion.joint_sd, nan=1.0), 0.001, 1.0))
    cost = np.nan_to_num(motion.cost)[:, None] * np.ones(count)
    seen = np.where(masks, a["exposed_second"] > _EXPOSED_SHARE, False)
    two = a["points_views"] >= 2
    # frames without a point of the joint get the distance from nearby frames
    gone = (a["points_views"] == 0) & points & (seconds_away(a["points_views"] > 0, rate) <= AROUND_S)
    for n in ("points_median", "points_worst"):
        a[n] = np.where(gone, _carried(np.where(a["points_views"] > 0, a[n], np.nan)), a[n])
    second = mean_nearby(a["bare_second"], around)
    found = {
        "log_sd": log_sd,
        "sd_around": np.asarray(uniform_filter1d(log_sd, around, axis=0, mode="nearest")),
        "moved": np.sqrt(_highest(moved, around)),
        "accel": np.log1p(_highest(accel, around)),
        "still": -np.log(np.maximum(_pace(motion.joints, rate, around), _SLOW)),
        "bare": np.sqrt(a["bare"]),
        "bare_more": np.sqrt(_beyond(a["bare"])),
        "bare_second": np.sqrt(second),
        "bare_beside": np.log((second + _LITTLE) / (np.median(a["bare_second"].mean(1)) + _LITTLE)),
        "bare_reach": np.sqrt(a["bare_reach"]),
        "bare_body": np.sqrt(a["bare"].mean(1, keepdims=True)) * np.ones(count),
        "exposed": mean_nearby(a["exposed"], around),
        "exposed_second": mean_nearby(a["exposed_second"], around),
        "hidden": seconds_away(seen, rate) * masks,
        "outside": np.sqrt(a["outside"]),
        "outside_body": np.sqrt(a["outside"].mean(1, keepdims=True)) * np.ones(count),
        "rival": a["rival"],
        "rival_around": mean_nearby(a["rival"], around),
        "cost": cost,
        "cost_more": _beyond(cost),
        "elsewhere": np.sqrt(mean_nearby(a["elsewhere"], around)),
        "elsewhere_by": mean_nearby(a["elsewhere_by"], around),
        "loose": mean_nearby(a["loose"], around),
        "exchanged": np.where(known, np.maximum(a["exchanged"] + _CLEAR, 0.0) / _CLEAR, 0.0),
        "points": np.log(0.005 + a["points_median"]) * points,
        "points_worst": np.log(0.005 + a["points_worst"]) * points,
        "points_around": np.log(0.005 + _highest(a["points_median"], around)) * points,
        "points_few": (1 - np.minimum(a["points_views"], 3) / 3) * points,
        "points_unseen": seconds_away(two, rate) * points,
        "points_all": np.log(0.005 + a["points_all"]) * points,
        "points_agree": np.minimum(mean_nearby(a["points_agree"], around), 3) * points,
        "points_against": np.sqrt(mean_nearby(a["points_against"], around)) * points,
        "points_contested": mean_nearby(
            a["points_against"] / np.maximum(a["points_agree"] ** 2 + a["points_against"], 1.0), around
        )
        * points,
        "points_renamed": mean_nearby(a["renamed"], around)
        / np.maximum(mean_nearby(a["renamed"] + a["named"], around), 0.5)
        * points,
        "apart": np.full(count, np.sqrt(views_apart(audit))),
        "more_mask": np.full(count, np.log(max(more_than_body(audit, motion.n_views) / _OF_BODIES_M2, 1.0))),
    }
    there = ~motion.lost if not motion.lost.all() else motion.lost
    found |= {f"{n}_of_clip": np.full(count, found[n][there].mean()) for n in OF_CLIP}
    return np.stack([found[n] for n in FEATURES], -1)


def _highest(values: Array, size: int) -> Array:
    """Compute the largest of the values (T, ...) over `size` frames around each frame."""
    return np.asarray(maximum_filter1d(values, size, axis=0, mode="nearest"))


def mean_nearby(values: Array, size: int) -> Array:
    """Average values (T, ...) over `size` frames; negative results become 0."""
    return np.maximum(uniform_filter1d(values, size, axis=0, mode="nearest"), 0.0)


def _pace(joints: Array, rate: float, size: int) -> Array:
    """Compute the joints' speed (T, J) relative to the pelvis, m/s, averaged over `size` frames; _USUAL_PACE for one
    frame."""
    about = joints - joints[:, :1]
    if len(about) < 2:
        return np.full(about.shape[:2], _USUAL_PACE)
    return mean_nearby(np.linalg.norm(np.gradient(about, axis=0), axis=-1) * rate, size)


def _beyond(values: Array) -> Array:
    """Compute by how much values lie above their lower quartile over the clip; 0 below it."""
    return np.maximum(values - np.percentile(values, 25, axis=0), 0.0)


def _carried(values: Array) -> Array:
    """Fill unknown frames (NaN) of each joint (T, J) by linear interpolation in time; NaN where nothing is known."""
    out = values.copy()
    for j in range(values.shape[1]):
        at = np.flatnonzero(np.isfinite(values[:, j]))
        if 0 < len(at) < len(values):
            out[:, j] = np.interp(np.arange(len(values)), at, values[at, j])
    return out


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

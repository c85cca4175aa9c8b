"""Compute the features from which a joint's error probability is estimated: from the audit, nearby frames and the
clip.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.tracking.joint_features import AUDITED

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
    a |= {n: _carried(a[n]) for n in ("loose", "exchanged")}
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
        a[n] = np.where(gone, _carried(np.where(a["points_views"] > 0, a[n], np.nan)), a[n])
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

"""What a joint of a frame is judged by: what a clip's audit found about it, nearby in time, and over the clip."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.tracking.joint_features import AUDITED, more_than_body, views_apart

AROUND_S = 0.25
"""s before and after that a joint is judged by as well: the error lasts"""
_HIDDEN_S = 1.0
_CLEAR = 0.05
"""IoU by which the body turned around, or with its legs exchanged, is worse where there is no doubt about it"""
_SLOW, _USUAL_PACE = 0.05, 0.35
"""m/s about the pelvis: slower limbs are at rest; the pace of limbs of which one frame alone is known"""
_USUAL_LOOSE_M = 0.01  # of arms that were not looked at
_LITTLE = 3e-4  # m^2 of bare mask
_OF_BODIES_M2 = 0.0022  # m^2 of it about a joint in a view, median over a clip, that bodies alone in usual masks have
_EXPOSED_SHARE = 0.25  # share of a part that is exposed in two views at least
OF_CLIP = ("cost", "outside_body", "bare_body", "log_sd", "loose", "outside", "bare_second", "rival")
"""Features whose mean over a clip tells what kind of clip it is: the same patch of bare mask tells much in one that
fits well, and little where a person wears a coat."""
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
"""What a joint is judged by, see `clip_features`."""
MOST_SD = np.array([2.0 if n.endswith("_of_clip") else 6.0 for n in FEATURES])
"""(F,) sd from where on a feature speaks no more for a joint. What kind of clip it is tells how much the rest says:
that a person fits badly all the time must not make a plainly wrong arm a good one."""


def clip_features(motion: Motion, raw_joints: Array, audit: ArrayLike) -> Array:
    """(T, J, len(FEATURES)) of a motion whose frames were tracked as raw_joints (T, J, 3) m and audited (T, J, A).

    log_sd: of the joint's sd; sd_around: its mean nearby in time; moved: largest distance of the frame's own joint from
    the clip's, nearby in time; accel: the largest of its accelerations nearby; still: how slowly it moves about the
    pelvis, since all frames of a limb at rest err alike and make each other too sure; bare*: of mask without body, near
    the joint, beyond the usual in the clip, in the second-barest view, there relative to the usual of all joints of
    the clip (masks of one camera are worse than another's), in the limb's reach, over the whole body; exposed*: how
    much of its part nothing else covers, smoothed; hidden: s from when it was last seen, or to the next time; outside*:
    of the joint's part and of the body outside the masks; rival*: what else was believed; elsewhere*, loose: how far an
    arm may be elsewhere for all that the masks show; cost*: 1 - IoU, and beyond the usual; points*: distance of its key
    points and of the frame's, how few views have it, and for how long, how many agree or do not, and how far those that
    do not outweigh those that do: one against one tells nothing, two against one does, and which share of the views
    calls its limb by the other side's name; apart: by how much the views contradict each other in this clip; more_mask:
    log of how many times more its masks show next to the body than of a body alone: limbs may have been put into it;
    *_of_clip: mean over all joints, and the frames in which the person was found."""
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
    # a frame that shows no point of a joint has no distance to it; nearby frames have
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
    return np.asarray(maximum_filter1d(values, size, axis=0, mode="nearest"))


def mean_nearby(values: Array, size: int) -> Array:
    """Mean of values (T, ...), of 0 at least, over so many frames."""
    return np.maximum(uniform_filter1d(values, size, axis=0, mode="nearest"), 0.0)


def _pace(joints: Array, rate: float, size: int) -> Array:
    """(T, J) m/s about the pelvis, mean over so many frames; _USUAL_PACE of a single frame."""
    about = joints - joints[:, :1]
    if len(about) < 2:
        return np.full(about.shape[:2], _USUAL_PACE)
    return mean_nearby(np.linalg.norm(np.gradient(about, axis=0), axis=-1) * rate, size)


def _beyond(values: Array) -> Array:
    """Above the lower quartile over the clip."""
    return np.maximum(values - np.percentile(values, 25, axis=0), 0.0)


def _carried(values: Array) -> Array:
    """(T, J) with each joint's unknown frames filled from the nearest known one before and after, in equal shares by
    distance; NaN where nothing is known."""
    out = values.copy()
    for j in range(values.shape[1]):
        at = np.flatnonzero(np.isfinite(values[:, j]))
        if 0 < len(at) < len(values):
            out[:, j] = np.interp(np.arange(len(values)), at, values[at, j])
    return out


def seconds_away(seen: NDArray[np.bool_], rate: float) -> Array:
    """s to the nearest frame in which a joint is seen, at most _HIDDEN_S."""
    most = _HIDDEN_S * rate
    out = np.full(seen.shape, most)
    for order in (range(len(seen)), range(len(seen) - 1, -1, -1)):
        gap = np.full(seen.shape[1], most)
        for t in order:
            gap = np.where(seen[t], 0.0, np.minimum(gap + 1, most))
            out[t] = np.minimum(out[t], gap)
    return out / rate

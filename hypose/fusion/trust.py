"""What a sensor's joint is worth: how far off it is, how likely it is a guess, and what that leaves open when fused.

A sensor's errors are no white noise: a tracker puts the same joint of the same pose wrong in the same way in every
frame, and guesses the limbs that the body hides. Neither more frames nor sensors that see the same make that smaller.
The numbers maximise the likelihood of how far two real sensors lie apart, on the odd ones of 39 recordings
(docs/fusion.md); they stand for one Kinect v2, and for what is like it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose import compute
from hypose.evidence.frame import TRACKED
from hypose.fusion import joints as jt
from hypose.geometry import Array

_PARTS = np.array([0, 0, 1, 2, 2, 1, 2, 2, 0, 3, 4, 4, 3, 4, 4])  # trunk, shoulders, arms, hips, legs
OWN_SD_M = np.array([0.027, 0.033, 0.027, 0.044, 0.022])[_PARTS]
"""(15,) m per axis: sd of what a sensor that sees a joint puts wrong all along. It is that of the difference of two
sensors at right angles: half of it is the other one's, and stands for what all sensors have in common, such as where
in a hip its centre is, which no difference shows."""
HIDDEN_P = np.array([0.0, 0.56, 0.9, 0.12, 0.63])[_PARTS]
"""(15,) how likely a joint is guessed that the body hides wholly, on the side turned away from the sensor."""
BEHIND_P = np.where(_PARTS > 0, 0.8, 0.0)
"""(15,) how likely a joint is guessed by a sensor that sees the back."""
GUESSED_P, LEAST_P, _INFERRED = 0.064, 0.05, 0.5
"""How likely any joint is guessed; how likely it is seen at least, before its bone is looked at; what of the rest is
left to a joint that the sensor itself calls inferred (an assumption: the recordings hold no states)."""
GUESS_SD_M, JITTER_M = 0.1, 0.0085
"""m per axis: sd of a guess, and what neighbouring frames differ by."""
BONE_SD_M, MOST_OFF_M = (0.016, 0.052), 0.1
"""m: by how much the length of a joint's bone is off where a sensor sees it, and where it guesses; more counts as
much as MOST_OFF_M."""
LARGE_ERROR_M, DOUBTFUL_P = 0.1, 0.3
"""m from which on a joint is wrong, and how likely it must be so for the joint to be doubtful: hips of which nothing is
wrong have 0.2 to 0.28."""
_BONE = np.array(
    [jt.SKELETON_BONES.tolist().index(sorted((j, int(p)))) if p >= 0 else -1 for j, p in enumerate(jt.PARENT)]
)
_SIDES = np.array([0, 0, 1, 1, 1, -1, -1, -1, 0, 1, 1, 1, -1, -1, -1])


def what_is_open(
    positions: Array,
    states: NDArray[np.uint8],
    eyes: Array,
    left: Array,
    lengths: Array,
    joints: Array,
    variance: ArrayLike,
) -> tuple[Array, Array]:
    """Of fused joints (15, 3) m: the variance (15,) m^2 per axis that more frames or sensors would not reduce, and how
    likely (15,) each is wrong by more than LARGE_ERROR_M.

    positions (K, 15, 3) m registered, states (K, 15): of which they were fused; eyes (K, 3) m: where the sensors stand,
    NaN where it is not known; left (3,): to the person's left, of any length; lengths (18,) m of joints.BONES, 0 where
    unknown; variance (15,) m^2 per axis: of what averages away."""
    seen = seen_joints(positions, states, eyes, left, lengths)
    points, to = np.where(seen[..., None] > 0, positions, 0.0), eyes - joints[jt.TORSO]
    apart = ((points[:, None] - points) ** 2).sum(-1)
    alike = np.maximum(_cosine(to[:, None], to)[..., 0], 0.0)
    order = np.argsort(-seen, axis=0, kind="stable")
    systematic, wrong = np.empty(15), np.empty(15)
    compute.fusion.judge_claims(
        *(
            points - joints,
            apart,
            alike,
            seen,
            order,
            np.asarray(variance),
            OWN_SD_M,
            GUESS_SD_M,
            JITTER_M,
            LARGE_ERROR_M,
        ),
        *(systematic, wrong),
    )
    return systematic, wrong


def seen_joints(positions: Array, states: NDArray[np.uint8], eyes: Array, left: Array, lengths: Array) -> Array:
    """(K, 15) how likely each sensor sees each joint rather than guesses it, 0 where it reports none; see
    `what_is_open`."""
    to = eyes - positions[:, jt.TORSO]
    up = positions[:, jt.NECK] - (positions[:, jt.LEFT_HIP] + positions[:, jt.RIGHT_HIP]) / 2
    away = np.maximum(-_SIDES * _cosine(left, to), 0.0)
    behind = np.maximum(_cosine(np.cross(up, left), to), 0.0)
    seen = np.maximum(1 - GUESSED_P - HIDDEN_P * away**2 - BEHIND_P * behind, LEAST_P)
    seen = np.where(states == TRACKED, seen, _INFERRED * seen)
    off = np.linalg.norm(positions - positions[:, jt.PARENT], axis=-1) - np.where(_BONE >= 0, lengths[_BONE], 0.0)
    off = np.minimum(np.abs(off), MOST_OFF_M)
    right, guessed = (
        p * np.exp(-0.5 * (off / sd) ** 2) / sd for p, sd in zip((seen, 1 - seen), BONE_SD_M, strict=True)
    )
    known = np.isfinite(off) & (_BONE >= 0) & (lengths[_BONE] > 0)
    seen = np.where(known, right / (right + guessed), seen)
    return np.where((states > 0) & np.isfinite(positions[..., 0]), seen, 0.0)


def _cosine(a: Array, b: Array) -> Array:
    """(..., 1) of the angles between vectors (..., 3), 0 where it is not known."""
    square = (a * a).sum(-1) * (b * b).sum(-1)
    return np.nan_to_num((a * b).sum(-1) / np.sqrt(np.where(square > 0, square, np.nan)))[..., None]

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
GUESSED_P, INFERRED = 0.064, 0.5
"""How likely any joint is guessed; what of the rest is left to a joint that the sensor itself calls inferred (this one
is an assumption: the recordings hold no states)."""
GUESS_SD_M, JITTER_M = 0.1, 0.0085
"""m per axis: sd of a guess, and what neighbouring frames differ by."""
BONE_SD_M = np.array([0.016, 0.052])
"""(2,) m: by how much the length of a joint's bone is off where a sensor sees it, and where it guesses."""
WRONG_M, DOUBTFUL_P = 0.1, 0.3
"""m from which on a joint is wrong, and how likely it must be so for the joint to be doubtful: hips of which nothing is
wrong have 0.2 to 0.28."""
_TRUNK = np.array([jt.TORSO, jt.NECK, jt.LEFT_HIP, jt.RIGHT_HIP])
_BONE = np.array([jt.BONES.tolist().index(sorted((j, int(p)))) if p >= 0 else -1 for j, p in enumerate(jt.PARENT)])
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
    likely (15,) each is wrong by more than WRONG_M.

    positions (K, 15, 3) m registered, states (K, 15): of which they were fused; eyes (K, 3) m: where the sensors stand,
    NaN where it is not known; left (3,): to the person's left, of any length; lengths (18,) m of joints.BONES, 0 where
    unknown; variance (15,) m^2 per axis: of what averages away."""
    weights, systematic, wrong = np.empty(states.shape), np.empty(15), np.empty(15)
    of_bone = np.where(_BONE >= 0, lengths[_BONE], 0.0)
    compute.fusion.seen_not_guessed(
        *(positions, states, eyes, left, of_bone, _TRUNK, jt.PARENT, _SIDES),
        *(HIDDEN_P, BEHIND_P, GUESSED_P, INFERRED, BONE_SD_M, weights),
    )
    compute.fusion.judge_claims(
        *(positions, weights, eyes, joints, np.asarray(variance), OWN_SD_M, GUESS_SD_M, JITTER_M, WRONG_M),
        *(systematic, wrong),
    )
    return systematic, wrong

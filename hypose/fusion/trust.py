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
OWN_SD_M = np.array([0.027, 0.035, 0.029, 0.047, 0.031])[_PARTS]
"""(15,) m per axis: sd of what a sensor that sees a joint puts wrong all along. It is that of the difference of two
sensors at right angles: half of it is the other one's, and stands for what all sensors have in common, such as where
in a hip its centre is, which no difference shows."""
HIDDEN_P = np.array([0.0, 0.47, 0.87, 0.1, 0.32])[_PARTS]
"""(15,) how likely a joint is guessed that the body hides wholly, on the side turned away from the sensor."""
BEHIND_P = np.where(_PARTS > 0, 0.8, 0.0)
"""(15,) how likely a joint is guessed by a sensor that sees the back."""
GUESSED_P, INFERRED = 0.035, 0.5
"""How likely any joint is guessed; what of the rest is left to a joint that the sensor itself calls inferred (this one
is an assumption: the recordings hold no states)."""
GUESS_SD_M, JITTER_M = 0.125, 0.009
"""m per axis: sd of a guess, and what neighbouring frames differ by."""
WRONG_M, DOUBTFUL_P = 0.1, 0.3
"""m from which on a joint is wrong, and how likely it must be so for the joint to be doubtful: hips of which nothing is
wrong have 0.2 to 0.28."""
_TRUNK = np.array([jt.TORSO, jt.NECK, jt.LEFT_HIP, jt.RIGHT_HIP])
_SIDES = np.array([0, 0, 1, 1, 1, -1, -1, -1, 0, 1, 1, 1, -1, -1, -1])


def seen_joints(
    positions: Array, states: NDArray[np.uint8], eyes: Array, left: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """How likely each sensor sees each joint rather than guesses it (K, 15), 0 where it reports none; positions with 0
    for missing (K, 15, 3); and whether a joint is reported at all (15,).

    positions (K, 15, 3) m registered, states (K, 15); eyes (K, 3) m: where the sensors stand, NaN where it is not
    known; left (3,): to the person's left, any length."""
    weights, points, evidence = np.empty(states.shape), np.empty(positions.shape), np.empty(15, dtype=np.bool_)
    compute.fusion.weigh_joints(
        *(positions, states, eyes, left, _TRUNK, _SIDES, HIDDEN_P, BEHIND_P, GUESSED_P, INFERRED),
        *(weights, points, evidence),
    )
    return weights, points, evidence


def what_is_open(points: Array, weights: Array, eyes: Array, joints: Array, variance: ArrayLike) -> tuple[Array, Array]:
    """Of fused joints (15, 3) m: the variance (15,) m^2 per axis that more frames or sensors would not reduce, and how
    likely (15,) each is wrong by more than WRONG_M.

    points, weights: of `seen_joints`; eyes (K, 3); variance (15,) m^2 per axis: of the rest."""
    systematic, wrong = np.empty(15), np.empty(15)
    compute.fusion.judge_claims(
        *(points, weights, eyes, joints, np.asarray(variance), OWN_SD_M, GUESS_SD_M, JITTER_M, WRONG_M),
        *(systematic, wrong),
    )
    return systematic, wrong

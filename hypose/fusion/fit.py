"""The default fusion: an articulated fit to the joints of all sensors, causal, one small solve per frame.

The solve holds the distances between joints, weighs joints by the sensors' states, predicts by constant velocity, and
uses a robust loss whose scale is reduced in every frame, so that a joint can return from a wrong sensor. A sensor that
sees the back and takes left for right has its sides exchanged back. The uncertainty is the variance of the solve plus
the systematic errors of the sensors.
Why: 45 unknown coordinates with stiff distances instead of joint angles, because a sensor's skeleton has no shape
model, and the distances between shoulders, hips and torso hold a trunk that is not rigid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import fusion
from hypose.evidence.frame import TRACKED
from hypose.fusion import joints as jt
from hypose.geometry import Array, skew

_PARTS = np.array([0, 0, 1, 2, 2, 1, 2, 2, 0, 3, 4, 4, 3, 4, 4])  # trunk, shoulders, arms, hips, legs
OWN_SD_M = np.array([0.027, 0.033, 0.027, 0.044, 0.022])[_PARTS]
"""(15,) m per axis, sd of the constant error of a sensor in a joint that it sees.

It is the sd of the difference between two sensors at right angles. Half of it comes from the other sensor, and stands
for errors that all sensors have in common (such as the centre of the hip), which no difference shows.
"""
HIDDEN_P = np.array([0.0, 0.56, 0.9, 0.12, 0.63])[_PARTS]
"""(15,) probability that a sensor guesses a joint that the body hides wholly, on the side turned away from it."""
BEHIND_P = np.where(_PARTS > 0, 0.8, 0.0)
"""(15,) probability that a sensor that sees the back guesses a joint."""
GUESSED_P, LEAST_P, _INFERRED = 0.064, 0.05, 0.5
"""Three constants. GUESSED_P: probability that any joint is guessed. LEAST_P: least probability that a joint is seen,
before its bone length is checked. _INFERRED: factor of that probability for a joint that the sensor calls inferred (an
assumption: the recordings hold no states).
"""
GUESS_SD_M, JITTER_M = 0.1, 0.0085
"""m per axis. GUESS_SD_M: sd of a guessed joint. JITTER_M: sd of the difference between neighbouring frames."""
BONE_SD_M, MOST_OFF_M = (0.016, 0.052), 0.1
"""m. BONE_SD_M: sd of the length of a joint's bone where the sensor sees the joint, and where it guesses it.
MOST_OFF_M: larger deviations count as this.
"""
LARGE_ERROR_M, DOUBTFUL_P = 0.1, 0.3
"""LARGE_ERROR_M: error in m from which a joint is wrong. DOUBTFUL_P: probability of such an error from which a joint is
doubtful; hips without any fault have 0.2 to 0.28.
"""
_BONE = np.array(
    [jt.SKELETON_BONES.tolist().index(sorted((j, int(p)))) if p >= 0 else -1 for j, p in enumerate(jt.PARENT)]
)
_SIDE_SIGNS = np.array([0, 0, 1, 1, 1, -1, -1, -1, 0, 1, 1, 1, -1, -1, -1])


def remaining_uncertainty(
    positions: Array,
    states: NDArray[np.uint8],
    eyes: Array,
    left: Array,
    lengths: Array,
    joints: Array,
    variance: ArrayLike,
) -> tuple[Array, Array]:
    """Compute the error variance of fused joints that more frames would not reduce, and the probability of a large
    error.

    positions: (K, 15, 3) m, the registered joints that were fused.
    states: (K, 15), their states.
    eyes: (K, 3) m, positions of the sensors, NaN where unknown.
    left: (3,) direction to the person's left, of any length.
    lengths: (18,) m, lengths of joints.SKELETON_BONES, 0 where unknown.
    joints: (15, 3) m, the fused joints.
    variance: (15,) m^2 per axis, the part that averages out over frames and sensors.
    Returns: systematic variance (15,) m^2 per axis, and probability (15,) of an error above LARGE_ERROR_M.
    """
    seen = seen_joints(positions, states, eyes, left, lengths)
    points, to = np.where(seen[..., None] > 0, positions, 0.0), eyes - joints[jt.TORSO]
    apart = ((points[:, None] - points) ** 2).sum(-1)
    alike = np.maximum(_cosine(to[:, None], to)[..., 0], 0.0)
    order = np.argsort(-seen, axis=0, kind="stable")
    out, given = np.empty((2, 15)), (np.asarray(variance), OWN_SD_M, GUESS_SD_M, JITTER_M, LARGE_ERROR_M)
    fusion.judge_claims(points - joints, apart, alike, seen, order, *given, *out)
    return out[0], out[1]


def seen_joints(positions: Array, states: NDArray[np.uint8], eyes: Array, left: Array, lengths: Array) -> Array:
    """Compute the probability (K, 15) that each sensor sees each joint instead of guessing it, 0 where it reports
    none.

    positions: (K, 15, 3) m, registered joints.
    states: (K, 15) joint states (0 missing, 1 inferred, 2 tracked).
    eyes: (K, 3) m, positions of the sensors, NaN where unknown.
    left: (3,) direction to the person's left, of any length.
    lengths: (18,) m, lengths of joints.SKELETON_BONES, 0 where unknown.

    A joint is doubted where the body hides it from the sensor, where the sensor sees the back, where its state is
    inferred, and where its bone has an unusual length.
    """
    to = eyes - positions[:, jt.TORSO]
    up = positions[:, jt.NECK] - (positions[:, jt.LEFT_HIP] + positions[:, jt.RIGHT_HIP]) / 2
    away = np.maximum(-_SIDE_SIGNS * _cosine(left, to), 0.0)
    behind = np.maximum(_cosine(up @ skew(left), to), 0.0)
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
    """Compute the cosine (..., 1) of the angle between vectors (..., 3), 0 where unknown."""
    square = (a * a).sum(-1) * (b * b).sum(-1)
    return np.where(square > 0, (a * b).sum(-1) / np.sqrt(np.where(square > 0, square, 1.0)), 0.0)[..., None]


_SIDES = np.array([(jt.LEFT_SHOULDER, jt.RIGHT_SHOULDER), (jt.LEFT_HIP, jt.RIGHT_HIP)])
# (18,) m, standard deviations of the lengths of SKELETON_BONES: small for limbs, larger within the trunk.
_BONE_SD_M = np.array([15, 15, 8, 8, 15, 8, 8, 15, 20, 8, 8, 20, 8, 8, 15, 15, 20, 20]) / 1000
# Cosine of the angle between a sensor's direction to the left and that of all sensors below which its sides are
# exchanged (107 degrees).
_AGAINST = -0.3


_DATA_SD_M, _PREDICTION_SD_M, _SCALE_M = 0.02, 0.03, 0.05
"""m: sd of a sensor's joint, sd of the prediction per frame of 1/30 s, and scale of the Cauchy loss."""
_COARSE, _ITERATIONS = 8.0, 6
"""Factor of the scale in the first iteration, which is halved per iteration, and number of iterations per frame."""
_BLEND, _INFERRED_WEIGHT = 0.5, 0.5
"""Share of the new velocity in the smoothed one, and weight of inferred joints."""
LOST_AFTER_S = 0.5
"""s without any joint after which the person is lost."""


@dataclass(frozen=True)
class FitState:
    """Memory of the fit between two frames.

    joints: (15, 3) m, joints of the last frame; None before the first.
    velocity: (15, 3) m/s of the last frame.
    time: s of that frame.
    seen: (15,) s, time at which each joint last had evidence.
    side: (3,) remembered direction to the person's left, a sum of unit vectors.
    lengths: (18,) m, lengths of joints.SKELETON_BONES.
    samples: (18,) number of samples of each length.
    fixed: whether the lengths were given and do not adapt.
    """

    joints: Array | None
    velocity: Array
    time: float
    seen: Array
    side: Array
    lengths: Array
    samples: Array
    fixed: bool


@dataclass(frozen=True)
class FitEstimate:
    """Fused skeleton of one frame.

    joints: (15, 3) m.
    variance: (15,) m^2 per axis that more frames or sensors would reduce.
    systematic: (15,) m^2 per axis that they would not reduce.
    wrong: (15,) probability that a joint is off by more than LARGE_ERROR_M.
    shares: (15, K) share of each sensor in each joint; 0 where no sensor saw it.
    lost: whether there was no evidence for too long.
    """

    joints: Array
    variance: Array
    systematic: Array
    wrong: Array
    shares: Array
    lost: bool


def start_fit(lengths: ArrayLike | None = None) -> FitState:
    """Make the state before the first frame.

    lengths: (18,) m, lengths of joints.SKELETON_BONES where known (0 = unknown), which are then kept; None: they are
        estimated from the frames.
    """
    return FitState(
        None,
        np.zeros((15, 3)),
        np.nan,
        np.full(15, -np.inf),
        np.zeros(3),
        np.zeros(len(jt.SKELETON_BONES)) if lengths is None else np.array(lengths, dtype=np.float64),
        np.zeros(len(jt.SKELETON_BONES)),
        lengths is not None,
    )


def fit_step(
    state: FitState, positions: Array, states: NDArray[np.uint8], time: float, eyes: Array
) -> tuple[FitState, FitEstimate]:
    """Fuse the joints of all sensors in one frame.

    state: memory of the frames before.
    positions: (K, 15, 3) m registered, NaN where missing.
    states: (K, 15) joint states.
    time: s of the frame.
    eyes: (K, 3) m, positions of the sensors, NaN where unknown.
    Returns: the new memory and the fused skeleton.
    """
    # a joint of a sensor that is not registered has a state but no position
    states = np.where(np.isfinite(positions[..., 0]), states, 0).astype(np.uint8)
    positions, states, side = unswap(positions, states, state.side)
    lengths, samples = state.lengths, state.samples
    if not state.fixed:
        lengths, samples, _ = adapt_lengths(positions, states, lengths, samples)
    weights = np.where(states == TRACKED, 1.0, np.where(states > 0, _INFERRED_WEIGHT, 0.0))
    points, evidence = np.where(states[..., None] > 0, positions, 0.0), (weights > 0).any(0)
    dt = 1 / 30 if not np.isfinite(state.time) else max(time - state.time, 1e-3)
    start = state.joints
    if start is None:
        # weighted means of the sensors' joints; joints that none reports start in the middle of the others
        total = weights.sum(0)[:, None]
        mean = (weights[..., None] * points).sum(0) / np.maximum(total, 1e-9)
        start = np.where(total > 0, mean, mean[total[:, 0] > 0].mean(0) if evidence.any() else 0.0)
        predicted, prior = start, np.ones(15)
    else:
        # a joint that is long unseen slows down and may be anywhere: its bones hold it
        away = np.minimum(time - state.seen, 1.0)
        predicted = start + state.velocity * (dt * np.where(evidence, 1.0, np.exp(-10 * away)))[:, None]
        prior = 1 / (_PREDICTION_SD_M * np.maximum(1.0, 30 * away)) ** 2
    x, share, variance = fusion.fit_frame(
        points,
        weights,
        predicted,
        prior,
        jt.SKELETON_BONES,
        lengths,
        1 / _BONE_SD_M**2,
        1 / _DATA_SD_M**2,
        _SCALE_M,
        _COARSE,
        _ITERATIONS,
    )
    seen = np.where(evidence, time, state.seen)
    if state.joints is None:
        velocity = np.zeros((15, 3))
    else:
        velocity = (1 - _BLEND) * state.velocity + _BLEND * (x - state.joints) / dt
    lost = bool(time - seen.max() > LOST_AFTER_S)
    new = FitState(x, velocity, time, seen, side, lengths, samples, state.fixed)
    if lost or (state.joints is None and not evidence.any()):
        new = replace(new, joints=None, velocity=np.zeros((15, 3)), side=np.zeros(3))
    systematic, wrong = remaining_uncertainty(positions, states, eyes, side, lengths, x, variance)
    return new, FitEstimate(x, variance, systematic, wrong, share.T.copy(), lost)


def unswap(positions: Array, states: NDArray[np.uint8], side: Array) -> tuple[Array, NDArray[np.uint8], Array]:
    """Exchange left and right of sensors whose sides contradict the other sensors and the memory.

    positions: (K, 15, 3) m registered.
    states: (K, 15) joint states.
    side: (3,) remembered direction to the left.
    Returns: positions, states, and the new memory (3,).
    """
    left, right = _SIDES.T
    known = (states[:, left] > 0) & (states[:, right] > 0)
    to_left = np.where(known[..., None], positions[:, left] - positions[:, right], 0.0).sum(1)
    to_left /= np.maximum(np.linalg.norm(to_left, axis=1, keepdims=True), 1e-3)
    consensus = 2 * side + to_left.sum(0)
    limit = _AGAINST * np.linalg.norm(consensus)
    swapped = (to_left @ consensus < limit) & (limit < 0)
    positions = np.where(swapped[:, None, None], positions[:, jt.MIRROR], positions)
    states = np.where(swapped[:, None], states[:, jt.MIRROR], states)
    total = (np.where(swapped, -1.0, 1.0)[:, None] * to_left).sum(0)
    return positions, states, 0.8 * side + 0.2 * total if side.any() else total


def adapt_lengths(
    positions: Array,
    states: NDArray[np.uint8],
    lengths: Array,
    samples: Array,
    bones: NDArray[np.int64] = jt.SKELETON_BONES,
    most: int = 600,
) -> tuple[Array, Array, Array]:
    """Update bone lengths causally by one frame.

    positions: (K, 15, 3) m.
    states: (K, 15) joint states.
    lengths, samples: (B,) lengths in m and number of samples of each bone.
    bones: (B, 2) pairs of joints.
    most: number of samples from which the steps do not become smaller.
    Returns: new lengths, numbers of samples, and the lengths (K, B) m that the sensors see. A length moves by a limited
        step towards each tracked sample, smaller with more samples: a slow median that one bad episode does not move.
    """
    d = positions[:, bones[:, 0]] - positions[:, bones[:, 1]]
    measured = np.sqrt((d * d).sum(-1))
    tracked = states == TRACKED
    good = tracked[:, bones[:, 0]] & tracked[:, bones[:, 1]]
    n = good.sum(0)
    fresh = (samples == 0) & (n > 0)
    if fresh.any():
        lengths = lengths.copy()
        for b in np.flatnonzero(fresh):
            lengths[b] = np.median(measured[good[:, b], b])
    count = samples + n
    step = np.where(good, np.clip(np.where(good, measured, 0.0) - lengths, -0.03, 0.03), 0.0).sum(0)
    return lengths + step / np.clip(count, 1, most), count, measured


def clip_lengths(positions: ArrayLike, states: ArrayLike) -> Array:
    """Compute the bone lengths of a whole clip: the median over the tracked samples.

    positions: (T, K, 15, 3) m.
    states: (T, K, 15) joint states.
    Returns: (18,) m of joints.SKELETON_BONES. With 20 tracked samples or fewer all samples count; 0 where there is
        none.
    """
    s = np.asarray(positions, dtype=np.float64)
    a, b = jt.SKELETON_BONES[:, 0], jt.SKELETON_BONES[:, 1]
    length = np.linalg.norm(s[:, :, a] - s[:, :, b], axis=-1)
    tracked = np.asarray(states) == TRACKED
    good = tracked[:, :, a] & tracked[:, :, b] & np.isfinite(length)
    use = np.where(good.sum((0, 1)) > 20, good, np.isfinite(length))
    return np.array([np.median(d[u]) if u.any() else 0.0 for d, u in zip(length.T, use.T, strict=True)])

"""The default fusion: an articulated fit over the joints of all sensors, causal, one small solve per frame.

Constant distances between joints, a robust loss that is graduated in every frame (so that a joint can come back from a
wrong sensor), a constant-velocity prediction, the SDK's confidence as weight, and sides exchanged back when a sensor
that sees the back takes left for right. 45 unknowns with distances as stiff rows rather than joint angles: a sensor
skeleton has no shape behind it, and distances between shoulders, hips and torso hold a trunk that is not rigid.
Uncertainty: the solve's own variance, plus what the sensors' systematic errors leave open (fusion.trust).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose import compute
from hypose.evidence.frame import TRACKED
from hypose.fusion import joints as jt
from hypose.fusion.trust import what_is_open
from hypose.geometry import Array

_SIDES = np.array([(jt.LEFT_SHOULDER, jt.RIGHT_SHOULDER), (jt.LEFT_HIP, jt.RIGHT_HIP)])
_AGAINST = -0.3
"""Cosine between the direction to the left of a sensor and of all below which its sides are exchanged: 107 degrees"""


def _bone_sd() -> Array:
    """(18,) m: limbs hold their length, the trunk's stays give more."""
    limb = {(2, 3), (3, 4), (5, 6), (6, 7), (9, 10), (10, 11), (12, 13), (13, 14)}
    stay = {(8, 9), (8, 12), (2, 8), (5, 8)}
    return np.array(
        [0.008 if tuple(b) in limb else 0.020 if tuple(b) in stay else 0.015 for b in jt.SKELETON_BONES.tolist()]
    )


@dataclass(frozen=True)
class FitSettings:
    """data_sd_m, scale_m: sd and Cauchy scale of a sensor's joint; coarse: the scale starts at this multiple and is
    halved per iteration; iterations; bone_sd_m (18,); prediction_sd_m: per frame of 1/30 s; blend: how fast the
    velocity follows; inferred: weight of inferred joints; unswap: exchange sides back; lost_after_s: without
    any joint for this long the person is lost."""

    data_sd_m: float = 0.02
    scale_m: float = 0.05
    coarse: float = 8.0
    iterations: int = 6
    bone_sd_m: Array = field(default_factory=_bone_sd)
    prediction_sd_m: float = 0.03
    blend: float = 0.5
    inferred: float = 0.5
    unswap: bool = True
    lost_after_s: float = 0.5

    @cached_property
    def bone_weight(self) -> Array:
        """(18,) 1/m^2."""
        return 1 / self.bone_sd_m**2


@dataclass(frozen=True)
class FitState:
    """joints (15, 3) m and velocity (15, 3) m/s of the last frame, or None before the first; time s of that frame; seen
    (15,) s when each joint last had evidence; side (3,): remembered direction to the person's left, a sum of unit
    vectors; lengths (18,) m and samples (18,) of the bones; fixed: lengths are given and do not adapt."""

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
    """joints (15, 3) m; variance (15,) m^2 per axis that more frames or sensors would reduce, and systematic (15,),
    which they would not; wrong (15,): how likely a joint is off by more than trust.WRONG_M; shares (15, K): what each
    sensor carried of each joint (0 everywhere where no sensor saw it); swapped (K,) sensors whose sides were exchanged;
    lost: no evidence for too long."""

    joints: Array
    variance: Array
    systematic: Array
    wrong: Array
    shares: Array
    swapped: NDArray[np.bool_]
    lost: bool


def start_fit(lengths: ArrayLike | None = None) -> FitState:
    """Before the first frame; lengths (18,) m of joints.BONES when they are known (0 = unknown), else they are
    estimated as frames come in."""
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
    state: FitState, positions: Array, states: NDArray[np.uint8], time: float, settings: FitSettings, eyes: Array
) -> tuple[FitState, FitEstimate]:
    """One frame: registered positions (K, 15, 3) m with NaN for missing, their states (K, 15), time s; eyes (K, 3) m:
    where the sensors stand, NaN where it is not known."""
    # a joint of a sensor that is not registered has a state but no place
    states = np.where(np.isfinite(positions[..., 0]), states, 0).astype(np.uint8)
    side, swapped = state.side, np.zeros(len(positions), dtype=np.bool_)
    if settings.unswap:
        positions, states, side, swapped = unswap(positions, states, state.side)
    lengths, samples = state.lengths, state.samples
    if not state.fixed:
        lengths, samples = adapt_lengths(positions, states, lengths, samples)
    weights = np.where(states == TRACKED, 1.0, np.where(states > 0, settings.inferred, 0.0))
    points, evidence = np.where(states[..., None] > 0, positions, 0.0), (weights > 0).any(0)
    dt = 1 / 30 if not np.isfinite(state.time) else max(time - state.time, 1e-3)
    start = state.joints
    if start is None:
        start = _first_guess(points, weights)
        predicted, prior = start, np.ones(15)
    else:
        # a joint that is long unseen slows down and may be anywhere: its bones hold it
        away = np.minimum(time - state.seen, 1.0)
        predicted = start + state.velocity * (dt * np.where(evidence, 1.0, np.exp(-10 * away)))[:, None]
        prior = 1 / (settings.prediction_sd_m * np.maximum(1.0, 30 * away)) ** 2
    x = predicted.copy()
    share = np.zeros(weights.shape)
    variance = np.zeros(15)
    compute.fusion.fit_frame(
        points,
        weights,
        predicted,
        prior,
        jt.SKELETON_BONES,
        lengths,
        settings.bone_weight,
        1 / settings.data_sd_m**2,
        settings.scale_m,
        settings.coarse,
        settings.iterations,
        x,
        share,
        variance,
    )
    seen = np.where(evidence, time, state.seen)
    if state.joints is None:
        velocity = np.zeros((15, 3))
    else:
        velocity = (1 - settings.blend) * state.velocity + settings.blend * (x - state.joints) / dt
    lost = bool(time - seen.max() > settings.lost_after_s)
    new = FitState(x, velocity, time, seen, side, lengths, samples, state.fixed)
    if lost or (state.joints is None and not evidence.any()):
        new = replace(new, joints=None, velocity=np.zeros((15, 3)), side=np.zeros(3))
    systematic, wrong = what_is_open(positions, states, eyes, side, lengths, x, variance)
    return new, FitEstimate(x, variance, systematic, wrong, share.T.copy(), swapped, lost)


def unswap(
    positions: Array, states: NDArray[np.uint8], side: Array
) -> tuple[Array, NDArray[np.uint8], Array, NDArray[np.bool_]]:
    """Exchanges left and right of sensors whose sides contradict the others and the memory.

    positions (K, 15, 3) registered; side (3,): remembered direction to the left. Returns positions, states, the new
    memory and which sensors were exchanged (K,)."""
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
    return positions, states, 0.8 * side + 0.2 * total if side.any() else total, swapped


def adapt_lengths(positions: Array, states: NDArray[np.uint8], lengths: Array, samples: Array) -> tuple[Array, Array]:
    """Causal bone lengths: a limited step towards every tracked sample, smaller as samples accumulate (a slow median
    that one bad episode does not move)."""
    d = positions[:, jt.SKELETON_BONES[:, 0]] - positions[:, jt.SKELETON_BONES[:, 1]]
    measured = np.sqrt((d * d).sum(-1))
    tracked = states == TRACKED
    good = tracked[:, jt.SKELETON_BONES[:, 0]] & tracked[:, jt.SKELETON_BONES[:, 1]]
    n = good.sum(0)
    fresh = (samples == 0) & (n > 0)
    if fresh.any():
        lengths = lengths.copy()
        for b in np.flatnonzero(fresh):
            lengths[b] = np.median(measured[good[:, b], b])
    count = samples + n
    step = np.where(good, np.clip(np.where(good, measured, 0.0) - lengths, -0.03, 0.03), 0.0).sum(0)
    return lengths + step / np.clip(count, 1, 600), count


def clip_lengths(positions: ArrayLike, states: ArrayLike) -> Array:
    """(18,) m lengths of joints.BONES from a whole clip, positions (T, K, 15, 3): median over the tracked samples, over
    all samples where there are fewer than 20 of those, 0 where there is none."""
    s = np.asarray(positions, dtype=np.float64)
    a, b = jt.SKELETON_BONES[:, 0], jt.SKELETON_BONES[:, 1]
    length = np.linalg.norm(s[:, :, a] - s[:, :, b], axis=-1)
    tracked = np.asarray(states) == TRACKED
    good = tracked[:, :, a] & tracked[:, :, b] & np.isfinite(length)
    out = np.zeros(len(jt.SKELETON_BONES))
    for i in range(len(out)):
        use = good[..., i] if good[..., i].sum() > 20 else np.isfinite(length[..., i])
        if use.any():
            out[i] = np.median(length[..., i][use])
    return out


def _first_guess(points: Array, weights: Array) -> Array:
    """Weighted means; joints that nobody sees start at the mean of the others."""
    total = weights.sum(0)
    if not (total > 0).any():
        return np.zeros((15, 3))
    mean = (weights[..., None] * points).sum(0) / np.maximum(total, 1e-9)[:, None]
    return np.where((total > 0)[:, None], mean, mean[total > 0].mean(0))

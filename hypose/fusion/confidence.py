"""Compute the noise of each joint of each sensor from three measures: inverse fluidity F, depth error D, unnatural
posture A.

Source of the measures: Asteriadis et al. 2013, section 2.3, eq. 5-6; each is divided by its maximum over the sensors
(section 2.4). Deviations, each with its own setting: D subtracts the thickness of the body in front of the joint, keeps
the last valid error over holes of the depth map, and is clipped and floored; the sensor's own joint state and the
deviation of bone lengths are merged into D.

Source of the noise: a Mamdani fuzzy inference with the five rules of section 2.4: AND = min, OR = max, implication =
product, aggregation = algebraic sum, defuzzification = centroid. Rule 2 is printed "D high OR F high AND A high"
without precedence; here AND binds tighter. The paper gives 0.3 as the sigma of every set, but no centres and no slopes;
the defaults place the noise of all-low and all-high inputs as the text says.
Limits: with these rules the noise lies between 0.42 and 0.74 only, and "F high" or "A high" alone give 0.5, as if no
    rule fired. As a weight it is worth little; as a preference repeated in every frame it selects sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.evidence.frame import TRACKED
from hypose.fusion import joints as jt
from hypose.fusion.fit import adapt_lengths
from hypose.geometry import Array

THICKNESS_M = np.array([90, 60, 65, 48, 42, 65, 48, 42, 125, 95, 68, 52, 95, 68, 52]) / 1000
"""(15,) thickness of the body between a joint and the surface that a depth sensor sees, m."""
# joint, its two neighbours: the angle of A. Only these have one; all other joints get A = 0.
_ANGLES = np.array([(3, 2, 4), (6, 5, 7), (10, 9, 11), (13, 12, 14)]).T
_NO_DEPTH_M = 4.0
_INFERRED_M = 0.15


@dataclass(frozen=True)
class ConfidenceSettings:
    """Settings of the measures F (inverse fluidity), D (depth error) and A (unnatural posture) of a sensor's joint. The
    defaults are the paper's.

    window: number of frames over which F is computed.
    thickness: whether to subtract THICKNESS_M from the depth error.
    hold: whether to keep the last depth error over holes of the depth map; else a hole counts as depth 0.
    clip_m: largest D, m.
    floor_m: D is divided by at least this, m.
    merge_bones: whether D is at least twice the deviation of the joint's bone from its usual length.
    merge_state: whether D of an inferred joint is at least 0.15 m.
    """

    window: int = 15
    thickness: bool = False
    hold: bool = False
    clip_m: float = _NO_DEPTH_M
    floor_m: float = 0.0
    merge_bones: bool = False
    merge_state: bool = False


PUBLISHED_CONFIDENCE = ConfidenceSettings()
CURED_CONFIDENCE = ConfidenceSettings(
    thickness=True, hold=True, clip_m=0.3, floor_m=0.15, merge_bones=True, merge_state=True
)


@dataclass(frozen=True)
class ConfidenceState:
    """Memory of the measures between two frames of K sensors.

    last: (K, 15, 3) m, positions in the last frame.
    times: (K,) s of the last frame.
    speeds: (window, K, 15) m/s, ring buffer of the joints' speeds.
    activations: (window, K, 15) m/s, ring buffer of the sums of the speeds.
    frames: number of frames so far.
    held: (K, 15) m, last depth errors, to use over holes.
    lengths: (8,) m, usual length of the bone to each limb joint.
    samples: (8,) number of samples of each length.
    """

    last: Array
    times: Array
    speeds: Array
    activations: Array
    frames: int
    held: Array
    lengths: Array
    samples: Array


def start_confidence(sensors: int, settings: ConfidenceSettings) -> ConfidenceState:
    """Make the memory of the measures before the first frame."""
    shape = (settings.window, sensors, 15)
    return ConfidenceState(
        np.full((sensors, 15, 3), np.nan),
        np.full(sensors, np.nan),
        np.zeros(shape),
        np.zeros(shape),
        0,
        np.zeros((sensors, 15)),
        np.zeros(len(_LIMB)),
        np.zeros(len(_LIMB)),
    )


def confidence_step(
    memory: ConfidenceState,
    positions: Array,
    state: NDArray[np.uint8],
    depth: Sequence[Array],
    times: Array,
    settings: ConfidenceSettings,
) -> tuple[ConfidenceState, Array]:
    """Compute the measures inverse fluidity F, depth error D and unnatural posture A of one frame, before
    normalisation.

    memory: memory of the frames before.
    positions: (K, 15, 3) m in the sensors' frames.
    state: (K, 15) joint states.
    depth: one array (K, 15) m, depth map at the joints' pixels, 0 = hole; none without depth maps.
    times: (K,) s of the reports.
    settings: settings of the measures.
    Returns: the new memory, and (3, K, 15) = F (m/s, eq. 5), D (m), A (0..1). The speed of a joint that was missing, or
        of a report without a new time, counts as 0.
    """
    t, n = memory.frames, settings.window
    passed = (times - memory.times)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.where(passed > 0, np.linalg.norm(positions - memory.last, axis=-1) / passed, 0.0)
    speeds, activations = memory.speeds.copy(), memory.activations.copy()
    speeds[t % n] = np.where(np.isfinite(speed), speed, 0.0)
    activations[t % n] = speeds.sum(0)  # the ring is zero before it is full, so this is the sum of what there is
    off, held = np.zeros(state.shape), memory.held
    lengths, samples = memory.lengths, memory.samples
    for measured in depth:
        off, held = depth_error(positions[..., 2], measured, held, settings)
    if settings.merge_bones:
        lengths, samples, deviation = _bone_deviation(positions, state, lengths, samples)
        off = np.maximum(off, np.minimum(2 * deviation, settings.clip_m))
    if settings.merge_state:
        off = np.maximum(off, np.where(state < TRACKED, _INFERRED_M, 0.0))
    inputs = np.stack([activations[: t + 1].std(0), off, unnatural(positions)])
    new = ConfidenceState(
        positions, np.asarray(times, dtype=np.float64), speeds, activations, t + 1, held, lengths, samples
    )
    return new, inputs


def depth_error(z: Array, depth: Array, held: Array, settings: ConfidenceSettings) -> tuple[Array, Array]:
    """Compute the depth error D = |z of the joint - depth map at its pixel| (section 2.3.2).

    z: (K, 15) m, depths of the joints.
    depth: (K, 15) m, depth map at their pixels, 0 = hole.
    held: (K, 15) m, errors of the last frame, used at holes where `settings.hold` is set.
    Returns: D (K, 15) m, and the errors to hold for the next frame.
    Deviation: a hole of the depth map counts as a depth of 0, and D is at most 4 m; the paper gives no rule for either.
    """
    with np.errstate(invalid="ignore"):
        error = np.abs(z - depth - (THICKNESS_M if settings.thickness else 0.0))
    if settings.hold:
        error = np.where((depth > 0) & np.isfinite(z), error, held)
    error = np.minimum(np.where(np.isfinite(error), error, settings.clip_m), settings.clip_m)
    return error, error


def unnatural(positions: ArrayLike) -> Array:
    """Compute the unnatural posture A = 1 - P(angle) of elbows and knees, with P a normal distribution of mean pi/2 and
    sd pi/6 (eq. 6).

    positions: (..., 15, 3) m.
    Returns: (..., 15): 0 for all other joints, 1 where a neighbour is missing.
    Deviation: the density is scaled to 1 at its mean, so that A is 0 there. The paper takes the angle from an inner
    product, which cannot give its "unnatural" angles beyond pi.
    """
    s = np.asarray(positions, dtype=np.float64)
    out = np.zeros(s.shape[:-1])
    j, a, b = _ANGLES
    to_a, to_b = s[..., a, :] - s[..., j, :], s[..., b, :] - s[..., j, :]
    product = np.linalg.norm(to_a, axis=-1) * np.linalg.norm(to_b, axis=-1)
    angle = np.arccos(np.clip((to_a * to_b).sum(-1) / np.maximum(product, 1e-12), -1, 1))
    improbable = 1 - np.exp(-0.5 * ((angle - np.pi / 2) / (np.pi / 6)) ** 2)
    out[..., j] = np.where(np.isfinite(improbable), improbable, 1.0)
    return out


def normalised(inputs: Array, settings: ConfidenceSettings) -> Array:
    """Divide the raw measures (3, K, 15) by their maxima over the sensors (for D at least floor_m)."""
    top = inputs.max(axis=1, keepdims=True)
    top[1] = np.maximum(top[1], settings.floor_m)
    return inputs / np.maximum(top, 1e-9)


_LIMB = np.array([3, 4, 6, 7, 10, 11, 13, 14])
_LIMB_BONES = np.stack([_LIMB, jt.PARENT[_LIMB]], 1)
_END = np.array([4, 7, 11, 14])


def _bone_deviation(
    positions: Array, state: NDArray[np.uint8], lengths: Array, samples: Array
) -> tuple[Array, Array, Array]:
    """Update the usual lengths of the limbs' bones, and compute how far each sensor's bones deviate from them.

    positions: (K, 15, 3) m.
    state: (K, 15) joint states.
    lengths, samples: (8,) usual lengths, m, and numbers of samples so far.
    Returns: lengths (8,) m, numbers of samples (8,), deviations (K, 15) m.
    """
    usual, count, length = adapt_lengths(positions, state, lengths, samples, _LIMB_BONES, 300)
    deviation = np.zeros(state.shape)
    off = np.where(usual > 0, np.abs(length - usual), 0.0)
    deviation[:, _LIMB] = np.where(np.isfinite(off), off, 0.3)
    deviation[:, _END] = np.maximum(deviation[:, _END], 0.5 * deviation[:, jt.PARENT[_END]])
    return usual, count, deviation


LOW, MEDIUM, HIGH = "low", "medium", "high"


@dataclass(frozen=True)
class NoiseRules:
    """Fuzzy rules that map normalised inverse fluidity, depth error and unnatural posture of a joint to a noise; inputs
    and output lie in [0, 1].

    low_centre, high_centre: centres of the sigmoids "low" and "high".
    slope: slope of both sigmoids.
    medium_centre, medium_sd: medium centre and medium sd of the Gaussian "medium".
    points: number of samples of the output for the centroid.
    """

    low_centre: float = 0.25
    high_centre: float = 0.75
    slope: float = 6.0
    medium_centre: float = 0.5
    medium_sd: float = 0.3
    points: int = 51

    def membership(self, x: ArrayLike, name: str) -> Array:
        """Compute the degree (...) to which values x (...) are LOW, MEDIUM or HIGH (the argument `name`)."""
        v = np.asarray(x, dtype=np.float64)
        if name == MEDIUM:
            return np.exp(-0.5 * ((v - self.medium_centre) / self.medium_sd) ** 2)
        centre, sign = (self.low_centre, 1.0) if name == LOW else (self.high_centre, -1.0)
        return 1 / (1 + np.exp(sign * self.slope * (v - centre)))

    def firing(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """Compute the firing strengths of the five rules.

        f, d, a: (...) normalised inverse fluidity, depth error and unnatural posture.
        Returns: (5, ...) strengths in 0..1.
        Deviation: rule 2 is printed without precedence; here AND binds tighter than OR.
        """
        v = np.stack(np.broadcast_arrays(np.asarray(f, np.float64), d, a))
        (fl, dl, al), (fm, dm, am), (fh, dh, ah) = (self.membership(v, n) for n in (LOW, MEDIUM, HIGH))
        both_low = np.minimum(fl, al)
        return np.stack(
            [
                np.minimum(dl, both_low),
                np.maximum(dh, np.minimum(fh, ah)),
                np.minimum(dm, both_low),
                np.minimum(np.minimum(dl, fm), al),
                np.minimum(np.minimum(dl, fl), am),
            ]
        )

    @cached_property
    def _consequents(self) -> tuple[Array, Array]:
        out = np.linspace(0, 1, self.points)
        low, medium, high = (self.membership(out, n) for n in (LOW, MEDIUM, HIGH))
        return out, np.stack([low, high, medium, medium, medium])

    def aggregate(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """Combine the rules' scaled output sets by the algebraic sum.

        f, d, a: (...) normalised inverse fluidity, depth error and unnatural posture.
        Returns: (..., points) membership of the output at points evenly spaced over [0, 1].
        """
        strength = self.firing(f, d, a)
        sets = self._consequents[1]
        return 1 - np.prod([1 - w[..., None] * s for w, s in zip(strength, sets, strict=True)], axis=0)

    def noise(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """Compute the noise lambda in (0, 1): the centroid of the aggregated output set, 0.5 where no rule fires.

        f, d, a: (...) normalised inverse fluidity, depth error and unnatural posture.
        Returns: (...) noise.
        Deviation: the centres and slopes of the sigmoids are chosen, because the paper does not give them.
        """
        g = self.aggregate(f, d, a)
        total = g.sum(-1)
        return np.where(total > 1e-12, g @ self._consequents[0] / np.maximum(total, 1e-12), 0.5)


PUBLISHED_RULES = NoiseRules()
SHARP_RULES = NoiseRules(low_centre=0.3, high_centre=0.7, slope=15.0)
"""Rules with steeper sigmoids: the largest noise is 2.2 times the smallest, instead of 1.7 times."""

"""The published fusion: a swarm of candidate positions per joint that move with their sensors and are resampled by a
roulette wheel.

Source: Asteriadis et al. 2013, sections 2.2, 2.5 and 2.6. One layer of the common search runs per frame: `ride`
    (propagate), `energy` (weigh), roulette wheel (resample). Populations are the joints; the origin of a candidate is
    the sensor around which it was created. Equal candidates are kept once, with their number as weight: the
    distribution is the same and most of the cost is saved, because roulette alone soon leaves a handful of distinct
    candidates.

Deviations, each a setting that PUBLISHED sets as in the paper: the length scale h of eq. 7, which is printed without
one (in millimetres only the nearest few of 2100 candidates would have weight); the power of the noise; immigrants,
because a sensor that misses one frame would otherwise lose all its candidates for ever; Baker's universal sampling; the
estimate read before the wheel, weighted by energy. The swarm chooses sensors well; it estimates positions less well,
because it ends on one sensor and keeps that sensor's bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.evidence.frame import TRACKED
from hypose.fusion import joints as jt
from hypose.fusion.fit import adapt_lengths
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Layer, Recipe, search, stream

# ---- confidence ----------------------------------------------------------------------------------------------------
# Compute the noise of each joint of each sensor from three measures: inverse fluidity F, depth error D, unnatural
# posture A.
#
# Source of the measures: Asteriadis et al. 2013, section 2.3, eq. 5-6; each is divided by its maximum over the sensors
# (section 2.4). Deviations, all with the setting `cured`: D subtracts the thickness of the body in front of the joint,
# keeps the last valid error over holes of the depth map, and is clipped and floored; the sensor's own joint state and
# the deviation of bone lengths are merged into D.
#
# Source of the noise: a Mamdani fuzzy inference with the five rules of section 2.4: AND = min, OR = max, implication =
# product, aggregation = algebraic sum, defuzzification = centroid. Rule 2 is printed "D high OR F high AND A high"
# without precedence; here AND binds tighter. The paper gives 0.3 as the sigma of every set, but no centres and no
# slopes; the defaults place the noise of all-low and all-high inputs as the text says.
# Limits: with these rules the noise lies between 0.42 and 0.74 only, and "F high" or "A high" alone give 0.5, as if no
#     rule fired. As a weight it is worth little; as a preference repeated in every frame it selects sensors.


THICKNESS_M = np.array([90, 60, 65, 48, 42, 65, 48, 42, 125, 95, 68, 52, 95, 68, 52]) / 1000
"""(15,) thickness of the body between a joint and the surface that a depth sensor sees, m."""
# joint, its two neighbours: the angle of A. Only these have one; all other joints get A = 0.
_ANGLES = np.array([(3, 2, 4), (6, 5, 7), (10, 9, 11), (13, 12, 14)]).T
_MOST_D_M, _CURED_MOST_D_M = 4.0, 0.3  # largest D: as published (the paper gives none), and with the cures
_INFERRED_M = 0.15  # with the cures, least D of an inferred joint, and least divisor of D


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


def start_confidence(sensors: int, window: int = 15) -> ConfidenceState:
    """Make the memory of the measures before the first frame; F is computed over `window` frames."""
    shape = (window, sensors, 15)
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
    cured: bool,
) -> tuple[ConfidenceState, Array]:
    """Compute the measures inverse fluidity F, depth error D and unnatural posture A of one frame, before
    normalisation.

    memory: memory of the frames before.
    positions: (K, 15, 3) m in the sensors' frames.
    state: (K, 15) joint states.
    depth: one array (K, 15) m, depth map at the joints' pixels, 0 = hole; none without depth maps.
    times: (K,) s of the reports.
    cured: whether D has the cures: the joint's thickness, holes, the bones' lengths, the state of the joint.
    Returns: the new memory, and (3, K, 15) = F (m/s, eq. 5), D (m), A (0..1). The speed of a joint that was missing, or
        of a report without a new time, counts as 0.
    """
    t, n = memory.frames, len(memory.speeds)
    passed = (times - memory.times)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.where(passed > 0, np.linalg.norm(positions - memory.last, axis=-1) / passed, 0.0)
    speeds, activations = memory.speeds.copy(), memory.activations.copy()
    speeds[t % n] = np.where(np.isfinite(speed), speed, 0.0)
    activations[t % n] = speeds.sum(0)  # the ring is zero before it is full, so this is the sum of what there is
    off, held = np.zeros(state.shape), memory.held
    lengths, samples = memory.lengths, memory.samples
    for measured in depth:
        off, held = depth_error(positions[..., 2], measured, held, cured)
    if cured:
        # how far each sensor's bones deviate from their usual lengths
        lengths, samples, length = adapt_lengths(positions, state, lengths, samples, _LIMB_BONES, 300)
        deviation, apart = np.zeros(state.shape), np.where(lengths > 0, np.abs(length - lengths), 0.0)
        deviation[:, _LIMB] = np.where(np.isfinite(apart), apart, 0.3)
        deviation[:, _END] = np.maximum(deviation[:, _END], 0.5 * deviation[:, jt.PARENT[_END]])
        off = np.maximum(off, np.minimum(2 * deviation, _CURED_MOST_D_M))
        off = np.maximum(off, np.where(state < TRACKED, _INFERRED_M, 0.0))
    inputs = np.stack([activations[: t + 1].std(0), off, unnatural(positions)])
    new = ConfidenceState(
        positions, np.asarray(times, dtype=np.float64), speeds, activations, t + 1, held, lengths, samples
    )
    return new, inputs


def depth_error(z: Array, depth: Array, held: Array, cured: bool) -> tuple[Array, Array]:
    """Compute the depth error D = |z of the joint - depth map at its pixel| (section 2.3.2).

    z: (K, 15) m, depths of the joints.
    depth: (K, 15) m, depth map at their pixels, 0 = hole.
    held: (K, 15) m, errors of the last frame.
    cured: whether the thickness of the body is subtracted, and errors are held over holes.
    Returns: D (K, 15) m, and the errors to hold for the next frame.
    Deviation: a hole of the depth map counts as a depth of 0, and D is at most 4 m; the paper gives no rule for either.
    """
    most = _CURED_MOST_D_M if cured else _MOST_D_M
    with np.errstate(invalid="ignore"):
        error = np.abs(z - depth - (THICKNESS_M if cured else 0.0))
    if cured:
        error = np.where((depth > 0) & np.isfinite(z), error, held)
    error = np.fmin(error, most)
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


def normalised(inputs: Array, cured: bool) -> Array:
    """Divide the raw measures (3, K, 15) by their maxima over the sensors (for D with the cures, at least 0.15 m)."""
    top = inputs.max(axis=1, keepdims=True)
    top[1] = np.maximum(top[1], _INFERRED_M if cured else 0.0)
    return inputs / np.maximum(top, 1e-9)


_LIMB = np.array([3, 4, 6, 7, 10, 11, 13, 14])
_LIMB_BONES = np.stack([_LIMB, jt.PARENT[_LIMB]], 1)
_END = np.array([4, 7, 11, 14])


LOW, MEDIUM, HIGH = "low", "medium", "high"
MEDIUM_SD = 0.3


@dataclass(frozen=True)
class NoiseRules:
    """Fuzzy rules that map normalised inverse fluidity, depth error and unnatural posture of a joint to a noise; inputs
    and output lie in [0, 1].

    low_centre, high_centre: centres of the sigmoids "low" and "high".
    slope: slope of both sigmoids.

    The set "medium" is a Gaussian of centre 0.5 and sd MEDIUM_SD; the centroid is that of 51 samples of the output.
    """

    low_centre: float = 0.25
    high_centre: float = 0.75
    slope: float = 6.0

    def membership(self, x: ArrayLike, name: str) -> Array:
        """Compute the degree (...) to which values x (...) are LOW, MEDIUM or HIGH (the argument `name`)."""
        v = np.asarray(x, dtype=np.float64)
        if name == MEDIUM:
            return np.exp(-0.5 * ((v - 0.5) / MEDIUM_SD) ** 2)
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

    def noise(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """Compute the noise lambda in (0, 1): the centroid of the aggregated output set, 0.5 where no rule fires.

        f, d, a: (...) normalised inverse fluidity, depth error and unnatural posture.
        Returns: (...) noise.
        Deviation: the centres and slopes of the sigmoids are chosen, because the paper does not give them.
        """
        out = np.linspace(0, 1, 51)
        low, medium, high = (self.membership(out, n) for n in (LOW, MEDIUM, HIGH))
        fired = zip(self.firing(f, d, a), (low, high, medium, medium, medium), strict=True)
        # the rules' scaled output sets, combined by the algebraic sum
        g = 1 - np.prod([1 - strength[..., None] * output for strength, output in fired], axis=0)
        total = g.sum(-1)
        return np.where(total > 1e-12, g @ out / np.maximum(total, 1e-12), 0.5)


PUBLISHED_RULES = NoiseRules()
SHARP_RULES = NoiseRules(low_centre=0.3, high_centre=0.7, slope=15.0)
"""Rules with steeper sigmoids: the largest noise is 2.2 times the smallest, instead of 1.7 times."""


# ---- swarm ---------------------------------------------------------------------------------------------------------
NEGLIGIBLE = 7.0
"""Distance in scales h beyond which exp(-d / h) < 0.001 counts as 0."""


@dataclass(frozen=True)
class SwarmSettings:
    """Settings of the swarm; the defaults are the paper's.

    count: number of candidates per joint.
    radius_m: radius of the ball in which they start, m.
    h_m: length scale of the energy, m.
    power: the weights of the energy are lambda^-power, with the noise lambda of a joint.
    pressure: the shares of the wheel are E^pressure, with the energy E (fitness scaling).
    immigrants: number of new candidates per sensor and frame (within count).
    universal: whether to use Baker's universal sampling instead of independent draws.
    weighted: whether the joint is the mean weighted by energy before the wheel adds its noise; else it is the plain
        mean of the candidates after the wheel.
    restart_every: number of frames between restarts (0 = never).
    restart_turn: rad that the person turns between restarts (0 = never); `fuse` computes no heading, so that it is for
        callers of `swarm_step`.
    cured: whether the depth error, of which the noise is made, has the cures.
    rules: fuzzy rules of the noise.
    """

    count: int = 2100
    radius_m: float = 0.1
    h_m: float = 0.05
    power: float = 1.0
    pressure: float = 1.0
    immigrants: int = 0
    universal: bool = False
    weighted: bool = False
    restart_every: int = 50
    restart_turn: float = 0.0
    cured: bool = False
    rules: NoiseRules = PUBLISHED_RULES


PUBLISHED = SwarmSettings()
IMPROVED = SwarmSettings(
    h_m=0.1,
    power=2.0,
    pressure=4.0,
    immigrants=3,
    universal=True,
    weighted=True,
    cured=True,
    rules=SHARP_RULES,
)
"""Settings chosen on simulated recordings of seeds below 1000. Baker's sampling chooses the same sensors and is
cheaper. Without pressure two sensors that agree share the candidates for ever; with it the mean of the population is 2
mm worse, because the candidates settle on one of them.
"""


@dataclass(frozen=True)
class SwarmFrame:
    """Evidence of one frame for the swarm, of K sensors and J joints.

    positions: (K, J, 3) m registered, NaN where missing.
    moved: (K, J, 3) m, change since each joint was last seen (0 where missing).
    weights: (K, J) = lambda^-power with the noise lambda of each joint, 0 where missing.
    settings: settings of the swarm.
    """

    positions: Array
    moved: Array
    weights: Array
    settings: SwarmSettings


def ride(h: Hypotheses, frame: SwarmFrame, rng: np.random.Generator, /) -> Hypotheses:
    """Move each candidate by the motion of its joint as the candidate's sensor saw it, and add new candidates
    (immigrants) around the joint of every sensor that sees it.
    """
    s = frame.settings
    log_weights, origin = h.log_weights, h.origin
    joints = np.arange(len(origin))
    values = h.values + frame.moved[np.maximum(origin, 0), joints[:, None]]
    if s.immigrants:
        extra, every = s.immigrants * len(frame.positions), np.ones(len(joints), dtype=np.bool_)
        fresh = _placed(frame.positions, frame.weights > 0, every, extra, s.radius_m, rng)
        values = np.concatenate([values, fresh[0]], 1)
        # each counts as one candidate of the population
        log_weights = np.concatenate([log_weights, fresh[1] + np.log(extra / s.count)], 1)
        origin = np.concatenate([origin, fresh[2]], 1)
    return Hypotheses(values, log_weights, origin)


def energy(h: Hypotheses, frame: SwarmFrame, /) -> Array:
    """Compute the log-weights of the candidates p: pressure * log E, E = sum_k lambda_k^-power exp(-|s_k - p| / h) (eq.
    7).

    h: the candidates; frame: joint positions s_k and noise lambda_k of the sensors k.
    Returns: (J, N); 0 for all candidates of a joint that none of them can explain in this frame, so that its population
        stays.
    Deviations: a length scale h (`h_m`), which is printed without one; a term below 0.001 of its weight counts as 0.
    """
    weights, scale = frame.weights.T[:, None], frame.settings.h_m
    away = np.linalg.norm(h.values[:, :, None] - np.swapaxes(frame.positions, 0, 1)[:, None], axis=-1)
    near = np.where((weights > 0) & (away < NEGLIGIBLE * scale), weights * np.exp(-away / scale), 0.0)
    total = np.where(h.origin >= 0, near.sum(2), 0.0)
    explained = np.asarray(((total > 0) & (h.log_weights > -np.inf)).any(1))
    with np.errstate(divide="ignore"):
        return np.where(explained[:, None], frame.settings.pressure * np.log(total), 0.0)


def mean_position(h: Hypotheses, /) -> Array:
    """Compute the weighted mean (J, 3) m of the candidates of each joint.

    Deviation: eq. 1 is printed as the best candidate; section 2.5 describes an average, which is used here.
    """
    return np.einsum("jm,jma->ja", _shares(h), h.values)


def _shares(h: Hypotheses) -> Array:
    """Compute the normalised weights (J, M) of the candidates; 0 for a joint without candidates."""
    peak = h.log_weights.max(1, keepdims=True)
    shares = np.exp(h.log_weights - np.where(np.isfinite(peak), peak, 0.0))
    return shares / np.maximum(shares.sum(1, keepdims=True), 1e-300)


def merged_wheel(h: Hypotheses, rng: np.random.Generator, /, count: int, universal: bool = False) -> Hypotheses:
    """Resample by roulette wheel (or Baker's universal sampling), and keep equal candidates once.

    count: number of draws per joint.
    universal: whether to use Baker's universal sampling.
    Returns: the distinct candidates drawn, with log-weights log(copies / count).
    """
    shares = _shares(h)
    some = np.asarray(shares.any(1))
    if universal:
        edges = np.cumsum(shares, 1)
        edges *= count / np.where(some, edges[:, -1], 1.0)[:, None]
        spun = np.clip(np.ceil(edges - rng.random((len(shares), 1))), 0, count)
        counts = np.diff(spun, axis=1, prepend=0.0).astype(np.int64)
    else:  # reversed, because rounding leaves a remainder to the last, which must not be padding
        counts = rng.multinomial(count, shares[:, ::-1])[:, ::-1]
    counts = np.where(some[:, None], counts, 0)
    width = int(np.count_nonzero(counts, axis=1).max())
    if width == 0:
        return h
    drawn = np.argsort(counts == 0, axis=1, kind="stable")[:, :width]
    copies = np.take_along_axis(counts, drawn, 1)
    with np.errstate(divide="ignore"):
        log_weights = np.log(copies / count)
    values = np.where(copies[..., None] > 0, np.take_along_axis(h.values, drawn[..., None], 1), 0.0)
    origin = np.where(copies > 0, np.take_along_axis(h.origin, drawn, 1), -1)
    return Hypotheses(values, log_weights, origin.astype(np.int32))


@dataclass(frozen=True)
class SwarmState:
    """Memory of the swarm between two frames.

    candidates: population after resampling, of J joints; None before the first frame.
    last: (K, J, 3) m, where each sensor last saw each joint, NaN before.
    age: number of frames since the last restart.
    heading_at_restart: heading of the person at the last restart, rad.
    frame: number of the next frame.
    """

    candidates: Hypotheses | None
    last: Array
    age: int
    heading_at_restart: float
    frame: int


@dataclass(frozen=True)
class SwarmEstimate:
    """Joints of one frame, estimated by the swarm.

    joints: (J, 3) m.
    spread: (J,) m, RMS distance of the candidates from their mean.
    shares: (J, K) share of the candidates by sensor of origin, after resampling.
    restarted: whether the swarm was initialised in this frame.
    distinct: (J,) number of distinct candidates left.
    """

    joints: Array
    spread: Array
    shares: Array
    restarted: bool
    distinct: NDArray[np.int64]


def start_swarm(sensors: int, joints: int = 15) -> SwarmState:
    """Make the memory of the swarm for a number of sensors and joints, before the first frame."""
    return SwarmState(None, np.full((sensors, joints, 3), np.nan), 0, 0.0, 0)


def swarm_step(
    state: SwarmState, positions: Array, noise: Array, heading: float, settings: SwarmSettings, seed: int
) -> tuple[SwarmState, SwarmEstimate]:
    """Run the swarm on one frame.

    state: memory of the frames before.
    positions: (K, J, 3) m registered, NaN where missing.
    noise: (K, J) noise lambda of each joint, 0..1.
    heading: heading of the person, rad.
    settings: settings of the swarm.
    seed: the result depends on (seed, number of the frame) only.
    Returns: the new memory and the estimate; NaN for joints that no sensor has seen yet.
    """
    seen = np.isfinite(positions[..., 0])
    moved = np.where(seen[..., None] & np.isfinite(state.last), positions - state.last, 0.0)
    last = np.where(seen[..., None], positions, state.last)
    weights = np.where(seen, np.maximum(noise, 1e-6) ** -settings.power, 0.0)
    frame = SwarmFrame(positions, moved, weights, settings)
    due = state.candidates is None or (settings.restart_every > 0 and state.age >= settings.restart_every)
    due = due or (settings.restart_turn > 0 and abs(heading - state.heading_at_restart) > settings.restart_turn)
    candidates = _candidates(state.candidates, due, frame, last, seed, state.frame)
    wheel = partial(merged_wheel, count=settings.count, universal=settings.universal)
    layer = Layer(ride, energy, wheel, "swarm")
    recipe = Recipe("swarm", (layer,), settings.count, estimate=mean_position, citation="Asteriadis et al. 2013")
    result = search(candidates, recipe, frame, partial(stream, seed, state.frame))
    chosen = result.resampled
    mean = result.estimate if settings.weighted else mean_position(chosen)
    used = (chosen.origin >= 0) & np.isfinite(chosen.log_weights)
    weights, distinct = np.where(used, _shares(chosen), 0.0), used.sum(1)
    # distances from one candidate, so that nothing is lost to cancellation far from the origin
    off = chosen.values - chosen.values[:, :1]
    square = (weights * (off**2).sum(2)).sum(1) - (np.einsum("jm,jma->ja", weights, off) ** 2).sum(1)
    spread = np.sqrt(np.maximum(square, 0.0))
    shares = np.stack([np.where(chosen.origin == k, weights, 0.0).sum(1) for k in range(len(positions))], 1)
    known = distinct > 0
    estimate = SwarmEstimate(
        np.where(known[:, None], mean, np.nan), np.where(known, spread, np.nan), shares, due, distinct
    )
    at = heading if due else state.heading_at_restart
    return SwarmState(chosen, last, 1 if due else state.age + 1, at, state.frame + 1), estimate


def _candidates(
    old: Hypotheses | None, due: bool, frame: SwarmFrame, last: Array, seed: int, number: int
) -> Hypotheses:
    """Return the old population, initialised again where a restart is due or a joint is seen for the first time.

    old: population of the frame before; None before the first.
    due: whether a restart is due.
    frame: evidence of this frame.
    last: (K, J, 3) m, where each sensor last saw each joint.
    seed, number: seed, and number of the frame, of the random stream.
    """
    s = frame.settings
    joints = frame.positions.shape[1]
    seen = np.asarray(frame.weights > 0)
    if old is None:
        old = Hypotheses(np.zeros((joints, 1, 3)), np.zeros((joints, 1)), np.full((joints, 1), -1))
    renew = np.asarray((due & np.isfinite(last[..., 0]).any(0)) | ((old.origin < 0).all(1) & seen.any(0)))
    if not renew.any():
        return old
    # a joint that no sensor sees at a restart starts around where it was seen last; ride() has yet to add this frame's
    # movement
    usable = np.where(seen.any(0), seen, np.isfinite(last[..., 0]))
    placed = _placed(last - frame.moved, usable, renew, s.count, s.radius_m, stream(seed, number, -1))
    if np.all(renew):
        return Hypotheses(*placed)
    width, keep = max(s.count, old.count), ~renew
    values, log_weights = np.zeros((joints, width, 3)), np.full((joints, width), -np.inf)
    origin = np.full((joints, width), -1, dtype=np.int32)
    values[keep, : old.count] = old.values[keep]
    log_weights[keep, : old.count] = old.log_weights[keep]
    origin[keep, : old.count] = old.origin[keep]
    values[renew, : s.count], log_weights[renew, : s.count], origin[renew, : s.count] = (a[renew] for a in placed)
    return Hypotheses(values, log_weights, origin)


def _placed(
    base: Array,
    usable: NDArray[np.bool_],
    renew: NDArray[np.bool_],
    count: int,
    radius: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, NDArray[np.int32]]:
    """Draw new candidates in balls around the joints of the sensors.

    base: (K, J, 3) m, centres of the balls.
    usable: (K, J) sensors around whose joint candidates are drawn.
    renew: (J,) joints of which candidates are drawn.
    count: number of candidates per joint.
    radius: radius of the balls, m.
    Returns: values (J, count, 3), log-weights -log(count), origins (the sensor of each).
    """
    joints = base.shape[1]
    values, log_weights = np.zeros((joints, count, 3)), np.full((joints, count), -np.inf)
    origin = np.full((joints, count), -1, dtype=np.int32)
    for j in np.flatnonzero(renew & usable.any(0)):
        log_weights[j], origin[j] = -np.log(count), np.resize(np.flatnonzero(usable[:, j]), count)
        ways = rng.normal(size=(count, 3))
        ways *= (radius * np.cbrt(rng.random(count)) / np.linalg.norm(ways, axis=1))[:, None]
        values[j] = base[origin[j], j] + ways
    return values, log_weights, origin

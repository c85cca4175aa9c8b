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

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.fusion.confidence import (
    CURED_CONFIDENCE,
    PUBLISHED_CONFIDENCE,
    PUBLISHED_RULES,
    SHARP_RULES,
    ConfidenceSettings,
    NoiseRules,
)
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Layer, Recipe, search, stream

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
    confidence: settings of the measures of which the noise is made.
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
    confidence: ConfidenceSettings = PUBLISHED_CONFIDENCE
    rules: NoiseRules = PUBLISHED_RULES


PUBLISHED = SwarmSettings()
IMPROVED = SwarmSettings(
    h_m=0.1,
    power=2.0,
    pressure=4.0,
    immigrants=3,
    universal=True,
    weighted=True,
    confidence=CURED_CONFIDENCE,
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


@dataclass(frozen=True)
class MergedWheel:
    """Resampling by roulette wheel (or Baker's universal sampling) that keeps equal candidates once.

    count: number of draws per joint.
    universal: whether to use Baker's universal sampling.
    """

    count: int
    universal: bool = False

    def __call__(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """Return the distinct candidates drawn, with log-weights log(copies / count)."""
        shares = _shares(h)
        some = np.asarray(shares.any(1))
        if self.universal:
            edges = np.cumsum(shares, 1)
            edges *= self.count / np.where(some, edges[:, -1], 1.0)[:, None]
            spun = np.clip(np.ceil(edges - rng.random((len(shares), 1))), 0, self.count)
            counts = np.diff(spun, axis=1, prepend=0.0).astype(np.int64)
        else:  # reversed, because rounding leaves a remainder to the last, which must not be padding
            counts = rng.multinomial(self.count, shares[:, ::-1])[:, ::-1]
        counts = np.where(some[:, None], counts, 0)
        width = int(np.count_nonzero(counts, axis=1).max())
        if width == 0:
            return h
        drawn = np.argsort(counts == 0, axis=1, kind="stable")[:, :width]
        copies = np.take_along_axis(counts, drawn, 1)
        with np.errstate(divide="ignore"):
            log_weights = np.log(copies / self.count)
        values = np.where(copies[..., None] > 0, np.take_along_axis(h.values, drawn[..., None], 1), 0.0)
        origin = np.where(copies > 0, np.take_along_axis(h.origin, drawn, 1), -1)
        return Hypotheses(values, log_weights, origin.astype(np.int32))


def _recipe(settings: SwarmSettings) -> Recipe:
    """Describe the swarm as a recipe for the common search."""
    layer = Layer(ride, energy, MergedWheel(settings.count, settings.universal), "swarm")
    return Recipe("swarm", (layer,), settings.count, estimate=mean_position, citation="Asteriadis et al. 2013")


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
    turned = abs(heading - state.heading_at_restart)
    due = due or (settings.restart_turn > 0 and turned > settings.restart_turn)
    candidates = _candidates(state.candidates, due, frame, last, seed, state.frame)
    result = search(candidates, _recipe(settings), frame, partial(stream, seed, state.frame))
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

"""The published fusion: a swarm of candidate positions per joint that ride with their sensors and spin a roulette
wheel.

Source: Asteriadis et al. 2013, sections 2.2, 2.5 and 2.6. One layer of the common spine per frame: ride (propose),
energy (weigh), roulette wheel (select). Populations are the joints, origins the sensors of birth. Equal candidates are
kept once with their number as weight, which changes nothing in distribution and most of the cost: roulette alone soon
leaves a handful of distinct candidates.

Deviations, each a setting with the paper's behaviour as its value in PUBLISHED: the length scale h of eq. 7, which is
printed without one (in millimetres only the nearest few of 2100 candidates would carry weight); the power of the noise;
immigrants, because a sensor that blinks for one frame otherwise loses all its candidates for good; Baker's universal
sampling; jitter, for roulette alone adds nothing new; the estimate read before the wheel, weighted by energy. The swarm
chooses sensors well; it is a mediocre estimator, because it ends on one sensor and keeps its bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.fusion.confidence import CURED_CONFIDENCE, PUBLISHED_CONFIDENCE, ConfidenceSettings
from hypose.fusion.fuzzy import PUBLISHED_RULES, SHARP_RULES, NoiseRules
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Layer, Recipe, search
from hypose.inference.random_streams import stream

FEW = 64
"""Distinct candidates per joint up to which binomial numbers are cheaper than spins."""


@dataclass(frozen=True)
class SwarmSettings:
    """count: candidates per joint; radius_m: of the ball they start in; h_m: length scale of the energy; power: the
    energy's weights are lambda^-power; pressure: the wheel's shares are E^pressure (fitness scaling); immigrants: fresh
    candidates per sensor and frame (within count); jitter_m: sd of a random step per frame; universal: Baker's sampling
    instead of independent spins; weighted: the joint is the mean weighted by energy, before the wheel adds its noise,
    instead of the plain mean of the candidates that the wheel leaves; restart_every: frames (0 = never); restart_turn:
    rad of turning since the last restart (0 = never)."""

    count: int = 2100
    radius_m: float = 0.1
    h_m: float = 0.05
    power: float = 1.0
    pressure: float = 1.0
    immigrants: int = 0
    jitter_m: float = 0.0
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
"""Chosen on simulated recordings of seeds below 1000. Baker's sampling chooses the same sensors and is cheaper. Without
pressure two sensors that agree share the candidates for good; with it the mean of the population is 2 mm worse, because
the candidates settle on one of them."""


@dataclass(frozen=True)
class SwarmFrame:
    """Evidence of one frame: positions (K, J, 3) m registered, NaN missing; moved (K, J, 3): their change since last
    seen (0 when missing); weights (K, J) = lambda^-power, 0 where missing; settings."""

    positions: Array
    moved: Array
    weights: Array
    settings: SwarmSettings


def ride(h: Hypotheses, frame: SwarmFrame, rng: np.random.Generator, /) -> Hypotheses:
    """Candidates move with the joint of their sensor; immigrants join around every sensor that sees the joint."""
    s = frame.settings
    old_values, log_weights, origin = h.values, h.log_weights, h.origin
    if s.jitter_m > 0:
        old_values, log_weights, origin = _singly(h.values, h.log_weights, h.origin, s.count)
        old_values = old_values + rng.normal(0, s.jitter_m, old_values.shape)
    joints, old = origin.shape
    extra = s.immigrants * len(frame.positions)
    values = np.empty((joints, old + extra, 3))
    compute.swarm_kernels.ride(old_values, origin, frame.moved, values)
    if extra:
        new_log = np.empty((joints, old + extra))
        new_origin = np.empty((joints, old + extra), dtype=np.int32)
        new_log[:, :old], new_origin[:, :old] = log_weights, origin
        fresh, fresh_log, fresh_origin = _placed(
            frame.positions, frame.weights > 0, np.ones(joints, dtype=np.bool_), extra, s.radius_m, rng
        )
        values[:, old:], new_origin[:, old:] = fresh, fresh_origin
        # each counts as one candidate of the population
        new_log[:, old:] = fresh_log + np.log(extra / s.count)
        log_weights, origin = new_log, new_origin
    return Hypotheses(values, log_weights, origin)


def energy(h: Hypotheses, frame: SwarmFrame, /) -> Array:
    """pressure * log E (J, N), eq. 7: E = sum_k lambda_k^-power exp(-|s_k - p| / h).

    Deviation: a length scale h, which is printed without one. Deviation: a term below 0.001 of its weight counts as 0.
    A joint that no candidate can explain this frame keeps its population (0 everywhere)."""
    out = np.empty(h.log_weights.shape)
    compute.swarm_kernels.swarm_energy(
        h.values, h.origin, h.log_weights, frame.positions, frame.weights, frame.settings.h_m, out
    )
    if frame.settings.pressure != 1:
        out *= frame.settings.pressure
    return out


def mean_position(h: Hypotheses, /) -> Array:
    """(J, 3) m weighted mean of the candidates.

    Deviation: eq. 1 is printed as the best candidate; section 2.5 says averaging, and so it is done."""
    shares, mean = np.empty(h.log_weights.shape), np.empty((len(h.values), 3))
    compute.swarm_kernels.shares_and_mean(h.log_weights, h.values, shares, mean)
    return mean


@dataclass(frozen=True)
class MergedWheel:
    """Roulette wheel (or Baker's universal sampling) that keeps equal candidates once: count draws per joint, the
    number of copies as the new weight."""

    count: int
    universal: bool = False

    def __call__(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """The distinct candidates drawn, with log-weights log(copies / count)."""
        shares, mean = np.empty(h.log_weights.shape), np.empty((len(h.values), 3))
        compute.swarm_kernels.shares_and_mean(h.log_weights, h.values, shares, mean)
        counts = np.empty(shares.shape, dtype=np.int64)
        if self.universal:
            compute.swarm_kernels.universal_counts(shares, rng.random(len(shares)), self.count, counts)
        elif h.count <= FEW:
            # a binomial number for each candidate instead of count spins: the same distribution. Reversed, because
            # rounding leaves a remainder to the last, which must not be padding
            total = shares.sum(1, keepdims=True)
            counts = rng.multinomial(self.count, (shares / np.where(total > 0, total, 1.0))[:, ::-1])[:, ::-1]
            counts = np.where(total > 0, counts, 0)
        else:
            spacings = rng.standard_exponential((len(shares), self.count + 1), dtype=np.float32)
            compute.swarm_kernels.wheel_counts(shares, spacings, counts)
        width = int(np.count_nonzero(counts, axis=1).max())
        if width == 0:
            return h
        values, log_weights = np.empty((len(counts), width, 3)), np.empty((len(counts), width))
        origin = np.empty((len(counts), width), dtype=np.int32)
        compute.swarm_kernels.keep_drawn(counts, h.values, h.origin, self.count, values, log_weights, origin)
        return Hypotheses(values, log_weights, origin)


def recipe(settings: SwarmSettings) -> Recipe:
    """The swarm as data for the common loop."""
    layer = Layer(ride, energy, MergedWheel(settings.count, settings.universal), "swarm")
    return Recipe("swarm", (layer,), settings.count, estimate=mean_position, citation="Asteriadis et al. 2013")


@dataclass(frozen=True)
class SwarmState:
    """candidates: the population after selection (J populations); last (K, J, 3) m: where each sensor last saw each
    joint, NaN before; age: frames since the last restart; heading_at_restart rad; frame: number of the next frame."""

    candidates: Hypotheses | None
    last: Array
    age: int
    heading_at_restart: float
    frame: int


@dataclass(frozen=True)
class SwarmEstimate:
    """joints (J, 3) m, spread (J,) m (root mean square distance of the candidates from their mean), shares (J, K) of
    the population by sensor of birth after selection, restarted, distinct (J,) candidates left."""

    joints: Array
    spread: Array
    shares: Array
    restarted: bool
    distinct: NDArray[np.int64]


def start_swarm(sensors: int, joints: int = 15) -> SwarmState:
    """Before the first frame."""
    return SwarmState(None, np.full((sensors, joints, 3), np.nan), 0, 0.0, 0)


def swarm_step(
    state: SwarmState, positions: Array, noise: Array, heading: float, settings: SwarmSettings, seed: int
) -> tuple[SwarmState, SwarmEstimate]:
    """One frame: registered positions (K, J, 3) m, noise lambda (K, J), heading rad of the person. Joints that no
    sensor has seen yet are NaN. Deterministic in (seed, number of the frame)."""
    seen = np.isfinite(positions[..., 0])
    moved = np.where(seen[..., None] & np.isfinite(state.last), positions - state.last, 0.0)
    last = np.where(seen[..., None], positions, state.last)
    weights = np.where(seen, np.maximum(noise, 1e-6) ** -settings.power, 0.0)
    frame = SwarmFrame(positions, moved, weights, settings)
    due = state.candidates is None or (settings.restart_every > 0 and state.age >= settings.restart_every)
    turned = abs(heading - state.heading_at_restart)
    due = due or (settings.restart_turn > 0 and turned > settings.restart_turn)
    candidates = _candidates(state.candidates, due, frame, last, seed, state.frame)
    result = search(candidates, recipe(settings), frame, partial(stream, seed, state.frame))
    chosen = result.selected
    mean, joints = result.estimate if settings.weighted else mean_position(chosen), positions.shape[1]
    spread, shares, distinct = np.empty(joints), np.empty((joints, len(positions))), np.empty(joints, dtype=np.int64)
    compute.swarm_kernels.swarm_summary(chosen.values, chosen.log_weights, chosen.origin, spread, shares, distinct)
    known = distinct > 0
    estimate = SwarmEstimate(
        np.where(known[:, None], mean, np.nan), np.where(known, spread, np.nan), shares, due, distinct
    )
    at = heading if due else state.heading_at_restart
    return SwarmState(chosen, last, 1 if due else state.age + 1, at, state.frame + 1), estimate


def _candidates(
    old: Hypotheses | None, due: bool, frame: SwarmFrame, last: Array, seed: int, number: int
) -> Hypotheses:
    """The old population, renewed where a restart is due or a joint is seen for the first time."""
    s = frame.settings
    joints = frame.positions.shape[1]
    seen = np.asarray(frame.weights > 0)
    if old is None:
        old = Hypotheses(np.zeros((joints, 1, 3)), np.zeros((joints, 1)), np.full((joints, 1), -1))
    renew = np.asarray((due & np.isfinite(last[..., 0]).any(0)) | ((old.origin < 0).all(1) & seen.any(0)))
    if not renew.any():
        return old
    # a joint that nobody sees at a restart starts around where it was seen last; ride() has yet to add this frame's
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
    """Fresh candidates of the joints with renew (J,), in balls around base (K, J, 3): values (J, count, 3), log-weights
    (each 1 / count), origins."""
    joints = base.shape[1]
    bits = rng.integers(0, 2**64, (joints, int(2.2 * count) + 60), dtype=np.uint64)
    values, log_weights = np.empty((joints, count, 3)), np.empty((joints, count))
    origin = np.empty((joints, count), dtype=np.int32)
    compute.swarm_kernels.place_candidates(bits, base, usable, renew, radius, values, log_weights, origin)
    return values, log_weights, origin


def _singly(values: Array, log_weights: Array, origin: NDArray[np.int32], count: int) -> tuple[Array, Array, NDArray]:
    """Merged candidates written out one by one again, so that each can take its own step."""
    copies = np.rint(np.exp(log_weights) * count).astype(np.int64)
    width = int(copies.sum(1).max())
    index = np.zeros((len(values), width), dtype=np.intp)
    used = np.zeros((len(values), width), dtype=np.bool_)
    for j, c in enumerate(copies):
        each = np.repeat(np.arange(len(c)), c)
        index[j, : len(each)], used[j, : len(each)] = each, True
    flat = np.take_along_axis(values, index[..., None], 1)
    origin = np.where(used, np.take_along_axis(origin, index, 1), -1).astype(np.int32)
    return flat, np.where(used, -np.log(count), -np.inf), origin

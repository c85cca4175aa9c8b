"""The published fusion: a swarm of candidate positions per joint that ride with their sensors and spin a roulette
wheel.

Source: Asteriadis et al. 2013, sections 2.2, 2.5 and 2.6. One layer of the common spine per frame: ride (propose),
energy (weigh), roulette wheel (select). Populations are the joints, labels the sensors of birth. Equal candidates are
kept once with their number as weight, which changes nothing in distribution and most of the cost: roulette alone soon
leaves a handful of distinct candidates.

Deviations, each a setting with the paper's behaviour as its value in PUBLISHED: the length scale h of eq. 7, which is
printed without one (in millimetres only the nearest few of 2100 candidates would carry weight); the power of the noise;
immigrants, because a sensor that blinks for one frame otherwise loses all its candidates for good; Baker's universal
sampling; jitter, for roulette alone adds nothing new. The estimate is the mean weighted by energy, read before the
wheel. The swarm chooses sensors well; it is a mediocre estimator, because it ends on one sensor and keeps its bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.compute import cpu_fusion
from hypose.fusion.confidence import CURED_CONFIDENCE, PUBLISHED_CONFIDENCE, ConfidenceSettings
from hypose.fusion.fuzzy import PUBLISHED_RULES, SHARP_RULES, NoiseRules
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Layer, Recipe, search
from hypose.inference.random_streams import stream


@dataclass(frozen=True)
class SwarmSettings:
    """count: candidates per joint; radius_m: of the ball they start in; h_m: length scale of the energy; power: the
    energy's weights are lambda^-power; immigrants: fresh candidates per sensor and frame (within count); jitter_m: sd
    of a random step per frame; universal: Baker's sampling instead of independent spins; restart_every: frames (0 =
    never); restart_turn: rad of turning since the last restart (0 = never)."""

    count: int = 2100
    radius_m: float = 0.1
    h_m: float = 0.05
    power: float = 1.0
    immigrants: int = 0
    jitter_m: float = 0.0
    universal: bool = False
    restart_every: int = 50
    restart_turn: float = 0.0
    confidence: ConfidenceSettings = PUBLISHED_CONFIDENCE
    rules: NoiseRules = PUBLISHED_RULES


PUBLISHED = SwarmSettings()
IMPROVED = SwarmSettings(h_m=0.1, power=2.0, immigrants=7, confidence=CURED_CONFIDENCE, rules=SHARP_RULES)


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
    joints = np.arange(h.values.shape[0])[:, None]
    values = h.values + frame.moved[np.maximum(h.label, 0), joints]
    log_weights, label = h.log_weights, h.label
    s = frame.settings
    if s.jitter_m > 0:
        values, log_weights, label = _singly(values, log_weights, label, s.count)
        values = values + rng.normal(0, s.jitter_m, values.shape)
    if s.immigrants > 0:
        sensors, j = frame.weights.shape
        born = np.repeat(np.arange(sensors), s.immigrants)
        seen = frame.weights[born].T > 0
        fresh = np.where(seen[..., None], frame.positions[born].swapaxes(0, 1), 0.0)
        fresh = fresh + _in_ball(rng, (j, len(born)), s.radius_m)
        values = np.concatenate([values, fresh], 1)
        log_weights = np.concatenate([log_weights, np.where(seen, -np.log(s.count), -np.inf)], 1)
        label = np.concatenate([label, np.where(seen, born, -1).astype(np.int32)], 1)
    return Hypotheses(values, log_weights, label)


def energy(h: Hypotheses, frame: SwarmFrame, /) -> Array:
    """log E (J, N), eq. 7: E = sum_k lambda_k^-power exp(-|s_k - p| / h). A joint that no candidate can explain this
    frame keeps its population (0 everywhere)."""
    out = np.empty(h.log_weights.shape)
    cpu_fusion.swarm_energy(h.values, h.label, frame.positions, frame.weights, frame.settings.h_m, out)
    alive = np.isfinite(h.log_weights)
    with np.errstate(divide="ignore"):
        log_energy = np.log(out)
    return np.where((out * alive).sum(1, keepdims=True) > 0, log_energy, 0.0)


@dataclass(frozen=True)
class MergedWheel:
    """Roulette wheel (or Baker's universal sampling) that keeps equal candidates once: count draws per joint, the
    number of copies as the new weight."""

    count: int
    universal: bool = False

    def __call__(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """The distinct candidates drawn, with log-weights log(copies / count)."""
        shares = h.weights
        counts = np.empty(shares.shape, dtype=np.int64)
        if self.universal:
            cpu_fusion.universal_counts(shares, rng.random(len(shares)), self.count, counts)
        else:
            cpu_fusion.wheel_counts(shares, rng.standard_exponential((len(shares), self.count + 1)), counts)
        width = int((counts > 0).sum(1).max())
        if width == 0:
            return h
        if width < h.count:
            index = np.argsort(counts == 0, axis=1, kind="stable")[:, :width]
            h, counts = h.take(index), np.take_along_axis(counts, index, 1)
        with np.errstate(divide="ignore"):
            return Hypotheses(h.values, np.log(counts / self.count), h.label)


def recipe(settings: SwarmSettings) -> Recipe:
    """The swarm as data for the common loop."""
    survivors = settings.count
    layer = Layer(ride, energy, MergedWheel(survivors, settings.universal), "swarm")
    return Recipe("swarm", (layer,), citation="Asteriadis et al. 2013")


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
    candidates = _candidates(state.candidates, due, frame, last, stream(seed, state.frame, -1))
    result = search(candidates, recipe(settings), frame, partial(stream, seed, state.frame))
    weighted, chosen = result.weighted, result.selected
    w = weighted.weights
    mean = result.estimate
    known = (chosen.label >= 0).any(1)
    variance = (w * ((weighted.values - mean[:, None]) ** 2).sum(-1)).sum(1)
    copies = chosen.weights
    shares = np.stack([(copies * (chosen.label == k)).sum(1) for k in range(len(positions))], 1)
    estimate = SwarmEstimate(
        np.where(known[:, None], mean, np.nan),
        np.where(known, np.sqrt(np.maximum(variance, 0)), np.nan),
        shares,
        due,
        (copies > 0).sum(1),
    )
    at = heading if due else state.heading_at_restart
    return SwarmState(chosen, last, 1 if due else state.age + 1, at, state.frame + 1), estimate


def _candidates(
    old: Hypotheses | None, due: bool, frame: SwarmFrame, last: Array, rng: np.random.Generator
) -> Hypotheses:
    """The old population, renewed where a restart is due or a joint is seen for the first time."""
    s = frame.settings
    joints = frame.positions.shape[1]
    seen = np.asarray(frame.weights > 0)
    if old is None:
        old = Hypotheses(np.zeros((joints, 1, 3)), np.zeros((joints, 1)), np.full((joints, 1), -1))
    renew = (due & (np.isfinite(last[..., 0]).any(0))) | ((old.label < 0).all(1) & seen.any(0))
    if not renew.any():
        return old
    values = np.zeros((joints, max(s.count, old.count), 3))
    log_weights = np.full(values.shape[:2], -np.inf)
    label = np.full(values.shape[:2], -1, dtype=np.int32)
    keep = ~renew
    values[keep, : old.count] = old.values[keep]
    log_weights[keep, : old.count] = old.log_weights[keep]
    label[keep, : old.count] = old.label[keep]
    ball = _in_ball(rng, (joints, s.count), s.radius_m)
    for j in np.flatnonzero(renew):
        # a joint that nobody sees at a restart starts around where it was seen last
        sensors = np.flatnonzero(seen[:, j]) if seen[:, j].any() else np.flatnonzero(np.isfinite(last[:, j, 0]))
        born = sensors[np.arange(s.count) % len(sensors)]
        # ride() has yet to add this frame's movement
        values[j, : s.count] = last[born, j] - frame.moved[born, j] + ball[j]
        log_weights[j, : s.count] = -np.log(s.count)
        label[j, : s.count] = born
    return Hypotheses(values, log_weights, label)


def _in_ball(rng: np.random.Generator, shape: tuple[int, int], radius: float) -> Array:
    """(*shape, 3) m uniform in a ball: a normal direction and the cube root of a uniform number."""
    direction = rng.standard_normal((*shape, 3), dtype=np.float32).astype(np.float64)
    length = np.sqrt(np.einsum("...i,...i->...", direction, direction))
    return direction * (radius * np.cbrt(rng.random(shape)) / np.maximum(length, 1e-12))[..., None]


def _singly(values: Array, log_weights: Array, label: NDArray[np.int32], count: int) -> tuple[Array, Array, NDArray]:
    """Merged candidates written out one by one again, so that each can take its own step."""
    copies = np.rint(np.exp(log_weights) * count).astype(np.int64)
    width = int(copies.sum(1).max())
    index = np.zeros((len(values), width), dtype=np.intp)
    used = np.zeros((len(values), width), dtype=np.bool_)
    for j, c in enumerate(copies):
        each = np.repeat(np.arange(len(c)), c)
        index[j, : len(each)], used[j, : len(each)] = each, True
    flat = np.take_along_axis(values, index[..., None], 1)
    labels = np.where(used, np.take_along_axis(label, index, 1), -1).astype(np.int32)
    return flat, np.where(used, -np.log(count), -np.inf), labels

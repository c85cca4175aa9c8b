"""Benchmarks of skeleton fusion: the published table, errors against a known truth, real sensors, speed.

Seeds: settings were chosen on recordings of seeds below 1000; what is reported comes from FRESH_SEED on.
"""

from __future__ import annotations

import gzip
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row, row
from hypose.evaluation.sensors import (
    FRAME_RATE,
    HIDDEN_BELOW,
    SensorModel,
    SensorRecording,
    human4d_recording,
    treadmill_recording,
)
from hypose.evidence.frame import SensorJoints
from hypose.fusion import baselines, live
from hypose.fusion import joints as jt
from hypose.fusion.confidence import confidence_step, normalised, start_confidence
from hypose.fusion.fit import FitSettings, fit_step, start_fit
from hypose.fusion.fuse import BASELINES, FusionSettings, common_positions, fuse_clip, start, step
from hypose.fusion.register import Registration, common_joints, heading, register, register_per_frame, upward
from hypose.fusion.swarm import IMPROVED, PUBLISHED, SwarmSettings, start_swarm, swarm_step
from hypose.geometry import Array
from hypose.io.skeleton_tables import read_kinect_csv

FRESH_SEED = 1000
HANDS = (jt.LEFT_HAND, jt.RIGHT_HAND)
CYCLES = {"t50": (50, 0.0), "t100": (100, 0.0), "adaptive": (100, np.pi / 3)}
"""Re-initialisation every so many frames, and beyond so much turning. A turn of pi/3 alone gives about one case per
sequence, too few for a share, so the adaptive mode has a largest age."""
PAPER = {"A/t50": 0.875, "A/t100": 0.833, "B/t50": 0.917, "B/t100": 0.95}
GOOD_ERROR_M = 0.09
GOOD_SHARE = 0.6
FEWEST_FRAMES = 30


# ---------------------------------------------------------------- Table 1


@dataclass(frozen=True)
class Choice:
    """What a swarm chose for both hands: shares (T, 2, K) of the sensors, restarts (T,), spread (T, 2) m, distinct
    candidates (T, 2)."""

    shares: Array
    restarts: np.ndarray
    spread: Array
    distinct: np.ndarray


@dataclass(frozen=True)
class Case:
    """One (hand, segment): success; chance: share of the sensors that are right; majority, ninety: iterations until
    that much of the population comes from one sensor (NaN: never)."""

    success: bool
    chance: float
    majority: float
    ninety: float


def noise_of(recording: SensorRecording, settings: SwarmSettings) -> Array:
    """Lambda (T, K, 15) of every frame."""
    sensors = recording.positions.shape[1]
    memory = start_confidence(sensors, settings.confidence)
    inputs = np.empty((len(recording), 3, sensors, 15))
    for t in range(len(recording)):
        memory, raw = confidence_step(
            memory, recording.positions[t], recording.state[t], recording.joint_depth[t], settings.confidence
        )
        inputs[t] = normalised(raw, settings.confidence)
    return settings.rules.noise_fast(np.moveaxis(inputs, 0, 1))


def choose(
    world: Array, noise: Array, turn: Array, settings: SwarmSettings, seed: int, joints: Sequence[int] = HANDS
) -> Choice:
    """Runs the swarm of some joints over registered positions (T, K, 15, 3)."""
    pick = list(joints)
    state = start_swarm(world.shape[1], len(pick))
    shares, restarts, spread, distinct = [], [], [], []
    for t in range(len(world)):
        state, found = swarm_step(state, world[t][:, pick], noise[t][:, pick], float(turn[t]), settings, seed)
        shares.append(found.shares)
        restarts.append(found.restarted)
        spread.append(found.spread)
        distinct.append(found.distinct)
    return Choice(np.array(shares), np.array(restarts), np.array(spread), np.array(distinct))


def cases(recording: SensorRecording, choice: Choice) -> list[Case]:
    """The scorable (hand, segment) cases: those in which some sensors are right and some wrong. A sensor is right when
    it sees the hand in 60 % of the segment's frames and is off by less than 9 cm on average. Success as in the paper:
    at the segment's end most of the population comes from sensors that are right."""
    edges = [*np.flatnonzero(choice.restarts).tolist(), len(recording)]
    out = []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if b - a < FEWEST_FRAMES:
            continue
        for i, j in enumerate(HANDS):
            error = np.nan_to_num(recording.error[a:b, :, j], nan=0.4).mean(0)
            good = ((recording.visible[a:b, :, j] >= HIDDEN_BELOW).mean(0) >= GOOD_SHARE) & (error < GOOD_ERROR_M)
            if not good.any() or good.all():
                continue
            top = choice.shares[a:b, i].max(1)
            out.append(
                Case(
                    bool(choice.shares[b - 1, i][good].sum() > 0.5),
                    float(good.mean()),
                    _first(top, 0.5),
                    _first(top, 0.9),
                )
            )
    return out


def _first(values: Array, limit: float) -> float:
    above = np.flatnonzero(values > limit)
    return float(above[0] + 1) if len(above) else np.nan


def _registered(recording: SensorRecording, per_frame: bool) -> Array:
    if per_frame:
        return register_per_frame(recording.positions)
    return register(recording.positions, recording.state).apply(recording.positions)


def table_1(options: BenchOptions) -> BenchReport:
    """fusion-table-1: share of (hand, segment) cases in which the majority comes from a sensor that tracks the hand."""
    seeds = options.seeds or (2 if options.quick else 10)
    found: dict[str, list[Case]] = {}
    for s in range(seeds):
        for scene in "AB":
            options.progress("sensor choice", 2 * s + (scene == "B"), 2 * seeds)
            recording = _treadmill(scene, FRESH_SEED + s, options)
            for name, settings, per_frame in (("published", PUBLISHED, True), ("swarm", IMPROVED, False)):
                for cycle, got in _all_cycles(recording, settings, per_frame, s).items():
                    found.setdefault(f"{name}/{scene}/{cycle}", []).extend(got)
    rows: list[Row] = []
    for case, got in found.items():
        paper = PAPER.get(case.partition("/")[2])
        more = {"baseline": "paper", "baseline_value": paper} if paper and case.startswith("published") else {}
        rows.append(row("success", case, [c.success for c in got], "share", **more))
    for scene in "AB":
        every = [c for case, got in found.items() if f"/{scene}/" in case for c in got]
        rows.append(row("chance", scene, [c.chance for c in every], "share"))
    for name in ("published", "swarm"):
        every = [c for case, got in found.items() if case.startswith(name) for c in got]
        for metric in ("majority", "ninety"):
            values = np.array([getattr(c, metric) for c in every])
            never = float(np.isnan(values).mean())
            case = metric if name == "published" else f"{metric}/{name}"
            rows.append(row("iterations", case, np.nanmedian(values), "frames"))
            rows.append(row("never_share", case, never, "share"))
            limit = 10 if metric == "majority" else 30
            within = (values <= limit).astype(np.float64)  # never counts as no
            rows.append(row("within_share", f"{case}_{limit}", within, "share"))
    return BenchReport(tuple(rows), _settings(options, seeds))


def _all_cycles(
    recording: SensorRecording, settings: SwarmSettings, per_frame: bool, seed: int
) -> dict[str, list[Case]]:
    noise, world = noise_of(recording, settings), _registered(recording, per_frame)
    turn = heading(world, upward(world))
    out = {}
    for cycle, (every, angle) in CYCLES.items():
        s = replace(settings, restart_every=every, restart_turn=angle)
        out[cycle] = cases(recording, choose(world, noise, turn, s, seed))
    return out


def _cured(**changes: object) -> SwarmSettings:
    confidence = replace(PUBLISHED.confidence, thickness=True, hold=True, clip_m=0.3, floor_m=0.15)
    return replace(PUBLISHED, confidence=confidence, **changes)  # type: ignore[arg-type]


def departure_settings() -> dict[str, SwarmSettings]:
    """The published settings with one departure each, and the improved ones with one taken back each."""

    def inputs(base: SwarmSettings, **changes: object) -> SwarmSettings:
        return replace(base, confidence=replace(base.confidence, **changes))  # type: ignore[arg-type]

    return {
        "published": PUBLISHED,
        "h=0.02": replace(PUBLISHED, h_m=0.02),
        "h=0.1": replace(PUBLISHED, h_m=0.1),
        "h=0.2": replace(PUBLISHED, h_m=0.2),
        "immigrants=7": replace(PUBLISHED, immigrants=7),
        "power=2": replace(PUBLISHED, power=2.0),
        "jitter=5mm": replace(PUBLISHED, jitter_m=0.005),
        "universal": replace(PUBLISHED, universal=True),
        "depth: thickness, hold, floor": _cured(),
        "without F": inputs(PUBLISHED, use_f=False),
        "without D": inputs(PUBLISHED, use_d=False),
        "without A": inputs(PUBLISHED, use_a=False),
        "improved": IMPROVED,
        "improved, h=0.05": replace(IMPROVED, h_m=0.05),
        "improved, power=1": replace(IMPROVED, power=1.0),
        "improved, independent spins": replace(IMPROVED, universal=False),
        "improved, no immigrants": replace(IMPROVED, immigrants=0),
        "improved, no merged evidence": inputs(IMPROVED, merge_bones=False, merge_state=False),
    }


def departures(options: BenchOptions) -> BenchReport:
    """fusion-departures: every departure from the paper, switched alone (registration is the robust one throughout)."""
    seeds = options.seeds or (1 if options.quick else 4)
    rows: list[Row] = []
    recordings = [(scene, _treadmill(scene, s, options), s) for s in range(seeds) for scene in "AB"]
    for n, (name, settings) in enumerate(departure_settings().items()):
        options.progress("departures", n, len(departure_settings()))
        found: dict[str, list[Case]] = {}
        for scene, recording, s in recordings:
            for cycle, got in _all_cycles(recording, settings, False, s).items():
                found.setdefault(f"{name}/{scene}/{cycle}", []).extend(got)
        rows += [row("success", case, [c.success for c in got], "share") for case, got in found.items() if got]
    return BenchReport(tuple(rows), _settings(options, seeds))


# ---------------------------------------------------------------- errors against the truth


def human4d(options: BenchOptions) -> BenchReport:
    """fusion-human4d: MPJPE of all methods on A, B (treadmill) and H (HUMAN4D's run from its four real camera
    poses)."""
    seeds = options.seeds or (1 if options.quick else 10)
    scenes = "ABH" if options.data is not None else "AB"
    found: dict[str, list[float]] = {}
    inside: dict[str, list[float]] = {}
    for s in range(seeds):
        for scene in scenes:
            options.progress(f"scene {scene}", s, seeds)
            recording = _treadmill(scene, FRESH_SEED + s, options)
            frames, truth = recording.frames(), recording.truth_in(0)
            for method in ("fit", "swarm", "published", *BASELINES):
                if method == "best_single":
                    value = _best_single(recording)
                else:
                    settings = FusionSettings(per_frame=method == "published", seed=s)
                    fused = fuse_clip(frames, method, settings)
                    error = np.linalg.norm(common_positions(fused.motion) - truth, axis=-1)
                    value = float(np.nanmean(error))
                    found.setdefault(f"hands/{scene}/{method}", []).append(
                        1e3 * float(np.nanmean(error[:, list(HANDS)]))
                    )
                    if method == "fit":
                        sd = fused.motion.joint_sd[:, [fused.motion.skeleton.joint(n) for n in jt.COMMON]]
                        inside.setdefault(scene, []).append(float((error < 2.5003 * sd).mean()))
                        causal = _causal(frames, truth)
                        found.setdefault(f"{scene}/fit/causal", []).append(1e3 * causal)
                    if method == "published":
                        # what is due to the swarm and what to registering every frame on three joints
                        window = fuse_clip(frames, method, FusionSettings(seed=s))
                        off = np.linalg.norm(common_positions(window.motion) - truth, axis=-1)
                        found.setdefault(f"{scene}/published/window", []).append(1e3 * float(np.nanmean(off)))
                found.setdefault(f"{scene}/{method}", []).append(1e3 * value)
    rows = [row("mpjpe_mm", case, values, "mm") for case, values in found.items()]
    # 90 % of an isotropic normal error in 3D lie within 2.5003 sd per axis
    rows += [row("coverage_90", scene, values, "share") for scene, values in inside.items()]
    return BenchReport(tuple(rows), _settings(options, seeds))


def _causal(frames: Sequence[SensorJoints], truth: Array) -> float:
    """Mean error m of the stream: registration and bone lengths learned as frames come in; the first 5 s not
    counted."""
    state = start(frames[0])
    errors = []
    for t, frame in enumerate(frames):
        state, fused = step(state, frame)
        if t >= min(5 * FRAME_RATE, len(frames) // 2):
            errors.append(np.linalg.norm(fused.joints - truth[t], axis=-1))
    return float(np.mean(errors))


def _best_single(recording: SensorRecording) -> float:
    """m: the best sensor in hindsight, in its own frame, so without any error of registration."""
    errors = [
        np.linalg.norm(baselines.single_sensor(recording.positions, k) - recording.truth_in(k), axis=-1).mean()
        for k in range(recording.positions.shape[1])
    ]
    return float(min(errors))


# ---------------------------------------------------------------- two real sensors

CONFIGURATIONS = {"0": "parallel", "1": "45", "2": "90"}
SCENARIOS = {"occlusion": {"6"}, "two_persons": {"4", "5", "8"}}


def real(options: BenchOptions) -> BenchReport:
    """fusion-real: two Kinect v2 on one person, no truth: agreement between the sensors after registration, bone
    lengths and jitter after fusion, leaving one sensor out. Three recordings per configuration, their first 400 common
    frames; with "/all" every recording, whole."""
    folder = options.folder("kinect_multitrack")
    found: dict[tuple[str, str, str], list[float]] = {}
    used: dict[str, int] = {}
    files = sorted(folder.glob("Study_*_Kinect_[012]_*.gz"))
    for n, file in enumerate(files):
        options.progress("recordings", n, len(files))
        configuration = file.name.partition("_Kinect_")[2][0]
        if used.get(configuration, 0) >= 3 and options.quick:
            continue
        try:
            frames = _main_person(file)
        except InputError:
            continue
        name = CONFIGURATIONS[configuration]
        if not options.quick:
            scenario = _scenarios(file)
            for label, wanted in SCENARIOS.items():
                part = [f for f in frames if scenario.get(round(1e3 * float(f.times[0]))) in wanted]
                if len(part) >= 100:
                    _measure_pair(part, name, f"/{label}", found)
        if len(frames) < 300:
            continue
        used[configuration] = used.get(configuration, 0) + 1
        if used[configuration] <= 3:
            _measure_pair(frames[:400], name, "", found)
        if not options.quick:
            _measure_pair(frames, name, "/all", found)
    rows = [row(metric, case, values, unit) for (metric, case, unit), values in found.items()]
    return BenchReport(tuple(rows), {"recordings": {CONFIGURATIONS[c]: n for c, n in used.items()}})


def _main_person(file: Path) -> list[SensorJoints]:
    """Instants in which both sensors report the person that is seen most, common joints."""
    recording = read_kinect_csv(file)
    if len(recording.streams) < 2:
        raise InputError(f"{file} holds one sensor; two are compared here.")
    a, b = recording.streams[:2]
    ids, counts = np.unique(a.person_ids[a.person_ids >= 0], return_counts=True)
    person = int(ids[counts.argmax()])
    # the logger writes both sensors under one time
    seen = {round(float(t), 4): i for i, t in enumerate(b.times)}
    out = []
    for i, t in enumerate(a.times):
        k = seen.get(round(float(t), 4))
        if k is None or not (person in a.person_ids[i] and person in b.person_ids[k]):
            continue
        ca, cb = int((a.person_ids[i] == person).argmax()), int((b.person_ids[k] == person).argmax())
        frame = SensorJoints(
            np.stack([a.positions[i, ca], b.positions[k, cb]]),
            np.stack([a.state[i, ca], b.state[k, cb]]),
            np.full(2, t),
            a.joint_names,
            (a.name, b.name),
        )
        out.append(common_joints(frame))
    return out


def _scenarios(file: Path) -> dict[int, str]:
    """Scenario_Id by ms since the first row."""
    with gzip.open(file, "rt", encoding="utf-8-sig") as f:
        table = [[c.strip() for c in line.split(",", 5)] for line in f]
    time_column, scenario_column = table[0].index("Tracker_Time"), table[0].index("Scenario_Id")
    rows = [(float(r[time_column]), r[scenario_column]) for r in table[1:] if len(r) > time_column]
    first = min(t for t, _ in rows)
    return {round(t - first): scenario for t, scenario in rows}


def _measure_pair(
    frames: list[SensorJoints], name: str, suffix: str, found: dict[tuple[str, str, str], list[float]]
) -> None:
    positions, states = np.stack([f.positions for f in frames]), np.stack([f.state for f in frames])

    def add(metric: str, case: str, value: float) -> None:
        found.setdefault((metric, case + suffix, "mm"), []).append(1e3 * value)

    def agreement(world: Array) -> float:
        return float(np.nanmedian(np.linalg.norm(world[:, 0] - world[:, 1], axis=-1)))

    registration = register(positions, states)
    world = registration.apply(positions)
    add("agreement_mm", name, agreement(world))
    add("agreement_mm", f"{name}/causal", agreement(_causal_world(frames)))
    methods = ("fit", "weighted_mean") if suffix else ("fit", "swarm", "weighted_mean")
    fused = {m: fuse_clip(frames, m, FusionSettings(check=False), registration) for m in methods}
    for method, result in fused.items():
        label = "mean" if method == "weighted_mean" else method
        joints = common_positions(result.motion)
        for metric, value in (("bone_sd_mm", bone_sd(joints)), ("jitter_mm", jitter(joints))):
            add(metric, f"{label}/{name}", value)
            if not suffix:
                add(metric, label, value)
    if suffix:
        return
    add("agreement_mm", f"{name}/per_frame", agreement(register_per_frame(positions)))
    add("agreement_mm", f"{name}/raw", agreement(positions))
    # leave one out: what the other sensor alone says, seen from here
    for left, kept in ((0, 1), (1, 0)):
        alone = np.where(np.arange(2)[:, None, None] == kept, world, np.nan)
        one = [SensorJoints(alone[t], f.state, f.times, jt.COMMON, f.sensor_names) for t, f in enumerate(frames)]
        result = fuse_clip(one, "fit", FusionSettings(registered=True, check=False))
        distance = np.linalg.norm(common_positions(result.motion) - world[:, left], axis=-1)
        add("leave_one_out_mm", name, float(np.nanmedian(distance)))


def _causal_world(frames: list[SensorJoints]) -> Array:
    """Both sensors as a stream registers them (T, 2, 15, 3)."""
    state = start(frames[0])
    out = []
    for frame in frames:
        state, _ = step(state, frame)
        out.append(state.registration.apply(frame.positions))
    return np.array(out)


def bone_sd(joints: Array) -> float:
    """m: sd over time of the length of arms' and legs' bones and of the shoulders', mean over the bones."""
    limbs = [b for b in jt.BONES[2:14].tolist() if jt.TORSO not in b]
    return float(np.mean([np.nanstd(np.linalg.norm(joints[:, a] - joints[:, b], axis=-1)) for a, b in limbs]))


def jitter(joints: Array) -> float:
    """m: median over joints and frames of the second difference."""
    return float(np.nanmedian(np.linalg.norm(joints[2:] - 2 * joints[1:-1] + joints[:-2], axis=-1)))


# ---------------------------------------------------------------- speed


def speed(options: BenchOptions) -> BenchReport:
    """fusion-speed: ms per frame on one core: the smallest over the repetitions for each frame (other load on the
    machine only adds), then the mean over the frames; the live path's latency without sockets."""
    repeats = 3 if options.quick else 15
    recording = _treadmill("A", 0, options)
    frames = recording.frames()[:152]
    registration = register(recording.positions, recording.state)
    times = {m: _frame_times(frames, registration, m, repeats) for m in ("fit", "swarm", "published")}
    stream = _frame_times(frames, None, "fit", repeats)
    rows = [
        row("ms_per_frame", "fit", times["fit"].mean(), "ms"),
        row("ms_per_frame", "fit/stream", stream.mean(), "ms"),
        row("ms_per_frame", "swarm", times["published"][50:150].mean(), "ms"),
        row("ms_per_frame", "swarm/improved", times["swarm"][50:150].mean(), "ms"),
        row("ms_per_frame", "restart", times["published"][50:151:50].mean(), "ms"),
        row("ms_per_frame", "restart/improved", times["swarm"][50:151:50].mean(), "ms"),
        row("ms_per_frame", "6_persons", _six_persons(frames, registration.apply(recording.positions), repeats), "ms"),
    ]
    latency = live.simulated_latency(_reports(recording, 2 if options.quick else 6))
    rows.append(row("latency_p99_ms", "all", np.percentile(latency[30:], 99), "ms"))
    rows.append(row("latency_median_ms", "all", np.median(latency[30:]), "ms"))
    return BenchReport(tuple(rows), {"repetitions": repeats, "candidates": "15 x 2100", "sensors": 3})


def _frame_times(frames: list[SensorJoints], registration: Registration | None, method: str, repeats: int) -> Array:
    out = np.full((repeats, len(frames)), np.inf)
    for r in range(repeats + 1):
        state = start(frames[0], FusionSettings(method=method), registration)
        for t, frame in enumerate(frames):
            begin = time.perf_counter()
            state, _ = step(state, frame)
            if r:
                out[r - 1, t] = time.perf_counter() - begin
    return 1e3 * out.min(0)


def _six_persons(frames: list[SensorJoints], world: Array, repeats: int) -> float:
    best = np.full(len(frames), np.inf)
    for _ in range(repeats):
        states = [start_fit() for _ in range(6)]
        for t, frame in enumerate(frames):
            begin = time.perf_counter()
            for p in range(6):
                states[p], _ = fit_step(states[p], world[t], frame.state, frame.times[0], FitSettings())
            best[t] = min(best[t], time.perf_counter() - begin)
    return float(1e3 * best.mean())


def _reports(recording: SensorRecording, persons: int) -> list[live.Report]:
    """The recording as messages of three sensors with their own clocks, a few ms on the way, and several persons 1.5 m
    apart; one sensor is silent for two seconds."""
    rng = np.random.default_rng(0)
    out = []
    for t in range(min(len(recording), 300)):
        for k, name in enumerate(recording.sensor_names):
            if k == 1 and 120 <= t < 180:
                continue
            at = recording.times[t] + 0.004 * k
            for p in range(persons):
                shift = recording.camera_from_world[k][:3, :3] @ np.array([1.5 * p, 0.0, 0.0])
                positions = recording.positions[t, k] + shift
                arrival = 100 + at + 0.002 + 0.003 * float(rng.random())
                out.append(live.Report(arrival, name, at, p, jt.COMMON, positions, recording.state[t, k]))
    return sorted(out, key=lambda r: r.arrival)


# ---------------------------------------------------------------- shared


def _treadmill(scene: str, seed: int, options: BenchOptions) -> SensorRecording:
    rng: np.random.Generator = np.random.default_rng([seed, ord(scene)])
    if scene == "H":
        return human4d_recording(options.folder("human4d_run").parent, rng)
    return treadmill_recording(scene, rng, options.data, take=seed)


def _settings(options: BenchOptions, seeds: int) -> dict[str, object]:
    model = SensorModel()
    return {
        "seeds": seeds,
        "first_seed": FRESH_SEED,
        "motion": "real" if options.data is not None else "built-in",
        "sensor_model": {name: getattr(model, name) for name in model.__dataclass_fields__},
    }

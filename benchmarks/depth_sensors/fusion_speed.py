"""Speed of fusion, and the latency of its live path."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, row
from benchmarks.depth_sensors.fusion_scenes import scene_recording
from benchmarks.depth_sensors.replay import replay
from benchmarks.synthetic.sensors import SensorRecording
from hypose.evidence.frame import SensorJoints, SensorReport
from hypose.fusion import joints as jt
from hypose.fusion.fit import fit_step, start_fit
from hypose.fusion.fuse import fuse_clip
from hypose.fusion.people import LiveFuser
from hypose.fusion.register import Registration, register
from hypose.geometry import Array


def speed(options: BenchOptions) -> BenchReport:
    """fusion-speed: ms per frame on one core: the smallest over the repetitions for each frame (other load on the
    machine only adds), then the mean over the frames; the live path's latency without sockets."""
    repeats = 3 if options.quick else 15
    recording = scene_recording("A", 0, options)
    frames = recording.frames()[:152]
    registration = register(recording.positions, recording.state)
    times = {m: _frame_times(frames, registration, m, repeats) for m in ("fit", "swarm", "published-window")}
    rows = [
        row("ms_per_frame", "fit", times["fit"][1:].mean(), "ms"),
        row("ms_per_frame", "swarm", times["published-window"][50:150].mean(), "ms"),
        row("ms_per_frame", "swarm/improved", times["swarm"][50:150].mean(), "ms"),
        row("ms_per_frame", "restart", times["published-window"][50:151:50].mean(), "ms"),
        row("ms_per_frame", "restart/improved", times["swarm"][50:151:50].mean(), "ms"),
        row("ms_per_frame", "6_persons", _six_persons(frames, registration.apply(recording.positions), repeats), "ms"),
    ]
    latency = simulated_latency(_reports(recording, 2 if options.quick else 6))
    rows.append(row("latency_p99_ms", "all", np.percentile(latency[30:], 99), "ms"))
    rows.append(row("latency_median_ms", "all", np.median(latency[30:]), "ms"))
    return BenchReport(tuple(rows), {"repetitions": repeats, "candidates": "15 x 2100", "sensors": 3})


def _frame_times(frames: list[SensorJoints], registration: Registration, method: str, repeats: int) -> Array:
    """Time (T,) ms of each frame; that of the first one includes the preparation of the clip."""
    out = np.empty((repeats + 1, len(frames) + 1))
    for r in range(repeats + 1):  # the first time compiles
        at = [time.perf_counter()]
        fuse_clip(frames, method, registration=registration, watch=lambda _, at=at: at.append(time.perf_counter()))
        out[r] = at
    return 1e3 * np.diff(out[1:], axis=1).min(0)


def _six_persons(frames: list[SensorJoints], world: Array, repeats: int) -> float:
    best, eyes = np.full(len(frames), np.inf), np.full((world.shape[1], 3), np.nan)
    for _ in range(repeats):
        states = [start_fit() for _ in range(6)]
        for t, frame in enumerate(frames):
            begin = time.perf_counter()
            for p in range(6):
                states[p], _ = fit_step(states[p], world[t], frame.state, frame.times[0], eyes)
            best[t] = min(best[t], time.perf_counter() - begin)
    return float(1e3 * best.mean())


def _reports(recording: SensorRecording, persons: int) -> list[SensorReport]:
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
                out.append(SensorReport(name, at, p, jt.COMMON, positions, recording.state[t, k], arrival))
    return sorted(out, key=lambda r: r.arrival)


def simulated_latency(reports: Iterable[SensorReport]) -> Array:
    """(N,) ms from the instant that a frame describes to when it is ready, computation included, sockets not."""
    frames = replay(LiveFuser(), reports, time.perf_counter)
    return np.array([1000 * latency for _, latency in frames])

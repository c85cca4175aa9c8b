"""Benchmarks by name, and the document that each of them writes; options that it would not use are refused.

This module pulls in the whole product: it is imported when a benchmark is asked for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks import golden
from benchmarks.bench_origin import beside_yardstick, command, commit, machine, yardstick
from benchmarks.bench_report import BenchOptions, BenchReport, Progress, Row
from benchmarks.cameras import (
    board_accuracy,
    boardless,
    caliscope_person,
    cameras_bench,
    doctor_real,
    gait_bench,
    planted_faults,
    sync_accuracy,
)
from benchmarks.depth_gestures import (
    gesture_alarms,
    gesture_asl,
    gesture_benchmarks,
    gesture_sessions,
    gesture_speed,
    gesture_sweeps,
)
from benchmarks.depth_sensors import depth_noise, depth_tracking, fusion_benchmarks, fusion_speed, sensor_choice
from benchmarks.live import live_bench
from benchmarks.multiview import (
    body_measures,
    body_measures_real,
    court,
    detector_bench,
    doubt_bench,
    front_back,
    lost_arms,
    opensim_ik_bench,
    path_speed,
    real_recordings,
    real_regions,
    rigging,
    scorer_speed,
    solve_speed,
    starts_bench,
    table_2_3,
    table_2_4,
    uncertainty,
)
from benchmarks.one_camera import mono_benchmarks, mono_real
from benchmarks.people import clothes_bench, mixed_up, players, shelf, together, two_people
from benchmarks.robustness import batch_scale, faults, inputs, kills, start_bench
from benchmarks.studio import page_bench
from hypose.errors import InputError


class Benchmark:
    """A benchmark, and which of "seeds", "first_seed", "data", "parts" and "other" it takes; all take quick."""

    def __init__(self, measure: Callable[[BenchOptions], BenchReport], *takes: str) -> None:
        self.measure, self.takes = measure, frozenset(takes)

    def check(self, name: str, options: BenchOptions) -> None:
        """An InputError for an option that was given and would not be used."""
        given = {"seeds": options.seeds or None, "first_seed": options.first_seed}
        given |= {"data": options.data, "parts": options.parts, "other": options.other or None}
        for option, value in given.items():
            if value is not None and option not in self.takes:
                known = [f"--{o.replace('_', '-')}" for o in given if o in self.takes]
                raise InputError(
                    f"The benchmark {name} does not use --{option.replace('_', '-')}; leave it out (it takes "
                    f"{' and '.join([', '.join(known), '--quick'] if known else ['--quick'])})."
                )


def benchmarks() -> dict[str, Benchmark]:
    """All benchmarks by name."""
    return {
        "golden": Benchmark(golden.golden, "data", "other"),
        "table-2.3": Benchmark(table_2_3.table_2_3, "seeds", "first_seed", "parts"),
        "product": Benchmark(table_2_3.product_table, "seeds", "first_seed", "data", "parts"),
        "table-2.4": Benchmark(table_2_4.table_2_4, "seeds", "first_seed", "parts"),
        "people": Benchmark(together.people, "seeds", "first_seed", "data", "parts"),
        "shelf": Benchmark(shelf.shelf, "data"),
        "two-people": Benchmark(two_people.two_people, "data"),
        "clothes": Benchmark(clothes_bench.clothes, "seeds", "first_seed", "parts"),
        "players": Benchmark(players.players, "seeds", "first_seed", "parts"),
        "mixed-up": Benchmark(mixed_up.mixed_up, "seeds", "first_seed", "parts"),
        "court-4": Benchmark(court.court_4, "seeds", "first_seed", "parts"),
        "arms": Benchmark(lost_arms.arms, "seeds", "first_seed", "data", "parts"),
        "doubt": Benchmark(doubt_bench.doubt, "seeds", "first_seed", "data", "parts"),
        "uncertainty": Benchmark(uncertainty.uncertainty, "seeds", "first_seed", "data"),
        "real-balancing": Benchmark(real_recordings.real_balancing, "data"),
        "detector": Benchmark(detector_bench.detector, "seeds", "first_seed", "data", "parts"),
        "regions-real": Benchmark(real_regions.regions_real, "data"),
        "real-uu4cam": Benchmark(real_recordings.real_uu4cam, "data"),
        "opensim": Benchmark(opensim_ik_bench.opensim, "data"),
        "inputs": Benchmark(inputs.bench_inputs),
        "gait": Benchmark(gait_bench.gait, "seeds", "first_seed", "data", "parts"),
        "caliscope": Benchmark(caliscope_person.caliscope, "data"),
        "cameras": Benchmark(cameras_bench.cameras, "seeds", "first_seed", "data", "parts"),
        "calibration": Benchmark(board_accuracy.boards, "seeds", "first_seed", "data"),
        "boardless": Benchmark(boardless.boardless, "seeds", "first_seed", "data", "parts"),
        "doctor": Benchmark(planted_faults.doctor, "seeds", "first_seed"),
        "doctor-real": Benchmark(doctor_real.doctor_real, "data"),
        "sync": Benchmark(sync_accuracy.sync, "seeds", "first_seed"),
        "silhouette-scorer": Benchmark(scorer_speed.silhouette_scorer, "data"),
        "contour-solve": Benchmark(solve_speed.contour_solve, "data"),
        "multiview-speed": Benchmark(path_speed.multiview_speed, "data"),
        "rigging": Benchmark(rigging.rigging, "seeds"),
        "anthropometry": Benchmark(body_measures.anthropometry, "seeds", "data"),
        "subject-balancing": Benchmark(body_measures_real.subject_balancing, "data"),
        "fusion-table-1": Benchmark(sensor_choice.table_1, "seeds", "first_seed", "data"),
        "fusion-departures": Benchmark(sensor_choice.departures, "seeds", "first_seed", "data"),
        "fusion-human4d": Benchmark(fusion_benchmarks.human4d, "seeds", "first_seed", "data"),
        "fusion-real": Benchmark(fusion_benchmarks.real, "data"),
        "fusion-speed": Benchmark(fusion_speed.speed, "data"),
        "depth": Benchmark(depth_tracking.depth, "seeds", "first_seed", "data", "parts"),
        "depth-noise": Benchmark(depth_noise.depth_noise, "data"),
        "gesture-table-3.1": Benchmark(gesture_benchmarks.table_3_1, "seeds", "first_seed", "parts"),
        "gesture-table-3.2": Benchmark(gesture_benchmarks.table_3_2, "seeds", "first_seed", "parts"),
        "gesture-sweeps": Benchmark(gesture_sweeps.sweeps, "seeds", "first_seed", "parts"),
        "gesture-table-3.3": Benchmark(gesture_sessions.table_3_3, "seeds", "first_seed", "parts"),
        "gesture-semi-synthetic": Benchmark(gesture_asl.semi_synthetic, "seeds", "first_seed", "data", "parts"),
        "gesture-speed": Benchmark(gesture_speed.speed),
        "gesture-false-alarms": Benchmark(gesture_alarms.false_alarms, "seeds", "first_seed", "parts"),
        "batch": Benchmark(batch_scale.batch, "seeds", "first_seed"),
        "faults": Benchmark(faults.faults, "seeds", "first_seed"),
        "studio": Benchmark(page_bench.studio),
        "live": Benchmark(live_bench.live, "seeds", "first_seed", "parts"),
        "front-back": Benchmark(front_back.front_back, "seeds", "first_seed"),
        "starts": Benchmark(starts_bench.starts, "seeds", "first_seed", "parts"),
        "start": Benchmark(start_bench.start),
        "short-clip": Benchmark(start_bench.short_clip, "data"),
        "kills": Benchmark(kills.kills, "seeds", "first_seed"),
        "mono-arm": Benchmark(mono_benchmarks.mono_arm, "seeds", "first_seed"),
        "mono-body": Benchmark(mono_benchmarks.mono_body, "seeds", "first_seed", "data"),
        "mono-speed": Benchmark(mono_benchmarks.mono_speed),
        "mono-real": Benchmark(mono_real.mono_real, "data"),
    }


def run_benchmark(
    name: str,
    *,
    quick: bool = False,
    seeds: int = 0,
    data: Path | None = None,
    progress: Progress | None = None,
    first_seed: int | None = None,
    parts: Path | None = None,
    other: bool = False,
) -> dict[str, Any]:
    """Runs one benchmark and returns its JSON document; an InputError lists the names when it is unknown."""
    known = benchmarks()
    if name not in known:
        raise InputError(f"There is no benchmark {name!r}; the benchmarks are {', '.join(known)}.")
    options = BenchOptions(quick, seeds, data, progress or (lambda stage, done, total: None), first_seed, parts, other)
    known[name].check(name, options)
    began, before = datetime.now(UTC), yardstick()
    begin = time.perf_counter()
    report = known[name].measure(options)
    seconds = time.perf_counter() - begin
    unit = (before + yardstick()) / 2
    return {
        "name": name,
        "commit": commit(),
        "date": began.isoformat(timespec="minutes"),
        "command": command(name, options),
        "machine": machine() | {"opencv_fill_us": unit},
        "settings": {**report.settings, "quick": quick},
        "results": [_plain(beside_yardstick(r, unit)) for r in report.rows],
        "seconds": seconds,
    }


def _plain(r: Row) -> dict[str, Any]:
    """A row as JSON has it, where what is not finite is null."""
    every = {**asdict(r), "ratio": r.ratio}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in every.items()}

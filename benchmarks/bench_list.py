"""Benchmarks by name and case, and the document that each of them writes; options that it would not use are refused.

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
)
from benchmarks.depth_sensors import depth_tracking, fusion_benchmarks, fusion_speed, sensor_choice
from benchmarks.live import live_bench
from benchmarks.multiview import (
    body_measures,
    detector_bench,
    error_bench,
    lost_arms,
    opensim_ik_bench,
    path_speed,
    real_recordings,
    real_regions,
    scorer_speed,
    solve_speed,
    starts_bench,
    table_2_3,
    table_2_4,
    uncertainty,
)
from benchmarks.one_camera import mono_benchmarks, mono_real
from benchmarks.people import clothes_bench, players, shelf, together, two_people
from benchmarks.robustness import batch_scale, start_bench
from benchmarks.studio import page_bench
from hypose.errors import InputError


class Benchmark:
    """A benchmark, and which of "seeds", "first_seed", "data", "parts" and "other" it takes; all take quick."""

    def __init__(self, measure: Callable[[BenchOptions], BenchReport], *takes: str) -> None:
        self.measure, self.takes = measure, frozenset(takes)

    def check(self, name: str, options: BenchOptions) -> None:
        """Raise an InputError for an option that was given and would not be used."""
        given = {"seeds": options.seeds or None, "first_seed": options.first_seed}
        given |= {"data": options.data, "parts": options.parts, "other": options.other or None}
        for option, value in given.items():
            if value is not None and option not in self.takes:
                known = [f"--{o.replace('_', '-')}" for o in given if o in self.takes]
                raise InputError(
                    f"The benchmark {name} does not use --{option.replace('_', '-')}; leave it out (it takes "
                    f"{' and '.join([', '.join(known), '--quick'] if known else ['--quick'])})."
                )


_SCENES = ("seeds", "first_seed", "parts")
_ALL = (*_SCENES, "data")


def benchmarks() -> dict[str, dict[str, Benchmark]]:
    """Return all benchmarks by name and case; "" is the case that is measured without --case."""
    return {
        "golden": {"": Benchmark(golden.golden, "data", "other")},
        "table-2.3": {"": Benchmark(table_2_3.table_2_3, *_SCENES)},
        "product": {"": Benchmark(table_2_3.product_table, *_ALL)},
        "table-2.4": {"": Benchmark(table_2_4.table_2_4, *_SCENES)},
        "arms": {"": Benchmark(lost_arms.arms, *_ALL)},
        "error-model": {"": Benchmark(error_bench.error_model, *_ALL)},
        "regions": {
            "": Benchmark(uncertainty.uncertainty, "seeds", "first_seed", "data"),
            "real": Benchmark(real_regions.regions_real, "data"),
        },
        "starts": {"": Benchmark(starts_bench.starts, *_SCENES)},
        "people": {
            "": Benchmark(together.people, *_ALL),
            "players": Benchmark(players.players, *_SCENES),
            "clothes": Benchmark(clothes_bench.clothes, *_SCENES),
            "shelf": Benchmark(shelf.shelf, "data"),
            "real": Benchmark(two_people.two_people, "data"),
        },
        "real": {
            "balancing": Benchmark(real_recordings.real_balancing, "data"),
            "uu4cam": Benchmark(real_recordings.real_uu4cam, "data"),
            "caliscope": Benchmark(caliscope_person.caliscope, "data"),
            "opensim": Benchmark(opensim_ik_bench.opensim, "data"),
        },
        "detector": {"": Benchmark(detector_bench.detector, *_ALL)},
        "cameras": {
            "": Benchmark(cameras_bench.cameras, *_ALL),
            "gait": Benchmark(gait_bench.gait, *_ALL),
        },
        "calibration": {
            "": Benchmark(board_accuracy.boards, "seeds", "first_seed", "data"),
            "faults": Benchmark(planted_faults.doctor, "seeds", "first_seed"),
            "real": Benchmark(doctor_real.doctor_real, "data"),
            "sync": Benchmark(sync_accuracy.sync, "seeds", "first_seed"),
        },
        "boardless": {"": Benchmark(boardless.boardless, *_ALL)},
        "body": {
            "": Benchmark(body_measures.anthropometry, "seeds", "data"),
            "real": Benchmark(body_measures.subject_balancing, "data"),
            "layered": Benchmark(body_measures.layered, "seeds", "first_seed"),
        },
        "fusion": {
            "table-1": Benchmark(sensor_choice.table_1, "seeds", "first_seed", "data"),
            "human4d": Benchmark(fusion_benchmarks.human4d, "seeds", "first_seed", "data"),
            "real": Benchmark(fusion_benchmarks.real, "data"),
            "speed": Benchmark(fusion_speed.speed, "data"),
        },
        "depth": {"": Benchmark(depth_tracking.depth, *_ALL)},
        "gesture": {
            "table-3.1": Benchmark(gesture_benchmarks.table_3_1, *_SCENES),
            "table-3.2": Benchmark(gesture_benchmarks.table_3_2, *_SCENES),
            "table-3.3": Benchmark(gesture_sessions.table_3_3, *_SCENES),
            "semi-synthetic": Benchmark(gesture_asl.semi_synthetic, *_ALL),
            "false-alarms": Benchmark(gesture_alarms.false_alarms, *_SCENES),
            "speed": Benchmark(gesture_speed.speed),
        },
        "mono": {
            "arm": Benchmark(mono_benchmarks.mono_arm, "seeds", "first_seed"),
            "body": Benchmark(mono_benchmarks.mono_body, "seeds", "first_seed", "data"),
            "real": Benchmark(mono_real.mono_real, "data"),
            "speed": Benchmark(mono_benchmarks.mono_speed),
        },
        "live": {"": Benchmark(live_bench.live, *_SCENES)},
        "speed": {
            "tracking": Benchmark(path_speed.multiview_speed, "data"),
            "scorer": Benchmark(scorer_speed.silhouette_scorer, "data"),
            "solve": Benchmark(solve_speed.contour_solve, "data"),
            "start": Benchmark(start_bench.start),
            "short-clip": Benchmark(start_bench.short_clip, "data"),
            "batch": Benchmark(batch_scale.batch, "seeds", "first_seed"),
        },
        "studio": {"": Benchmark(page_bench.studio)},
    }


def kept_name(name: str, case: str) -> str:
    """Return the name of the document of a benchmark's case: NAME, or NAME-CASE."""
    return f"{name}-{case}" if case else name


def find_benchmark(name: str, case: str = "") -> tuple[str, str, Benchmark]:
    """Return the name, the case and the benchmark that are asked for; the name of a document stands for its case.

    Raises: InputError with the names, or with the cases of a name."""
    known = benchmarks()
    asked = [(n, c) for n, cases in known.items() for c in cases if kept_name(n, c) == kept_name(name, case)]
    if asked:
        name, case = asked[0]
        return name, case, known[name][case]
    if name in known:
        cases = ", ".join(c for c in known[name] if c) or "none but the one without --case"
        raise InputError(f"Choose one of the cases of the benchmark {name} with --case: {cases}.")
    names = "; ".join(f"{n} ({', '.join(c for c in cases if c)})" if any(cases) else n for n, cases in known.items())
    raise InputError(f"There is no benchmark {name!r}; the benchmarks are, with their cases: {names}.")


def run_benchmark(
    name: str,
    case: str = "",
    *,
    quick: bool = False,
    seeds: int = 0,
    data: Path | None = None,
    progress: Progress | None = None,
    first_seed: int | None = None,
    parts: Path | None = None,
    other: bool = False,
) -> dict[str, Any]:
    """Run a case of a benchmark and return its JSON document; an InputError lists the names when it is unknown."""
    name, case, benchmark = find_benchmark(name, case)
    options = BenchOptions(quick, seeds, data, progress or (lambda stage, done, total: None), first_seed, parts, other)
    benchmark.check(name, options)
    began, before = datetime.now(UTC), yardstick()
    begin = time.perf_counter()
    report = benchmark.measure(options)
    seconds = time.perf_counter() - begin
    unit = (before + yardstick()) / 2
    return {
        "name": kept_name(name, case),
        "commit": commit(),
        "date": began.isoformat(timespec="minutes"),
        "command": command(name, case, options),
        "machine": machine() | {"opencv_fill_us": unit},
        "settings": {**report.settings, "quick": quick},
        "results": [_plain(beside_yardstick(r, unit)) for r in report.rows],
        "seconds": seconds,
    }


def _plain(r: Row) -> dict[str, Any]:
    """A row as JSON has it, where what is not finite is null."""
    every = {**asdict(r), "ratio": r.ratio}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in every.items()}

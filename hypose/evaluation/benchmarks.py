"""Benchmarks by name, and the document that each of them writes.

A benchmark is a function from options to rows; options that it would not use are refused. Names, metrics and cases are
fixed, so that figures of different versions can be compared; ratios are taken against a baseline of the same run,
because machines are noisy.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.io.files import write_text
from hypose.io.results import to_json

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class BenchOptions:
    """quick: end within a minute and be small; seeds: repetitions, 0 = the benchmark's own number; data: folder of real
    recordings (None: only what needs none); progress(stage, done, total); first_seed: where the repetitions' seeds
    begin, for benchmarks that have an own default; parts: folder that keeps the figures of each part."""

    quick: bool = False
    seeds: int = 0
    data: Path | None = None
    progress: Progress = field(default=lambda stage, done, total: None)
    first_seed: int | None = None
    parts: Path | None = None

    def seed_range(self, usual: int, *, quick: int = 1, first: int = 0) -> range:
        """The seeds to measure: as many as asked for (else `usual`, or `quick`), from the first one asked for (else
        `first`). Long tables can so be measured seed by seed."""
        start = first if self.first_seed is None else self.first_seed
        return range(start, start + (self.seeds or (quick if self.quick else usual)))

    def part(self, name: str, measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The figures of one part of a long benchmark (a seed, a gesture), as JSON has them: those kept in the folder
        `parts`, else measured and kept there. Nothing measured is lost when a run is cut short, and a table can be
        measured bit by bit. Which code a part was measured with is not known here: new code, new folder."""
        if self.parts is None:
            return measure()
        path = self.parts / f"{name}{'.quick' if self.quick else ''}.json"
        if path.exists():
            try:
                return dict(json.loads(path.read_text(encoding="utf-8")))
            except (ValueError, TypeError):
                raise InputError(f"{path} is no part of a benchmark; delete it, or give another folder.") from None
        figures = measure()
        write_text(path, to_json(figures))
        return figures

    def folder(self, name: str) -> Path:
        """A real recording's folder; an InputError says what is missing."""
        if self.data is None or not (self.data / name).exists():
            where = "no --data folder was given" if self.data is None else f"{self.data / name} does not exist"
            raise InputError(
                f"This benchmark needs the recording {name!r}, but {where}; give the folder that holds it with --data."
            )
        return self.data / name


@dataclass(frozen=True)
class Row:
    """One figure: metric, case, value, unit, sd over the repetitions, n repetitions, and a baseline if there is one."""

    metric: str
    case: str
    value: float
    unit: str
    sd: float | None = None
    n: int = 1
    baseline: str | None = None
    baseline_value: float | None = None

    @property
    def ratio(self) -> float | None:
        """value / baseline_value."""
        return None if not self.baseline_value else self.value / self.baseline_value


@dataclass(frozen=True)
class BenchReport:
    """The rows of a benchmark and the settings it ran with."""

    rows: tuple[Row, ...]
    settings: Mapping[str, Any]


def row(metric: str, case: str, values: Any, unit: str, **more: Any) -> Row:
    """The mean of values (n,) with their sd."""
    v = np.atleast_1d(np.asarray(values, dtype=np.float64))
    sd = float(v.std(ddof=1)) if len(v) > 1 else None
    return Row(metric, case, float(v.mean()), unit, sd, len(v), **more)


class Benchmark:
    """A benchmark, and which of "seeds", "first_seed", "data" and "parts" it takes; all take quick."""

    def __init__(self, measure: Callable[[BenchOptions], BenchReport], *takes: str) -> None:
        self.measure, self.takes = measure, frozenset(takes)

    def check(self, name: str, options: BenchOptions) -> None:
        """An InputError for an option that was given and would not be used."""
        given = {"seeds": options.seeds or None, "first_seed": options.first_seed}
        given |= {"data": options.data, "parts": options.parts}
        for option, value in given.items():
            if value is not None and option not in self.takes:
                known = [f"--{o.replace('_', '-')}" for o in given if o in self.takes]
                raise InputError(
                    f"The benchmark {name} does not use --{option.replace('_', '-')}; leave it out (it takes "
                    f"{' and '.join([', '.join(known), '--quick'] if known else ['--quick'])})."
                )


def benchmarks() -> dict[str, Benchmark]:
    """All benchmarks by name (imported when asked for, because they pull in the whole product)."""
    from hypose.evaluation import (
        anthropometry,
        anthropometry_real,
        batch_scale,
        calibration,
        court,
        doctor,
        doctor_real,
        faults,
        front_back,
        fusion_benchmarks,
        fusion_speed,
        gesture_alarms,
        gesture_asl,
        gesture_benchmarks,
        gesture_sessions,
        gesture_speed,
        gesture_sweeps,
        kills,
        mono_benchmarks,
        mono_real,
        path_speed,
        published,
        real,
        rigging,
        scorer_speed,
        sensor_choice,
        speed,
        sync,
        table_2_4,
        uncertainty,
    )

    return {
        "table-2.3": Benchmark(published.table_2_3, "seeds", "first_seed", "data"),
        "table-2.4": Benchmark(table_2_4.table_2_4, "seeds", "first_seed"),
        "court-4": Benchmark(court.court_4, "seeds", "first_seed"),
        "uncertainty": Benchmark(uncertainty.uncertainty, "seeds", "first_seed", "data"),
        "real-balancing": Benchmark(real.real_balancing, "data"),
        "real-uu4cam": Benchmark(real.real_uu4cam, "data"),
        "calibration": Benchmark(calibration.boards, "seeds", "first_seed", "data"),
        "doctor": Benchmark(doctor.doctor, "seeds", "first_seed"),
        "doctor-real": Benchmark(doctor_real.doctor_real, "data"),
        "sync": Benchmark(sync.sync, "seeds", "first_seed"),
        "silhouette-scorer": Benchmark(scorer_speed.silhouette_scorer, "data"),
        "contour-solve": Benchmark(speed.contour_solve, "data"),
        "multiview-speed": Benchmark(path_speed.multiview_speed, "data"),
        "rigging": Benchmark(rigging.rigging, "seeds"),
        "anthropometry": Benchmark(anthropometry.anthropometry, "seeds", "data"),
        "subject-balancing": Benchmark(anthropometry_real.subject_balancing, "data"),
        "fusion-table-1": Benchmark(sensor_choice.table_1, "seeds", "first_seed", "data"),
        "fusion-departures": Benchmark(sensor_choice.departures, "seeds", "first_seed", "data"),
        "fusion-human4d": Benchmark(fusion_benchmarks.human4d, "seeds", "first_seed", "data"),
        "fusion-real": Benchmark(fusion_benchmarks.real, "data"),
        "fusion-speed": Benchmark(fusion_speed.speed, "data"),
        "gesture-table-3.1": Benchmark(gesture_benchmarks.table_3_1, "seeds", "first_seed", "parts"),
        "gesture-table-3.2": Benchmark(gesture_benchmarks.table_3_2, "seeds", "first_seed", "parts"),
        "gesture-sweeps": Benchmark(gesture_sweeps.sweeps, "seeds", "first_seed", "parts"),
        "gesture-table-3.3": Benchmark(gesture_sessions.table_3_3, "seeds", "first_seed", "parts"),
        "gesture-semi-synthetic": Benchmark(gesture_asl.semi_synthetic, "seeds", "first_seed", "data", "parts"),
        "gesture-speed": Benchmark(gesture_speed.speed),
        "gesture-false-alarms": Benchmark(gesture_alarms.false_alarms, "seeds", "first_seed", "parts"),
        "batch": Benchmark(batch_scale.batch, "seeds", "first_seed"),
        "faults": Benchmark(faults.faults, "seeds", "first_seed"),
        "front-back": Benchmark(front_back.front_back, "seeds", "first_seed"),
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
) -> dict[str, Any]:
    """Runs one benchmark and returns its JSON document; an InputError lists the names when it is unknown."""
    known = benchmarks()
    if name not in known:
        raise InputError(f"There is no benchmark {name!r}; the benchmarks are {', '.join(known)}.")
    options = BenchOptions(quick, seeds, data, progress or (lambda stage, done, total: None), first_seed, parts)
    known[name].check(name, options)
    begin = time.perf_counter()
    report = known[name].measure(options)
    return {
        "name": name,
        "machine": machine(),
        "settings": {**report.settings, "quick": quick},
        "results": [{**asdict(r), "ratio": r.ratio} for r in report.rows],
        "seconds": time.perf_counter() - begin,
    }


def machine() -> dict[str, Any]:
    """Processor, number of usable cores, python and load of this machine."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"processor": model, "cores": cores, "python": platform.python_version(), "load": load}

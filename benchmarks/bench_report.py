"""What a benchmark is given, and the rows it returns. `bench_list` has them by name.

Metrics and cases are fixed, so that figures of different versions can be compared; ratios are taken against a baseline
of the same run, because machines are noisy.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.io.files import write_text
from hypose.io.motions.results import to_json

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class BenchOptions:
    """quick: end within a minute and be small; seeds: repetitions, 0 = the benchmark's own number; data: folder of real
    recordings (None: only what needs none); progress(stage, done, total); first_seed: where the repetitions' seeds
    begin, for benchmarks that have an own default; parts: folder that keeps the figures of each part; other: the second
    set of golden clips."""

    quick: bool = False
    seeds: int = 0
    data: Path | None = None
    progress: Progress = field(default=lambda stage, done, total: None)
    first_seed: int | None = None
    parts: Path | None = None
    other: bool = False

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


def best(call: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of the fastest of some calls: the figure that other load on the machine disturbs least.

    clock: time.thread_time (processor time of this thread) for what uses no second thread is disturbed less still."""
    seconds = []
    for _ in range(repeats):
        begin = clock()
        call()
        seconds.append(clock() - begin)
    return min(seconds)

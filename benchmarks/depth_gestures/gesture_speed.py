"""Measure the speed of finding and of learning gestures, and the memory of a forest."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, best, row
from benchmarks.depth_gestures.gesture_data import Size, examples, for_gesture, teach, test_set, thinned, training_set
from benchmarks.depth_gestures.gesture_pictures import GestureFrame
from benchmarks.depth_gestures.gesture_scores import THOROUGH, judge
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.forest import Forest
from hypose.gestures.localise import Scratch, localise
from hypose.gestures.online import Learner
from hypose.synthetic.gesture_people import GESTURES


@dataclass(frozen=True)
class _Grown:
    """A forest of each gesture, its size (MB) while growing, the AP (5 cm) that looking quickly costs; seconds of every
    learning step; ms to find a gesture in each of its test pictures."""

    forests: list[Forest]
    megabytes: list[float]
    lost: list[float]
    steps_s: list[float]
    find_ms: list[float]


def _grow(shot: list[GestureFrame], test: list[GestureFrame], options: BenchOptions) -> _Grown:
    out = _Grown([], [], [], [], [])
    for number in range(1, len(GESTURES) + 1):
        learner, shown = Learner.new(np.random.default_rng(number)), examples(shot, number)
        teach(learner, shown[:20])  # compiles
        for _ in range(2 if options.quick else 4):
            out.steps_s.extend(_cpu(partial(teach, learner, [e])) for e in thinned(shown, 0.5, learner.rng))
        forest, mine = learner.forest.freeze(), for_gesture(test, number)
        out.forests.append(forest)
        out.megabytes.append(_megabytes(learner))
        quick, thorough = judge(forest, mine, number), judge(forest, mine, number, THOROUGH)
        out.lost.append(thorough.ap_metres() - quick.ap_metres())
        out.find_ms.extend(_milliseconds([f.depth for f in mine[:: 2 if options.quick else 1]], [forest]))
        options.progress("learn", number, len(GESTURES))
    return out


def _megabytes(learner: Learner) -> float:
    return sum(a.nbytes for a in learner.forest.arrays) / 1e6


def speed(options: BenchOptions) -> BenchReport:
    """Milliseconds per 640 x 480 picture for one and for six gestures; learning steps per second; megabytes."""
    size = Size(12, 48, 8) if options.quick else Size(24, 96, 24)
    rng = np.random.default_rng([91, 0])
    shot = training_set(size, rng, tick=lambda k, n: options.progress("render", k, n))
    test = test_set(size, rng)
    grown = _grow(shot, test, options)

    pictures = [f.depth for f in test[:: 4 if options.quick else 2]]
    ms = grown.find_ms
    rows = [
        Row("detect_ms", "one", float(np.median(ms)), "ms", float(np.std(ms)), len(ms)),
        Row("detect_ms", "one/p95", float(np.percentile(ms, 95)), "ms", n=len(ms)),
        Row("detect_ms", "six", float(np.median(_milliseconds(pictures, grown.forests))), "ms", n=len(pictures)),
        row("ap_lost_to_rejection", "all", grown.lost, "1"),
        Row("train_frames_per_second", "all", 1 / float(np.mean(grown.steps_s)), "1/s", n=len(grown.steps_s)),
        Row("model_mb", "all", max(grown.megabytes), "MB", n=len(grown.megabytes)),
        Row("nodes", "one", float(np.mean([f.size.sum() for f in grown.forests])), "1"),
    ]
    return BenchReport(
        tuple(rows), {"size": [640, 480], "trees": 15, "deepest": 20, "threads": 1, "time": "processor, best of 3"}
    )


def _cpu(call: Callable[[], object], repeats: int = 1) -> float:
    return best(call, repeats, time.thread_time)


def _milliseconds(pictures: list[Any], forests: list[Forest]) -> list[float]:
    scratch = Scratch()
    for f in forests:
        _ = f.packed
    return [1e3 * _cpu(partial(localise, d, KINECT, forests, None, scratch), 3) for d in pictures]

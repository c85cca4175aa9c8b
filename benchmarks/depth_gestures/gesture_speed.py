"""Speed of finding and of learning gestures, and memory while growing; beside libraries that are made for tables."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_data import Size, examples, for_gesture, teach, test_set, thinned, training_set
from benchmarks.depth_gestures.gesture_pictures import GestureFrame
from benchmarks.depth_gestures.gesture_scores import THOROUGH, judge
from benchmarks.papers.offline_forests import OfflineSettings, Pool, collect, train_offline
from benchmarks.short_calls import best
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.forest import Forest, ForestSettings
from hypose.gestures.localise import Scratch, localise, pad
from hypose.gestures.online import Example, Learner, LearnSettings
from hypose.synthetic.gesture_poses import GESTURES


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
    shown = examples(shot, GESTURES.index("ok") + 1)
    deep = Learner.new(rng, ForestSettings(alpha=40), LearnSettings(positives=60, hard=60))
    for _ in range(2 if options.quick else 4):
        teach(deep, shown, shuffle=True)
    pictures = [f.depth for f in test[:: 4 if options.quick else 2]]
    ms = grown.find_ms
    rows = [
        Row("detect_ms", "one", float(np.median(ms)), "ms", float(np.std(ms)), len(ms)),
        Row("detect_ms", "one/p95", float(np.percentile(ms, 95)), "ms", n=len(ms)),
        Row("detect_ms", "one/deep", float(np.median(_milliseconds(pictures, [deep.forest.freeze()]))), "ms"),
        Row("detect_ms", "six", float(np.median(_milliseconds(pictures, grown.forests))), "ms", n=len(pictures)),
        row("ap_lost_to_rejection", "all", grown.lost, "1"),
        Row("train_frames_per_second", "all", 1 / float(np.mean(grown.steps_s)), "1/s", n=len(grown.steps_s)),
        Row("model_mb", "all", max(grown.megabytes), "MB", n=len(grown.megabytes)),
        Row("model_mb", "deep", _megabytes(deep), "MB"),
        Row("nodes", "one", float(np.mean([f.size.sum() for f in grown.forests])), "1"),
        Row("nodes", "deep", float(deep.forest.arrays.size.sum()), "1"),
        *_compared(shown, rng, options),
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


def _compared(shown: list[Example], rng: np.random.Generator, options: BenchOptions) -> list[Row]:
    """Our learning beside scikit-learn (fit of as many trees on 100 ready-made features, all tried at every node) and
    river (one sample); alone where they are not installed."""
    pool = collect(shown, rng)
    train_offline(pool, rng, OfflineSettings(ForestSettings(trees=1), per_class=100))  # compiles
    settings = OfflineSettings(per_class=len(pool.labels) // 2)
    ours = _cpu(lambda: train_offline(pool, np.random.default_rng(0), settings))
    features, theirs = _features(pool, rng), dict[str, Any]()
    if (ensemble := _optional("sklearn.ensemble")) is not None:
        model = ensemble.RandomForestClassifier(15, max_depth=20, max_features=None, n_jobs=1, random_state=0)
        value = _cpu(lambda: model.fit(features, pool.labels))
        theirs = {"baseline": "scikit-learn", "baseline_value": value}
    rows = [Row("offline_fit_s", "all", ours, "s", **theirs)]

    learner = Learner.new(np.random.default_rng(3))
    picture = pad(shown[0].depth, KINECT, 150, 500)
    y, x = (7 * k for k in np.nonzero(shown[0].depth[::7, ::7]))
    labels = rng.integers(0, 2, len(y)).astype(np.int32)
    learner.forest.learn(picture, y[:64], x[:64], labels[:64])
    ours, theirs = _cpu(lambda: learner.forest.learn(picture, y, x, labels)) / len(y), dict[str, Any]()
    if (river := _optional("river.forest")) is not None:
        adaptive = river.ARFClassifier(n_models=15, seed=0)
        samples = [dict(enumerate(map(float, f))) for f in features[: 60 if options.quick else 200]]

        def learn() -> None:
            for sample, label in zip(samples, pool.labels.tolist(), strict=False):
                adaptive.learn_one(sample, int(label))

        theirs = {"baseline": "river", "baseline_value": 1e6 * _cpu(learn) / len(samples)}
    return [*rows, Row("learn_one_us", "all", 1e6 * ours, "us", **theirs)]


def _optional(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def _features(pool: Pool, rng: np.random.Generator) -> np.ndarray:
    """(n, 100) clipped differences of random patch pixels: what a library for tables would be given."""
    side = pool.patches.shape[1]
    p = np.clip(pool.patches.reshape(len(pool.patches), -1), -150, 150)
    pairs = rng.integers(0, side * side, (100, 2))
    return (p[:, pairs[:, 0]] - p[:, pairs[:, 1]]).astype(np.float32)

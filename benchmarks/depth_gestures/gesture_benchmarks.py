"""The gesture tables of the thesis on simulated depth: clipping (3.1), offline against online learning (3.2).

Other people in cluttered rooms with a second person; a quarter of the test pictures shows the gesture; one detection
per picture. Settings were chosen on seed 100, which is none of the seeds reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_data import (
    CLUTTERED,
    FULL,
    QUICK,
    SEEDS,
    SHARE,
    TRAINING,
    Size,
    examples,
    for_gesture,
    teach,
    test_set,
    thinned,
    training_set,
    two_fixed_rooms,
)
from benchmarks.depth_gestures.gesture_pictures import GestureFrame, Stage
from benchmarks.depth_gestures.gesture_scores import THOROUGH, Judged, judge
from benchmarks.multiview.paired import differences
from benchmarks.papers.offline_forests import OfflineSettings, collect, train_offline
from hypose.gestures.forest import Forest, ForestSettings
from hypose.gestures.online import Example, Learner, LearnSettings
from hypose.synthetic.gesture_people import GESTURES

PASSES = 4
"""Over the positive pictures; each pass takes half of the negative ones."""
_THOROUGH = "online_hard_thorough"
PUBLISHED_ORDER = (
    ("online_hard_published", "online_random_as_many"),
    ("online_random_as_many", "offline_boosted"),
    ("online_hard_published", "offline_boosted"),
)
"""The printed order of Table 3.2: hard negatives, random ones, offline learning."""


@dataclass(frozen=True)
class Shot:
    """Pictures to learn from and to test with."""

    train: list[GestureFrame]
    test: list[GestureFrame]


def shoot(seed: int, options: BenchOptions, size: Size, stage: Stage = TRAINING) -> Shot:
    """The pictures of a seed: other people, and cluttered rooms, in the test."""
    rng = np.random.default_rng([8, seed])
    return Shot(
        training_set(size, rng, stage, tick=lambda k, n: options.progress("render", k, n)),
        test_set(size, rng, CLUTTERED, tick=lambda k, n: options.progress("render test", k, n)),
    )


def learn_online(
    shown: Sequence[Example],
    seed: int,
    *,
    settings: ForestSettings | None = None,
    passes: int = PASSES,
    **pixels: Any,
) -> Forest:
    """A forest taught with examples, several passes in random order; pixels: numbers of LearnSettings."""
    learner = Learner.new(np.random.default_rng([81, seed]), settings, LearnSettings(**pixels))
    for _ in range(passes):
        teach(learner, thinned(shown, 0.5, learner.rng), shuffle=True)
    return learner.forest.freeze()


def table_3_2(options: BenchOptions) -> BenchReport:
    """Offline boosted (as published, and with negatives around the place) against online learning with random and with
    hard negatives, on the same frames.

    Deviation: drawn people in drawn rooms in place of the thesis' recordings."""
    seeds, size = options.seed_range(SEEDS), QUICK if options.quick else FULL
    names = GESTURES[:2] if options.quick else GESTURES
    values: dict[tuple[str, str], list[Judged]] = {}
    for done, seed in enumerate(seeds):
        data = cache(partial(shoot, seed, options, size))  # drawn only for what has not been measured yet
        for k, name in enumerate(names):
            part = options.part(f"gesture-table-3.2.{seed}.{name}", partial(_learn_all_ways, data, name, seed))
            for method, judged in part.items():
                values.setdefault((method, name), []).append(Judged.of(judged))
            options.progress("learn", done * len(names) + k + 1, len(seeds) * len(names))
    methods = tuple(dict.fromkeys(m for m, _ in values))
    mean = {m: np.mean([[j.ap() for j in values[m, g]] for g in names], axis=0) for m in methods}  # per seed
    rows = _means(values, names, "mean_ap", methods)
    rows += differences("ap_difference{}", mean, PUBLISHED_ORDER, "1")
    for g in names:
        ap = {f"{m}/{g}": [j.ap() for j in values[m, g]] for m in methods}
        rows += differences("ap_difference{}", ap, [(f"{a}/{g}", f"{b}/{g}") for a, b in PUBLISHED_ORDER], "1")
    for case, take in (("10px", Judged.ap), ("5cm", Judged.ap_metres)):
        ways = [np.array([[take(j) for j in values[m, g]] for g in names]) for m in (_THOROUGH, "online_hard")]
        rows.append(row("ap_lost_to_rejection", case, (ways[0] - ways[1]).ravel(), "1"))  # of every forest
    more = {"curves": _curves(values), "mean_ap_per_seed": {m: v.tolist() for m, v in mean.items()}}
    return BenchReport(tuple(rows), _settings(size, seeds) | more)


def _learn_all_ways(data: Callable[[], Shot], name: str, seed: int) -> dict[str, Any]:
    number, shot = GESTURES.index(name) + 1, data()
    shown, test = examples(shot.train, number), for_gesture(shot.test, number)
    published, pool = (collect(shown, np.random.default_rng([83, seed]), around=n) for n in (0, 10))
    forests = {
        "online_hard": learn_online(shown, seed),
        "online_random": learn_online(shown, seed, hard=0, around=0, random=10, few=10),
        # the published ones: no ring of negatives; as many random negatives as hard ones can be
        "online_hard_published": learn_online(shown, seed, around=0),
        "online_random_as_many": learn_online(shown, seed, hard=0, around=0, random=32, few=32),
        "offline_boosted": train_offline(published, np.random.default_rng([82, seed])),
        "offline_boosted_around": train_offline(pool, np.random.default_rng([82, seed])),
    }
    judged = {method: judge(forest, test, number) for method, forest in forests.items()}
    judged[_THOROUGH] = judge(forests["online_hard"], test, number, THOROUGH)
    return {method: j.plain() for method, j in judged.items()}


def _curves(values: Mapping[tuple[str, str], Sequence[Judged]]) -> dict[str, list[list[list[float]]]]:
    """Of each seed, by method/gesture."""
    return {f"{m}/{g}": [j.curve() for j in every] for (m, g), every in values.items()}


def _means(
    values: dict[tuple[str, str], list[Judged]], names: Sequence[str], metric: str, methods: Sequence[str]
) -> list[Row]:
    """The mean over the gestures (sd over seeds) at both radii, then every gesture."""
    rows: list[Row] = []
    for method in methods:
        px = np.array([[j.ap() for j in values[method, g]] for g in names])
        cm = np.array([[j.ap_metres() for j in values[method, g]] for g in names])
        rows.append(row(metric, method, px.mean(0), "1"))
        rows.append(row(metric, f"{method}/5cm", cm.mean(0), "1"))
        rows += [row("ap", f"{method}/{g}", px[k], "1") for k, g in enumerate(names)]
        rows += [row("ap", f"{method}/{g}/5cm", cm[k], "1") for k, g in enumerate(names)]
    return rows


_CLIPS: dict[str, int | None] = {"clipped_15": 150, "clipped_30": 300, "clipped_50": 500, "unclipped": None}


def table_3_1(options: BenchOptions) -> BenchReport:
    """Clipping distances, trained in two fixed empty rooms, tested in clutter; and boosted sub-forests.

    Deviation: drawn people in drawn rooms in place of the thesis' recordings."""
    seeds, size = options.seed_range(SEEDS), QUICK if options.quick else Size(40, 160, 20)
    names = ("tee", "ok") if options.quick else GESTURES
    values: dict[tuple[str, str], list[Judged]] = {}
    online: dict[tuple[str, str], list[float]] = {}
    for done, seed in enumerate(seeds):
        stage = two_fixed_rooms(np.random.default_rng([84, seed]))
        data = cache(partial(shoot, seed + 1000, options, size, stage))
        for k, name in enumerate(names):
            part = options.part(f"gesture-table-3.1.{seed}.{name}", partial(_clip, data, name, seed))
            for case, judged in part["offline"].items():
                values.setdefault((case, name), []).append(Judged.of(judged))
            for case, judged in part["online"].items():
                online.setdefault((case, name), []).append(Judged.of(judged).ap())
            options.progress("learn", done * len(names) + k + 1, len(seeds) * len(names))
    rows: list[Row] = []
    for metric, table in (("auc", {k: [j.auc() for j in v] for k, v in values.items()}), ("online_ap", online)):
        for case in dict.fromkeys(c for c, _ in table):
            v = np.array([table[case, g] for g in names])  # (gestures, seeds)
            rows.append(row(metric, case, v.mean(0), "1"))
            rows += [row(metric, f"{case}/{g}", v[k], "1") for k, g in enumerate(names)]
    return BenchReport(tuple(rows), _settings(size, seeds) | {"curves": _curves(values)})


def _clip(data: Callable[[], Shot], name: str, seed: int) -> dict[str, Any]:
    number, shot = GESTURES.index(name) + 1, data()
    shown, test = examples(shot.train, number), for_gesture(shot.test, number)
    pool = collect(shown, np.random.default_rng([83, seed]), negatives=20, around=0)
    jobs = {c: OfflineSettings(ForestSettings(clip_mm=mm), per_class=5000, tests=60) for c, mm in _CLIPS.items()}
    jobs["subforest"] = replace(jobs["unclipped"], learning="subforests")  # the published baseline is unclipped
    offline_rng = partial(np.random.default_rng, [82, seed])
    online = {
        c: learn_online(shown, seed, settings=ForestSettings(clip_mm=_CLIPS[c]), passes=2)
        for c in ("clipped_15", "unclipped")
    }
    return {
        "offline": {c: judge(train_offline(pool, offline_rng(), s), test, number).plain() for c, s in jobs.items()},
        "online": {c: judge(forest, test, number).plain() for c, forest in online.items()},
    }


def _settings(size: Size, seeds: range) -> dict[str, Any]:
    return {
        "seeds": list(seeds),
        "training_pictures": {"of_each_gesture": size.train_each, "of_movement": size.train_movement},
        "test_pictures_of_each_gesture": size.test_each,
        "share_of_positives": SHARE,
        "people": {"trained": 12, "tested": 6},
        "passes": PASSES,
    }

"""Interactive sessions of one person (Table 3.3)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_data import SEEDS, SHARE, examples
from benchmarks.depth_gestures.gesture_pictures import UNSEEN, GestureFrame, Stage, picture
from benchmarks.depth_gestures.gesture_scores import Judged, judge
from benchmarks.papers.offline_forests import OfflineSettings, collect, train_offline
from hypose.gestures.online import Example, Learner
from hypose.gestures.trainer import Trainer
from hypose.synthetic.gesture_people import GESTURES
from hypose.synthetic.gesture_scenes import Setting, make_gesture_room, make_view

ROUNDS = 6
PUBLISHED = ("tee", "silence", "cross")
OTHERS_SHARE = 0.3
"""Of the negative frames of a session show another gesture."""


def session_frames(person: int, name: str, frames: int, rng: np.random.Generator) -> Iterator[GestureFrame]:
    """One session: a furnished room with a fixed camera, ROUNDS times the gesture and then other movement."""
    room, view = make_gesture_room(rng, "furnished"), make_view(rng, rng.uniform(1.3, 2.6))
    stage = Stage(("furnished",), 0.0, settings=(Setting(room, view),))
    others = [g for g in GESTURES if g != name]
    for k in range(frames):
        shows = (k * 2 * ROUNDS // frames) % 2 == 0
        kind = name if shows else str(rng.choice(others)) if rng.random() < OTHERS_SHARE else "movement"
        yield picture(person, kind, stage, rng)


def test_frames(person: int, name: str, shown: int, rng: np.random.Generator) -> list[GestureFrame]:
    """Pictures of the same person in other rooms: a share SHARE of them shows the gesture."""
    stage = Stage(("empty", "furnished"), 0.0)
    rest = round(shown * (1 / SHARE - 1))
    others = [g for g in GESTURES if g != name]
    kinds = [name] * shown + [others[k % 5] for k in range(rest // 2)]
    kinds += [UNSEEN[k % len(UNSEEN)] if k % 4 == 0 else "movement" for k in range(rest - rest // 2)]
    return [picture(person, kind, stage, rng) for kind in kinds]


def table_3_3(options: BenchOptions) -> BenchReport:
    """Three sessions of 3 minutes of one person; the forest is resumed; offline learning on the same frames beside.

    Deviation: drawn people in drawn rooms in place of the thesis' recordings."""
    frames, tests = (60, 10) if options.quick else (500, 40)  # of a session; that show the gesture
    seeds, names = options.seed_range(SEEDS), PUBLISHED[:1] if options.quick else PUBLISHED
    judged: dict[tuple[str, str], list[Judged]] = {}
    minutes, busy = dict[str, list[float]](), list[float]()
    for repetition, seed in enumerate(seeds):
        for n, name in enumerate(names):
            part = options.part(
                f"gesture-table-3.3.{seed}.{name}", partial(_three_sessions, seed, n, name, frames, tests)
            )
            for case, value in part["judged"].items():
                judged.setdefault((case, name), []).append(Judged.of(value))
                minutes.setdefault(case, []).append(part["minutes"][case])
            busy += part["steps_s"]
            options.progress("session", repetition * len(names) + n + 1, len(seeds) * len(names))
    rows: list[Row] = []
    for case in dict.fromkeys(c for c, _ in judged):
        for metric, take in (("ap_10px", Judged.ap), ("ap_5cm", Judged.ap_metres)):
            v = np.array([[take(j) for j in judged[case, g]] for g in names])  # (gestures, seeds)
            rows.append(row(metric, case, v.mean(0), "1"))
            rows += [row(metric, f"{case}/{g}", v[k], "1") for k, g in enumerate(names)]
        rows.append(row("minutes", case, minutes[case], "min"))
    rows.append(Row("training_step_ms", "interactive", 1e3 * float(np.median(busy)), "ms", n=len(busy)))
    settings = {"seeds": list(seeds), "gestures": names, "frames_of_a_session": frames, "share_of_positives": SHARE}
    return BenchReport(tuple(rows), settings | {"test_pictures_that_show_it": tests})


def _three_sessions(seed: int, n: int, name: str, frames: int, tests: int) -> dict[str, Any]:
    number, person = GESTURES.index(name) + 1, (5 * seed + 2 + n) % 18
    rng = np.random.default_rng([86, seed, n])
    test = test_frames(person, name, tests, rng)
    trainer = Trainer(Learner.new(rng))
    every, busy = list[Example](), list[float]()
    judged, minutes = {}, {}
    for k in range(3):
        for e in examples(session_frames(person, name, frames, rng), number):
            every.append(e)
            began = time.thread_time()
            trainer.learn("gesture" if e.gesture else "negative", e.depth, e.lens, (e.x, e.y))
            busy.append(time.thread_time() - began)
        case, forest = f"{3 * (k + 1)}min", trainer.learner.forest.freeze()
        judged[f"interactive/{case}"] = judge(forest, test, number).plain()
        minutes[f"interactive/{case}"] = 3.0 * (k + 1)
        for way, around in (("offline", 10), ("offline_published", 0)):  # published: no ring of negatives
            began = time.thread_time()
            pool = collect(every, np.random.default_rng([87, seed]), positives=20, negatives=20, around=around)
            offline = train_offline(pool, np.random.default_rng([88, seed]), OfflineSettings(per_class=8000))
            waited = time.thread_time() - began
            judged[f"{way}/{case}"] = judge(offline, test, number).plain()
            minutes[f"{way}/{case}"] = 3.0 * (k + 1) + waited / 60
    return {"judged": judged, "minutes": minutes, "steps_s": busy}

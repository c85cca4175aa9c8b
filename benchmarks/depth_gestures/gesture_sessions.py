"""Interactive sessions of one person (Table 3.3)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_gestures.gesture_data import SEEDS, SHARE
from benchmarks.depth_gestures.gesture_pictures import UNSEEN, GestureFrame, Stage, picture
from benchmarks.depth_gestures.gesture_scores import Judged, judge
from benchmarks.papers.offline_forests import OfflineSettings, collect, train_offline
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.online import Example, Learner
from hypose.gestures.trainer import Trainer
from hypose.synthetic.gesture_poses import GESTURES
from hypose.synthetic.gesture_scenes import Setting, make_gesture_room, make_view

ROUNDS = 6
PUBLISHED = ("tee", "silence", "cross")
OTHERS_SHARE = 0.3
"""Of the negative frames of a session show another gesture."""


@dataclass(frozen=True)
class _Size:
    frames: int  # of a session
    tests: int  # that show the gesture


def session_frames(person: int, name: str, frames: int, rng: np.random.Generator) -> Iterator[tuple[GestureFrame, str]]:
    """One session: a furnished room with a fixed camera, ROUNDS times the gesture and then other movement."""
    setting = Setting(make_gesture_room(rng, "furnished"), make_view(rng, rng.uniform(1.3, 2.6)))
    stage = Stage(("furnished",), 0.0, settings=(setting,))
    others = [g for g in GESTURES if g != name]
    for k in range(frames):
        shows = (k * 2 * ROUNDS // frames) % 2 == 0
        kind = name if shows else str(rng.choice(others)) if rng.random() < OTHERS_SHARE else "movement"
        yield picture(person, kind, stage, rng), "positive" if shows else "negative"


def example(frame: GestureFrame, number: int) -> Example:
    """The frame for a one-gesture forest."""
    return Example(frame.depth, KINECT, int(frame.gesture == number), frame.x, frame.y)


def live_step(trainer: Trainer, e: Example, *, mine: bool = True) -> None:
    """What an interactive session does with a frame."""
    trainer.learn("gesture" if e.gesture else "negative", e.depth, e.lens, (e.x, e.y), mine=mine)


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
    size = _Size(60, 10) if options.quick else _Size(500, 40)
    seeds, names = options.seed_range(SEEDS), PUBLISHED[:1] if options.quick else PUBLISHED
    judged: dict[tuple[str, str], list[Judged]] = {}
    minutes: dict[str, list[float]] = {}
    busy: list[float] = []
    for repetition, seed in enumerate(seeds):
        for n, name in enumerate(names):
            part = options.part(f"gesture-table-3.3.{seed}.{name}", partial(_three_sessions, seed, n, name, size))
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
    settings_out = {
        "seeds": list(seeds),
        "gestures": names,
        "frames_of_a_session": size.frames,
        "share_of_positives": SHARE,
    }
    return BenchReport(tuple(rows), settings_out | {"test_pictures_that_show_it": size.tests})


def _three_sessions(seed: int, n: int, name: str, size: _Size) -> dict[str, Any]:
    number, person = GESTURES.index(name) + 1, (5 * seed + 2 + n) % 18
    rng = np.random.default_rng([86, seed, n])
    test = test_frames(person, name, size.tests, rng)
    trainer = Trainer(Learner.new(rng))
    every: list[Example] = []
    busy: list[float] = []
    judged, minutes = {}, {}
    for k in range(3):
        for frame, _ in session_frames(person, name, size.frames, rng):
            e = example(frame, number)
            every.append(e)
            began = time.thread_time()
            live_step(trainer, e)
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

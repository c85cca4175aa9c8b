"""Interactive sessions of one person (Table 3.3), and false alarms during free movement."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row, row
from hypose.evaluation.gesture_data import SHARE
from hypose.evaluation.gesture_metrics import Judged, judge
from hypose.evaluation.gesture_people import Puppet, load_people
from hypose.evaluation.gesture_poses import GESTURES, UNSEEN, continuous
from hypose.evaluation.gesture_scenes import GestureFrame, Setting, Stage, make_room, make_view, moment, picture
from hypose.gestures.events import EventSettings, EventState, step
from hypose.gestures.forest import Forest
from hypose.gestures.localise import LocaliseSettings, Scratch, densities, localise, settle
from hypose.gestures.offline import OfflineSettings, collect, train
from hypose.gestures.online import Example, Learner
from hypose.gestures.pictures import KINECT
from hypose.gestures.trainer import Trainer

SESSION_S = 180.0
ROUNDS = 6
PUBLISHED = ("tee", "silence", "cross")
OTHERS_SHARE = 0.3
"""Of the negative frames of a session show another gesture."""


@dataclass(frozen=True)
class _Size:
    frames: int  # of a session
    tests: int  # that show the gesture
    seeds: int


def session_frames(person: int, name: str, frames: int, rng: np.random.Generator) -> Iterator[tuple[GestureFrame, str]]:
    """One session: a furnished room with a fixed camera, ROUNDS times the gesture and then other movement."""
    setting = Setting.new(make_room(rng, "furnished"), make_view(rng, rng.uniform(1.3, 2.6)))
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
    """Three sessions of 3 minutes of one person; the forest is resumed; offline learning on the same frames beside."""
    size = _Size(60, 10, 1) if options.quick else _Size(500, 40, 3)
    seeds, names = options.seeds or size.seeds, PUBLISHED[:1] if options.quick else PUBLISHED
    judged: dict[str, list[tuple[float, float]]] = {}
    minutes: dict[str, list[float]] = {}
    busy: list[float] = []
    for seed in range(seeds):
        for n, name in enumerate(names):
            number, person = GESTURES.index(name) + 1, (5 * seed + 2 + n) % 18
            rng = np.random.default_rng([86, seed, n])
            test = test_frames(person, name, size.tests, rng)
            trainer = Trainer(Learner.new(rng))
            every: list[Example] = []
            for k in range(3):
                for frame, _ in session_frames(person, name, size.frames, rng):
                    e = example(frame, number)
                    every.append(e)
                    began = time.perf_counter()
                    live_step(trainer, e)
                    busy.append(time.perf_counter() - began)
                case = f"{3 * (k + 1)}min"
                forest = trainer.learner.forest.freeze()
                _keep(judged, f"interactive/{case}", judge(forest, test, number))
                began = time.perf_counter()
                pool = collect(every, np.random.default_rng([87, seed]), positives=20, negatives=20)
                offline = train(pool, np.random.default_rng([88, seed]), OfflineSettings(per_class=8000))
                waited = time.perf_counter() - began
                _keep(judged, f"offline/{case}", judge(offline, test, number))
                minutes.setdefault(f"interactive/{case}", []).append(3.0 * (k + 1))
                minutes.setdefault(f"offline/{case}", []).append(3.0 * (k + 1) + waited / 60)
                done = (seed * len(names) + n) * 3 + k + 1
                options.progress("session", done, seeds * len(names) * 3)
    rows: list[Row] = []
    for case, pairs in judged.items():
        rows.append(row("ap_10px", case, [a for a, _ in pairs], "1"))
        rows.append(row("ap_5cm", case, [b for _, b in pairs], "1"))
        rows.append(row("minutes", case, minutes[case], "min"))
    rows.append(Row("training_step_ms", "interactive", 1e3 * float(np.median(busy)), "ms", n=len(busy)))
    settings_out = {"seeds": seeds, "gestures": names, "frames_of_a_session": size.frames, "share_of_positives": SHARE}
    return BenchReport(tuple(rows), settings_out | {"test_pictures_that_show_it": size.tests})


def _keep(judged: dict[str, list[tuple[float, float]]], case: str, j: Judged) -> None:
    judged.setdefault(case, []).append((j.ap(), j.ap_metres()))


def false_alarms(options: BenchOptions) -> BenchReport:
    """Events per minute and gesture of free movement without gestures, with the automatic threshold: after random and
    after hard negatives (and there with the threshold as published), with and without temporal recursion; and the share
    of pictures of the gesture, in other rooms, that the threshold lets through."""
    minutes, rate = (0.5, 5.0) if options.quick else (10.0, 5.0)
    seeds = options.seeds or 1
    names = PUBLISHED[:1] if options.quick else (*PUBLISHED, "pause")
    frames = 60 if options.quick else 300
    counts: dict[str, list[float]] = {}
    passed: dict[str, list[float]] = {}
    for seed in range(seeds):
        rng = np.random.default_rng([89, seed])
        person = (7 * seed + 1) % 18
        forests: dict[str, list[Forest]] = {"random": [], "hard": []}
        thresholds: dict[str, list[float]] = {"random": [], "hard": [], "hard_published": []}
        for n, name in enumerate(names):
            number = GESTURES.index(name) + 1
            shown = [example(f, number) for f, _ in session_frames(person, name, frames, rng)]
            test = [f for f in test_frames(person, name, 12, rng) if f.gesture == number]
            for mode in forests:
                trainer = Trainer(Learner.new(np.random.default_rng([90, seed])))
                for e in shown:
                    live_step(trainer, e, mine=mode == "hard")
                forests[mode].append(trainer.learner.forest.freeze())
                limits = {mode: trainer.final_threshold()}
                if mode == "hard":
                    limits["hard_published"] = trainer.threshold
                found = np.array([localise(f.depth, KINECT, [forests[mode][-1]])[0].score for f in test])
                for case, limit in limits.items():
                    thresholds[case].append(max(limit or 0.0, 1e-3))
                    passed.setdefault(case, []).append(float((found >= thresholds[case][-1]).mean()))
            options.progress("learn", n + 1, len(names))
        stage = Setting.new(make_room(rng, "furnished"), make_view(rng, 2.0))
        puppet = Puppet(load_people()[person])
        cases = [(m, r) for m in thresholds for r in (1.0, 0.8)]
        scratch = {c: Scratch() for c in cases}
        looking = {mode: Scratch() for mode in forests}
        states = dict.fromkeys(cases, EventState())
        starts = dict.fromkeys(cases, 0)
        total = round(minutes * 60 * rate)
        for k, pose in enumerate(continuous(puppet, rng, minutes * 60, rate)):
            depth = moment(puppet, pose, stage, rng)
            maps = {m: densities(depth, KINECT, f, LocaliseSettings(), looking[m]) for m, f in forests.items()}
            for mode, memory in cases:
                limits = [EventSettings(t) for t in thresholds[mode]]
                look = LocaliseSettings(memory=memory)
                seen = settle(maps[mode.removesuffix("_published")], depth, KINECT, look, scratch[mode, memory])
                states[mode, memory], events = step(states[mode, memory], seen, k / rate, limits)
                starts[mode, memory] += sum(e.kind == "start" for e in events)
            options.progress("watch", k + 1, total)
        for (mode, memory), number in starts.items():
            case = f"{mode}/{'recursion' if memory < 1 else 'no_recursion'}"
            counts.setdefault(case, []).append(number / minutes / len(names))
    rows = [row("false_alarms_per_minute", case, v, "1/min") for case, v in counts.items()]
    rows += [row("let_through", mode, v, "1") for mode, v in passed.items()]
    return BenchReport(
        tuple(rows),
        {"minutes": minutes, "frames_per_second": rate, "gestures": names, "seeds": seeds, "session_frames": frames},
    )

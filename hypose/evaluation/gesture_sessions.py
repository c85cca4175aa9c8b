"""Interactive sessions of one person (Table 3.3), and false alarms during free movement."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row, row
from hypose.evaluation.gesture_data import SHARE, seeds_of
from hypose.evaluation.gesture_metrics import Judged, judge
from hypose.evaluation.gesture_people import Puppet, load_people
from hypose.evaluation.gesture_poses import GESTURES, UNSEEN, continuous
from hypose.evaluation.gesture_scenes import GestureFrame, Setting, Stage, make_room, make_view, moment, picture
from hypose.gestures.events import EventSettings, EventState, step
from hypose.gestures.forest import Forest
from hypose.gestures.localise import LocaliseSettings, Scratch, densities, localise, settle
from hypose.gestures.offline import OfflineSettings, collect, train
from hypose.gestures.online import Learner
from hypose.gestures.pictures import KINECT
from hypose.gestures.pixels import Example
from hypose.gestures.trainer import Trainer

ROUNDS = 6
PUBLISHED = ("tee", "silence", "cross")
OTHERS_SHARE = 0.3
"""Of the negative frames of a session show another gesture."""
WATCHED_FPS = 5.0
"""Of the free movement in which false alarms are counted."""


@dataclass(frozen=True)
class _Size:
    frames: int  # of a session
    tests: int  # that show the gesture


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
    size = _Size(60, 10) if options.quick else _Size(500, 40)
    seeds, names = seeds_of(options), PUBLISHED[:1] if options.quick else PUBLISHED
    judged: dict[str, list[tuple[float, float]]] = {}
    minutes: dict[str, list[float]] = {}
    busy: list[float] = []
    for repetition, seed in enumerate(seeds):
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
                    began = time.thread_time()
                    live_step(trainer, e)
                    busy.append(time.thread_time() - began)
                case = f"{3 * (k + 1)}min"
                forest = trainer.learner.forest.freeze()
                _keep(judged, f"interactive/{case}", judge(forest, test, number))
                began = time.thread_time()
                pool = collect(every, np.random.default_rng([87, seed]), positives=20, negatives=20)
                offline = train(pool, np.random.default_rng([88, seed]), OfflineSettings(per_class=8000))
                waited = time.thread_time() - began
                _keep(judged, f"offline/{case}", judge(offline, test, number))
                minutes.setdefault(f"interactive/{case}", []).append(3.0 * (k + 1))
                minutes.setdefault(f"offline/{case}", []).append(3.0 * (k + 1) + waited / 60)
                done = (repetition * len(names) + n) * 3 + k + 1
                options.progress("session", done, len(seeds) * len(names) * 3)
    rows: list[Row] = []
    for case, pairs in judged.items():
        rows.append(row("ap_10px", case, [a for a, _ in pairs], "1"))
        rows.append(row("ap_5cm", case, [b for _, b in pairs], "1"))
        rows.append(row("minutes", case, minutes[case], "min"))
    rows.append(Row("training_step_ms", "interactive", 1e3 * float(np.median(busy)), "ms", n=len(busy)))
    settings_out = {
        "seeds": list(seeds),
        "gestures": names,
        "frames_of_a_session": size.frames,
        "share_of_positives": SHARE,
    }
    return BenchReport(tuple(rows), settings_out | {"test_pictures_that_show_it": size.tests})


def _keep(judged: dict[str, list[tuple[float, float]]], case: str, j: Judged) -> None:
    judged.setdefault(case, []).append((j.ap(), j.ap_metres()))


_MODES = ("random", "hard")


@dataclass(frozen=True)
class _Learned:
    """What the sessions of one person left: forests by kind of negatives; by case (the published threshold is one more)
    the thresholds of every gesture, and the share of its pictures that each lets through."""

    forests: dict[str, list[Forest]]
    thresholds: dict[str, list[float]]
    passed: dict[str, list[float]]


def _learn_all(names: Sequence[str], person: int, frames: int, seed: int, rng: np.random.Generator) -> _Learned:
    out = _Learned({m: [] for m in _MODES}, {}, {})
    for name in names:
        number = GESTURES.index(name) + 1
        shown = [example(f, number) for f, _ in session_frames(person, name, frames, rng)]
        test = [f for f in test_frames(person, name, 12, rng) if f.gesture == number]
        for mode in _MODES:
            trainer = Trainer(Learner.new(np.random.default_rng([90, seed])))
            for e in shown:
                live_step(trainer, e, mine=mode == "hard")
            forest = trainer.learner.forest.freeze()
            out.forests[mode].append(forest)
            limits = {mode: trainer.final_threshold()}
            if mode == "hard":
                limits["hard_published"] = trainer.threshold
            found = np.array([localise(f.depth, KINECT, [forest])[0].score for f in test])
            for case, limit in limits.items():
                threshold = max(limit or 0.0, 1e-3)
                out.thresholds.setdefault(case, []).append(threshold)
                out.passed.setdefault(case, []).append(float((found >= threshold).mean()))
    return out


def _count_starts(
    learned: _Learned, person: int, seconds: float, rng: np.random.Generator, options: BenchOptions
) -> dict[str, int]:
    """Events that start while the person moves freely, by case, with and without temporal recursion."""
    setting = Setting.new(make_room(rng, "furnished"), make_view(rng, 2.0))
    puppet = Puppet(load_people()[person])
    cases = {
        f"{case}/{name}": (case.removesuffix("_published"), LocaliseSettings(memory=memory), Scratch())
        for case in learned.thresholds
        for name, memory in (("no_recursion", 1.0), ("recursion", 0.8))
    }
    limits = {case: [EventSettings(t) for t in values] for case, values in learned.thresholds.items()}
    looking = {mode: Scratch() for mode in learned.forests}
    states, starts = dict.fromkeys(cases, EventState()), dict.fromkeys(cases, 0)
    for k, pose in enumerate(continuous(puppet, rng, seconds, WATCHED_FPS)):
        depth = moment(puppet, pose, setting, rng)
        maps = {m: densities(depth, KINECT, f, LocaliseSettings(), looking[m]) for m, f in learned.forests.items()}
        for case, (mode, look, scratch) in cases.items():
            found = settle(maps[mode], depth, KINECT, look, scratch)
            states[case], events = step(states[case], found, k / WATCHED_FPS, limits[case.partition("/")[0]])
            starts[case] += sum(e.kind == "start" for e in events)
        options.progress("watch", k + 1, round(seconds * WATCHED_FPS))
    return starts


def false_alarms(options: BenchOptions) -> BenchReport:
    """Events per minute and gesture of free movement without gestures, with the automatic threshold: after random and
    after hard negatives (and there with the threshold as published), with and without temporal recursion; and the share
    of pictures of the gesture, in other rooms, that the threshold lets through."""
    minutes, frames = (0.5, 60) if options.quick else (10.0, 300)
    names = PUBLISHED[:1] if options.quick else (*PUBLISHED, "pause")
    seeds = seeds_of(options)
    alarms: dict[str, list[float]] = {}
    passed: dict[str, list[float]] = {}
    for done, seed in enumerate(seeds):
        rng, person = np.random.default_rng([89, seed]), (7 * seed + 1) % 18
        learned = _learn_all(names, person, frames, seed, rng)
        for case, shares in learned.passed.items():
            passed.setdefault(case, []).extend(shares)
        for case, starts in _count_starts(learned, person, 60 * minutes, rng, options).items():
            alarms.setdefault(case, []).append(starts / minutes / len(names))
        options.progress("person", done + 1, len(seeds))
    rows = [row("false_alarms_per_minute", case, v, "1/min") for case, v in alarms.items()]
    rows += [row("let_through", case, v, "1") for case, v in passed.items()]
    settings = {"minutes": minutes, "frames_per_second": WATCHED_FPS, "gestures": names, "seeds": list(seeds)}
    return BenchReport(tuple(rows), settings | {"session_frames": frames})

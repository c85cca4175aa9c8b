"""False alarms during free movement, and what the threshold lets through in other rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, row
from hypose.evaluation.gesture_data import seeds_of
from hypose.evaluation.gesture_people import Puppet, load_people
from hypose.evaluation.gesture_poses import GESTURES, continuous
from hypose.evaluation.gesture_scenes import Setting, make_room, make_view, moment
from hypose.evaluation.gesture_sessions import PUBLISHED, example, live_step, session_frames, test_frames
from hypose.gestures.events import EventSettings, EventState, step
from hypose.gestures.forest import Forest
from hypose.gestures.localise import LocaliseSettings, Scratch, densities, localise, settle
from hypose.gestures.online import Learner
from hypose.gestures.pictures import KINECT
from hypose.gestures.trainer import Trainer

WATCHED_FPS = 5.0
"""Of the free movement."""
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
        measure = partial(_one_person, names, seed, frames, minutes, options)
        part = options.part(f"gesture-false-alarms.{seed}", measure)
        for case, shares in part["passed"].items():
            passed.setdefault(case, []).append(float(np.mean(shares)))
        for case, starts in part["starts"].items():
            alarms.setdefault(case, []).append(starts / minutes / len(names))
        options.progress("person", done + 1, len(seeds))
    rows = [row("false_alarms_per_minute", case, v, "1/min") for case, v in alarms.items()]
    rows += [row("let_through", case, v, "1") for case, v in passed.items()]
    settings = {"minutes": minutes, "frames_per_second": WATCHED_FPS, "gestures": names, "seeds": list(seeds)}
    return BenchReport(tuple(rows), settings | {"session_frames": frames})


def _one_person(
    names: Sequence[str], seed: int, frames: int, minutes: float, options: BenchOptions
) -> dict[str, dict[str, Any]]:
    rng, person = np.random.default_rng([89, seed]), (7 * seed + 1) % 18
    learned = _learn_all(names, person, frames, seed, rng)
    starts = _count_starts(learned, person, 60 * minutes, rng, options)
    return {"starts": starts, "passed": learned.passed, "thresholds": learned.thresholds}

"""False alarms during free movement, and what the threshold lets through in other rooms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, row
from benchmarks.depth_gestures.gesture_data import SEEDS, examples
from benchmarks.depth_gestures.gesture_sessions import PUBLISHED, session_frames, test_frames
from hypose.compute.forests import DepthImage
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.events import EventSettings, EventState, detect_events
from hypose.gestures.forest import Forest
from hypose.gestures.localise import LocaliseSettings, Scratch, densities, localise, settle
from hypose.gestures.online import Learner
from hypose.gestures.trainer import Trainer
from hypose.synthetic.gesture_people import GESTURES, Keyframe, Puppet, apply, load_people, movement
from hypose.synthetic.gesture_scenes import Setting, live_person, make_gesture_room, make_view, render, stand_at

WATCHED_FPS = 5.0
"""Of the free movement."""
HELD_S, TRIES = 2.5, 6
"""A gesture is asked for so long (getting there takes some 0.7 s), in so many other rooms."""
MEMORIES = {"hard/no_recursion": 1.0, "hard/recursion": 0.8}
"""Adaptation rate of each case; negatives are hard."""


def _learn_all(
    names: Sequence[str], person: int, frames: int, seed: int, rng: np.random.Generator
) -> tuple[list[Forest], list[float], list[float]]:
    """Learn each gesture in one session of a person, with hard negatives.

    Returns: per gesture the forest, its threshold, and the share of its pictures that the threshold lets through."""
    forests, thresholds, passed = list[Forest](), list[float](), list[float]()
    for name in names:
        number = GESTURES.index(name) + 1
        shown = examples(session_frames(person, name, frames, rng), number)
        test = [f for f in test_frames(person, name, 12, rng) if f.gesture == number]
        trainer = Trainer(Learner.new(np.random.default_rng([90, seed])))
        for e in shown:
            trainer.learn("gesture" if e.gesture else "negative", e.depth, e.lens, (e.x, e.y))
        forests.append(trainer.learner.forest.freeze())
        thresholds.append(max(trainer.final_threshold() or 0.0, 1e-3))
        found = np.array([localise(f.depth, KINECT, forests[-1:])[0].score for f in test])
        passed.append(float((found >= thresholds[-1]).mean()))
    return forests, thresholds, passed


class _Watcher:
    """Looks with all forests, with and without temporal recursion; forgets what it saw with `rest`."""

    def __init__(self, forests: list[Forest], thresholds: list[float]) -> None:
        self._forests = forests
        self._limits = [EventSettings(t) for t in thresholds]
        self.rest()

    def rest(self) -> None:
        """Begin a new stream."""
        self._looking, self._kept = Scratch(), {case: Scratch() for case in MEMORIES}
        self._states = dict.fromkeys(MEMORIES, EventState())

    def started(self, depth: DepthImage, seconds: float) -> dict[str, list[int]]:
        """The gestures (from 1 on) that start in a frame, by case."""
        out = {}
        maps = densities(depth, KINECT, self._forests, LocaliseSettings(), self._looking)
        for case, share in MEMORIES.items():
            seen = settle(maps, depth, KINECT, LocaliseSettings(adaptation_rate=share), self._kept[case])
            self._states[case], events = detect_events(self._states[case], seen, seconds, self._limits)
            out[case] = [e.gesture for e in events if e.kind == "start"]
        return out


def _count_alarms(
    watcher: _Watcher, person: int, seconds: float, rng: np.random.Generator, options: BenchOptions
) -> dict[str, int]:
    """Events that start while the person moves freely, by case."""
    setting = Setting(make_gesture_room(rng, "furnished"), make_view(rng, 2.0))
    puppet, out = Puppet(load_people()[person]), dict.fromkeys(MEMORIES, 0)
    watcher.rest()
    for k, pose in enumerate(continuous(puppet, rng, seconds, WATCHED_FPS)):
        for case, started in watcher.started(moment(puppet, pose, setting, rng), k / WATCHED_FPS).items():
            out[case] += len(started)
        options.progress("watch", k + 1, round(seconds * WATCHED_FPS))
    return out


def _share_of_holds(
    watcher: _Watcher, person: int, names: Sequence[str], tries: int, rng: np.random.Generator
) -> dict[str, float]:
    """Share of the gestures, each held for HELD_S in other rooms, that start an event of theirs, by case."""
    out = dict.fromkeys(MEMORIES, 0.0)
    for number, name in enumerate(names, 1):
        for _ in range(tries):
            watcher.rest()
            live = live_person(person, name, rng, WATCHED_FPS)
            next(live)
            hit = set[str]()
            for k in range(round(HELD_S * WATCHED_FPS)):
                started = watcher.started(live.send(True).depth, k / WATCHED_FPS)
                hit |= {case for case, several in started.items() if number in several}
            for case in hit:
                out[case] += 1 / (tries * len(names))
    return out


def false_alarms(options: BenchOptions) -> BenchReport:
    """Events per minute and gesture of free movement without gestures, with the automatic threshold, with and without
    temporal recursion; and in other rooms, the share of pictures of the gesture that the threshold lets through, and of
    gestures held that start an event."""
    minutes, frames, tries = (0.5, 60, 1) if options.quick else (10.0, 300, TRIES)
    names = PUBLISHED[:1] if options.quick else (*PUBLISHED, "pause")
    seeds = options.seed_range(SEEDS)
    alarms, held, passed = dict[str, list[float]](), dict[str, list[float]](), list[float]()
    for done, seed in enumerate(seeds):
        measure = partial(_one_person, names, seed, (frames, tries, minutes), options)
        part = options.part(f"gesture-false-alarms.{seed}", measure)
        passed.append(float(np.mean(part["passed"])))
        for case, starts in part["starts"].items():
            alarms.setdefault(case, []).append(starts / minutes / len(names))
            held.setdefault(case, []).append(part["held"][case])
        options.progress("person", done + 1, len(seeds))
    rows = [row("false_alarms_per_minute", case, v, "1/min") for case, v in alarms.items()]
    rows.append(row("let_through", "hard", passed, "1"))
    rows += [row("holds_found", case, v, "1") for case, v in held.items()]
    settings = {"minutes": minutes, "frames_per_second": WATCHED_FPS, "gestures": names, "seeds": list(seeds)}
    return BenchReport(tuple(rows), settings | {"session_frames": frames, "holds_of_each_gesture": tries})


def _one_person(names: Sequence[str], seed: int, size: tuple[int, int, float], options: BenchOptions) -> dict[str, Any]:
    frames, tries, minutes = size
    rng, person = np.random.default_rng([89, seed]), (7 * seed + 1) % 18
    forests, thresholds, passed = _learn_all(names, person, frames, seed, rng)
    watcher = _Watcher(forests, thresholds)
    starts = _count_alarms(watcher, person, 60 * minutes, rng, options)
    held = _share_of_holds(watcher, person, names, tries, rng)
    return {"starts": starts, "held": held, "passed": passed, "thresholds": thresholds}


def continuous(puppet: Puppet, rng: np.random.Generator, seconds: float, rate: float) -> Iterator[Keyframe]:
    """Free movement without gestures: smooth ways between random poses, 0.5 to 1.2 s each, some of them held."""
    last, at, knot = movement(puppet, rng), 0.0, rng.uniform(0.5, 1.2)
    following = movement(puppet, rng)
    for k in range(round(seconds * rate)):
        while k / rate - at > knot:
            at += knot
            last, knot = following, rng.uniform(0.5, 1.2)
            following = last if rng.random() < 0.2 else movement(puppet, rng)
        t = (k / rate - at) / knot
        yield last.towards(following, t * t * (3 - 2 * t))


def moment(puppet: Puppet, frame: Keyframe, setting: Setting, rng: np.random.Generator) -> DepthImage:
    """The picture of a person in a given pose (of a continuous movement)."""
    apply(puppet, frame)
    return render([(puppet.person, stand_at(puppet))], setting.behind, setting.view, rng)[0]

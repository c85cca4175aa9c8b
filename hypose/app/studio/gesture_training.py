"""Process the frames of a gesture session: teach a gesture (all is recorded and saved), or watch for gestures; each
frame gives the message that the page shows.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.app.jobs.gesture_job import growing_model, loaded_forests, new_learner, thresholds
from hypose.app.live.gesture_sources import Taken
from hypose.app.studio.gesture_start import STUDIO_PHASES, Controls, GestureFeed, SessionRequest
from hypose.compute.forests import DepthImage
from hypose.gestures.depth_pictures import DepthLens, surface_depth
from hypose.gestures.events import (
    RADIUS_M,
    Event,
    EventSettings,
    EventState,
    average_precision,
    detect_events,
    precision_recall,
)
from hypose.gestures.forest import Forest
from hypose.gestures.localise import Localisation, LocaliseSettings, Scratch, densities, localise, settle
from hypose.gestures.model import GestureModel
from hypose.gestures.trainer import Command, Feedback, Trainer
from hypose.gestures.trainer import advance as peek
from hypose.pipeline.gesture_files import SessionWriter, content_of, save_model

# ---- gesture judge -------------------------------------------------------------------------------------------------
# Test a forest during its training: on held-back frames, and on movement before it is learned.


_KEPT = 40
"""Frames of each kind that are kept for testing; every frame has the same chance."""
_WINDOW_S = 60.0
"""Time of movement over which false alarms are counted, s."""
_POINTS = 100
"""Most points of a curve that are reported."""


class _Seen(NamedTuple):
    """Result of one test frame: score, error (m; infinite where the gesture is not shown), and whether it is shown."""

    score: float
    error: float
    shown: bool


class HeldBack:
    """Held-back frames on which a forest is tested while it is trained; in a thread of its own, so that the session
    does not wait.
    """

    def __init__(self, lens: DepthLens) -> None:
        self._lens, self._keep = lens, np.random.default_rng(0)
        # by whether the gesture is done: depth, its pixel (None: it is not done), segment
        self._frames: dict[bool, list[tuple[DepthImage, tuple[float, float] | None, int]]] = {True: [], False: []}
        self._count = {True: 0, False: 0}
        self._tested: list[_Seen] = []
        self._busy: threading.Thread | None = None
        self._result: dict[str, Any] | None = None

    def keep(self, depth: DepthImage, at: tuple[float, float] | None, segment: int) -> None:
        """Hold back a frame of a training segment.

        at: pixel of the gesture; None for other movement.
        segment: number of its segment.
        """
        kept, shown = self._frames[at is not None], at is not None
        self._count[shown] += 1
        if len(kept) < _KEPT:
            kept.append((depth, at, segment))
        elif (place := int(self._keep.integers(self._count[shown]))) < _KEPT:
            kept[place] = depth, at, segment

    def test(self, depth: DepthImage, at: tuple[float, float] | None, found: Localisation) -> None:
        """Add a frame of the test phase with a known result."""
        self._tested.append(_judged(depth, self._lens, at, found))

    def drop(self, undone: tuple[int, ...]) -> None:
        """Remove the frames of segments that were undone."""
        self._frames = {shown: [k for k in kept if k[2] not in undone] for shown, kept in self._frames.items()}

    def begin(self, forest: Forest) -> None:
        """Start testing the held-back frames with the current forest, unless a test is running."""
        if self._busy is None or not self._busy.is_alive():
            frames = [*self._frames[True], *self._frames[False]]
            self._busy = threading.Thread(target=self._look, args=(forest, frames), daemon=True)
            self._busy.start()

    def _look(self, forest: Forest, frames: list[tuple[DepthImage, tuple[float, float] | None, int]]) -> None:
        scratch = Scratch()
        found = [(d, at, localise(d, self._lens, [forest], None, scratch)[0]) for d, at, _ in frames]
        self._result = _curve([_judged(d, self._lens, at, f) for d, at, f in found]) | {"on": "held-back"}

    def result(self, threshold: float | None) -> dict[str, Any] | None:
        """Return the newest result once; None where there is no new one. It is of the test phase once that has both
        kinds of frames, else of the held-back frames.
        """
        new, self._result = self._result, None
        if {s.shown for s in self._tested} == {True, False}:
            new = _curve(self._tested) | {"on": "test"}
        return None if new is None else new | {"at": _at(new, threshold)}


def _judged(depth: DepthImage, lens: DepthLens, at: tuple[float, float] | None, found: Localisation) -> _Seen:
    z = None if at is None else surface_depth(depth, *at)
    if at is None or z is None:
        return _Seen(found.score, np.inf, at is not None)
    return _Seen(found.score, float(np.hypot(found.x - at[0], found.y - at[1])) * z / 1000 / lens.fx, True)


def _curve(seen: list[_Seen]) -> dict[str, Any]:
    scores, correct = np.array([s.score for s in seen]), np.array([s.error for s in seen]) <= RADIUS_M
    positives = sum(s.shown for s in seen)
    out: dict[str, Any] = {"frames": len(seen), "positives": positives, "ap": None}
    if not positives or positives == len(seen):
        return out | {"precision": [], "recall": [], "scores": []}
    precision, recall = precision_recall(scores, correct, positives)
    ranked = scores[np.lexsort((correct, -scores))]
    ranked = ranked[ranked > 0]
    pick = np.unique(np.linspace(0, len(ranked) - 1, min(_POINTS, len(ranked))).astype(int))
    return out | {
        "ap": average_precision(scores, correct, positives),
        "precision": precision[pick].round(4).tolist(),
        "recall": recall[pick].round(4).tolist(),
        "scores": ranked[pick].round(3).tolist(),
    }


def _at(curve: dict[str, Any], threshold: float | None) -> dict[str, float] | None:
    """Return precision and recall at a threshold."""
    if threshold is None or not curve["scores"]:
        return None
    passed = [k for k, s in enumerate(curve["scores"]) if s >= threshold]
    if not passed:
        return {"precision": 1.0, "recall": 0.0}
    return {"precision": curve["precision"][passed[-1]], "recall": curve["recall"][passed[-1]]}


class FalseAlarms:
    """Counter of events in movement that the forest has not learned yet, over the last minute."""

    def __init__(self) -> None:
        self._state, self._clock = EventState(), 0.0
        self._last: float | None = None
        self._starts: list[float] = []

    def see(self, time: float, found: Localisation, threshold: float | None, hold_s: float) -> None:
        """Count the events of a frame of other movement, before it is learned."""
        if self._last is not None and 0 < time - self._last < 1:
            self._clock += time - self._last
        elif self._last is not None:  # another segment: an event that was going on has ended
            self._state = EventState()
        self._last = time
        if threshold is None or threshold <= 0:
            return
        settings = [EventSettings(threshold, hold_s=hold_s)] * found.gesture
        self._state, events = detect_events(self._state, [found], self._clock, settings)
        self._starts += [self._clock for e in events if e.kind == "start"]

    def reported(self) -> dict[str, float | None]:
        """Return false_per_min and tested_s."""
        seconds = min(self._clock, _WINDOW_S)
        recent = sum(t > self._clock - _WINDOW_S for t in self._starts)
        return {"false_per_min": recent * 60 / seconds if seconds > 5 else None, "tested_s": round(seconds, 1)}


BOX_M = 0.1
"""Half side of the box on the page, at the surface in it, m."""
_ADAPTATION_RATE = 0.8
"""Share of the new frame in the density while watching, as in `hypose gesture run`."""
_HELD_EVERY = 5
"""Of so many seconds of training, one second is held back."""


_Shown = tuple[dict[str, Any], NDArray[np.float32] | None]
"""Result of a frame for the page: the step message (without seq), and the map of votes where wanted."""


class Training:
    """Training of one gesture. Only the session's thread may call it; `save` also after that thread has ended."""

    def __init__(self, start: SessionRequest, feed: GestureFeed, old: Path | None, folder: Path, model: Path) -> None:
        self.feed, self.folder, self.path, self.names = feed, folder, model, [start.gesture]
        self._old = growing_model(old, start.gesture) if old is not None else None
        # this checks the name before anything is written
        learner = (self._old.learner if self._old is not None else None) or new_learner(start.seed)
        GestureModel((start.gesture,), learner.forest, (None,), LocaliseSettings(), learner)
        self.trainer = Trainer(learner, start.settings)
        s = start.settings
        seconds = {name: getattr(s, f"{name}_s") for name in STUDIO_PHASES}
        self.reported = {"rounds": s.rounds, "seconds": seconds}
        source = feed.source
        self._writer = SessionWriter(folder, [start.gesture], source.lens, source.size, self.reported)
        self._held, self._alarms = HeldBack(source.lens), FalseAlarms()
        self._scratch, self._events = Scratch(), EventState()
        self._final: float | None = None  # the threshold that a saved model gets, found when the test begins
        self._place = (source.size[0] / 2, 0.45 * source.size[1])
        self._frames, self._pixels = {"gesture": 0, "negative": 0}, [0, 0]
        self._before: tuple[int, dict[str, int], list[int]] = (0, {}, [])  # a segment, and the counts when it began
        self._seconds = 0.0
        self._judged_at = -10.0

    @property
    def asks(self) -> str:
        """Phase that the next picture should show."""
        return self.trainer.session.phase

    @property
    def paused(self) -> bool:
        """Whether the session waits for the page."""
        return self.trainer.session.paused is not None

    def frame(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Shown:
        """Process a picture.

        fresh: False: only the commands are new, the picture was processed before.
        """
        source, trainer = self.feed.source, self.trainer
        if not self.feed.knows:
            self._place = controls.box or self._place
        elif taken.box is not None:
            self._place = taken.box
        before = trainer.session
        session, instruction = peek(before, trainer.settings, taken.time, commands)
        kept = instruction.learn is not None and int(taken.time - session.entered) % _HELD_EVERY == _HELD_EVERY - 1
        # where the source knows the truth, a picture must show the kind of movement to be learned
        sure = instruction.learn is None or not self.feed.knows
        usable = fresh and (sure or (taken.box is not None) == (instruction.learn == "gesture"))
        if session.segment != self._before[0]:
            self._before = (session.segment, dict(self._frames), list(self._pixels))
        began = clock.perf_counter()
        f = trainer.frame(taken.time, taken.depth, source.lens, self._place, commands, learn=usable and not kept)
        learned = clock.perf_counter()
        found, density = self._look(taken, f, controls.map)
        looked = clock.perf_counter()
        self._seconds += learned - began
        if "undo" in commands and trainer.session.undone != before.undone:
            self._held.drop(trainer.session.undone)
            _, self._frames, self._pixels = self._before
        if instruction.phase == "test" and before.phase != "test":
            self._final = trainer.final_threshold()
        threshold, events = self._threshold(controls), []
        if fresh:
            self._keep(taken, f, found, usable and kept, threshold, controls.hold_s)
            if not self.paused:
                self._write(taken, f)
            if self.asks == "test" and threshold is not None and threshold > 0:
                settings = [EventSettings(threshold, hold_s=controls.hold_s)]
                self._events, events = detect_events(self._events, [found], taken.time, settings)
        for c in commands:
            gone = trainer.session.undone[len(before.undone) :] if c == "undo" else ()
            self._writer.act(taken.time, c, str(gone[0]) if gone else "")
        message = self._message(taken, f, found, threshold, controls, events)
        message["ms"] = {"learn": round(1e3 * (learned - began), 2), "look": round(1e3 * (looked - learned), 2)}
        return message, density

    def _look(self, taken: Taken, f: Feedback, wanted: bool) -> tuple[Localisation, NDArray[np.float32] | None]:
        """Localise the gesture in a picture; where the picture is learned, with the forest as it was before.

        wanted: the map of votes is wanted.
        Returns: the place of the gesture, and the map or None.
        """
        maxima = f.taught.maxima if f.taught is not None else ()
        if maxima and not wanted:
            return maxima[0], None
        look = LocaliseSettings() if f.instruction.phase == "test" else self.trainer.learner.settings.look
        lens, forest = self.feed.source.lens, self.trainer.learner.forest
        maps = densities(taken.depth, lens, [forest], look, self._scratch)
        found = maxima[0] if maxima else settle(maps, taken.depth, lens, look, self._scratch)[0]
        return found, maps[0][0] if wanted else None

    def _threshold(self, controls: Controls) -> float | None:
        return controls.threshold or (self._final if self.asks == "test" else None) or self.trainer.threshold

    def _keep(
        self, taken: Taken, f: Feedback, found: Localisation, kept: bool, threshold: float | None, hold_s: float
    ) -> None:
        """Count learned frames, and hold back frames for testing."""
        kind, phase = f.instruction.learn, f.instruction.phase
        if kind is not None and f.taught is not None:
            self._frames[kind] += 1
            for k, n in enumerate(f.taught.learned):
                self._pixels[k] += n
        if kept:
            at = self._place if kind == "gesture" else None
            self._held.keep(taken.depth, at, f.instruction.segment)
        if phase == "negative" and not self.paused:
            self._alarms.see(taken.time, found, threshold, hold_s)
        if phase == "test" and self.feed.source.clear():
            self._held.test(taken.depth, taken.box, found)

    def _write(self, taken: Taken, f: Feedback) -> None:
        phase, learned = f.instruction.phase, f.taught is not None
        self._writer.add(
            taken.time,
            taken.depth,
            "free" if phase in ("positive", "negative") and not learned else phase,
            f.instruction.segment,
            int(f.instruction.learn == "gesture"),
            self._place,
        )

    def _message(
        self, taken: Taken, f: Feedback, found: Localisation, threshold: float | None, c: Controls, events: list[Event]
    ) -> dict[str, Any]:
        s, i = self.trainer.session, f.instruction
        z = surface_depth(taken.depth, *self._place)
        half = BOX_M * self.feed.source.lens.fx / (2.0 if z is None else z / 1000)
        return {
            "t": "step",
            "time": round(taken.time, 3),
            "phase": i.phase,
            "prompt": i.prompt,
            "left_s": None if i.left_s == float("inf") else round(i.left_s, 2),
            "round": s.round + 1,
            "paused": s.paused is not None,
            "box": [round(self._place[0], 1), round(self._place[1], 1), round(half, 1)],
            "cross": [round(found.x, 1), round(found.y, 1)] if found.score > 0 else None,
            "position": position(found),
            "learned": None if f.taught is None else list(f.taught.learned),
            "mined": [] if f.taught is None else [[round(m.x, 1), round(m.y, 1)] for m in f.taught.mined],
            "score": round(found.score, 3),
            "high": rounded(s.high),
            "low": rounded(s.low),
            "threshold": rounded(threshold),
            "manual": c.threshold is not None,
            "detected": threshold is not None and found.score >= threshold,
            "counts": {
                **self._frames,
                "pixels": list(self._pixels),
                "nodes": int(self.trainer.learner.forest.size.sum()),
                "segments": s.segment - len(s.undone),
            },
            "events": [event_message(e, self.names) for e in events],
        }

    def judged(self, time: float, controls: Controls) -> dict[str, Any] | None:
        """Return the newest test result, about once per second of the session; None where there is no new one."""
        if abs(time - self._judged_at) < 1.0:
            return None
        self._judged_at = time
        result = self._held.result(self._threshold(controls))
        if self.asks != "test" and not self.paused:
            self._held.begin(self.trainer.learner.forest.freeze())
        return None if result is None else {"t": "judged", **result, **self._alarms.reported()}

    def save(self, controls: Controls) -> Path | None:
        """Write the model; return its path, or None where nothing has been learned yet."""
        if not sum(self._frames.values()):
            return None
        threshold = controls.threshold or self._final or self.trainer.final_threshold()
        old = self._old.history if self._old is not None else ()
        if (
            threshold is None and self._old is not None
        ):  # the session ended before both gesture and movement were seen again
            threshold = self._old.thresholds[0]
        entry: Mapping[str, Any] = {
            "session": self.folder.name,
            "frames_learned": sum(self._frames.values()),
            "computing_s": round(self._seconds, 3),
            "content": content_of(self.folder),
        }
        learner = self.trainer.learner
        model = GestureModel(
            tuple(self.names), learner.forest, (threshold,), LocaliseSettings(), learner, (*old, entry)
        )
        save_model(model, self.path)
        return self.path

    def close(self) -> None:
        """Close the recording."""
        self._writer.close()


class Watching:
    """Search for the gestures of all models; nothing is learned or written."""

    reported: dict[str, Any] = {"rounds": 0, "seconds": {}}
    folder = None
    asks = "free"

    def __init__(self, feed: GestureFeed, models: Sequence[GestureModel]) -> None:
        self.feed = feed
        self.names = [n for m in models for n in m.names]
        self._forests, self._limits = loaded_forests(models), thresholds(models, None)
        self._look = LocaliseSettings(adaptation_rate=_ADAPTATION_RATE)
        self._scratch, self._state, self._pause = Scratch(), EventState(), False

    @property
    def paused(self) -> bool:
        """Whether the session waits for the page."""
        return self._pause

    def frame(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Shown:
        """Process a picture.

        fresh: False: only the commands are new, the picture was processed before.
        """
        for c in commands:
            self._pause = c == "pause" if c in ("pause", "continue") else self._pause
        lens = self.feed.source.lens
        began = clock.perf_counter()
        maps = densities(taken.depth, lens, self._forests, self._look, self._scratch)
        found = settle(
            maps, taken.depth, lens, self._look if fresh else replace(self._look, adaptation_rate=1.0), self._scratch
        )
        spent = clock.perf_counter() - began
        limits = [controls.threshold or t for t in self._limits]
        events = []
        if fresh:
            settings = [EventSettings(t, hold_s=controls.hold_s) for t in limits]
            self._state, events = detect_events(self._state, found, taken.time, settings)
        best = max(found, key=lambda f: f.score / limits[f.gesture - 1])
        limit = limits[best.gesture - 1]
        message = {
            "t": "step",
            "time": round(taken.time, 3),
            "phase": "test",
            "prompt": "Paused" if self._pause else "Watching",
            "left_s": None,
            "round": 0,
            "paused": self._pause,
            "box": None,
            "cross": [round(best.x, 1), round(best.y, 1)] if best.score > 0 else None,
            "position": position(best),
            "learned": None,
            "mined": [],
            "score": round(best.score, 3),
            "high": None,
            "low": None,
            "threshold": rounded(limit),
            "manual": controls.threshold is not None,
            "detected": best.score >= limit,
            "counts": {"gesture": 0, "negative": 0, "pixels": [], "nodes": 0, "segments": 0},
            "found": [
                {
                    "gesture": self.names[f.gesture - 1],
                    "score": round(f.score, 3),
                    "x": round(f.x, 1),
                    "y": round(f.y, 1),
                    "threshold": rounded(t),
                }
                for f, t in zip(found, limits, strict=True)
            ],
            "events": [event_message(e, self.names) for e in events],
            "ms": {"look": round(1e3 * spent, 2)},
        }
        return message, maps[best.gesture - 1][0] if controls.map else None

    def judged(self, time: float, controls: Controls) -> dict[str, Any] | None:
        """Return None: nothing is tested while watching."""
        return None

    def save(self, controls: Controls) -> Path | None:
        """Return None: there is nothing to save."""
        return None

    def close(self) -> None:
        """Do nothing; there is nothing to close."""


def event_message(event: Event, names: Sequence[str]) -> dict[str, Any]:
    """Convert an event to the form of the page."""
    return {
        "kind": event.kind,
        "gesture": names[event.gesture - 1],
        "time": round(event.time, 3),
        "x": round(event.x, 1),
        "y": round(event.y, 1),
        "score": round(event.score, 3),
    }


def position(found: Localisation) -> list[float] | None:
    """Return the place of a gesture in the camera's frame of reference, rounded, m."""
    return None if found.position is None else [round(float(v), 3) for v in found.position]


def rounded(value: float | None) -> float | None:
    """Round a value for JSON."""
    return None if value is None else round(value, 3)

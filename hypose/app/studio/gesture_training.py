"""Process the frames of a gesture session: teach a gesture (all is recorded and saved), or watch for gestures; each
frame gives the message that the page shows. A forest is judged by frames that it has not learned yet.
"""

from __future__ import annotations

import time as clock
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.app.jobs.gesture_job import growing_model, loaded_forests, new_learner, thresholds
from hypose.app.live.gesture_sources import GestureSource, Taken
from hypose.app.studio.http import request_number
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
from hypose.gestures.localise import Localisation, LocaliseSettings, Scratch, densities, settle
from hypose.gestures.model import GestureModel
from hypose.gestures.trainer import Command, Feedback, SessionSettings, Trainer, advance
from hypose.pipeline.gesture_files import SessionWriter, content_of, save_model

PHASES = ("do_gesture", "positive", "release", "negative")
"""Phases of a training session, in their order."""
_JUDGED_S, _MOST_JUDGED = 1.0, 120
"""Time at the beginning of a segment in which frames are judged, s, and most of the latest ones that count."""
_WINDOW_S = 60.0
"""Time of movement over which false alarms are counted, s."""
_POINTS = 100
"""Most points of a curve that are reported."""
BOX_M = 0.1
"""Half side of the box on the page, at the surface in it, m."""
_ADAPTATION_RATE = 0.8
"""Share of the new frame in the density while watching, as in `hypose gesture run`."""
_TEST = 0
"""Number of the segment of frames of the test."""
_Step = tuple[dict[str, Any], NDArray[np.float32] | None]
"""Result of a frame for the page: the step message (without seq), and the map of votes where wanted."""


class Judge:
    """Judgement of a forest by frames before it learns them: those at the beginning of a segment, which differ most
    from learned ones, and those of the test.

    lens: lens parameters of the depth camera.
    """

    def __init__(self, lens: DepthLens) -> None:
        self._lens = lens
        self._frames: list[tuple[int, float, float]] = []  # segment, score (cm^2), error (m)
        self._state, self._clock = EventState(), 0.0
        self._last: float | None = None
        self._alarms: list[float] = []

    def see(self, depth: DepthImage, at: tuple[float, float] | None, found: Localisation, segment: int = _TEST) -> None:
        """Add a frame.

        depth: (h, w) uint16 mm.
        at: true pixel of the gesture; None: it is not done.
        found: place that the forest found.
        segment: number of its segment; _TEST: it is of the test.
        """
        error = np.nan
        if at is not None:
            z = surface_depth(depth, *at)
            far = np.inf if z is None else z / 1000 / self._lens.fx
            error = float(np.hypot(found.x - at[0], found.y - at[1])) * far
        self._frames.append((segment, found.score, error))

    def move(self, time: float, found: Localisation, threshold: float | None, hold_s: float) -> None:
        """Count the events of a frame of other movement as false alarms.

        time: s.
        found: place that the forest found.
        threshold: cm^2, from which it counts; None: not known yet.
        hold_s: time for which a gesture must be held, s.
        """
        if self._last is not None and 0 < time - self._last < 1:
            self._clock += time - self._last
        elif self._last is not None:  # another segment: an event that was going on has ended
            self._state = EventState()
        self._last = time
        if threshold is not None and threshold > 0:
            settings = [EventSettings(threshold, hold_s=hold_s)] * found.gesture
            self._state, events = detect_events(self._state, [found], self._clock, settings)
            self._alarms += [self._clock for e in events if e.kind == "start"]

    def reported(self, undone: Collection[int] = ()) -> dict[str, Any]:
        """Return the judgement for the page: of the frames of the test once these are of both kinds, else of the latest
        frames of segments.

        undone: numbers of segments that do not count.
        Returns: numbers of frames, and of those with the gesture (positives); average precision (ap; None where all
            frames are of one kind) and its curve; false_per_min, alarms per minute of the last minute of other
            movement (None before 5 s of it), and tested_s, how long that was, s.
        """
        tested = [f for f in self._frames if f[0] == _TEST]
        test = {bool(np.isnan(error)) for _, _, error in tested} == {True, False}
        seen = tested if test else [f for f in self._frames if f[0] not in (_TEST, *undone)][-_MOST_JUDGED:]
        scores, errors = np.array([f[1:] for f in seen]).reshape(-1, 2).T
        correct, positives = errors <= RADIUS_M, int((~np.isnan(errors)).sum())
        seconds = min(self._clock, _WINDOW_S)
        recent = sum(t > self._clock - _WINDOW_S for t in self._alarms)
        out = {"on": "test" if test else "segments", "frames": len(seen), "positives": positives, "ap": None}
        out |= {"precision": [], "recall": [], "scores": [], "tested_s": round(seconds, 1)}
        out |= {"false_per_min": recent * 60 / seconds if seconds > 5 else None}
        if 0 < positives < len(seen):
            precision, recall = precision_recall(scores, correct, positives)
            ranked = scores[np.lexsort((correct, -scores))]
            ranked = ranked[ranked > 0]
            pick = np.unique(np.linspace(0, len(ranked) - 1, min(_POINTS, len(ranked))).astype(int))
            out |= {"ap": average_precision(scores, correct, positives), "scores": ranked[pick].round(3).tolist()}
            out |= {"precision": precision[pick].round(4).tolist(), "recall": recall[pick].round(4).tolist()}
        return out


@dataclass
class Controls:
    """Settings that a page changes while a session runs.

    box: (x, y) px where the gesture is asked for; None: the middle.
    threshold: cm^2; None: automatic.
    hold_s: time for which a gesture must be held, s.
    map: the map of votes is wanted.
    """

    box: tuple[float, float] | None = None
    threshold: float | None = None
    hold_s: float = 0.15
    map: bool = False

    def change(self, message: Mapping[str, Any], size: tuple[int, int]) -> bool:
        """Apply a message that changes box, threshold, hold or map.

        size: (width, height) size of the pictures, px; a box outside is moved to the border.
        Returns: False where the message is none of these.
        Raises: InputError where its value is not possible.
        """
        kind = message.get("t")
        if kind == "box":
            x, y = (request_number(message.get(k), f"the box's {k}", -1e9, 1e9) for k in ("x", "y"))
            self.box = (min(max(x, 0.0), size[0] - 1.0), min(max(y, 0.0), size[1] - 1.0))
        elif kind == "threshold":
            value = message.get("value")
            self.threshold = None if value is None else request_number(value, "the threshold (cm²)", 1e-3, 1e6)
        elif kind == "hold":
            self.hold_s = request_number(message.get("seconds"), "the time to hold (s)", 0, 10)
        elif kind == "map":
            self.map = message.get("on") is True
        return kind in ("box", "threshold", "hold", "map")


class Training:
    """Training of one gesture: all is recorded and saved. Only the session's thread may call it; `save` also after that
    thread has ended.

    source: source of the pictures.
    gesture: its name.
    settings: settings of the training.
    seed: seed of random numbers, for a new forest.
    knows: the box of a picture is the true place of the gesture, and None means that it is not shown.
    old: file of the model that is trained further, or None.
    folder: new folder for the recording.
    model: file for the model.
    """

    def __init__(
        self,
        source: GestureSource,
        gesture: str,
        settings: SessionSettings,
        seed: int,
        knows: bool,
        old: Path | None,
        folder: Path,
        model: Path,
    ) -> None:
        self.folder: Path | None = folder
        self.path, self.names = model, [gesture]
        self._source, self._knows = source, knows
        self._old = growing_model(old, gesture) if old is not None else None
        learner = (self._old.learner if self._old is not None else None) or new_learner(seed)
        self.trainer = Trainer(learner, settings)
        self.reported = {"rounds": settings.rounds, "seconds": {p: getattr(settings, f"{p}_s") for p in PHASES}}
        self._writer = SessionWriter(folder, self.names, source.lens, source.size, self.reported)
        self._judge, self._scratch, self._events = Judge(source.lens), Scratch(), EventState()
        self._final: float | None = None  # the threshold that a saved model gets, found when the test begins
        self._place = (source.size[0] / 2, 0.45 * source.size[1])
        self._learned: Counter[tuple[int, str]] = Counter()  # frames and pixels by segment
        self._seconds = 0.0

    @property
    def asks(self) -> str:
        """Phase of the session that the next picture should show, a word."""
        return self.trainer.session.phase

    @property
    def paused(self) -> bool:
        """Whether the session waits for the page."""
        return self.trainer.session.paused is not None

    def frame(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Step:
        """Process a picture.

        taken: the picture.
        controls: settings of the page.
        commands: commands of the page since the last picture.
        fresh: False: only the commands are new, the picture was processed before.
        """
        trainer, before = self.trainer, self.trainer.session
        self._place = (taken.box if self._knows else controls.box) or self._place
        instruction = advance(before, trainer.settings, taken.time, commands)[1]
        # where the source knows the truth, a picture must show the kind of movement to be learned
        sure = instruction.learn is None or not self._knows
        usable = fresh and (sure or (taken.box is not None) == (instruction.learn == "gesture"))
        began = clock.perf_counter()
        f = trainer.frame(taken.time, taken.depth, self._source.lens, self._place, commands, learn=usable)
        learned = clock.perf_counter()
        found, density = self._look(taken, f, controls.map)
        looked = clock.perf_counter()
        self._seconds += learned - began
        if instruction.phase == "test" and before.phase != "test":
            self._final = trainer.final_threshold()
        threshold, events = self._threshold(controls), []
        if fresh:
            self._count(taken, f, found, usable, threshold, controls.hold_s)
            if self.asks == "test" and threshold is not None and threshold > 0:
                settings = [EventSettings(threshold, hold_s=controls.hold_s)]
                self._events, events = detect_events(self._events, [found], taken.time, settings)
        for c in commands:
            gone = trainer.session.undone[len(before.undone) :] if c == "undo" else ()
            self._writer.act(taken.time, c, str(gone[0]) if gone else "")
        message = self._message(taken, f, found, threshold, controls) | {"events": _shown(events, self.names)}
        message["ms"] = {"learn": round(1e3 * (learned - began), 2), "look": round(1e3 * (looked - learned), 2)}
        return message, density

    def _look(self, taken: Taken, f: Feedback, wanted: bool) -> tuple[Localisation, NDArray[np.float32] | None]:
        """Localise the gesture in a picture; where the picture is learned, with the forest as it was before.

        taken, f: the picture, and what the trainer did with it.
        wanted: the map of votes is wanted.
        Returns: the place of the gesture, and the map or None.
        """
        known = f.taught.found if f.taught is not None else None
        if known is not None and not wanted:
            return known, None
        look = LocaliseSettings() if f.instruction.phase == "test" else self.trainer.learner.settings.look
        lens, forest = self._source.lens, self.trainer.learner.forest
        maps = densities(taken.depth, lens, [forest], look, self._scratch)
        found = known or settle(maps, taken.depth, lens, look, self._scratch)[0]
        return found, maps[0][0] if wanted else None

    def _threshold(self, controls: Controls) -> float | None:
        return controls.threshold or (self._final if self.asks == "test" else None) or self.trainer.threshold

    def _count(
        self, taken: Taken, f: Feedback, found: Localisation, usable: bool, threshold: float | None, hold_s: float
    ) -> None:
        """Count, judge and record a new frame.

        taken, f: the picture, and what the trainer did with it.
        found: place of the gesture.
        usable: the picture shows what it was asked for.
        threshold: cm^2 or None; hold_s: s. Both count false alarms.
        """
        session, i = self.trainer.session, f.instruction
        if i.learn is not None and f.taught is not None:
            self._learned[i.segment, i.learn] += 1
            self._learned[i.segment, "pixels"] += sum(f.taught.learned)
        both_known = None not in session.before  # the segment began with a forest that knew gesture and movement
        if i.learn is not None and usable and both_known and taken.time - session.entered < _JUDGED_S:
            self._judge.see(taken.depth, self._place if i.learn == "gesture" else None, found, i.segment)
        if i.phase == "test" and self._source.clear():
            self._judge.see(taken.depth, taken.box, found)
        if self.paused:
            return
        if i.phase == "negative":
            self._judge.move(taken.time, found, threshold, hold_s)
        used = "free" if i.learn is not None and f.taught is None else i.phase
        self._writer.add(taken.time, taken.depth, used, i.segment, int(i.learn == "gesture"), self._place)

    def _message(
        self, taken: Taken, f: Feedback, found: Localisation, threshold: float | None, c: Controls
    ) -> dict[str, Any]:
        """Return the step message (docs/studio-protocol.md) without events and times.

        taken, f: the picture, and what the trainer did with it.
        found: place of the gesture.
        threshold: cm^2; None: not known yet.
        c: settings of the page.
        """
        s, i = self.trainer.session, f.instruction
        z = surface_depth(taken.depth, *self._place)
        half = BOX_M * self._source.lens.fx / (2.0 if z is None else z / 1000)
        return {
            **_step(taken, found, threshold, c),
            "phase": i.phase,
            "prompt": i.prompt,
            "left_s": None if i.left_s == float("inf") else round(i.left_s, 2),
            "round": s.round + 1,
            "paused": s.paused is not None,
            "box": [round(self._place[0], 1), round(self._place[1], 1), round(half, 1)],
            "learned": None if f.taught is None else list(f.taught.learned),
            "mined": [[round(found.x, 1), round(found.y, 1)]] if f.taught is not None and f.taught.mined else [],
            "high": _rounded(s.high),
            "low": _rounded(s.low),
            "counts": {
                **{what: self._sum(what) for what in ("gesture", "negative", "pixels")},
                "nodes": int(self.trainer.learner.forest.size.sum()),
                "segments": s.segment - len(s.undone),
            },
        }

    def _sum(self, what: str) -> int:
        """Sum what was learned ("gesture", "negative" frames or "pixels") in segments that were not undone."""
        undone = self.trainer.session.undone
        return sum(n for (segment, kind), n in self._learned.items() if kind == what and segment not in undone)

    def judged(self) -> dict[str, Any] | None:
        """Return the judgement of the forest."""
        return {"t": "judged", **self._judge.reported(self.trainer.session.undone)}

    def save(self, controls: Controls) -> Path | None:
        """Write the model; return its path, or None where nothing has been learned yet."""
        frames = self._sum("gesture") + self._sum("negative")
        if not frames or self.folder is None:
            return None
        threshold = controls.threshold or self._final or self.trainer.final_threshold()
        if threshold is None and self._old is not None:  # only one of gesture and movement was seen this time
            threshold = self._old.threshold
        entry: Mapping[str, Any] = {
            "session": self.folder.name,
            "frames_learned": frames,
            "computing_s": round(self._seconds, 3),
            "content": content_of(self.folder),
        }
        old = () if self._old is None else self._old.history
        save_model(GestureModel(self.names[0], self.trainer.learner, threshold, (*old, entry)), self.path)
        return self.path

    def close(self) -> None:
        """Close the recording."""
        self._writer.close()


class Watching:
    """Search for the gestures of all models; nothing is learned or written.

    source: source of the pictures.
    models: models of one gesture each.
    """

    reported: dict[str, Any] = {"rounds": 0, "seconds": {}}
    folder: Path | None = None
    asks = "free"

    def __init__(self, source: GestureSource, models: Sequence[GestureModel]) -> None:
        self._lens = source.lens
        self.names = [m.name for m in models]
        self._forests, self._limits = loaded_forests(models), thresholds(models, None)
        self._look = LocaliseSettings(adaptation_rate=_ADAPTATION_RATE)
        self._scratch, self._state, self.paused = Scratch(), EventState(), False

    def frame(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Step:
        """Search for the gestures in a picture.

        taken: the picture.
        controls: settings of the page.
        commands: not used.
        fresh: False: the picture was processed before.
        """
        for c in commands:
            self.paused = c == "pause" if c in ("pause", "continue") else self.paused
        began = clock.perf_counter()
        maps = densities(taken.depth, self._lens, self._forests, self._look, self._scratch)
        look = self._look if fresh else replace(self._look, adaptation_rate=1.0)
        found = settle(maps, taken.depth, self._lens, look, self._scratch)
        spent = clock.perf_counter() - began
        limits, events = [controls.threshold or t for t in self._limits], []
        if fresh:
            settings = [EventSettings(t, hold_s=controls.hold_s) for t in limits]
            self._state, events = detect_events(self._state, found, taken.time, settings)
        best = max(found, key=lambda f: f.score / limits[f.gesture - 1])
        message = {
            **_step(taken, best, limits[best.gesture - 1], controls),
            "phase": "test",
            "prompt": "Paused" if self.paused else "Watching",
            "left_s": None,
            "round": 0,
            "paused": self.paused,
            "box": None,
            "learned": None,
            "mined": [],
            "high": None,
            "low": None,
            "counts": {"gesture": 0, "negative": 0, "pixels": 0, "nodes": 0, "segments": 0},
            "found": [
                {
                    "gesture": self.names[f.gesture - 1],
                    "score": round(f.score, 3),
                    "x": round(f.x, 1),
                    "y": round(f.y, 1),
                    "threshold": _rounded(t),
                }
                for f, t in zip(found, limits, strict=True)
            ],
            "events": _shown(events, self.names),
            "ms": {"look": round(1e3 * spent, 2)},
        }
        return message, maps[best.gesture - 1][0] if controls.map else None

    def judged(self) -> dict[str, Any] | None:
        """Return None: nothing is judged while watching."""
        return None

    def save(self, controls: Controls) -> Path | None:
        """Return None: there is nothing to save."""
        return None

    def close(self) -> None:
        """Do nothing; there is nothing to close."""


def _step(taken: Taken, found: Localisation, threshold: float | None, c: Controls) -> dict[str, Any]:
    """Return the part of the step message on the place that was found in a picture.

    threshold: cm^2; None: not known yet.
    c: settings of the page.
    """
    where = None if found.position is None else [round(float(v), 3) for v in found.position]
    return {
        "t": "step",
        "time": round(taken.time, 3),
        "cross": [round(found.x, 1), round(found.y, 1)] if found.score > 0 else None,
        "position": where,
        "score": round(found.score, 3),
        "threshold": _rounded(threshold),
        "manual": c.threshold is not None,
        "detected": threshold is not None and found.score >= threshold,
    }


def _shown(events: Sequence[Event], names: Sequence[str]) -> list[dict[str, Any]]:
    """Convert events to the form of the page; names: names of the gestures."""
    return [
        {
            "kind": e.kind,
            "gesture": names[e.gesture - 1],
            "time": round(e.time, 3),
            "x": round(e.x, 1),
            "y": round(e.y, 1),
            "score": round(e.score, 3),
        }
        for e in events
    ]


def _rounded(value: float | None) -> float | None:
    """Round a value for JSON; None stays None."""
    return None if value is None else round(value, 3)

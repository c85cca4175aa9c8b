"""Gesture session of the studio, one per server (docs/studio-protocol.md, /ws/gesture).

A page starts a session. A thread (`Run`) takes pictures at their pace, lets `Lesson` (which teaches a gesture) or
`Watch` process them with the page's requests, reports the results, and saves. A forest is judged by frames that it has
not learned yet (`Judge`).
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import queue
import threading
import time as clock
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.live.gestures import GestureSource, Taken, Teaching, Watching, event_value, growing_model, open_source
from hypose.app.reports.result_pictures import jpeg
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.http import DEPTH, MAP, Message, Topic, digits, request_choice, request_number, text, whole
from hypose.app.studio.live_topics import recording_folder
from hypose.compute.forests import DepthImage
from hypose.errors import HyposeError, InputError
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
from hypose.gestures.model import GestureModel, check_gesture_name
from hypose.gestures.trainer import COMMANDS, Command, Feedback, SessionSettings
from hypose.io.files import free_path, read_json
from hypose.pipeline.gesture_files import load_model, read_recording, save_model
from hypose.synthetic.gesture_people import GESTURES, load_people

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
_TEST = 0
"""Number of the segment of frames of the test."""
_Step = tuple[dict[str, Any], NDArray[np.float32] | None]
"""Result of a frame for the page: the step message (without seq), and the map of votes where wanted."""
_FOLDER = "gestures"
"""Folder for sessions and models in the served folder."""
_CAMERA = "realsense"
"""Source that delivers pictures by itself, and does not know the gesture's true place. Pictures of other sources are
shown at the pace of their times.
"""
ALONE_S = 5.0
"""Time without a page after which a session is paused, s."""
HISTORY = 2000
"""Number of latest frames whose scores a new page receives."""
_SAVE_S, _JUDGE_S = 10.0, 1.0
"""Times after which a session is saved and judged, s."""
_LEAST_FULL, _FADING = 1e-5, 0.95
"""The map of votes shows the highest recent density as opaque: least such density (m^2 of voting surface per cell), and
the factor by which it decreases per map. Why: densities differ with gesture, distance and amount of training.
"""


class Judge:
    """Judgement of a forest by frames before it learns them: those at the beginning of a segment, which differ most
    from learned ones, and those of the test.

    lens: lens parameters of the depth camera.
    """

    def __init__(self, lens: DepthLens) -> None:
        self._lens = lens
        self._frames: list[tuple[int, float, float]] = []  # segment, score (cm^2), error (m)
        self._last: float | None = None
        self._clock = 0.0  # time of other movement, s
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

    def move(self, time: float, alarms: int) -> None:
        """Count the false alarms in a frame of other movement.

        time: s.
        alarms: gestures that were wrongly found to start.
        """
        if self._last is not None and 0 < time - self._last < 1:
            self._clock += time - self._last
        self._last = time
        self._alarms += [self._clock] * alarms

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
        out = {
            "on": "test" if test else "segments",
            "frames": len(seen),
            "positives": positives,
            "ap": None,
            **{curve: [] for curve in ("precision", "recall", "scores")},
            "tested_s": round(seconds, 1),
            "false_per_min": recent * 60 / seconds if seconds > 5 else None,
        }
        if 0 < positives < len(seen):
            precision, recall = precision_recall(scores, correct, positives)
            ranked = scores[np.lexsort((correct, -scores))]
            ranked = ranked[ranked > 0]
            pick = np.unique(np.linspace(0, len(ranked) - 1, min(_POINTS, len(ranked))).astype(int))
            out |= {
                "ap": average_precision(scores, correct, positives),
                "precision": precision[pick].round(4).tolist(),
                "recall": recall[pick].round(4).tolist(),
                "scores": ranked[pick].round(3).tolist(),
            }
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
        match message.get("t"):
            case "box":
                x, y = (request_number(message.get(k), f"the box's {k}", -1e9, 1e9) for k in ("x", "y"))
                self.box = (min(max(x, 0.0), size[0] - 1.0), min(max(y, 0.0), size[1] - 1.0))
            case "threshold":
                value = message.get("value")
                self.threshold = None if value is None else request_number(value, "the threshold (cm²)", 1e-3, 1e6)
            case "hold":
                self.hold_s = request_number(message.get("seconds"), "the time to hold (s)", 0, 10)
            case "map":
                self.map = message.get("on") is True
            case _:
                return False
        return True


class Lesson(Teaching):
    """Session that teaches one gesture for a page: it is judged and saved as well. Only the session's thread may call
    it; `save` also after that thread has ended.

    path: file for the model.
    Other arguments: as of `Teaching`.
    """

    def __init__(
        self,
        source: GestureSource,
        gesture: str,
        settings: SessionSettings,
        *,
        old: GestureModel | None,
        seed: int,
        record: Path,
        path: Path,
    ) -> None:
        super().__init__(source, gesture, settings, old=old, seed=seed, record=record)
        self.path, self.names = path, [gesture]
        self.reported = {"rounds": settings.rounds, "seconds": {p: getattr(settings, f"{p}_s") for p in PHASES}}
        self._judge, self._scratch, self._events = Judge(source.lens), Scratch(), EventState()

    def step(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Step:
        """Process a picture.

        taken: the picture.
        controls: settings of the page.
        commands: commands of the page since the last picture.
        fresh: False: only the commands are new, the picture was processed before.
        """
        f = self.frame(taken, commands, controls.box, fresh)
        found, density = self._look(taken, f, controls.map)
        i, session, events = f.instruction, self.trainer.session, list[Event]()
        threshold = controls.threshold or (self.final if i.phase == "test" else None) or f.threshold
        if fresh and threshold:
            settings = [EventSettings(threshold, hold_s=controls.hold_s)]
            self._events, events = detect_events(self._events, [found], taken.time, settings)
        if fresh:
            both_known = None not in session.before  # the segment began with a forest that knew gesture and movement
            if self.usable and both_known and taken.time - session.entered < _JUDGED_S:
                self._judge.see(taken.depth, self.place if i.learn == "gesture" else None, found, i.segment)
            if i.phase == "test" and self.source.clear():
                self._judge.see(taken.depth, taken.box, found)
            if i.phase == "negative" and not self.paused:
                self._judge.move(taken.time, sum(e.kind == "start" for e in events))
        z = surface_depth(taken.depth, *self.place)
        half = BOX_M * self.source.lens.fx / (2.0 if z is None else z / 1000)
        message = {
            **_step(taken, found, threshold, controls, events if i.phase == "test" else [], self.names),
            "phase": i.phase,
            "prompt": i.prompt,
            "left_s": None if i.left_s == float("inf") else round(i.left_s, 2),
            "round": session.round + 1,
            "paused": self.paused,
            "box": [round(self.place[0], 1), round(self.place[1], 1), round(half, 1)],
            "learned": None if f.taught is None else list(f.taught.learned),
            "mined": [[round(found.x, 1), round(found.y, 1)]] if f.taught is not None and f.taught.mined else [],
            "high": _rounded(session.high),
            "low": _rounded(session.low),
            "counts": {
                **{what: self.learned(what) for what in ("gesture", "negative", "pixels")},
                "nodes": int(self.trainer.learner.forest.size.sum()),
                "segments": session.segment - len(session.undone),
            },
        }
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
        maps = densities(taken.depth, self.source.lens, [self.trainer.learner.forest], look, self._scratch)
        found = known or settle(maps, taken.depth, self.source.lens, look, self._scratch)[0]
        return found, maps[0][0] if wanted else None

    def judged(self) -> dict[str, Any]:
        """Return the judgement of the forest."""
        return {"t": "judged", **self._judge.reported(self.trainer.session.undone)}

    def save(self, controls: Controls) -> Path | None:
        """Write the model; return its path, or None where nothing has been learned yet."""
        if not self.learned("pixels"):
            return None
        save_model(self.model(controls.threshold), self.path)
        return self.path


class Watch(Watching):
    """Session that watches for the gestures of models for a page; nothing is learned or written."""

    reported: Mapping[str, Any] = {"rounds": 0, "seconds": {}}
    folder: Path | None = None
    phase, paused = "free", False

    def step(self, taken: Taken, controls: Controls, commands: Sequence[Command], fresh: bool) -> _Step:
        """Search for the gestures in a picture; arguments as of `Lesson.step`."""
        for c in commands:
            self.paused = c == "pause" if c in ("pause", "continue") else self.paused
        limits = [replace(s, threshold=controls.threshold or s.threshold, hold_s=controls.hold_s) for s in self.limits]
        w = self.frame(taken, limits, fresh)
        best = max(w.found, key=lambda f: f.score / limits[f.gesture - 1].threshold)
        nothing = dict.fromkeys(("left_s", "box", "learned", "high", "low"))
        message = {
            **_step(taken, best, limits[best.gesture - 1].threshold, controls, w.events, self.names),
            **nothing,
            "phase": "test",
            "prompt": "Paused" if self.paused else "Watching",
            "round": 0,
            "paused": self.paused,
            "mined": [],
            "counts": dict.fromkeys(("gesture", "negative", "pixels", "nodes", "segments"), 0),
            "found": [
                {
                    "gesture": self.names[f.gesture - 1],
                    "score": round(f.score, 3),
                    "x": round(f.x, 1),
                    "y": round(f.y, 1),
                    "threshold": _rounded(limit.threshold),
                }
                for f, limit in zip(w.found, limits, strict=True)
            ],
        }
        return message, w.maps[best.gesture - 1] if controls.map else None


def _step(
    taken: Taken,
    found: Localisation,
    threshold: float | None,
    c: Controls,
    events: Sequence[Event],
    names: Sequence[str],
) -> dict[str, Any]:
    """Return the part of the step message on the place that was found in a picture, and on the events.

    threshold: cm^2; None: not known yet.
    c: settings of the page.
    names: names of the gestures.
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
        "events": [event_value(e, names) for e in events],
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def open_feed(where: str, gesture: str, seed: int, catalog: Catalog) -> GestureSource:
    """Open a source.

    where: simulated:PERSON, session:ID or realsense. Why no others: a page must not open paths.
    gesture, seed: gesture and seed of a simulated person.
    catalog: items of the served folder, among them the sessions.
    Raises: InputError for other sources.
    """
    kind, _, rest = where.partition(":")
    if kind == "session":
        where = str(catalog.find("session", rest).path)
    elif kind == "simulated":
        digits(rest or "0", "the simulated person's number")
    elif where != _CAMERA:
        raise InputError(f"There is no source {where[:40]!r}; choose one of the list.")
    return open_source(where, gesture, seed)


class GestureTopic(Topic):
    """Topic of the gesture session: it is started and watched by pages, and belongs to the server.

    Attributes:
    running: the running session; None without one.
    """

    name = "gesture"

    def __init__(self, catalog: Catalog) -> None:
        super().__init__()
        self.catalog = catalog
        self._starting = threading.Lock()
        self.running: Run | None = None

    def hello(self) -> Message:
        """Return the state of the session, whose last picture is sent again."""
        if (run := self.running) is not None:
            run.requests.put("again")
        return {"t": "hello", "session": run and run.described()}

    async def heard(self, message: dict[str, Any]) -> None:
        """Handle a message of a page: start a session, or pass the message to the running session."""
        if message["t"] == "start":
            await asyncio.to_thread(self._start, message)
        elif (run := self.running) is None:
            raise InputError("No session is running; start one.")
        else:
            run.post(message)

    def _start(self, message: Message) -> None:
        """Start the session that a page requests.

        Raises: InputError where one is running, or a value, the source, a model or the recording's folder cannot be
            used.
        """
        with self._starting:
            if self.running is not None:
                raise InputError("A session is running already; stop it first.")
            mode = request_choice(message.get("mode"), "mode", ("train", "run"))
            where = text(message.get("source"), "source", 80, "choose a simulated person, a session or a camera")
            seed = whole(message.get("seed", 0), "the seed", 0, 2**32 - 1)
            activity = (self._watch if mode == "run" else self._lesson)(message, where, seed)
            self.running = run = Run(message, activity, self)
            self.post(self.hello())
            run.thread.start()

    def _watch(self, message: Message, where: str, seed: int) -> Watch:
        """Make the session that watches for the gestures of models; arguments as of `_lesson`."""
        ids = message.get("models")
        if not isinstance(ids, list) or not 1 <= len(ids) <= 16:
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        models = [load_model(self.catalog.find("model", m).path) for m in ids]
        return Watch(open_feed(where, models[0].name, seed, self.catalog), models)

    def _lesson(self, message: Message, where: str, seed: int) -> Lesson:
        """Make the session that teaches a gesture.

        where: its source.
        seed: seed of random numbers.
        """
        gesture = text(message.get("gesture"), "name of the gesture", 64, "type one, for example tee").strip()
        check_gesture_name(gesture)
        rounds = whole(message.get("rounds", 10), "the number of rounds", 1, 1000)
        seconds = message.get("seconds") or {}
        if not isinstance(seconds, dict):
            raise InputError("Every phase must be given a number of seconds.")
        given = {f"{p}_s": request_number(seconds[p], f"the seconds of {p}", 0, 600) for p in PHASES if p in seconds}
        resumed = message.get("resume")
        path = None if resumed is None else self.catalog.find("model", resumed).path
        old = None if path is None else growing_model(path, gesture)
        record = recording_folder(self.catalog, _FOLDER, gesture)
        path = path or free_path(record.parent, gesture, ".npz")
        settings, source = SessionSettings(rounds=rounds, **given), open_feed(where, gesture, seed, self.catalog)
        return Lesson(source, gesture, settings, old=old, seed=seed, record=record, path=path)

    def close(self) -> None:
        """Stop the session and save everything, when the server ends."""
        if (run := self.running) is not None:
            run.requests.put("stop")
            run.thread.join(10)


class Run:
    """Thread of one session.

    request: what the page requested; `fast`: recordings and simulated persons are not slowed down to real time.
    activity: the session.
    topic: its pages get the messages.
    """

    def __init__(self, request: Message, activity: Lesson | Watch, topic: GestureTopic) -> None:
        self.requests: queue.SimpleQueue[str] = queue.SimpleQueue()  # commands, "save", "stop", "again", "changed"
        self.thread = threading.Thread(target=self._work, daemon=True)
        self._source, self._activity, self._topic = activity.source, activity, topic
        self._lesson = activity if isinstance(activity, Lesson) else None
        self._live, self._fast = request["source"] == _CAMERA, request.get("fast") is True
        self._request = {"models": [], "resume": None, **request}
        self._history: deque[list[Any]] = deque(maxlen=HISTORY)
        self._judged: dict[str, Any] | None = None
        self._controls = Controls()
        self._full = 0.0  # density that the map shows opaque

    def described(self) -> dict[str, Any]:
        """Return the SESSION object of the protocol."""
        a = self._activity
        return {
            **{k: self._request[k] for k in ("mode", "models", "source", "resume")},
            "gestures": a.names,
            "title": self._source.name,
            "size": list(self._source.size),
            **a.reported,
            "folder": None if a.folder is None else f"{a.folder.parent.name}/{a.folder.name}",
            "history": list(self._history),
            "judged": self._judged,
        }

    def post(self, message: Mapping[str, Any]) -> None:
        """Take a message of a page.

        Raises: InputError where the message is not valid.
        """
        if message["t"] in ("save", "stop"):
            self.requests.put(message["t"])
        elif self._controls.change(message, self._source.size):
            self.requests.put("changed")
        else:
            self.requests.put(request_choice(message.get("command"), "command", COMMANDS))

    def _work(self) -> None:
        """Run the session until it ends; save, close, and report why it ended."""
        try:
            why = self._loop()
        except HyposeError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001 - the thread's end must be reported, and the work saved
            why = f"The session broke off ({type(error).__name__}: {error}); what was recorded is kept."
        try:
            self._save()
        except (HyposeError, OSError) as error:
            self._topic.post({"t": "error", "error": str(error)})
        # an unplugged camera or a full disk must not keep the session from ending
        with contextlib.suppress(OSError, RuntimeError), contextlib.closing(self._source):
            if self._lesson is not None:
                self._lesson.close()
        self._topic.running = None
        self._topic.post({"t": "ended", "why": why})

    def _loop(self) -> str:
        """Process pictures until the session is stopped or the source ends; return the reason."""
        a, last, seq, begin = self._activity, None, 0, 0.0
        due = saved = judged = watched = clock.monotonic()  # due: time of the next picture
        while True:
            # a paused recording waits; a camera continues, so that the person sees themselves
            waits = a.paused and not self._live
            requests = self._wait(None if waits else due)
            if "stop" in requests:
                return "The session was stopped."
            now = clock.monotonic()
            watched = now if self._topic.pages else watched
            if now - watched > ALONE_S and not a.paused:
                requests.append("pause")
            fresh = last is None or not (waits or now < due) or "continue" in requests
            if fresh:
                taken = self._source.take(a.phase)
                if taken is None:
                    return "The recording has ended."
                begin = taken.time if last is None else begin
                taken = replace(taken, time=taken.time - begin)
                if not (self._fast or self._live):
                    step = 0.0 if last is None else max(0.0, taken.time - last.time)
                    due = max(due, clock.monotonic() - 0.2) + step
                last = taken
            assert last is not None
            seq += 1
            self._publish(last, requests, fresh, seq)
            if self._lesson is not None and clock.monotonic() - judged > _JUDGE_S:
                self._judged, judged = self._lesson.judged(), clock.monotonic()
                self._topic.post(self._judged)
            if "save" in requests or clock.monotonic() - saved > _SAVE_S:
                self._save()
                saved = clock.monotonic()

    def _wait(self, until: float | None) -> list[str]:
        """Wait for requests until a time, s (None: without limit); return those that have come."""
        requests: list[str] = []
        with contextlib.suppress(queue.Empty):
            requests.append(self.requests.get(timeout=None if until is None else max(0.0, until - clock.monotonic())))
            while True:
                requests.append(self.requests.get_nowait())
        return requests

    def _publish(self, taken: Taken, requests: Sequence[str], fresh: bool, seq: int) -> None:
        """Process a picture and send the result.

        fresh: False: it was processed before, only the requests are new.
        seq: number of the message.
        """
        a, topic = self._activity, self._topic
        commands: list[Command] = [cast(Command, r) for r in requests if r in COMMANDS]
        m, density = a.step(taken, self._controls, commands, fresh)
        if fresh:
            self._history.append([m["time"], m["score"], m["high"], m["low"], m["threshold"], m["phase"]])
        self._topic.post(m | {"seq": seq})  # before the pictures are encoded
        if fresh or "again" in requests:
            topic.picture(DEPTH, seq, taken.time, jpeg(coloured(taken.depth), taken.depth.shape[1], _JPEG_QUALITY))
        if density is not None:
            self._full = max(float(density.max()), _FADING * self._full, _LEAST_FULL)
            topic.picture(MAP, seq, taken.time, map_png(density, self._full))

    def _save(self) -> None:
        """Save the trained model and report it, where anything was learned."""
        if self._lesson is None or (path := self._lesson.save(self._controls)) is None:
            return
        folder, catalog = self._lesson.folder, self._topic.catalog
        model = catalog.id_of("model", path)
        recording = None if folder is None else catalog.id_of("session", folder)
        self._topic.post(
            {"t": "saved", "model": model, "path": f"{path.parent.name}/{path.name}", "recording": recording}
        )


# ---- pictures and lists ----------------------------------------------------------------------------------------------
# Pictures of depth and votes, and lists of sessions, models and sources, for the page.


_SIZE = 96
"""Width and height of the thumbnail, px."""
_HALF_M = 0.22
"""Half side of the shown square at the surface where the gesture is done, m."""
_NEAREST_MM, _FARTHEST_MM = 500, 4200
"""Range of the colours, mm; nearer and farther depths have the colour of the end."""
_JPEG_QUALITY = 75
_FARTHEST_LEVEL = 40
"""Level of the farthest depth in the colour map, of 255; level 0, black, shows holes."""


def coloured(depth: DepthImage) -> NDArray[np.uint8]:
    """Convert a depth picture (h, w) uint16 mm to colours (h, w, 3) BGR, the brighter the nearer; holes are dark."""
    slope = (_FARTHEST_LEVEL - 255) / (_FARTHEST_MM - _NEAREST_MM)
    near = np.clip(depth, _NEAREST_MM, _FARTHEST_MM)
    level = cv2.convertScaleAbs(near, alpha=slope, beta=255 - slope * _NEAREST_MM)
    level[depth == 0] = 0
    return np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO), np.uint8)


def map_png(density: NDArray[np.float32], full: float) -> bytes:
    """Encode a map of voting surface (rows, columns) as PNG; alpha is the share of `full`, the density
    shown as opaque.
    """
    alpha = np.clip(density * (255 / max(full, 1e-12)), 0, 255).astype(np.uint8)
    image = np.empty((*alpha.shape, 4), np.uint8)
    image[..., :3] = (60, 90, 255)
    image[..., 3] = alpha
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def models_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """List the usable gesture models for the page, as JSON values."""
    found = [(item, _facts_of_model(item.path, item.changed)) for item in catalog.items("model")]
    return [
        {"id": item.id, "path": catalog.shown(item.path), "gesture": facts[0], "threshold": facts[1]}
        for item, facts in found
        if facts is not None
    ]


@lru_cache(maxsize=512)
def _facts_of_model(path: Path, changed: float) -> tuple[str, float | None] | None:
    """Return the gesture and the threshold of a model; None where it cannot be used.

    changed: time of its last change, for the cache.
    """
    with contextlib.suppress(HyposeError):
        model = load_model(path)
        return model.name, model.threshold


def sources_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """List the sources of depth pictures for the page, as JSON values; a source that is not available has the key
    "missing".
    """
    people = [
        {"value": f"simulated:{n}", "title": f"Simulated person {n + 1}", "gestures": GESTURES}
        for n in range(len(load_people()))
    ]
    recorded = [
        {
            "value": f"session:{item.id}",
            "title": f"Recorded session {item.path.name}",
            "gestures": _gestures_of(item.path),
        }
        for item in catalog.items("session")
    ]
    camera: dict[str, Any] = {"value": "realsense", "title": "RealSense camera"}
    if importlib.util.find_spec("pyrealsense2") is None:
        camera["missing"] = "The driver is not installed: pip install 'hypose[realsense]'."
    return [*people, *recorded, camera]


def _gestures_of(folder: Path) -> list[str]:
    """Read the names of the gestures of a session; none where it cannot be read."""
    names = None
    with contextlib.suppress(HyposeError, AttributeError):
        names = read_json(folder / "session.json", "a session.json").get("gestures")
    return [str(n) for n in names] if isinstance(names, list) else []


def gesture_thumbnail(model: Path) -> bytes | None:
    """Return a JPEG thumbnail of a gesture: the middle one of the frames that a training session learned the gesture
    from.

    model: path of the model file; its sessions are searched in the same folder, the latest first.
    Returns: None where no session or frame is found.
    """
    learned = load_model(model)
    for entry in reversed(learned.history):
        folder = (
            model.parent / Path(str(entry.get("session", ""))).name
        )  # only its name is used, so that the folder lies next to the model
        if folder == model.parent or not (folder / "session.json").is_file():
            continue
        recording = read_recording(folder)
        shown = [f for f in recording.learned() if f.gesture and recording.gestures[f.gesture - 1] == learned.name]
        if not shown:
            continue
        frame = shown[len(shown) // 2]
        depth = frame.depth()
        z = surface_depth(depth, frame.x, frame.y)
        half = _HALF_M * recording.lens.fx / (2.0 if z is None else z / 1000)
        size = (max(1, round(2 * half)),) * 2
        hand = cv2.getRectSubPix(coloured(depth), size, (frame.x, frame.y))
        return jpeg(np.asarray(cv2.resize(hand, (_SIZE, _SIZE)), np.uint8), _SIZE)
    return None

"""Gesture session of the studio, one per server (docs/studio-protocol.md, /ws/gesture).

A page starts a session (`SessionRequest`). A thread (`Run`) takes pictures at their pace, lets `Training` or `Watching`
process them with the page's requests, reports the results, and saves.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
import time as clock
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from hypose.app.live.gesture_sources import GestureSource, Taken, open_source
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.gesture_training import PHASES, Controls, Training, Watching
from hypose.app.studio.gesture_views import depth_jpeg, map_png
from hypose.app.studio.http import digits, request_choice, request_number, text, whole
from hypose.app.studio.hub import DEPTH, MAP, Hub, Message, Topic
from hypose.app.studio.live_topics import recording_folder
from hypose.errors import HyposeError, InputError
from hypose.gestures.model import check_gesture_name
from hypose.gestures.trainer import COMMANDS, Command, SessionSettings
from hypose.pipeline.gesture_files import load_model

_FOLDER = "gestures"
"""Folder for sessions and models in the served folder."""
ALONE_S = 5.0
"""Time without a page after which a session is paused, s."""
HISTORY = 2000
"""Number of latest frames whose scores a new page receives."""
_SAVE_S = 10.0
_LEAST_FULL, _FADING = 1e-5, 0.95
"""The map of votes shows the highest recent density as opaque: least such density (m^2 of voting surface per cell), and
the factor by which it decreases per map. Why: densities differ with gesture, distance and amount of training.
"""
MOST_GESTURES = 8
"""Most gestures that are taught one after the other."""


@dataclass(frozen=True)
class SessionRequest:
    """Checked request to start a gesture session.

    mode: "train" or "run".
    source: simulated:PERSON, session:ID or realsense.
    gesture: name, for training.
    resume: id of a model to train further.
    settings: of the training.
    models: ids of the models to run.
    then: gestures that are taught next.
    taught: ids of the models taught before; all are tried at the end.
    seed: of random numbers.
    fast: recordings and the simulated person are not slowed down to real time.
    """

    mode: str
    source: str
    gesture: str = ""
    resume: str | None = None
    settings: SessionSettings = SessionSettings()
    models: tuple[str, ...] = ()
    then: tuple[str, ...] = ()
    taught: tuple[str, ...] = ()
    seed: int = 0
    fast: bool = False

    @property
    def live(self) -> bool:
        """Whether a camera delivers the pictures: they arrive by themselves, and the gesture's true place is not known.
        Pictures of other sources are shown at the pace of their times.
        """
        return self.source == "realsense"


def read_start(message: Mapping[str, Any]) -> SessionRequest:
    """Check the start message of a page.

    Raises: InputError names the faulty value.
    """
    mode = request_choice(message.get("mode"), "mode", ("train", "run"))
    source = text(message.get("source"), "source", 80, "choose the simulated person, a recorded session or a camera")
    about = {"seed": whole(message.get("seed", 0), "the seed", 0, 2**32 - 1), "fast": message.get("fast") is True}
    if mode == "run":
        models = message.get("models")
        if not isinstance(models, list) or not 1 <= len(models) <= 16 or not all(isinstance(m, str) for m in models):
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        return SessionRequest("run", source, models=tuple(models), **about)
    gesture, resume = text(message.get("gesture"), "name of the gesture", 64, "type one, for example tee").strip(), None
    if message.get("resume") is not None:
        resume = text(message["resume"], "gesture to go on with", 64, "choose it from the list")
    then = message.get("then") or []
    if not isinstance(then, list) or len(then) > MOST_GESTURES - 1:
        raise InputError(f"At most {MOST_GESTURES} gestures are taught in one session; teach the others in another.")
    names = [gesture, *(text(v, "name of a gesture", 64, "type one, for example ok").strip() for v in then)]
    for name in names:
        check_gesture_name(name)
    if len(set(names)) < len(names):
        raise InputError("A gesture is named twice; name each of them once.")
    seconds, rounds = message.get("seconds") or {}, whole(message.get("rounds", 10), "the number of rounds", 1, 1000)
    if not isinstance(seconds, dict):
        raise InputError("Every phase must be given a number of seconds.")
    given = {f"{p}_s": request_number(seconds[p], f"the seconds of {p}", 0, 600) for p in PHASES if p in seconds}
    settings = SessionSettings(rounds=rounds, **given)
    return SessionRequest("train", source, gesture, resume, settings, then=tuple(names[1:]), **about)


def open_feed(start: SessionRequest, gesture: str, catalog: Catalog) -> GestureSource:
    """Open the source of a request; its name is the title for the page.

    start: the request. Its source is simulated:PERSON, session:ID or realsense. Why no others: a page must not open
        paths.
    gesture: name of the gesture that a simulated person shows.
    catalog: knows the sessions.
    Raises: InputError for other sources.
    """
    kind, _, rest = start.source.partition(":")
    if kind == "simulated":
        person = digits(rest or "0", "the simulated person's number")
        return replace(open_source(f"simulated:{person}", gesture, start.seed), name=f"Simulated person {person + 1}")
    if kind == "session":
        path = catalog.find("session", rest).path
        return _from_zero(open_source(str(path), gesture), f"Recorded session {path.name}")
    if start.live:
        return _from_zero(open_source("realsense"), "RealSense camera")
    raise InputError(f"There is no source {start.source[:40]!r}; choose one of the list.")


def _from_zero(source: GestureSource, name: str) -> GestureSource:
    """Return a source under another name, with times that start at 0."""
    first: list[float] = []

    def take(phase: str) -> Taken | None:
        taken = source.take(phase)
        if taken is None:
            return None
        first.append(taken.time)
        return replace(taken, time=taken.time - first[0])

    return replace(source, name=name, take=take)


def _shut(source: GestureSource) -> None:
    """Close a source and ignore its errors, so that an unplugged camera does not lose a session."""
    with contextlib.suppress(OSError, RuntimeError):
        source.close()


class GestureTopic(Topic):
    """Topic of the gesture session: it is started and watched by pages, and belongs to the server."""

    name = "gesture"

    def __init__(self, hub: Hub, catalog: Catalog) -> None:
        self.hub, self.catalog = hub, catalog
        self._starting = threading.Lock()
        self._run: Run | None = None
        self._closed = False

    @property
    def running(self) -> Run | None:
        """The running session; None without one."""
        return None if self._run is None or self._run.over else self._run

    def hello(self) -> Message:
        """Return the state of the session."""
        run = self.running
        return {"t": "hello", "session": run and run.described()}

    def watched(self, pages: int) -> None:
        """Show the last picture to a new page."""
        if pages and (run := self.running) is not None:
            run.requests.put("again")

    async def heard(self, message: dict[str, Any]) -> None:
        """Start a session, or pass a message to the running one."""
        if message["t"] == "start":
            await asyncio.to_thread(lambda: self._start(read_start(message)))
        elif (run := self.running) is None:
            raise InputError("No session is running; start one.")
        else:
            run.post(message)

    def _start(self, start: SessionRequest) -> None:
        """Start a session.

        start: what was requested.
        Raises: InputError where one is running, or the source, a model or the recording's folder cannot be used.
        """
        with self._starting:
            if self.running is not None:
                raise InputError("A session is running already; stop it first.")
            models = [load_model(self.catalog.find("model", m).path) for m in start.models]
            old = None if start.resume is None else self.catalog.find("model", start.resume).path
            gesture = start.gesture or models[0].name
            source = open_feed(start, gesture, self.catalog)
            try:
                if start.mode == "run":
                    activity: Training | Watching = Watching(source, models)
                else:
                    folder = recording_folder(self.catalog, _FOLDER, gesture)
                    model = old or _free_model(folder.parent, gesture)
                    knows = not start.live
                    activity = Training(source, gesture, start.settings, start.seed, knows, old, folder, model)
            except Exception:
                _shut(source)
                raise
            self._run = Run(start, source, activity, None if old is None else old.stem, self)
            self.hub.post(self.name, self.hello())
            self._run.thread.start()

    def go_on(self, start: SessionRequest, model: str) -> None:
        """Start the session of the next gesture of several, or try all of them after the last. Called by the thread
        that has ended.

        start: request of the session that has ended.
        model: id of the model that it taught.
        """
        taught = (*start.taught, model)
        if self._closed:
            return
        if start.then:
            gesture, *then = start.then
            self._start(replace(start, gesture=gesture, then=tuple(then), taught=taught, resume=None))
        else:
            self._start(replace(start, mode="run", models=taught))

    def close(self) -> None:
        """Stop the session and save everything, when the server ends."""
        self._closed = True
        if (run := self.running) is not None:
            run.requests.put("stop")
            run.thread.join(10)


def _free_model(folder: Path, gesture: str) -> Path:
    """Return the first path for a model of this gesture that does not exist."""
    names = (f"{gesture}{'' if n == 1 else f'-{n}'}.npz" for n in range(1, 10_000))
    return next(folder / name for name in names if not (folder / name).exists())


class Run:
    """Thread of one session.

    start: what was requested.
    source: of the pictures.
    activity: training or watching.
    resumed: name of the model that is trained further, or None.
    topic: its pages get the messages, and its `go_on` is called, in place of the end message, where one of several
        gestures was taught.
    """

    def __init__(
        self,
        start: SessionRequest,
        source: GestureSource,
        activity: Training | Watching,
        resumed: str | None,
        topic: GestureTopic,
    ) -> None:
        self.over = False
        self.requests: queue.SimpleQueue[str] = queue.SimpleQueue()  # commands, "save", "stop", "again", "changed"
        self.thread = threading.Thread(target=self._work, daemon=True)
        self._start, self._source, self._activity, self._resumed, self._topic = start, source, activity, resumed, topic
        self._history: deque[list[Any]] = deque(maxlen=HISTORY)
        self._controls = Controls()
        self._taught = False
        self._full = 0.0  # density that the map shows opaque
        self._packed_ms = 0.0  # time to encode the last pictures

    def described(self) -> dict[str, Any]:
        """Return the SESSION object of the protocol."""
        a = self._activity
        return {
            "mode": self._start.mode,
            "gesture": a.names[0],
            "gestures": a.names,
            "models": list(self._start.models),
            "source": self._start.source,
            "title": self._source.name,
            "size": list(self._source.size),
            **a.reported,
            "folder": None if a.folder is None else f"{a.folder.parent.name}/{a.folder.name}",
            "resumed": self._resumed,
            "then": list(self._start.then),
            "before": len(self._start.taught),
            "history": list(self._history),
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

    def _say(self, message: Message) -> None:
        self._topic.hub.post(GestureTopic.name, message)

    def _work(self) -> None:
        """Run the session until it ends; save, close, and report why it ended, or start the next one."""
        why = "The session was stopped."
        try:
            why = self._loop() or why
        except HyposeError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001 - the thread's end must be reported, and the work saved
            why = f"The session broke off ({type(error).__name__}: {error}); what was recorded is kept."
        model = None
        try:
            model = self._save()
        except (HyposeError, OSError) as error:
            self._say({"t": "error", "error": str(error)})
        self._activity.close()
        _shut(self._source)
        self.over = True
        if self._taught and model is not None:
            try:
                return self._topic.go_on(self._start, model)
            except (HyposeError, OSError) as error:
                why = str(error)
        self._say({"t": "ended", "why": why})

    def _loop(self) -> str | None:
        """Process pictures until the session is stopped or one of several gestures is taught (None), or the source ends
        (the reason).
        """
        a, last, seq, live = self._activity, None, 0, self._start.live
        due = saved = watched = clock.monotonic()  # due: time of the next picture
        while True:
            # a paused recording waits; a camera continues, so that the person sees themselves
            waits = a.paused and not live
            requests = self._wait(None if waits else due)
            if "stop" in requests:
                return None
            now = clock.monotonic()
            watched = now if self._topic.hub.listens(GestureTopic.name) else watched
            if now - watched > ALONE_S and not a.paused:
                requests.append("pause")
            fresh = last is None or not (waits or now < due) or "continue" in requests
            if fresh:
                taken = self._source.take(a.asks)
                if taken is None:
                    return "The recording has ended."
                if not (self._start.fast or live):
                    step = 0.0 if last is None else max(0.0, taken.time - last.time)
                    due = max(due, clock.monotonic() - 0.2) + step
                last = taken
            assert last is not None
            seq += 1
            self._publish(last, requests, fresh, seq)
            if (self._start.then or self._start.taught) and a.asks == "test":
                self._taught = True
                return None
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
        a, hub = self._activity, self._topic.hub
        commands: list[Command] = [cast(Command, r) for r in requests if r in COMMANDS]
        m, density = a.frame(taken, self._controls, commands, fresh)
        if fresh:
            self._history.append([m["time"], m["score"], m["high"], m["low"], m["threshold"], m["phase"]])
        m |= {"seq": seq, "ms": {**m["ms"], "depth": self._packed_ms}}
        if commands:  # answer a click before the pictures are encoded
            self._say(m)
        began = clock.perf_counter()
        if fresh or "again" in requests:
            hub.picture(GestureTopic.name, DEPTH, seq, taken.time, depth_jpeg(taken.depth))
        if density is not None:
            self._full = max(float(density.max()), _FADING * self._full, _LEAST_FULL)
            hub.picture(GestureTopic.name, MAP, seq, taken.time, map_png(density, self._full))
        self._packed_ms = round(1e3 * (clock.perf_counter() - began), 2)
        if not commands:
            self._say(m)
        judged = a.judged(taken.time, self._controls)
        if judged is not None:
            self._say(judged)

    def _save(self) -> str | None:
        """Save the trained model and return its id; None where nothing was trained."""
        path, folder, catalog = self._activity.save(self._controls), self._activity.folder, self._topic.catalog
        if path is None:
            return None
        model = catalog.id_of("model", path)
        recording = None if folder is None else catalog.id_of("session", folder)
        self._say({"t": "saved", "model": model, "path": f"{path.parent.name}/{path.name}", "recording": recording})
        return model

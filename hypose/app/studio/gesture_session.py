"""Gesture session of the studio, one per server (docs/studio-protocol.md, /ws/gesture).

A page starts a session. A thread (`Run`) takes pictures at their pace, lets `Training` or `Watching` process them with
the page's requests, reports the results, and saves.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
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
_Make = Callable[[GestureSource], Training | Watching]


def open_feed(where: str, gesture: str, seed: int, catalog: Catalog) -> GestureSource:
    """Open a source; its name is the title for the page.

    where: simulated:PERSON, session:ID or realsense. Why no others: a page must not open paths.
    gesture, seed: gesture and seed of a simulated person.
    catalog: items of the served folder, among them the sessions.
    Raises: InputError for other sources.
    """
    kind, _, rest = where.partition(":")
    if kind == "simulated":
        person = digits(rest or "0", "the simulated person's number")
        return replace(open_source(f"simulated:{person}", gesture, seed), name=f"Simulated person {person + 1}")
    if kind == "session":
        path = catalog.find("session", rest).path
        return replace(open_source(str(path), gesture), name=f"Recorded session {path.name}")
    if where == _CAMERA:
        return replace(open_source(_CAMERA), name="RealSense camera")
    raise InputError(f"There is no source {where[:40]!r}; choose one of the list.")


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

    @property
    def running(self) -> Run | None:
        """The running session; None without one."""
        return None if self._run is None or self._run.over else self._run

    def hello(self) -> Message:
        """Return the state of the session."""
        run = self.running
        return {"t": "hello", "session": run and run.described()}

    def watched(self, pages: int) -> None:
        """Send the last picture again when the number of watching pages changes."""
        if pages and (run := self.running) is not None:
            run.requests.put("again")

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
            gesture, make = (self._watching if mode == "run" else self._training)(message, where, seed)
            source = open_feed(where, gesture, seed, self.catalog)
            try:
                activity = make(source)
            except Exception:
                _shut(source)
                raise
            self._run = Run(message, source, activity, self)
            self.hub.post(self.name, self.hello())
            self._run.thread.start()

    def _watching(self, message: Message, where: str, seed: int) -> tuple[str, _Make]:
        """Read a request to watch for the gestures of models; arguments and result as of `_training`."""
        ids = message.get("models")
        if not isinstance(ids, list) or not 1 <= len(ids) <= 16:
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        models = [load_model(self.catalog.find("model", m).path) for m in ids]
        return models[0].name, partial(Watching, models=models)

    def _training(self, message: Message, where: str, seed: int) -> tuple[str, _Make]:
        """Read a request to teach a gesture.

        where: its source.
        seed: seed of random numbers.
        Returns: the name of the gesture, and the function that makes the activity from the source.
        """
        gesture = text(message.get("gesture"), "name of the gesture", 64, "type one, for example tee").strip()
        check_gesture_name(gesture)
        rounds, seconds = (
            whole(message.get("rounds", 10), "the number of rounds", 1, 1000),
            message.get("seconds") or {},
        )
        if not isinstance(seconds, dict):
            raise InputError("Every phase must be given a number of seconds.")
        given = {f"{p}_s": request_number(seconds[p], f"the seconds of {p}", 0, 600) for p in PHASES if p in seconds}
        resumed = message.get("resume")
        old = None if resumed is None else self.catalog.find("model", resumed).path

        def make(source: GestureSource) -> Training:
            folder = recording_folder(self.catalog, _FOLDER, gesture)
            names = (f"{gesture}{'' if n == 1 else f'-{n}'}.npz" for n in range(1, 10_000))
            model = old or next(folder.parent / name for name in names if not (folder.parent / name).exists())
            settings = SessionSettings(rounds=rounds, **given)
            return Training(source, gesture, settings, seed, where != _CAMERA, old, folder, model)

        return gesture, make

    def close(self) -> None:
        """Stop the session and save everything, when the server ends."""
        if (run := self.running) is not None:
            run.requests.put("stop")
            run.thread.join(10)


class Run:
    """Thread of one session.

    request: what the page requested; `fast`: recordings and simulated persons are not slowed down to real time.
    source: source of the pictures.
    activity: training or watching.
    topic: its pages get the messages.
    """

    def __init__(
        self, request: Message, source: GestureSource, activity: Training | Watching, topic: GestureTopic
    ) -> None:
        self.over = False
        self.requests: queue.SimpleQueue[str] = queue.SimpleQueue()  # commands, "save", "stop", "again", "changed"
        self.thread = threading.Thread(target=self._work, daemon=True)
        self._source, self._activity, self._topic = source, activity, topic
        self._live, self._fast = request["source"] == _CAMERA, request.get("fast") is True
        self._request = {"models": [], "resume": None, **request}
        self._history: deque[list[Any]] = deque(maxlen=HISTORY)
        self._judged: dict[str, Any] | None = None
        self._controls = Controls()
        self._full = 0.0  # density that the map shows opaque
        self._packed_ms = 0.0  # time to encode the last pictures

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

    def _say(self, message: Message) -> None:
        self._topic.hub.post(GestureTopic.name, message)

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
            self._say({"t": "error", "error": str(error)})
        self._activity.close()
        _shut(self._source)
        self.over = True
        self._say({"t": "ended", "why": why})

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
            watched = now if self._topic.hub.listens(GestureTopic.name) else watched
            if now - watched > ALONE_S and not a.paused:
                requests.append("pause")
            fresh = last is None or not (waits or now < due) or "continue" in requests
            if fresh:
                taken = self._source.take(a.asks)
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
            if clock.monotonic() - judged > _JUDGE_S and (found := a.judged()) is not None:
                self._judged, judged = found, clock.monotonic()
                self._say(found)
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
        self._say(m | {"seq": seq, "ms": {**m["ms"], "depth": self._packed_ms}})  # before the pictures are encoded
        began = clock.perf_counter()
        if fresh or "again" in requests:
            hub.picture(GestureTopic.name, DEPTH, seq, taken.time, depth_jpeg(taken.depth))
        if density is not None:
            self._full = max(float(density.max()), _FADING * self._full, _LEAST_FULL)
            hub.picture(GestureTopic.name, MAP, seq, taken.time, map_png(density, self._full))
        self._packed_ms = round(1e3 * (clock.perf_counter() - began), 2)

    def _save(self) -> None:
        """Save the trained model and report it, where anything was learned."""
        path, folder, catalog = self._activity.save(self._controls), self._activity.folder, self._topic.catalog
        if path is None:
            return
        model = catalog.id_of("model", path)
        recording = None if folder is None else catalog.id_of("session", folder)
        self._say({"t": "saved", "model": model, "path": f"{path.parent.name}/{path.name}", "recording": recording})

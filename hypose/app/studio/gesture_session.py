"""Gesture session of the studio, one per server (docs/studio-protocol.md, /ws/gesture).

A thread takes pictures at their pace, processes them with the page's requests, reports the results, and saves.
"""

from __future__ import annotations

import asyncio
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hypose.app.live.gesture_sources import Taken
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.gesture_start import Controls, SessionRequest, change, open_feed, read_command, read_start, shut
from hypose.app.studio.gesture_training import Training, Watching
from hypose.app.studio.gesture_views import depth_jpeg, map_png
from hypose.app.studio.hub import DEPTH, MAP, Hub, Message, Topic
from hypose.app.studio.live_topics import recording_folder
from hypose.errors import HyposeError, InputError
from hypose.gestures.model import check_gesture_name
from hypose.gestures.trainer import Command
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


class GestureTopic(Topic):
    """Topic of the gesture session: it is started and watched by pages, and paused 5 s after the last page has left."""

    name = "gesture"

    def __init__(self, hub: Hub, catalog: Catalog) -> None:
        self._hub, self._catalog = hub, catalog
        self._lock = threading.RLock()
        self._run: Run | None = None
        self._alone: threading.Timer | None = None
        self._closed = False

    def hello(self) -> Message:
        """Return the state of the session."""
        with self._lock:
            return {"t": "hello", "session": self._run.described() if self.runs and self._run else None}

    @property
    def runs(self) -> bool:
        """Whether a session is running."""
        return self._run is not None and not self._run.over

    def watched(self, pages: int) -> None:
        """Resume pictures for a new page, or start the timer that pauses the session without pages."""
        with self._lock:
            if self._alone is not None:
                self._alone.cancel()
            if self._run is None or self._run.over:
                return
            if pages:
                self._run.again()
            else:
                self._alone = threading.Timer(ALONE_S, self._run.post, [{"t": "command", "command": "pause"}])
                self._alone.daemon = True
                self._alone.start()

    async def heard(self, message: dict[str, Any]) -> None:
        """Start a session, or pass a message to the running one."""
        if message["t"] == "start":
            await asyncio.to_thread(lambda: self._start(read_start(message)))
        elif self._run is None or self._run.over:
            raise InputError("No session is running; start one.")
        else:
            self._run.post(message)

    def _start(self, start: SessionRequest) -> None:
        with self._lock:
            if self.runs:
                raise InputError("A session is running already; stop it first.")
            self._run = None
            old = self._model(start.resume) if start.resume is not None else None
            models = [load_model(self._model(m)) for m in start.models]
            gesture = start.gesture or models[0].names[0]
            feed = open_feed(start, gesture, lambda id: self._catalog.find("session", id).path)
            try:
                if start.mode == "run":
                    activity: Training | Watching = Watching(feed, models)
                else:
                    check_gesture_name(gesture)
                    folder = recording_folder(self._catalog, _FOLDER, gesture)
                    activity = Training(start, feed, old, folder, old or _free_model(folder.parent, gesture))
            except Exception:
                shut(feed)
                raise
            resumed = old.stem if old is not None else None
            self._run = Run(start, activity, resumed, self._catalog, self._hub, partial(self._go_on, start))
            self._hub.post(self.name, self.hello())
            self._run.begin()

    def _model(self, id: str) -> Path:
        return self._catalog.find("model", id).path

    def _go_on(self, start: SessionRequest, model: str) -> None:
        """Start the session of the next gesture of several, or try all of them after the last. Called by the thread
        that has ended.
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
        with self._lock:
            self._closed = True
            if self._alone is not None:
                self._alone.cancel()
        if self._run is not None:
            self._run.stop()


def _free_model(folder: Path, gesture: str) -> Path:
    """Return the first path for a model of this gesture that does not exist."""
    names = (f"{gesture}{'' if n == 1 else f'-{n}'}.npz" for n in range(1, 10_000))
    return next(folder / name for name in names if not (folder / name).exists())


class Run:
    """Thread of one session.

    activity: training or watching.
    resumed: name of the model that is trained further.
    after: called with the id of the model, in place of the end message, where one of several gestures was taught.
    """

    def __init__(
        self,
        start: SessionRequest,
        activity: Training | Watching,
        resumed: str | None,
        catalog: Catalog,
        hub: Hub,
        after: Callable[[str], None],
    ) -> None:
        self.over = False
        self._after, self._taught = after, False
        self._start, self._activity, self._resumed = start, activity, resumed
        self._catalog, self._hub = catalog, hub
        self._history: deque[list[Any]] = deque(maxlen=HISTORY)
        self._news = threading.Condition()
        self._commands: list[Command] = []
        self._controls = Controls()
        self._changed, self._save, self._stop = False, False, False
        self._newcomer = False  # a new page has no picture yet
        self._full = 0.0  # density that the map shows opaque
        self._packed_ms = 0.0  # time to encode the last pictures
        self._thread = threading.Thread(target=self._work, daemon=True)

    def begin(self) -> None:
        """Start the thread."""
        self._thread.start()

    def described(self) -> dict[str, Any]:
        """Return the SESSION object of the protocol."""
        a = self._activity
        return {
            "mode": self._start.mode,
            "gesture": a.names[0],
            "gestures": a.names,
            "models": list(self._start.models),
            "source": self._start.source,
            "title": a.feed.title,
            "size": list(a.feed.source.size),
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
        with self._news:
            kind = message.get("t")
            if kind == "save":
                self._save = True
            elif kind == "stop":
                self._stop = True
            elif change(self._controls, message, self._activity.feed.source.size):
                self._changed = True
            else:
                self._commands.append(read_command(message))
            self._news.notify()

    def again(self) -> None:
        """Show the last picture again, for a page that has just connected."""
        with self._news:
            self._changed = self._newcomer = True
            self._news.notify()

    def stop(self) -> None:
        """Stop the session and save everything."""
        self.post({"t": "stop"})
        if self._thread.is_alive():
            self._thread.join(10)

    def _say(self, message: Message) -> None:
        self._hub.post(GestureTopic.name, message)

    def _work(self) -> None:
        a, why = self._activity, "The session was stopped."
        try:
            why = self._loop() or why
        except HyposeError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001 - the thread's end must be reported, and the work saved
            why = f"The session broke off ({type(error).__name__}: {error}); what was recorded is kept."
        model = None
        try:
            model = self._saved()
        except (HyposeError, OSError) as error:
            self._say({"t": "error", "error": str(error)})
        a.close()
        shut(a.feed)
        self.over = True
        if self._taught and model is not None:
            try:
                return self._after(model)
            except (HyposeError, OSError) as error:
                why = str(error)
        self._say({"t": "ended", "why": why})

    def _loop(self) -> str | None:
        """Process pictures until the session is stopped or one of several gestures is taught (None), or the source ends
        (the reason).
        """
        a, last, seq = self._activity, None, 0
        behind = saved = clock.monotonic()  # behind: time at which the next picture is due
        while True:
            # a paused recording waits; a camera continues, so that the person sees themselves
            waits = a.paused and not a.feed.live
            commands, stop, save = self._wait(None if waits else behind)
            if stop:
                return None
            fresh = last is None or not (waits or clock.monotonic() < behind) or "continue" in commands
            if fresh:
                taken = a.feed.source.take(a.asks)
                if taken is None:
                    return "The recording has ended."
                if not (self._start.fast or a.feed.live):
                    step = 0.0 if last is None else max(0.0, taken.time - last.time)
                    behind = max(behind, clock.monotonic() - 0.2) + step
                last = taken
            assert last is not None
            seq += 1
            self._publish(last, commands, fresh, seq)
            if (self._start.then or self._start.taught) and a.asks == "test":
                self._taught = True
                return None
            if save or clock.monotonic() - saved > _SAVE_S:
                self._saved()
                saved = clock.monotonic()

    def _wait(self, until: float | None) -> tuple[list[Command], bool, bool]:
        """Wait for requests of the page until a time (None: without limit); return commands, and whether to stop and to
        save.
        """
        with self._news:
            while not (self._commands or self._changed or self._stop or self._save):
                left = None if until is None else until - clock.monotonic()
                if left is not None and left <= 0:
                    break
                self._news.wait(left)
            out = (self._commands, self._stop, self._save)
            self._commands, self._changed, self._save = [], False, False
        return out

    def _publish(self, taken: Taken, commands: list[Command], fresh: bool, seq: int) -> None:
        a = self._activity
        m, density = a.frame(taken, self._controls, commands, fresh)
        if fresh:
            self._history.append([m["time"], m["score"], m["high"], m["low"], m["threshold"], m["phase"]])
        m |= {"seq": seq, "ms": {**m["ms"], "depth": self._packed_ms}}
        if commands:  # answer a click before the pictures are encoded
            self._say(m)
        began = clock.perf_counter()
        with self._news:
            newcomer, self._newcomer = self._newcomer, False
        if fresh or newcomer:
            self._hub.picture(GestureTopic.name, DEPTH, seq, taken.time, depth_jpeg(taken.depth))
        if density is not None:
            self._full = max(float(density.max()), _FADING * self._full, _LEAST_FULL)
            self._hub.picture(GestureTopic.name, MAP, seq, taken.time, map_png(density, self._full))
        self._packed_ms = round(1e3 * (clock.perf_counter() - began), 2)
        if not commands:
            self._say(m)
        judged = a.judged(taken.time, self._controls)
        if judged is not None:
            self._say(judged)

    def _saved(self) -> str | None:
        """Save the trained model and return its id; None where nothing was trained."""
        path, folder = self._activity.save(self._controls), self._activity.folder
        if path is None:
            return None
        model = self._catalog.id_of("model", path)
        recording = None if folder is None else self._catalog.id_of("session", folder)
        shown = f"{path.parent.name}/{path.name}"
        self._say({"t": "saved", "model": model, "path": shown, "recording": recording})
        return model

"""The one gesture session of the studio, which belongs to the server: docs/studio-protocol.md, /ws/gesture.

It runs in a thread of its own and speaks to pages through outlets, so it knows nothing of sockets: the server hands it
the messages of a page (`handle`), and puts what comes out (`Outlet`) on the wire, with acknowledgement and dropping.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from hypose.app.studio.gesture_controls import Start, read_start
from hypose.app.studio.gesture_feed import open_feed, shut
from hypose.app.studio.gesture_run import Run
from hypose.app.studio.gesture_train import Training
from hypose.app.studio.gesture_watch import Watching
from hypose.app.studio.live_socket import recording_folder
from hypose.errors import InputError
from hypose.gestures.model import check_gesture_name
from hypose.pipeline.gesture_files import load_model

ALONE_S = 5.0
"""s without a page after which a session is paused."""


class Outlet(Protocol):
    """A page that listens. Both are called from the session's thread and must not wait."""

    def text(self, message: Mapping[str, Any], /) -> None:
        """A JSON message of the protocol; never dropped."""
        ...

    def picture(self, message: bytes, /) -> None:
        """A binary message of the protocol; dropped when the page has not answered the last ones."""
        ...


@dataclass(frozen=True)
class Places:
    """Where files lie. gestures: folder to write sessions and models to; model, session: the path of an id (an
    InputError when there is none); identify: the id of a model's or a session's path."""

    gestures: Path
    model: Callable[[str], Path]
    session: Callable[[str], Path]
    identify: Callable[[Path], str]


class GestureRoom:
    """handle, join and leave may be called from any thread."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self._lock = threading.RLock()
        self._outlets: list[Outlet] = []
        self._run: Run | None = None
        self._alone: threading.Timer | None = None
        self._closed = False

    def join(self, outlet: Outlet) -> None:
        """A page has come: it gets hello, and then everything."""
        with self._lock:
            if self._alone is not None:
                self._alone.cancel()
            run = self._run
            outlet.text({"t": "hello", "session": None if run is None or run.over else run.described()})
            self._outlets.append(outlet)
            if run is not None:
                run.again()

    def leave(self, outlet: Outlet) -> None:
        """A page has gone; without any, a session is paused after 5 s."""
        with self._lock:
            if outlet in self._outlets:
                self._outlets.remove(outlet)
            if not self._outlets and self._run is not None and not self._run.over:
                self._alone = threading.Timer(ALONE_S, self._pause_alone)
                self._alone.daemon = True
                self._alone.start()

    def _pause_alone(self) -> None:
        with self._lock:
            if not self._outlets and self._run is not None:
                self._run.post({"t": "command", "command": "pause"})

    def handle(self, message: Mapping[str, Any]) -> None:
        """A message of a page, except ack; an InputError is for that page."""
        if message.get("t") == "start":
            self._start(read_start(message))
            return
        with self._lock:
            run = self._run
        if run is None or run.over:
            raise InputError("No session is running; start one.")
        run.post(message)

    def _go_on(self, start: Start, model: str) -> None:
        """A gesture of several is taught: the next one, or all of them tried. Called by the thread that has ended."""
        taught = (*start.taught, model)
        if self._closed:
            return
        if start.then:
            gesture, *then = start.then
            self._start(replace(start, gesture=gesture, then=tuple(then), taught=taught, resume=None))
        else:
            self._start(replace(start, mode="run", models=taught))

    def _start(self, start: Start) -> None:
        with self._lock:
            if self._run is not None and not self._run.over:
                raise InputError("A session is running already; stop it first.")
            self._run = None
            old = self._places.model(start.resume) if start.resume is not None else None
            models = [load_model(self._places.model(m)) for m in start.models]
            gesture = start.gesture or models[0].names[0]
            feed = open_feed(start.source, gesture, start.seed, self._places.session)
            try:
                if start.mode == "run":
                    activity: Training | Watching = Watching(feed, models)
                else:
                    folder, fresh = _free(self._places.gestures, gesture)
                    activity = Training(start, feed, old, folder, old or fresh)
            except Exception:
                shut(feed)
                raise
            resumed = old.stem if old is not None else None
            go_on = partial(self._go_on, start)
            self._run = Run(start, activity, resumed, self._places.identify, self._say, self._show, go_on)
            self._say({"t": "hello", "session": self._run.described()})
            self._run.begin()

    def _say(self, message: Mapping[str, Any]) -> None:
        with self._lock:
            for outlet in self._outlets:
                outlet.text(message)

    def _show(self, message: bytes) -> None:
        with self._lock:
            for outlet in self._outlets:
                outlet.picture(message)

    def close(self) -> None:
        """Stop the session with everything saved (the server ends)."""
        with self._lock:
            self._closed = True
            run, self._outlets = self._run, []
            if self._alone is not None:
                self._alone.cancel()
        if run is not None:
            run.stop()


def _free(folder: Path, gesture: str) -> tuple[Path, Path]:
    """A new folder for the recording of a gesture, and a new model file."""

    check_gesture_name(gesture)
    names = (f"{gesture}{'' if n == 1 else f'-{n}'}.npz" for n in range(1, 10_000))
    return recording_folder(folder, gesture), next(p for name in names if not (p := folder / name).exists())

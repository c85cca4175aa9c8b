"""The thread of a gesture session: takes pictures at their pace, hands them on with what the page asked for, saves."""

from __future__ import annotations

import threading
import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hypose.app.live.gesture_sources import Taken
from hypose.app.studio.gesture_controls import Controls, Start, change, read_command
from hypose.app.studio.gesture_feed import shut
from hypose.app.studio.gesture_pictures import depth_picture, map_picture
from hypose.app.studio.gesture_train import Training
from hypose.app.studio.gesture_watch import Watching
from hypose.errors import HyposeError
from hypose.gestures.session import Command

HISTORY = 2000
"""Frames whose scores a page that comes later gets."""
_SAVE_S = 10.0
_LEAST_FULL, _FADING = 1e-5, 0.95
"""The map shows opaque the highest density of late (m^2 of voting surface per cell; how it sinks from one map to the
next), and at least this: how dense votes lie is another matter with every gesture, distance and amount of teaching."""


class Run:
    """say gets messages, show pictures; both from this thread. after: called instead of the last word when one of
    several gestures is taught, with the id of its model."""

    def __init__(
        self,
        start: Start,
        activity: Training | Watching,
        resumed: str | None,
        identify: Callable[[Path], str],
        say: Callable[[Mapping[str, Any]], None],
        show: Callable[[bytes], None],
        after: Callable[[str], None],
    ) -> None:
        self.over = False
        self._after, self._taught = after, False
        self._start, self._activity, self._resumed = start, activity, resumed
        self._identify, self._say, self._show = identify, say, show
        self._history: deque[list[Any]] = deque(maxlen=HISTORY)
        self._news = threading.Condition()
        self._commands: list[Command] = []
        self._controls = Controls()
        self._changed, self._save, self._stop = False, False, False
        self._newcomer = False  # a page has come that has no picture yet
        self._full = 0.0  # density that the map shows opaque
        self._packed_ms = 0.0  # that the last pictures took to pack
        self._thread = threading.Thread(target=self._work, daemon=True)

    def begin(self) -> None:
        """Start the thread."""
        self._thread.start()

    def described(self) -> dict[str, Any]:
        """SESSION of the protocol."""
        a = self._activity
        names = a.names if isinstance(a, Watching) else [self._start.gesture]
        return {
            "mode": self._start.mode,
            "gesture": names[0],
            "gestures": names,
            "models": list(self._start.models),
            "source": self._start.source,
            "title": a.feed.title,
            "size": list(a.feed.source.size),
            **a.told,
            "folder": None if a.folder is None else f"{a.folder.parent.name}/{a.folder.name}",
            "resumed": self._resumed,
            "then": list(self._start.then),
            "before": len(self._start.taught),
            "history": list(self._history),
        }

    def post(self, message: Mapping[str, Any]) -> None:
        """A message of a page; InputError when it cannot be."""
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
        """Show the last picture once more, to a page that has just come."""
        with self._news:
            self._changed = self._newcomer = True
            self._news.notify()

    def stop(self) -> None:
        """End it, with everything saved."""
        with self._news:
            self._stop = True
            self._news.notify()
        if self._thread.is_alive():
            self._thread.join(10)

    def _work(self) -> None:
        a, why = self._activity, "The session was stopped."
        try:
            why = self._loop() or why
        except HyposeError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001 - the thread's end must be told, and the work saved
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
        """Until it is stopped, or one of several gestures is taught (None), or the source ends (why)."""
        a, last, seq = self._activity, None, 0
        behind = clock.monotonic()  # the moment at which a picture of time 0 is due
        saved = clock.monotonic()
        while True:
            # a paused recording waits; a camera goes on, so that the person sees where they stand
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
            if last is None:
                continue
            seq += 1
            self._publish(last, commands, fresh, seq)
            if (self._start.then or self._start.taught) and a.asks == "test":
                self._taught = True
                return None
            if save or clock.monotonic() - saved > _SAVE_S:
                self._saved()
                saved = clock.monotonic()

    def _wait(self, until: float | None) -> tuple[list[Command], bool, bool]:
        """What the page asked for meanwhile, as soon as it does; None: nothing happens before."""
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
        shown = a.frame(taken, self._controls, commands, fresh)
        m = shown.message
        if fresh:
            self._history.append([m["time"], m["score"], m["high"], m["low"], m["threshold"], m["phase"]])
        m["ms"]["depth"] = self._packed_ms
        if commands:  # the answer to a click does not wait until pictures are packed
            self._say({**m, "seq": seq})
        began = clock.perf_counter()
        with self._news:
            newcomer, self._newcomer = self._newcomer, False
        if fresh or newcomer:
            self._show(depth_picture(taken.depth, seq, taken.time))
        if shown.density is not None:
            self._full = max(float(shown.density.max()), _FADING * self._full, _LEAST_FULL)
            self._show(map_picture(shown.density, seq, taken.time, self._full))
        self._packed_ms = round(1e3 * (clock.perf_counter() - began), 2)
        if not commands:
            self._say({**m, "seq": seq})
        judged = a.judged(taken.time, self._controls)
        if judged is not None:
            self._say(judged)

    def _saved(self) -> str | None:
        """Save what was taught; the id of the model."""
        path = self._activity.save(self._controls)
        if path is None:
            return None
        folder, model = self._activity.folder, self._identify(path)
        self._say(
            {
                "t": "saved",
                "model": model,
                "path": f"{path.parent.name}/{path.name}",
                "recording": None if folder is None else self._identify(folder),
            }
        )
        return model

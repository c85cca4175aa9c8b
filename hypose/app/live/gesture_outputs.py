"""Where the events of gestures go: JSON lines, OSC, WebSocket, commands of this computer."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from typing import Protocol

from hypose.app.jobs.gesture_job import Watched
from hypose.app.live.osc import OscTarget, osc_message
from hypose.app.live.servers import SocketListeners
from hypose.errors import InputError
from hypose.gestures.events import Event

MOST_COMMANDS = 8
"""That run at a time; what a gesture would set off beyond them is left out."""
WAITING = 256
"""Texts that wait for a slow listener."""


def event_line(event: Event, names: Sequence[str]) -> str:
    """One JSON line of an event."""
    value = {
        "event": event.kind,
        "gesture": names[event.gesture - 1],
        "time": round(event.time, 4),
        "x": round(event.x, 1),
        "y": round(event.y, 1),
        "position": None if event.position is None else [round(float(v), 4) for v in event.position],
        "score": round(event.score, 3),
    }
    return json.dumps(value)


class Out(Protocol):
    """Takes every frame that was looked at."""

    def send(self, watched: Watched, /) -> None:
        """One frame."""
        ...

    def close(self) -> None:
        """The end."""
        ...


class OscOut:
    """Sends every frame by OSC: /gesture/NAME score x y z, /gesture/NAME/start and /end, and Wekinator's /wek/outputs
    (each gesture's score over its threshold, at most 1)."""

    def __init__(self, target: str, names: Sequence[str], limits: Sequence[float]) -> None:
        self._target = OscTarget(target)
        self._names, self._limits = list(names), list(limits)

    def send(self, watched: Watched) -> None:
        """One frame."""
        messages = []
        for f in watched.found:
            p = (0.0, 0.0, 0.0) if f.position is None else tuple(float(v) for v in f.position)
            messages.append(osc_message(f"/gesture/{self._names[f.gesture - 1]}", float(f.score), *p))
        for e in watched.events:
            messages.append(osc_message(f"/gesture/{self._names[e.gesture - 1]}/{e.kind}", float(e.score)))
        shares = [min(1.0, f.score / limit) for f, limit in zip(watched.found, self._limits, strict=True)]
        messages.append(osc_message("/wek/outputs", *shares))
        self._target.send(messages)

    def close(self) -> None:
        """Let go of the socket."""
        self._target.close()


class WebSocketOut:
    """Sends JSON text to whoever connects to ws://127.0.0.1:PORT: every event as on stdout, and every frame
    {"time", "scores": {name: cm^2}}; see `SocketListeners`."""

    def __init__(self, port: int, names: Sequence[str]) -> None:
        self._names, self._listeners = list(names), SocketListeners(port, WAITING)

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._listeners.port

    def send(self, watched: Watched) -> None:
        """One frame."""
        scores = {self._names[f.gesture - 1]: round(f.score, 3) for f in watched.found}
        self._listeners.post(json.dumps({"time": round(watched.time, 4), "scores": scores}))
        for e in watched.events:
            self._listeners.post(event_line(e, self._names))

    def close(self) -> None:
        """Stop listening, after what was sent."""
        self._listeners.close()


class CommandOut:
    """Runs a command when a gesture starts, {gesture} in it replaced by its name; with {event} in it, at ends too
    (start, end). No shell reads it; it is not waited for."""

    def __init__(self, text: str, names: Sequence[str]) -> None:
        try:
            self._words = shlex.split(text, posix=os.name != "nt")
        except ValueError as error:
            raise InputError(f"--command {text!r} cannot be read ({error}); close its quotes.") from None
        if not self._words or shutil.which(self._words[0]) is None:
            raise InputError(f"--command {text!r}: there is no such program; give one that runs in this terminal.")
        self._names, self._ends = list(names), "{event}" in text
        # the user's own program imports what lies beside it
        self._environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
        self._running: list[subprocess.Popen[bytes]] = []

    def send(self, watched: Watched) -> None:
        """One frame."""
        self._running = [p for p in self._running if p.poll() is None]
        for e in watched.events:
            if (e.kind == "start" or self._ends) and len(self._running) < MOST_COMMANDS:
                name = self._names[e.gesture - 1]
                words = [w.replace("{gesture}", name).replace("{event}", e.kind) for w in self._words]
                nowhere = subprocess.DEVNULL
                self._running.append(subprocess.Popen(words, stdin=nowhere, stdout=nowhere, env=self._environment))

    def close(self) -> None:
        """What still runs goes on by itself."""

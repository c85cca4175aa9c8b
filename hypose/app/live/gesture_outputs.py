"""Where events go: JSON lines, OSC, WebSocket. What they set off on this computer: gesture_actions.py."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Protocol

from hypose.app.jobs.gesture_job import Watched
from hypose.app.live.osc import OscTarget, osc_message
from hypose.app.live.socket_listeners import SocketListeners
from hypose.gestures.events import Event

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

"""Where events go: JSON lines, OSC, WebSocket. What they set off on this computer: gesture_actions.py."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from typing import Any, Protocol, TypeVar

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from hypose.app.jobs.gesture_job import Watched
from hypose.app.live.door import Door, fold_logs
from hypose.app.live.osc import OscTarget, osc_message
from hypose.errors import InputError
from hypose.gestures.events import Event

T = TypeVar("T")
MAX_LISTENERS = 16
WAITING = 256
"""Texts that wait for a slow listener."""
_LOCAL = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")


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
    {"time", "scores": {name: cm^2}}. Listens on this computer alone, to programs and to pages of this computer."""

    def __init__(self, port: int, names: Sequence[str]) -> None:
        if not 0 <= port < 65536:
            raise InputError(f"--ws {port} is no port; give 0 (any free one) to 65535.")
        self._names, self._waiting = list(names), set[asyncio.Queue[str | None]]()
        self._door, self._loop = Door(), asyncio.new_event_loop()
        fold_logs()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        try:
            self._server = self._in_loop(self._open(port))
        except OSError as error:
            self._end_loop()
            raise InputError(f"Port {port} cannot be used ({(error.strerror or str(error)).lower()}).") from None

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return int(next(iter(self._server.sockets)).getsockname()[1])

    def send(self, watched: Watched) -> None:
        """One frame. A listener that is too slow loses the oldest texts; nobody is waited for."""
        scores = {self._names[f.gesture - 1]: round(f.score, 3) for f in watched.found}
        self._post(json.dumps({"time": round(watched.time, 4), "scores": scores}))
        for e in watched.events:
            self._post(event_line(e, self._names))

    def close(self) -> None:
        """Stop listening, after what was sent."""
        self._post(None)
        self._in_loop(self._close())
        self._end_loop()

    def _in_loop(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _post(self, text: str | None) -> None:
        self._loop.call_soon_threadsafe(self._put, text)

    # ---- in the loop ----

    async def _open(self, port: int) -> Server:
        return await serve(
            self._listen,
            "127.0.0.1",
            port,
            origins=[None, _LOCAL],
            compression=None,
            max_size=1 << 16,
            open_timeout=5,
            close_timeout=1,
            create_connection=self._door.letting_in(ServerConnection),  # type: ignore[arg-type] - as any factory
            backlog=self._door.backlog,
        )

    async def _close(self) -> None:
        for _ in range(100):  # listeners take what waits for them, if they take anything
            if not self._waiting:
                break
            await asyncio.sleep(0.02)
        self._server.close()
        await self._server.wait_closed()

    async def _listen(self, connection: ServerConnection) -> None:
        if len(self._waiting) >= MAX_LISTENERS:
            await connection.close(1013, "too many listeners")
            return
        texts: asyncio.Queue[str | None] = asyncio.Queue(WAITING)
        self._waiting.add(texts)
        try:
            with self._door.answering(connection.remote_address, True), suppress(ConnectionClosed):
                while (text := await texts.get()) is not None:
                    await connection.send(text)
        finally:
            self._waiting.discard(texts)

    def _put(self, text: str | None) -> None:
        for texts in self._waiting:
            if texts.full():
                texts.get_nowait()
            texts.put_nowait(text)

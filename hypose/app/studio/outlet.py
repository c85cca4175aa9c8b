"""One page's end of a WebSocket that a thread speaks to: messages in order, pictures only when the page keeps up."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from starlette.websockets import WebSocket

from hypose.app.studio.asked import whole
from hypose.app.studio.sockets import IN_FLIGHT, hear, tell
from hypose.app.studio.view_bundle import plain
from hypose.errors import HyposeError

_MOST_WAITING = 512
"""Messages that wait for a page; one that reads nothing at all is sent away."""


class SocketOutlet:
    """text and picture may be called from any thread and never wait; `talk` runs in the server's loop.

    A picture that comes while IN_FLIGHT are unanswered takes the place of the one that waits of its kind, so a slow
    page sees the newest and nobody waits for it."""

    def __init__(self, ws: WebSocket) -> None:
        self._ws, self._loop = ws, asyncio.get_running_loop()
        self._texts: deque[str] = deque()
        self._pictures: dict[int, bytes] = {}
        self._unanswered: set[int] = set()
        self._awake = asyncio.Event()
        self._full = False

    def text(self, message: Mapping[str, Any], /) -> None:
        """A JSON message; never dropped."""
        text = json.dumps(plain(message), separators=(",", ":"))
        self._later(lambda: self._put(text))

    def picture(self, message: bytes, /) -> None:
        """A binary message; dropped when the page has not answered the last ones."""
        self._later(lambda: self._keep(message))

    async def talk(self, handle: Callable[[dict[str, Any]], None]) -> None:
        """Send what comes and hand over what the page says, until either side ends it. handle runs in a thread; its
        InputError is told to the page."""
        reading = asyncio.ensure_future(self._read(handle))
        try:
            while not reading.done() and not self._full:
                woken = asyncio.ensure_future(self._awake.wait())
                await asyncio.wait({woken, reading}, return_when=asyncio.FIRST_COMPLETED)
                woken.cancel()
                self._awake.clear()
                await self._send()
            if reading.done():
                reading.result()
            else:
                await self._ws.close(1013, "the page does not keep up")
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    # ---- in the loop ----

    def _later(self, call: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(call)

    def _put(self, text: str) -> None:
        self._texts.append(text)
        self._full = len(self._texts) > _MOST_WAITING
        self._awake.set()

    def _keep(self, message: bytes) -> None:
        self._pictures[message[0]] = message
        self._awake.set()

    async def _send(self) -> None:
        while self._texts:
            await tell(self._ws, self._texts.popleft())
        while self._pictures and len(self._unanswered) < IN_FLIGHT:
            message = self._pictures.pop(next(iter(self._pictures)))
            self._unanswered.add(struct.unpack_from("<I", message, 4)[0])
            await tell(self._ws, message)

    async def _read(self, handle: Callable[[dict[str, Any]], None]) -> None:
        while True:
            try:
                message = await hear(self._ws)
                if message["t"] == "ack":
                    self._unanswered.discard(whole(message.get("seq"), "the picture's number", 0, 2**32 - 1))
                    self._awake.set()
                else:
                    await asyncio.to_thread(handle, message)
            except HyposeError as error:
                self._put(json.dumps({"t": "error", "error": str(error)}))

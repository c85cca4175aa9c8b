"""Hub of the studio's WebSockets: /ws/TOPIC, with typed messages in both directions (docs/studio-protocol.md).

A page listens to one topic and sends messages to it. The queue of a slow page is limited: of messages with a key only
the newest waits, pictures wait until the page has drawn earlier ones, and a page that reads nothing is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import struct
from collections.abc import Hashable, Mapping
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from hypose.app.studio.http import object_of, whole
from hypose.app.studio.view_bundle import json_values
from hypose.errors import HyposeError, InputError

MAX_MESSAGE = 1 << 16
"""Largest message from a page, bytes."""
_MOST_PAGES, _MOST_WAITING = 16, 512
"""Most connections, and most messages without a key that wait for one of them."""
IN_FLIGHT = 3
"""Pictures that may be sent before the page has drawn the first of them."""
DEPTH, MAP = 1, 2
"""Types of pictures."""
Message = Mapping[str, Any]


class Topic:
    """Topic that pages listen and send messages to. All methods are called in the server's event loop; name: name of
    the topic, a part of the address.
    """

    name = ""

    def hello(self) -> Message:
        """Return the first message to a page."""
        raise NotImplementedError

    async def heard(self, message: dict[str, Any]) -> None:
        """Handle a message of a page; an InputError is sent to that page only."""
        raise InputError("A page has nothing to say here.")

    def watched(self, pages: int) -> None:
        """Handle a change of the number of listening pages."""


class Hub:
    """WebSocket connections of a server with the pages that listen to its topics. `post` and `picture` may be called
    from any thread, and never wait.
    """

    def __init__(self) -> None:
        self._topics: dict[str, Topic] = {}
        self._pages: dict[str, list[_Page]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None

    def add(self, topic: Topic) -> None:
        """Add a topic that pages can listen to."""
        self._topics[topic.name] = topic
        self._pages[topic.name] = []

    async def serve(self, ws: WebSocket) -> None:
        """Accept a connection and handle it until either side ends it."""
        self._loop = asyncio.get_running_loop()
        topic = self._topics.get(ws.path_params["topic"])
        await ws.accept()
        if topic is None or sum(map(len, self._pages.values())) >= _MOST_PAGES:
            await ws.close(1013, "too many connections; close some pages" if topic else "there is no such topic")
            return
        page, pages = _Page(ws), self._pages[topic.name]
        page.put(_text(topic.hello()))
        pages.append(page)
        topic.watched(len(pages))
        try:
            await page.talk(topic)
        except WebSocketDisconnect:
            pass
        finally:
            pages.remove(page)
            topic.watched(len(pages))

    def listens(self, topic: str) -> bool:
        """Return whether any page listens to a topic."""
        return bool(self._pages[topic])

    def post(self, topic: str, message: Message | str, key: Hashable = None) -> None:
        """Send a message (or its JSON text) to all pages that listen to a topic.

        key: key of waiting messages with the same key only the newest is kept; None: all are kept.
        """
        if self.listens(topic):
            text = message if isinstance(message, str) else _text(message)
            self._later(lambda: [page.put(text, key) for page in self._pages[topic]])

    def picture(self, topic: str, kind: int, seq: int, time: float, data: bytes) -> None:
        """Send a picture to all pages of a topic: 16 bytes with type, stream, number and time, then the file. Of each
        type only the newest waits.

        topic: name of the topic.
        kind: DEPTH or MAP.
        seq: number of the picture, which the page answers.
        time: s.
        data: the file, JPEG or PNG.
        """
        if self.listens(topic):
            message = struct.pack("<BBHId", kind, 0, 0, seq & 0xFFFFFFFF, time) + data
            self._later(lambda: [page.put(message, kind) for page in self._pages[topic]])

    def _later(self, call: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            if self._loop is not None:
                self._loop.call_soon_threadsafe(call)


class _Page:
    """Server side of one connection; used in the event loop."""

    def __init__(self, ws: WebSocket) -> None:
        self._ws = ws
        self._texts: dict[Hashable, str] = {}
        self._pictures: dict[Hashable, bytes] = {}
        self._unanswered: set[int] = set()
        self._awake, self._numbers = asyncio.Event(), itertools.count()

    def put(self, message: str | bytes, key: Hashable = None) -> None:
        """Queue a text, or a picture with its header, which is sent when the page has drawn the last ones.

        key: key of messages with the same one only the newest waits; None: all wait.
        """
        queue: dict[Hashable, Any] = self._texts if isinstance(message, str) else self._pictures
        key = next(self._numbers) if key is None else ("newest", key)
        queue.pop(key, None)
        queue[key] = message
        self._awake.set()

    async def talk(self, topic: Topic) -> None:
        """Send queued messages and pass received ones to the topic, until either side ends the connection."""
        reading = asyncio.ensure_future(self._read(topic))
        try:
            while not reading.done() and len(self._texts) <= _MOST_WAITING:
                woken = asyncio.ensure_future(self._awake.wait())
                await asyncio.wait({woken, reading}, return_when=asyncio.FIRST_COMPLETED)
                woken.cancel()
                self._awake.clear()
                await self._send()
            if reading.done():
                reading.result()
            await self._ws.close(1013, "the page does not keep up")
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    async def _send(self) -> None:
        """Send all queued texts, and pictures while the page has drawn enough of the earlier ones."""
        try:
            while self._texts:
                await self._ws.send_text(self._texts.pop(next(iter(self._texts))))
            while self._pictures and len(self._unanswered) < IN_FLIGHT:
                message = self._pictures.pop(next(iter(self._pictures)))
                self._unanswered.add(struct.unpack_from("<I", message, 4)[0])
                await self._ws.send_bytes(message)
        except RuntimeError:  # the connection is closed already
            raise WebSocketDisconnect(1006) from None

    async def _read(self, topic: Topic) -> None:
        """Pass messages of the page to a topic, until the page ends the connection (WebSocketDisconnect)."""
        while True:
            received = await self._ws.receive()
            if received["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(received.get("code", 1005))
            try:
                if received.get("text") is None:
                    raise InputError("The message is binary; send JSON as text.")
                message = object_of(received["text"], "message")
                if not isinstance(message.get("t"), str):
                    raise InputError('The message has no "t" that says what it is; send one.')
                if message["t"] == "ack":
                    self._unanswered.discard(whole(message.get("seq"), "the picture's number", 0, 2**32 - 1))
                    self._awake.set()
                else:  # a page that leaves must not interrupt a start or an end with its saving
                    await asyncio.shield(topic.heard(message))
            except HyposeError as error:
                self.put(_text({"t": "error", "error": str(error)}))


def _text(message: Message) -> str:
    return json.dumps(json_values(message), separators=(",", ":"))

"""What all WebSockets share: how many there may be, how they end, and pictures that wait for nobody."""

from __future__ import annotations

import struct
from collections.abc import Awaitable, Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from hypose.app.studio.asked import object_of
from hypose.errors import InputError

MAX_MESSAGE = 1 << 16
"""Bytes of a message from the page."""
_MOST = 16
IN_FLIGHT = 3
"""Pictures that may be on their way before the page has drawn the first of them."""
DEPTH, MAP, COLOUR = 1, 2, 3
"""Types of pictures."""


class Sockets:
    """The connections of a server."""

    def __init__(self) -> None:
        self._open = 0

    async def serve(self, ws: WebSocket, talk: Callable[[WebSocket], Awaitable[None]]) -> None:
        """Let a connection in and talk to it until either side ends it."""
        await ws.accept()
        if self._open >= _MOST:
            await ws.close(1013, "too many connections; close some pages")
            return
        self._open += 1
        try:
            await talk(ws)
        except WebSocketDisconnect:
            pass
        finally:
            self._open -= 1


def picture(kind: int, stream: int, seq: int, time: float, data: bytes) -> bytes:
    """A binary message: type, stream, number, time (s), then the file."""
    return struct.pack("<BBHId", kind, stream, 0, seq & 0xFFFFFFFF, time) + data


async def tell(ws: WebSocket, message: str | bytes) -> None:
    """Send a message; WebSocketDisconnect when the connection has ended, also by what the page sent meanwhile."""
    try:
        await (ws.send_text(message) if isinstance(message, str) else ws.send_bytes(message))
    except RuntimeError:  # the server has closed it, which we have not heard of yet
        raise WebSocketDisconnect(1006) from None


async def hear(ws: WebSocket) -> dict[str, Any]:
    """The next message of the page, an object whose "t" is a text; an InputError when it is no such thing,
    WebSocketDisconnect when the page has gone."""
    received = await ws.receive()
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code", 1005))
    if received.get("text") is None:
        raise InputError("The message is binary; send JSON as text.")
    message = object_of(received["text"], "message")
    if not isinstance(message.get("t"), str):
        raise InputError('The message has no "t" that says what it is; send one.')
    return message

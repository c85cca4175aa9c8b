"""What runs live inside the studio, told on a WebSocket: one host, and the pages that look at it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket

from hypose.app.live.servers import put_newest
from hypose.app.studio.asked import text
from hypose.app.studio.job_kinds import free_folder
from hypose.app.studio.sockets import Sockets, hear, tell
from hypose.errors import HyposeError, InputError

_WAITING = 32
"""Messages that wait for a slow page; it then misses the oldest."""


class LiveHost(Protocol):
    """What runs at most once in a server, and goes on without a page. Used in the server's loop only. acts: what else
    a page may ask for."""

    @property
    def acts(self) -> Mapping[str, Callable[[], None]]:
        """By what a page calls them."""
        ...

    def hello(self) -> dict[str, Any]:
        """What a page needs first; "running" is False, or how it runs."""
        ...

    async def start(self, message: dict[str, Any], /) -> None:
        """Begin as a page asks; an InputError says what cannot be."""
        ...

    async def stop(self) -> str | None:
        """End; what is to be said."""
        ...

    def listen(self, queue: asyncio.Queue[str], /) -> None:
        """From now on a queue gets what is told, as text, while it runs."""
        ...

    def unlisten(self, queue: asyncio.Queue[str], /) -> None:
        """No more of it."""
        ...


def live_route(path: str, host: LiveHost, sockets: Sockets) -> WebSocketRoute:
    """The WebSocket of a host."""
    pages: set[asyncio.Queue[str]] = set()

    async def heard(message: dict[str, Any]) -> None:
        if message["t"] == "start":
            await host.start(message)
        elif message["t"] == "stop":
            said = await host.stop()
            if said:
                for queue in pages:
                    put(queue, {"t": "said", "text": said})
        else:
            if message["t"] not in host.acts:
                known = ", ".join(["start", *host.acts])
                raise InputError(f"There is nothing to {message['t'][:20]!r} here; {known} or stop.")
            host.acts[message["t"]]()
            return
        for queue in pages:
            host.listen(queue)
            put(queue, host.hello())

    async def read(ws: WebSocket, queue: asyncio.Queue[str]) -> None:
        while True:
            try:
                # a page that leaves meanwhile must not leave it half begun, nor half ended with nothing kept
                await asyncio.shield(heard(await hear(ws)))
            except HyposeError as error:
                put(queue, {"t": "error", "error": str(error)})

    async def talk(ws: WebSocket) -> None:
        queue: asyncio.Queue[str] = asyncio.Queue(_WAITING)
        pages.add(queue)
        host.listen(queue)
        put(queue, host.hello())
        reading = asyncio.ensure_future(read(ws, queue))
        try:
            while True:
                waiting = asyncio.ensure_future(queue.get())
                await asyncio.wait({waiting, reading}, return_when=asyncio.FIRST_COMPLETED)
                if reading.done():
                    waiting.cancel()
                    reading.result()
                    return
                await tell(ws, waiting.result().replace('"type":', '"t":', 1))
        finally:
            pages.discard(queue)
            host.unlisten(queue)
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    async def socket(ws: WebSocket) -> None:
        await sockets.serve(ws, talk)

    return WebSocketRoute(path, socket)


def put(queue: asyncio.Queue[str], message: dict[str, Any] | str) -> None:
    """A message to a page; when it is slow it misses the oldest."""
    put_newest(queue, message if isinstance(message, str) else json.dumps(message))


def target(value: Any, port: int) -> str | None:
    """Where something is sent to, HOST:PORT; None for nowhere."""
    if value is None or value == "":
        return None
    return text(value, "address to send to", 100, f"give HOST:PORT, for example 127.0.0.1:{port}").strip()


def recording_folder(parent: Path, name: str) -> Path:
    """A new folder to record to. parent: a folder of the served one; an InputError where it is a link that leads out of
    that."""
    if not parent.resolve().is_relative_to(parent.parent):
        raise InputError(f"{parent.name} is a link that leads out of the served folder; remove it first.")
    return free_folder(parent, name)

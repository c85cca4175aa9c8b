"""Live fusion as it runs: the live server of `hypose fuse --live` inside the studio, told on a WebSocket."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from starlette.routing import BaseRoute, WebSocketRoute
from starlette.websockets import WebSocket

from hypose.app.live.live_server import LiveOptions, LiveServer
from hypose.app.studio.answers import NotNow
from hypose.app.studio.asked import number, whole
from hypose.app.studio.sockets import Sockets, hear, tell
from hypose.errors import HyposeError, InputError
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON, PARENT
from hypose.fusion.live import LiveSettings

_WAITING = 32
"""Messages that wait for a slow page; it then misses the oldest."""


class FuseHost:
    """The one live fusion of a server; it goes on without a page. Used in the server's loop only."""

    def __init__(self) -> None:
        self._server: LiveServer | None = None
        self._changing = asyncio.Lock()  # of two pages that start at once the second finds it running

    def hello(self) -> dict[str, Any]:
        """What a page needs first."""
        s = self._server
        running = False if s is None else {"udp": s.udp_port, "ws": s.ws_port}
        return {"t": "hello", "running": running, "joints": COMMON, "parents": PARENT.tolist()}

    async def start(self, message: dict[str, Any]) -> None:
        """Open the ports on this computer; an InputError when they are taken."""
        udp, ws = (whole(message.get(k, 0), f"the {k} port", 0, 65535) for k in ("udp", "ws"))
        rate = number(message.get("rate", 30), "the rate", 1, 240)
        async with self._changing:
            if self._server is not None:
                raise NotNow("The fusion is running already; stop it first.")
            server = LiveServer(LiveOptions(udp=udp, ws=ws, settings=LiveSettings(AlignSettings(rate=rate))))
            await server.start()
            self._server = server

    async def stop(self) -> None:
        """Close the ports."""
        async with self._changing:
            server, self._server = self._server, None
            if server is not None:
                await server.stop()

    def listen(self, queue: asyncio.Queue[str]) -> None:
        """From now on a queue gets what is sent, while the fusion runs."""
        if self._server is not None:
            self._server.listen(queue)

    def unlisten(self, queue: asyncio.Queue[str]) -> None:
        """No more of it."""
        if self._server is not None:
            self._server.unlisten(queue)


def routes(host: FuseHost, sockets: Sockets) -> list[BaseRoute]:
    """The WebSocket."""
    pages: set[asyncio.Queue[str]] = set()

    def tell_all() -> None:
        for queue in pages:
            host.listen(queue)
            _put(queue, host.hello())

    async def heard(message: dict[str, Any]) -> None:
        if message["t"] == "start":
            await host.start(message)
        elif message["t"] == "stop":
            await host.stop()
        else:
            raise InputError(f"There is nothing to {message['t'][:20]!r} here; start or stop.")
        tell_all()

    async def read(ws: WebSocket, queue: asyncio.Queue[str]) -> None:
        while True:
            try:
                await heard(await hear(ws))
            except HyposeError as error:
                _put(queue, {"t": "error", "error": str(error)})

    async def talk(ws: WebSocket) -> None:
        queue: asyncio.Queue[str] = asyncio.Queue(_WAITING)
        pages.add(queue)
        host.listen(queue)
        _put(queue, host.hello())
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

    return [WebSocketRoute("/ws/fuse", socket)]


def _put(queue: asyncio.Queue[str], message: dict[str, Any]) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(json.dumps(message))

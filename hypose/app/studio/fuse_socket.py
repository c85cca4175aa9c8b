"""Live fusion as it runs: the live server of `hypose fuse --live` inside the studio, told on a WebSocket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute, WebSocketRoute
from starlette.websockets import WebSocket

from hypose.app.live import simulated_sensors
from hypose.app.live.live_server import LiveOptions, LiveServer
from hypose.app.studio.answers import NotNow
from hypose.app.studio.asked import number, text, whole
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import free_folder, fused_in
from hypose.app.studio.sockets import Sockets, hear, tell
from hypose.errors import HyposeError, InputError
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON, PARENT
from hypose.fusion.live import LiveSettings

_WAITING = 32
"""Messages that wait for a slow page; it then misses the oldest."""
FOLDER = "live"
"""Where recordings go, in the served folder."""


class FuseHost:
    """The one live fusion of a server; it goes on without a page. recordings: folder to record to. Used in the server's
    loop only."""

    def __init__(self, recordings: Path) -> None:
        self._recordings = recordings
        self._server: LiveServer | None = None
        self._simulated: asyncio.Task[None] | None = None
        self._changing = asyncio.Lock()  # of two pages that start at once the second finds it running

    def hello(self) -> dict[str, Any]:
        """What a page needs first."""
        s = self._server
        running = False if s is None else {"udp": s.udp_port, "ws": s.ws_port, **self._told(s)}
        return {"t": "hello", "running": running, "joints": COMMON, "parents": PARENT.tolist()}

    def _told(self, server: LiveServer) -> dict[str, Any]:
        record = server.options.record
        shown = None if record is None else f"{record.parent.name}/{record.name}"
        o = server.options
        return {"simulated": self._simulated is not None, "osc": o.osc, "vmc": o.vmc, "record": shown}

    async def start(self, message: dict[str, Any]) -> None:
        """Open the ports on this computer, and the recording where one is wanted; an InputError when they are taken.
        With `simulated` made-up sensors send to it."""
        udp, ws = (whole(message.get(k, 0), f"the {k} port", 0, 65535) for k in ("udp", "ws"))
        rate = number(message.get("rate", 30), "the rate", 1, 240)
        made_up = message.get("simulated") or 0
        if made_up:
            whole(made_up, "the number of simulated sensors", 2, simulated_sensors.MOST)
        osc, vmc = (_target(message.get(k), port) for k, port in (("osc", 9000), ("vmc", 39539)))
        async with self._changing:
            if self._server is not None:
                raise NotNow("The fusion is running already; stop it first.")
            seen = await run_in_threadpool(_seen, made_up) if made_up else None
            record = free_folder(self._recordings, "live") if message.get("record") is True else None
            settings = LiveSettings(AlignSettings(rate=rate))
            server = LiveServer(LiveOptions(udp=udp, ws=ws, osc=osc, vmc=vmc, record=record, settings=settings))
            try:
                await server.start()
            except InputError:
                if record is not None:
                    shutil.rmtree(record, ignore_errors=True)  # nothing was recorded there
                raise
            self._server = server
            if seen is not None:
                sending = simulated_sensors.send(seen, server.take, np.random.default_rng(1))
                self._simulated = asyncio.ensure_future(sending)

    async def stop(self) -> str | None:
        """Close the ports; what is to be said of the recording, if there was one."""
        async with self._changing:
            server, self._server = self._server, None
            sending, self._simulated = self._simulated, None
            if sending is not None:
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await sending
            if server is None:
                return None
            await server.stop()
            record = server.options.record
            if record is None:
                return None
            return server.unrecorded or f"Recorded as {record.parent.name}/{record.name}."

    def listen(self, queue: asyncio.Queue[str]) -> None:
        """From now on a queue gets what is sent, while the fusion runs."""
        if self._server is not None:
            self._server.listen(queue)

    def unlisten(self, queue: asyncio.Queue[str]) -> None:
        """No more of it."""
        if self._server is not None:
            self._server.unlisten(queue)


def recorded(catalog: Catalog) -> list[dict[str, Any]]:
    """The recordings of live sensors, for a list; result: id of what they were fused to."""
    out = []
    for item in catalog.items("skeletons"):
        fused = fused_in(item.path)
        result = catalog.id_of("result", fused) if (fused / "motion.npz").is_file() else None
        out.append({"id": item.id, "name": item.path.name, "path": catalog.shown(item.path), "result": result})
    return out


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
            said = await host.stop()
            if said:
                for queue in pages:
                    _put(queue, {"t": "said", "text": said})
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


def _target(value: Any, port: int) -> str | None:
    """Where fused skeletons are sent to; None for nowhere."""
    if value is None or value == "":
        return None
    return text(value, "address to send to", 100, f"give HOST:PORT, for example 127.0.0.1:{port}").strip()


def _seen(sensors: int) -> simulated_sensors.SensorRecording:
    return simulated_sensors.simulated_sensors(sensors, np.random.default_rng(0))


def _put(queue: asyncio.Queue[str], message: dict[str, Any]) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(json.dumps(message))

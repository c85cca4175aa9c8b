"""Live fusion as it runs: the live server of `hypose fuse --live` inside the studio, told on a WebSocket."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool

from hypose.app.live import simulated_sensors
from hypose.app.live.live_server import LiveOptions, LiveServer
from hypose.app.studio.answers import NotNow
from hypose.app.studio.asked import number, whole
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import fused_in
from hypose.app.studio.live_socket import recording_folder, target
from hypose.errors import InputError
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON, PARENT
from hypose.fusion.live import LiveSettings

FOLDER = "live"
"""Where recordings go, in the served folder."""


class FuseHost:
    """The one live fusion of a server; it goes on without a page. recordings: folder to record to. Used in the server's
    loop only."""

    def __init__(self, recordings: Path) -> None:
        self._recordings = recordings
        self._server: LiveServer | None = None
        self._simulated: asyncio.Task[None] | None = None
        self.acts: Mapping[str, Callable[[], None]] = {}
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
        return {"simulated": self._simulated is not None, "osc": o.osc, "record": shown}

    async def start(self, message: dict[str, Any]) -> None:
        """Open the ports on this computer, and the recording where one is wanted; an InputError when they are taken.
        With `simulated` made-up sensors send to it."""
        udp, ws = (whole(message.get(k, 0), f"the {k} port", 0, 65535) for k in ("udp", "ws"))
        rate = number(message.get("rate", 30), "the rate", 1, 240)
        made_up = message.get("simulated") or 0
        if made_up:
            whole(made_up, "the number of simulated sensors", 2, simulated_sensors.MOST)
        osc = target(message.get("osc"), 9000)
        async with self._changing:
            if self._server is not None:
                raise NotNow("The fusion is running already; stop it first.")
            seen = await run_in_threadpool(_seen, made_up) if made_up else None
            record = recording_folder(self._recordings, "live") if message.get("record") is True else None
            settings = LiveSettings(AlignSettings(rate=rate))
            server = LiveServer(LiveOptions(udp=udp, ws=ws, osc=osc, record=record, settings=settings))
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
            self._server.outbox.join(queue)

    def unlisten(self, queue: asyncio.Queue[str]) -> None:
        """No more of it."""
        if self._server is not None:
            self._server.outbox.leave(queue)


def recorded(catalog: Catalog) -> list[dict[str, Any]]:
    """The recordings of live sensors, for a list; result: id of what they were fused to."""
    out = []
    for item in catalog.items("skeletons"):
        fused = fused_in(item.path)
        result = catalog.id_of("result", fused) if (fused / "motion.npz").is_file() else None
        out.append({"id": item.id, "name": item.path.name, "path": catalog.shown(item.path), "result": result})
    return out


def _seen(sensors: int) -> simulated_sensors.SensorRecording:
    return simulated_sensors.simulated_sensors(sensors, np.random.default_rng(0))

"""Live server for fusion: receive skeletons by UDP and WebSocket, send fused skeletons by WebSocket and OSC
(docs/live.md).

Everything runs in one thread: a line that arrives is parsed and fused, and a timer sends the frames that are due. All
input is limited: bytes per line, sensors, persons, clients, and messages kept for a slow client.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hypose.app.commands.console import counted, ended_by_signals
from hypose.app.live.osc import OscTarget, people_osc
from hypose.app.live.servers import SocketServer, listen_error, quiet_logs, same_secret, token_for
from hypose.errors import InputError, visible
from hypose.fusion.align import AlignSettings
from hypose.fusion.joints import COMMON
from hypose.fusion.people import LiveFrame, LiveFuser
from hypose.io.motions.results import json_values
from hypose.io.sensors.skeleton_files import MAX_SKELETON_LINE, FolderWriter, parse_line
from hypose.pipeline.live.processes import punctual

_Say = Callable[[str], None]
_TOKEN = re.compile(r"[A-Za-z0-9_.-]{8,128}")
_COMPLAINT_S = 5.0
_STATUS_S = 1.0
_REPORT_S, _LOOK_S = 10.0, 0.1
"""Time between two reports, and between two checks for the end, s."""


class LiveServer:
    """Server of live fusion; it runs in the event loop from `start` to `stop`, and counts lines and frames.

    host: address to listen on.
    udp, ws: ports of UDP and WebSocket; 0: any free one, None: the protocol is not used.
    osc: HOST:PORT to which results are sent by OSC; None: not sent.
    token: secret that senders and listeners must show; where it is missing, one is made unless only this computer can
        connect.
    record: new folder for a recording; None: nothing is recorded.
    settings: settings of the output instants.
    note: receives sentences on problems.
    Raises: InputError where the token has an invalid form.
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        udp: int | None = 9870,
        ws: int | None = 9871,
        osc: str | None = None,
        token: str | None = None,
        record: Path | None = None,
        settings: AlignSettings | None = None,
        note: _Say = lambda text: None,
    ) -> None:
        if token is not None and not _TOKEN.fullmatch(token):
            raise InputError("A token must have 8 to 128 letters, digits, _ . and -; leave it out to have one made.")
        self.host, self.udp, self.ws, self.osc, self.record = host, udp, ws, osc, record
        self.settings, self.token = settings or AlignSettings(), token_for(host, token)
        self.fuser: LiveFuser = LiveFuser(self.settings)
        self.received = self.used = self.ignored = self.frames = 0
        self.latencies: deque[float] = deque(maxlen=3000)
        self.people: int = 0
        self.udp_port = self.ws_port = 0
        self._note = note
        self.clock: Callable[[], float] = time.monotonic  # s, that of the event loop
        self._complained, self._silent = -math.inf, 0
        self._writer = FolderWriter(record) if record is not None else None
        self.unrecorded: str = ""  # why a requested recording is not complete
        self._timer: asyncio.TimerHandle | None = None
        self._datagrams: asyncio.DatagramTransport | None = None
        self.listeners: list[_Say] = []  # receivers of all messages
        hello = json.dumps({"type": "hello", "version": 1, "joints": COMMON, "rate": self.settings.rate})
        self.sockets: SocketServer = SocketServer(hello, "/out", clients=32, take=self.take, token=self.token)
        self._osc: OscTarget | None = None
        self._status_at = 0.0

    # ---- life ----

    async def start(self) -> None:
        """Open the ports.

        Raises: InputError where a port cannot be opened.
        """
        loop = asyncio.get_running_loop()
        quiet_logs()
        if self.osc is not None:
            self._osc = OscTarget(self.osc)
        try:
            if self.udp is not None:
                transport, _ = await loop.create_datagram_endpoint(
                    lambda: _Datagrams(self), local_addr=(self.host, self.udp)
                )
                self._datagrams = transport
                with contextlib.suppress(OSError):
                    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
                self.udp_port = transport.get_extra_info("sockname")[1]
            if self.ws is not None:
                self.ws_port = await self.sockets.start(self.host, self.ws)
        except (OSError, OverflowError) as error:
            await self.stop()
            raise InputError(
                f"The ports {self.udp} (UDP) and {self.ws} (WebSocket) on {self.host} cannot be opened "
                f"({listen_error(error)}); choose others with --udp and --ws."
            ) from None

    async def stop(self) -> None:
        """Close all connections and complete the recording."""
        if self._timer is not None:
            self._timer.cancel()
        if self._datagrams is not None:
            self._datagrams.close()
        await self.sockets.stop()
        if self._osc is not None:
            self._osc.close()
        self._record(lambda writer: writer.close())
        self._writer = None

    # ---- in ----

    def take(self, data: bytes | str) -> str | None:
        """Parse and fuse one received line; return the reason where it is ignored, else None."""
        now = self.clock()
        self.received += 1
        held = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
        if self.token and self.token.encode() not in held:  # a cheap test first
            return self._ignore("the token is missing or wrong", now)
        try:
            if len(data) > MAX_SKELETON_LINE:
                return self._ignore(f"a line has more than {MAX_SKELETON_LINE} bytes", now)
            line, token = parse_line(data)
            if self.token and not same_secret(token, self.token):
                return self._ignore("the token is missing or wrong", now)
            fresh = self.fuser.push(line, now)
        except InputError as error:
            return self._ignore(str(error).rstrip("."), now)
        self.used += fresh
        self._record(lambda writer: writer.add(line))
        self.tick()
        return None

    def _record(self, write: Callable[[FolderWriter], None]) -> None:
        """Write to the recording, if there is one; an error ends the recording."""
        if self._writer is None:
            return
        try:
            write(self._writer)
        except InputError as error:
            self.unrecorded, self._writer = str(error), None
            self._note(f"Recording stops: {error}")

    def _ignore(self, reason: str, now: float) -> str:
        """Count an ignored line, and report it at most every 5 s; return the reason."""
        self.ignored += 1
        self._silent += 1
        if now - self._complained >= _COMPLAINT_S:
            more = f" ({self._silent} lines ignored)" if self._silent > 1 else ""
            self._note(f"Ignored: {visible(reason)[:200]}{more}")
            self._complained, self._silent = now, 0
        return reason

    # ---- out ----

    def tick(self) -> None:
        """Send the frames that are ready, and set the timer for the next one."""
        for frame in self.fuser.poll(self.clock()):
            self._send(frame, self.clock())
        if self._timer is not None:
            self._timer.cancel()
        due, now = self.fuser.aligner.due(), self.clock()
        self._timer = asyncio.get_running_loop().call_later(max(0.0, due - now), self.tick) if due < math.inf else None
        if now - self._status_at >= _STATUS_S:
            self._status_at = now
            self._post(lambda: self._status(now))
            self._record(lambda writer: writer.flush())

    def _send(self, frame: LiveFrame, now: float) -> None:
        latency = now - frame.time
        self.frames += 1
        self.latencies.append(latency)
        self.people = len(frame.people)
        self._post(lambda: frame_json(frame, latency))
        if self._osc is not None:
            people = [(p.id, COMMON, p.joints, p.sd) for p in frame.people]
            self._osc.send(people_osc(frame.index, frame.time, latency, people, len(people)))

    def _post(self, line: Callable[[], str]) -> None:
        """Send a line, which is made only where it is received."""
        if self.sockets.listeners or self.listeners:
            text = line()
            for listener in (self.sockets.post, *self.listeners):
                listener(text)

    def _status(self, now: float) -> str:
        residuals, places = self.fuser.people.residuals, self.fuser.people.transforms
        sensors = [
            {
                **status,
                "registered": status["name"] in residuals,
                "residual": round(residuals.get(status["name"], math.nan), 5),
                "place": places[status["name"]].round(4).tolist() if status["name"] in places else None,
            }
            for status in self.fuser.aligner.status(now)
        ]
        counts = {
            "received": self.received,
            "ignored": self.ignored,
            "frames": self.frames,
            "dropped": self.sockets.dropped,
        }
        return json.dumps(json_values({"type": "status", "sensors": sensors, **counts}), separators=(",", ":"))


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, server: LiveServer) -> None:
        self._server = server

    def datagram_received(self, data: bytes, addr: Any) -> None:
        for line in data.split(b"\n", 64)[:64]:
            if line.strip():
                self._server.take(line)


def frame_json(frame: LiveFrame, latency: float) -> str:
    """Encode one frame as a line of JSON: per person joints (15) [x, y, z] m in the order of the hello message, and sd
    (15) m.

    latency: from the time of the frame until now, s.
    """
    people = [
        {
            "id": p.id,
            "seen": p.seen,
            "sensors": p.sensors,
            "joints": p.joints.round(5),
            "sd": p.sd.round(5),
        }
        for p in frame.people
    ]
    head = {"type": "frame", "n": frame.index, "time": round(frame.time, 6), "latency_ms": round(1000 * latency, 3)}
    return json.dumps(json_values({**head, "people": people}), separators=(",", ":"))


async def run_live(server: LiveServer, say: _Say, note: _Say) -> None:
    """Run the server until Ctrl-C or SIGTERM, with a report now and then.

    say: prints results.
    note: prints remarks.
    Raises: InputError where the ports cannot be opened, or the recording failed.
    """
    ended = threading.Event()
    with ended_by_signals(ended):
        await server.start()
        try:
            host = f"[{server.host}]" if ":" in server.host else server.host
            for text, there in (
                (f"Skeletons in:  udp {host}:{server.udp_port}", server.udp is not None),
                (f"Skeletons in:  ws://{host}:{server.ws_port}/in", server.ws is not None),
                (f"Fused out:     ws://{host}:{server.ws_port}/out", server.ws is not None),
                (f"Fused out:     osc {server.osc}", server.osc is not None),
                (f"Token:         {server.token}", server.token != ""),
                ("Stop with Ctrl-C.", True),
            ):
                if there:
                    say(text)
            reported = time.monotonic()
            with punctual():
                while not ended.is_set():
                    await asyncio.sleep(_LOOK_S)
                    if server.frames and time.monotonic() - reported >= _REPORT_S:
                        reported = time.monotonic()
                        note(_summary(server))
        finally:
            await server.stop()
    if server.frames:
        say(f"{counted(server.frames, 'frame')} sent. {_summary(server)}")
    if server.unrecorded:
        raise InputError(server.unrecorded)
    if server.record is not None:
        say(f"Recorded: {server.record}")


def _summary(server: LiveServer) -> str:
    p99 = 1000 * float(np.percentile(server.latencies, 99))
    alive = sum(s["alive"] for s in server.fuser.aligner.status(server.clock()))
    return f"{alive} sensors, {server.people} persons, latency p99 {p99:.1f} ms, {server.ignored} lines ignored."

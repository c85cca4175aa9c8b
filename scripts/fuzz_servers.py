"""The servers as targets of the fuzzer: a studio and a live server of this process, on loopback.

A spoilt input is what somebody sends: heads and bodies of requests, WebSocket frames (text, binary, in parts, bare
bytes), datagrams. It must be answered, and not with 500; nothing with a traceback may be logged, and afterwards the
server must serve who asks properly.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import socket
import struct
import tempfile
import threading
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from hypose.fusion.joints import COMMON

_KERNELS = ("pickle.find_class ('numba", "pickle.find_class ('copyreg")
ALLOWED = ("socket.connect", "socket.bind", "wrote", *_KERNELS, "ctypes.dlopen")
"""What these targets may do that a reader of files may not: the studio keeps what pages make, and loads what it
computes with when it is first asked."""
_TOKEN = "a-good-token"
_LOGGERS = ("asyncio", "uvicorn.error", "websockets.server")
_KEY = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
_UPGRADE = f"Connection: Upgrade\r\nUpgrade: websocket\r\n{_KEY}"
_HOST = "Host: 127.0.0.1:8765\r\n"
_WAIT_S = 20.0
"""s after which a server that says nothing has hung; who sends half a request is not waited for that long."""
_LAST = f"GET /api/click-joints HTTP/1.1\r\n{_HOST}Connection: close\r\n\r\n".encode()


class _Servers:
    """Both servers in one loop of a thread of its own. Made once per process."""

    def __init__(self) -> None:
        from hypose.app.live.live_server import LiveServer
        from hypose.app.studio.http import NotNow
        from hypose.app.studio.server import Studio, make_server, open_port

        self._folder = tempfile.TemporaryDirectory()  # lives as long as the process
        root = Path(self._folder.name)
        _recording(root)
        studio = Studio(root)

        def no_jobs(*_: Any) -> None:
            raise NotNow("Nothing is started here.")

        studio.jobs.start = studio.jobs.resume = no_jobs  # type: ignore[method-assign]
        self.studio = studio
        self.live = LiveServer(udp=0, ws=0, token=_TOKEN)
        listening, port = threading.Event(), open_port("127.0.0.1", 0)
        self.port = port.getsockname()[1]

        async def serve() -> None:
            await self.live.start()
            listening.set()
            await make_server(studio).serve(sockets=[port])

        threading.Thread(target=lambda: asyncio.run(serve()), daemon=True).start()
        if not listening.wait(120):
            raise RuntimeError("the servers do not start")
        self.logged: list[str] = []
        for name in _LOGGERS:  # those about what others have sent do not come so far
            logging.getLogger(name).addHandler(_Keep(self.logged))

    def check(self, answer: bytes = b"") -> None:
        """RuntimeError when an answer is a bug's, something bad was logged, or a good request is not served."""
        said = _ask(self.port, _LAST)
        bad = list(self.logged)
        self.logged.clear()
        if bad:
            raise RuntimeError(f"logged {_last_words(bad[0])}")
        if b"HTTP/1.1 500" in answer:
            raise RuntimeError(f"answered {answer[:300]!r}")
        if not said.startswith(b"HTTP/1.1 200"):
            raise RuntimeError(f"no longer serves: {said[:200]!r}")


def _last_words(logged: str) -> str:
    """The error of a logged traceback, and the innermost line of the package in it."""
    places = re.findall(r'File ".*/hypose/(.*)", (line \d+)', logged)
    return logged.strip().rpartition("\n")[2][:300] + (f" at {' '.join(places[-1])}" if places else "")


class _Keep(logging.Handler):
    """Keeps what is logged."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__()
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        """One record."""
        self._lines.append(self.format(record))


@cache
def _servers() -> _Servers:
    return _Servers()


def _recording(root: Path) -> None:
    """A recording with a result, as the studio serves them."""
    import numpy as np

    from benchmarks.robustness.small_recordings import small_scene, write_masks
    from hypose.body.default_body import human
    from hypose.body.motion import Motion, isotropic
    from hypose.io.motions.results import save_body, save_motion

    write_masks(small_scene(1, 2), root / "walk")
    body, folder = human(), root / "walk" / "results" / "default"
    poses = np.zeros((2, body.skeleton.dof))
    joints, flags = body.joints(poses), np.zeros(2, bool)
    sd = isotropic(np.full(joints.shape[:2], 0.01))
    folder.mkdir(parents=True)
    motion = Motion(body.skeleton, np.arange(2) / 25, joints, poses, sd, flags, flags, np.full(2, 2), np.full(2, 0.1))
    save_motion(motion, folder / "motion.npz")
    save_body(body, folder / "body.npz")


# ---- what is sent ----------------------------------------------------------------------------------------------


def send_requests(data: bytes) -> None:
    """The bytes of requests to the studio, and a good one behind them."""
    servers = _servers()
    servers.check(_ask(servers.port, data + _LAST))


def send_live_request(data: bytes) -> None:
    """The bytes of a request to the live server."""
    servers = _servers()
    servers.check(_ask(servers.live.ws_port, data))


def send_datagrams(data: bytes) -> None:
    """Lines to the live server by UDP, then one that it must have counted."""
    servers = _servers()
    before = servers.live.received
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        for start in range(0, max(1, len(data)), 60_000):
            s.sendto(data[start : start + 60_000], ("127.0.0.1", servers.live.udp_port))
        s.sendto(b"x", ("127.0.0.1", servers.live.udp_port))
        s.settimeout(_WAIT_S)
        wait = threading.Event()
        for _ in range(int(_WAIT_S / 0.001)):
            if servers.live.received > before:
                break
            wait.wait(0.001)
        else:
            raise RuntimeError("the live server takes no more datagrams")
    servers.check()


def send_frames(path: str) -> Callable[[bytes], None]:
    """Every line is a message to the studio's WebSocket at a path."""

    def send(data: bytes) -> None:
        servers = _servers()
        with socket.create_connection(("127.0.0.1", servers.port), timeout=_WAIT_S) as s:
            s.sendall(f"GET {path} HTTP/1.1\r\n{_HOST}{_UPGRADE}\r\n".encode())
            if b" 101 " not in _head(s):
                raise RuntimeError(f"{path} cannot be opened")
            try:
                for line in data.split(b"\n"):
                    s.sendall(_frames(line))
                s.sendall(_frame(9, b"end"))
                _until_pong(s)
            except (ConnectionResetError, BrokenPipeError):
                pass  # closed as it may be; what it said is read no more
        servers.check()

    return send


def _frames(line: bytes) -> bytes:
    """A line on the wire: as text, mostly; as binary, in parts, with its own bytes as frames."""
    kind = zlib.crc32(line) % 10
    if kind < 6:
        return _frame(1, line)
    if kind == 6:
        return _frame(2, line)
    if kind == 7:
        parts = [line[: len(line) // 3], b"", line[len(line) // 3 :]]
        return _frame(1, parts[0], fin=False) + _frame(0, parts[1], fin=False) + _frame(0, parts[2])
    if kind == 8:
        return _frame(zlib.crc32(line[1:]) % 16, line)
    return line


def _frame(opcode: int, payload: bytes, fin: bool = True) -> bytes:
    """A frame of a client, its mask zero."""
    n = len(payload)
    size = (
        bytes([128 | n]) if n < 126 else b"\xfe" + struct.pack(">H", n) if n < 65536 else b"\xff" + struct.pack(">Q", n)
    )
    return bytes([(128 if fin else 0) | opcode]) + size + bytes(4) + payload


def _head(s: socket.socket) -> bytes:
    got = b""
    while not got.endswith(b"\r\n\r\n") and (byte := s.recv(1)):  # frames follow the head
        got += byte
    return got


def _until_pong(s: socket.socket) -> None:
    """Read frames until the one that answers `end`, or the connection is closed."""
    waiting = bytearray()
    s.settimeout(2.0)  # a line that was half a frame has swallowed the ping
    while True:
        try:
            more = s.recv(65536)
        except TimeoutError:
            return
        waiting += more
        if not more or b"\x8a\x03end" in waiting:
            return


def _ask(port: int, data: bytes) -> bytes:
    """All that is answered until the server ends the connection, or says nothing more."""
    got = b""
    with socket.create_connection(("127.0.0.1", port), timeout=_WAIT_S) as s:
        try:
            s.sendall(data)
            if not data.endswith(_LAST) or data is not _LAST:
                s.settimeout(0.5)  # half a request is not answered
            while more := s.recv(1 << 20):
                got += more
        except (TimeoutError, ConnectionResetError, BrokenPipeError):
            pass
    return got


# ---- good inputs -----------------------------------------------------------------------------------------------


def write_good(folder: Path) -> None:
    """servers/: requests, messages for each WebSocket, datagrams."""
    from hypose.app.studio.catalog import Catalog

    catalog = Catalog(Path("/"))
    recording, result = (
        catalog.id_of("recording", Path("/walk")),
        catalog.id_of("result", Path("/walk/results/default")),
    )
    out = folder / "servers"
    out.mkdir()
    click = {"joint": "neck", "x": 40.5, "y": 30.0, "occluded": False}
    fit = {"recording": recording, "result": result, "frame": 0, "height": 1.75}
    fit["views"] = [{"camera": "cam1", "points": [click]}]
    mask = "settings=%7B%22threshold%22:4,%22shadow%22:true,%22shadow_range%22:[0.4,0.9]%7D"
    gets = [
        *(
            "/",
            "/static/studio.js",
            "/api/results",
            f"/api/results/{result}/view",
            f"/api/click-body?recording={recording}",
        ),
        *(f"/api/results/{result}/outlines/0", f"/api/recordings/{recording}", "/api/jobs/0123456789ab/view"),
        *(f"/api/results/{result}/files/motion.trc", f"/api/recordings/{recording}/file/check.png"),
        f"/api/results/{result}/pictures/1?width=64",
        "/api/folder?path=walk/masks&within",
        f"/api/recordings/{recording}/image/cam1/1.jpg?width=64&mask=only&{mask}",
    ]
    new = {"folder": "walk", "name": "new", "calibration": "a.toml", "frame_rate": 25.0}
    new["views"] = [{"name": "a", "camera": "a", "video": "b.mp4"}]
    posts = [
        ("POST", "/api/fit-clicks", fit),
        ("POST", f"/api/recordings/{recording}/starts", {**fit, "name": "first", "camera": "cam1"}),
        ("POST", "/api/jobs", {"kind": "track", "recording": recording, "options": {"seed": 1}}),
        ("POST", "/api/recordings", new),
        ("POST", "/api/jobs", {"kind": "export", "result": result, "options": {"formats": ["trc"]}}),
        ("POST", f"/api/recordings/{recording}/mask-settings", {"close_px": 3, "shadow_range": [0.4, 0.9]}),
    ]
    text = "".join(f"GET {path} HTTP/1.1\r\n{_HOST}\r\n" for path in gets)
    for method, path, value in posts:
        body = json.dumps(value)
        origin = "Origin: http://127.0.0.1:8765\r\nContent-Type: application/json\r\n"
        text += f"{method} {path} HTTP/1.1\r\n{_HOST}{origin}Content-Length: {len(body)}\r\n\r\n{body}"
    (out / "requests.txt").write_bytes(text.encode())
    seconds = {"do_gesture": 3, "positive": 5.5, "release": 2, "negative": 8}
    start = {"t": "start", "mode": "train", "gesture": "tee", "source": "session:0123456789ab", "seconds": seconds}
    gesture = [
        {**start, "rounds": 2, "seed": 0, "fast": False, "resume": None},
        {"t": "start", "mode": "run", "models": ["0123456789ab"], "source": "simulated:0"},
        {"t": "command", "command": "next"},
        {"t": "box", "x": 320, "y": 200.5},
        {"t": "threshold", "value": 4.2},
        {"t": "hold", "seconds": 0.15},
        *({"t": "map", "on": True}, {"t": "save"}, {"t": "stop"}, {"t": "ack", "seq": 7}),
    ]
    fuse = [{"t": "start", "udp": 0, "ws": 0, "rate": 30}, {"t": "stop"}, {"t": "hello"}]
    for name, messages in (("gesture", gesture), ("fuse", fuse)):
        (out / f"{name}.txt").write_text("\n".join(map(json.dumps, messages)))
    joints = {n: [0.1, 0.1 * k, 2.0, 2] for k, n in enumerate(COMMON)}
    line = {"sensor": "s0", "time": 1.25, "person": 0, "token": _TOKEN, "joints": joints}
    (out / "datagrams.txt").write_text("\n".join(json.dumps({**line, "sensor": f"s{k}"}) for k in range(3)))
    live = f"GET /in?token={_TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:9871\r\nOrigin: http://localhost\r\n{_UPGRADE}\r\n".encode()
    (out / "live.txt").write_bytes(live + _frame(1, json.dumps(line).encode()) + _frame(2, b"\xff\n{}"))

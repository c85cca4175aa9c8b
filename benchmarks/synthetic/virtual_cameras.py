"""Cameras that are not there: motion JPEG over HTTP on this computer, in real time, with the faults of real cameras."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

_BOUNDARY = "picture"


@dataclass(frozen=True)
class CameraFaults:
    """jitter s: sd by which pictures are late (only ever late); lost: share of the pictures that never come; gone: of
    each view the spans (s from the beginning) in which it is unplugged."""

    jitter: float = 0.0
    lost: float = 0.0
    gone: tuple[tuple[tuple[float, float], ...], ...] = ()


def there_and_back(n: float, count: int) -> float:
    """Frame n of a clip that is played forwards and backwards, so that nobody jumps at its end."""
    last = count - 1
    return last - abs(n % (2 * last) - last) if last else 0


class VirtualCameras:
    """clips: of each view the JPEG bytes of its pictures, played at `rate` Hz from `begin` (s, monotonic) on, over and
    over, forwards and backwards, after `first` (of each view: pictures shown once before them, such as the empty room,
    and over and over until `begin`).
    Listens on this computer alone, on a free port. Usable as a context manager."""

    def __init__(
        self,
        clips: Sequence[Sequence[bytes]],
        rate: float,
        faults: CameraFaults | None = None,
        seed: int = 0,
        first: Sequence[Sequence[bytes]] = (),
    ) -> None:
        self.clips, self.rate, self.faults, self.first = clips, rate, faults or CameraFaults(), first
        self._seed, self._ended = seed, threading.Event()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = True
        self.begin = time.monotonic()
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def addresses(self) -> list[str]:
        """Of each view."""
        return [f"http://127.0.0.1:{self._server.server_port}/{c}" for c in range(len(self.clips))]

    def shown(self, at: float) -> float:
        """Which picture of the clips, as a number with a fraction, is shown at a time (s, monotonic); below 0 before
        them."""
        n = (at - self.begin) * self.rate - (len(self.first[0]) if self.first else 0)
        return n if n < 0 else there_and_back(n, len(self.clips[0]))

    def __enter__(self) -> VirtualCameras:
        self.begin = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()

    def picture(self, view: int, n: int) -> bytes:
        """What a view shows as its picture number n."""
        first = self.first[view] if self.first else ()
        if first and n < len(first):
            return first[n % len(first)]
        return self.clips[view][int(there_and_back(n - len(first), len(self.clips[view])))]

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        cameras = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                view = self.path.strip("/")
                if not view.isdigit() or int(view) >= len(cameras.clips) or cameras.away(int(view)):
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
                self.end_headers()
                with contextlib.suppress(OSError):
                    cameras.play(int(view), self.wfile.write)

            def log_message(self, format: str, *args: object) -> None:
                """Silent."""

        return Handler

    def away(self, view: int) -> bool:
        """Whether a view is unplugged now."""
        spans = self.faults.gone[view] if view < len(self.faults.gone) else ()
        return any(a <= time.monotonic() - self.begin < b for a, b in spans)

    def play(self, view: int, write) -> None:  # noqa: ANN001 - a file's write
        """The pictures of one view from now on, each at its time, until it is unplugged or the end."""
        f, rng = self.faults, np.random.default_rng([self._seed, view])
        n = int((time.monotonic() - self.begin) * self.rate) + 1
        while not self._ended.is_set() and not self.away(view):
            at = self.begin + n / self.rate
            wait = at + abs(float(rng.normal(0, f.jitter))) - time.monotonic() if f.jitter else at - time.monotonic()
            if wait > 0 and self._ended.wait(wait):
                return
            if rng.random() >= f.lost:
                data = self.picture(view, n)
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                write(head.encode() + data + b"\r\n")
            n = max(n + 1, int((time.monotonic() - self.begin) * self.rate))

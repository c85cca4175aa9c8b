"""Read cameras in threads: one per camera keeps the newest pictures and opens the camera again when it was lost."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.errors import HyposeError, InputError
from hypose.fusion.align import SensorClock
from hypose.geometry import Array
from hypose.io.videos.video import CameraImage, CameraSource
from hypose.pipeline.settings import SETTINGS


@dataclass(frozen=True)
class FeedStatus:
    """Status of one camera.

    received: number of pictures that arrived.
    lost: number of pictures that are missing between them.
    rate: pictures per second, Hz; 0 while not known, or when the camera is absent.
    returns: number of times that the camera was lost and came back.
    trouble: reason for which it is absent; "" when it delivers.
    ended: whether it is a file that has been read to its end.
    loss: share of the recent pictures that was lost, 0 to 1.
    """

    name: str
    received: int
    lost: int
    rate: float
    returns: int
    trouble: str
    ended: bool
    loss: float = 0.0


class CameraFeed:
    """Newest pictures of one camera, which a thread reads; it opens the camera again when it was lost.

    name: name of the camera, for messages.
    opener: function that opens the camera.
    arrived: condition that is notified at every picture, and when the camera is lost.

    Attributes, which the user of the class may change:
    offset: time by which the pictures of this camera are late, s; it is subtracted from their times.
    ahead: offset of the latest camera minus this camera's own, s; pictures are kept so long, until the other camera has
        delivered the same instant.
    """

    def __init__(self, name: str, opener: Callable[[], CameraSource], arrived: threading.Condition) -> None:
        self.name, self.offset, self.ahead = name, 0.0, 0.0
        self._opener, self._arrived = opener, arrived
        self._shots: deque[tuple[float, CameraImage]] = deque()
        self._pace: deque[float] = deque(maxlen=SETTINGS.feeds_pace)
        self._clock, self._nonsense = SensorClock(), 0
        self._received = self._lost = self._returns = 0
        self._recent: deque[int] = deque(maxlen=SETTINGS.feeds_recent)
        self._trouble, self._ended = "", False
        self._begun = time.monotonic()
        self._stop = threading.Event()
        self._source: CameraSource | None = None
        self._thread = threading.Thread(target=self._run, name=f"camera {name}", daemon=True)

    def start(self) -> None:
        """Open the camera and start reading.

        Raises: InputError where it cannot be opened.
        """
        try:
            self._source = self._opener()
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None
        self._thread.start()

    def end(self) -> None:
        """Stop reading, without waiting."""
        self._stop.set()

    def stop(self) -> None:
        """Stop reading, and wait until the camera is released."""
        self.end()
        if self._thread.is_alive():
            self._thread.join(6)

    def delivered(self) -> tuple[Delivered, list[CameraImage]]:
        """Return the times of the newest pictures, with `offset` subtracted, and the pictures themselves, in the same
        order; call it with `arrived` locked.
        """
        times = np.array([t for t, _ in self._shots]) - self.offset
        arrivals = np.array([s.arrival for _, s in self._shots])
        return Delivered(times, arrivals, self._period()), [s for _, s in self._shots]

    def status(self) -> FeedStatus:
        """Return the status of the camera."""
        with self._arrived:
            period, trouble = self._period(), self._trouble
            silent = time.monotonic() - (self._shots[-1][1].arrival if self._shots else self._begun)
            if not trouble and silent > 2 * SETTINGS.feeds_gone_s:
                trouble = "it sends no pictures"
            rate = 1 / period if np.isfinite(period) and not trouble else 0.0
            lost = max(sum(self._recent), 0)
            loss = lost / max(lost + len(self._recent), 1)
            return FeedStatus(self.name, self._received, self._lost, rate, self._returns, trouble, self._ended, loss)

    def _period(self) -> float:
        if len(self._pace) < SETTINGS.feeds_known:
            return float("nan")
        steps = np.diff(self._pace)
        usual = float(np.median(steps))
        mean = float(steps[steps < max(SETTINGS.feeds_gone_s, 2 * usual)].mean())  # without pauses
        return usual if usual > 0.5 * mean else mean  # a network may deliver pictures in bunches

    def _run(self) -> None:
        source, wait, back = self._source, SETTINGS.feeds_again_s, False
        while not self._stop.is_set():
            try:
                if source is None:
                    source, back = self._opener(), True
                self._take(source.read())
                self._returns += back
                wait, back = SETTINGS.feeds_again_s, False
            except HyposeError as error:
                over = source is not None and not source.live  # a damaged file stays damaged
                if source is not None:
                    source.close()
                source = None
                with self._arrived:
                    self._trouble, self._ended = str(error), over
                    self._pace.clear()
                    self._arrived.notify_all()
                if over:
                    return
                self._stop.wait(wait)
                wait = min(2 * wait, SETTINGS.feeds_longest_s)
        if source is not None:
            with contextlib.suppress(HyposeError):
                source.close()

    def _when(self, shot: CameraImage) -> float | None:
        """Compute the time at which a picture was taken, s, on this computer's clock; None: not known.

        Why: the camera's own times are ignored after too many impossible ones, since some programs send constant times
        or another unit.
        """
        if shot.stamp is None or self._nonsense >= SETTINGS.feeds_nonsense:
            return shot.arrival
        at = self._clock.update(shot.stamp, shot.arrival)
        known = at is not None and not (self._shots and at <= self._shots[-1][0])
        self._nonsense = max(0, self._nonsense - 1) if known else self._nonsense + 1
        return at

    def _take(self, shot: CameraImage) -> None:
        with self._arrived:
            at = self._when(shot)
            if at is None or (self._shots and at <= self._shots[-1][0]):
                if self._shots and shot.arrival - self._shots[-1][1].arrival > 1.0:
                    self._shots.clear()  # the clock was set back
                return
            if np.isfinite(period := self._period()):
                # a picture that comes too soon after another was only late: it reduces the number of lost ones
                self._recent.append(round((at - self._pace[-1]) / period) - 1)
                self._lost = max(0, self._lost + self._recent[-1])
            self._shots.append((at, shot))
            while len(self._shots) > SETTINGS.feeds_kept and self._shots[SETTINGS.feeds_kept][0] <= at - self.ahead:
                self._shots.popleft()
            self._pace.append(at)
            self._received += 1
            self._trouble = ""
            self._arrived.notify_all()


@dataclass(frozen=True)
class Delivered:
    """Times of the newest pictures of one camera.

    times: (N,) at which they were taken, on the common clock (corrected by the camera's offset), ascending, s.
    arrivals: (N,) at which they arrived, on this computer's clock, ascending, s.
    period: usual time between two pictures, s; NaN while not known.
    """

    times: Array
    arrivals: Array
    period: float


@dataclass(frozen=True)
class _Instant:
    """One instant that several cameras show.

    time: on the common clock, s.
    shots: per camera, the index of the picture that shows it; None: there is none.
    """

    time: float
    shots: tuple[int | None, ...]


def newest_instant(
    cameras: Sequence[Delivered], last: float, now: float, least: int = 2
) -> tuple[_Instant | None, float]:
    """Find the newest instant for which no present camera will send a better picture.

    cameras: times of the pictures of each camera.
    last: time of the last instant that was used, on the common clock, s; only later ones are found.
    now: this computer's clock, s.
    least: least number of cameras that must show it.
    Returns: the instant, or None; and the time (this computer's clock) until which it is worth waiting for more
        pictures.
    """
    there = [c for c, d in enumerate(cameras) if is_there(d, now)]
    known = [cameras[c].period for c in there if np.isfinite(cameras[c].period)]
    if len(there) < least or not known:
        return None, now + 0.05
    period = float(np.median(known))
    times = np.unique(np.concatenate([cameras[c].times for c in there]))
    times = times[times > last + SETTINGS.feeds_new * period]
    waits = [_still_to_come(cameras[c], period, now) for c in there]
    reported = times < min(begin for begin, _ in waits)
    for at in times[reported][::-1][: SETTINGS.feeds_candidates]:
        shots = [_nearest(d, float(at), period) if c in there else None for c, d in enumerate(cameras)]
        if sum(s is not None for s in shots) >= least:
            return _Instant(float(at), tuple(shots)), now
    next_one = times[~reported][:1]
    return None, min([now + period, *(max(until for begin, until in waits if begin <= t) for t in next_one)])


def is_there(camera: Delivered, now: float) -> bool:
    """Return whether a camera still delivers: its last picture is recent.

    now: this computer's clock, s.
    """
    period = camera.period if np.isfinite(camera.period) else 0.0
    return len(camera.arrivals) > 0 and bool(
        now - camera.arrivals[-1] < max(SETTINGS.feeds_gone_s, SETTINGS.feeds_gone_periods * period)
    )


def _still_to_come(camera: Delivered, period: float, now: float) -> tuple[float, float]:
    """Predict the next picture of a camera.

    period: usual time between pictures of all cameras, s, for a camera whose own is not known.
    now: this computer's clock, s.
    Returns: time (common clock) from which instants may get a better picture, and time (this computer's clock) by which
        it should arrive.
    """
    own = camera.period if np.isfinite(camera.period) else period
    # n: number of the next picture after lost ones, of which those not due yet may still come
    n = max(1, math.floor((now - SETTINGS.feeds_slack_s - camera.arrivals[-1]) / own) + 1)
    return float(camera.times[-1]) + (n - 0.5) * own, float(camera.arrivals[-1]) + n * own + SETTINGS.feeds_slack_s


def _nearest(camera: Delivered, time: float, period: float) -> int | None:
    own = max(period, camera.period) if np.isfinite(camera.period) else period
    k = int(np.abs(camera.times - time).argmin())
    return k if abs(float(camera.times[k]) - time) <= SETTINGS.feeds_same * own else None

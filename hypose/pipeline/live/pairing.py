"""Which pictures of several cameras show one instant: free-running or triggered, frames late or lost, a camera gone.

Nothing here waits: the caller says what time it is and is told how long it is worth waiting.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hypose.geometry import Array

SLACK_S = 0.015
"""s that a picture may come later than the rate of its camera promises; after that it is not waited for"""
GONE_S, GONE_PERIODS = 0.5, 6.0
"""s, and frames, without a picture after which a camera is not there"""
_NEW = 0.6
"""share of a period by which an instant lies behind the one before"""
_CANDIDATES = 8
"""newest instants of which nothing more will come that are looked at"""
_SAME = 0.55
"""share of a period within which a picture shows the instant"""


@dataclass(frozen=True)
class Delivered:
    """The last pictures of one camera: times (N,) s on the common clock and arrivals (N,) s on this computer's, both
    ascending; period s between two, NaN while it is not known."""

    times: Array
    arrivals: Array
    period: float


@dataclass(frozen=True)
class Instant:
    """time: s on the common clock; shots: of each camera the index of the picture that shows it, None: it has none."""

    time: float
    shots: tuple[int | None, ...]


def newest_instant(
    cameras: Sequence[Delivered], last: float, now: float, least: int = 2
) -> tuple[Instant | None, float]:
    """The newest instant after `last` (s, common clock) that every camera which is there has told of, or will not tell
    of, by `now` (s, this computer's clock); and until when it is worth waiting for more. So many cameras at
    least show it.
    """
    there = [c for c, d in enumerate(cameras) if is_there(d, now)]
    known = [cameras[c].period for c in there if np.isfinite(cameras[c].period)]
    if len(there) < least or not known:
        return None, now + 0.05
    period = float(np.median(known))
    times = np.unique(np.concatenate([cameras[c].times for c in there]))
    times = times[times > last + _NEW * period]
    waits = [_still_to_come(cameras[c], period, now) for c in there]
    told = times < min(begin for begin, _ in waits)
    for time in times[told][::-1][:_CANDIDATES]:
        shots = [_nearest(d, float(time), period) if c in there else None for c, d in enumerate(cameras)]
        if sum(s is not None for s in shots) >= least:
            return Instant(float(time), tuple(shots)), now
    next_one = times[~told][:1]
    return None, min([now + period, *(max(until for begin, until in waits if begin <= t) for t in next_one)])


def is_there(camera: Delivered, now: float) -> bool:
    """Whether a camera still delivers."""
    period = camera.period if np.isfinite(camera.period) else 0.0
    return len(camera.arrivals) > 0 and bool(now - camera.arrivals[-1] < max(GONE_S, GONE_PERIODS * period))


def _still_to_come(camera: Delivered, period: float, now: float) -> tuple[float, float]:
    """From which instant on (common clock) a picture may come that shows it better than those that are here, and until
    when the first of them may (this computer's clock)."""
    own = camera.period if np.isfinite(camera.period) else period
    # of one that is later than others the pictures after a lost one are not due yet
    n = max(1, math.floor((now - SLACK_S - camera.arrivals[-1]) / own) + 1)
    return float(camera.times[-1]) + (n - 0.5) * own, float(camera.arrivals[-1]) + n * own + SLACK_S


def _nearest(camera: Delivered, time: float, period: float) -> int | None:
    own = max(period, camera.period) if np.isfinite(camera.period) else period
    k = int(np.abs(camera.times - time).argmin())
    return k if abs(float(camera.times[k]) - time) <= _SAME * own else None

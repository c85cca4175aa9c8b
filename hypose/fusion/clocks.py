"""Estimate the offset of a sensor's clock from the arrival of its messages, and the offset between two recordings from
the movement of the person.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from hypose.geometry import Array, procrustes, transform

WINDOW_S = 10.0
"""Period of which the smallest difference is the offset, s (a drift of 100 ppm makes 1 ms in 10 s)."""
_JUMP_S, AGREE_S = 0.25, 0.025
"""s. _JUMP_S: difference from the offset above which a message is suspected. AGREE_S: largest difference between
neighbouring suspected messages that show the same jump."""
_CONFIRM, _GIVE_IN = 3, 30
"""Numbers of suspected messages in a row after which a jump is accepted: where they agree, and in any case."""


class SensorClock:
    """Estimator of the offset between one sensor's clock and the host's.

    A message sent at sensor time s arrives at host time a = s + offset + delay with delay >= 0. The offset is therefore
    estimated by the smallest a - s of the last seconds, as in one-way clock filters. The least delay counts as part of
    the offset. A clock that was set shows as several messages in a row that are off by the same amount; a late message
    or a wrong time stamp does not.
    """

    def __init__(self) -> None:
        self._smallest: deque[tuple[float, float]] = deque()
        self._suspects: list[float] = []
        self._suspect_time = math.nan
        self.jumps = 0

    @property
    def offset(self) -> float:
        """Seconds to add to the sensor's time to get the host's; NaN before the first message."""
        return self._smallest[0][1] if self._smallest else math.nan

    def update(self, sensor_time: float, arrival: float) -> float | None:
        """Add the times of a message, and return its time on the host's clock.

        sensor_time: s on the sensor's clock.
        arrival: s on the host's clock.
        Returns: s on the host's clock, never after the arrival; None while the message's time is implausible.
        """
        difference = arrival - sensor_time
        if self._smallest and abs(difference - self.offset) > _JUMP_S:
            # all persons of one frame count once: a backlog of late frames must not look like a jump
            if sensor_time == self._suspect_time and self._suspects:
                return None
            self._suspect_time = sensor_time
            self._suspects.append(difference)
            last = self._suspects[-_CONFIRM:]
            agreeing = len(last) == _CONFIRM and np.abs(np.diff(last)).max() <= AGREE_S
            if not agreeing and len(self._suspects) < _GIVE_IN:
                return None
            self.jumps += 1
            self._smallest.clear()
        self._suspects.clear()
        while self._smallest and self._smallest[-1][1] >= difference:
            self._smallest.pop()
        self._smallest.append((arrival, difference))
        while self._smallest[0][0] < arrival - WINDOW_S:
            self._smallest.popleft()
        return sensor_time + self.offset


def _body_speed(times: ArrayLike, positions: ArrayLike, at: ArrayLike) -> Array:
    """Compute the mean speed of the joints of a body at given times; the same from every sensor position.

    times: (T,) s of the positions.
    positions: (T, J, 3) m, NaN where missing.
    at: (N,) s.
    Returns: (N,) m/s, 0 in gaps. Steps span a tenth of a second, so that noise counts little.
    """
    t, p = np.asarray(times, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    k = max(1, round(0.1 / max(float(np.median(np.diff(t))), 1e-3))) if len(t) > 1 else 1
    if len(t) <= k:
        return np.zeros(len(np.asarray(at)))
    step = np.linalg.norm(p[k:] - p[:-k], axis=-1)
    known = np.isfinite(step)
    speed = np.where(known, step, 0).sum(1) / np.maximum(known.sum(1), 1)
    speed = np.minimum(speed / np.maximum(t[k:] - t[:-k], 1e-6), 10.0)
    return np.interp(np.asarray(at, dtype=np.float64), (t[k:] + t[:-k]) / 2, speed, left=0.0, right=0.0)


def offset_by_movement(
    times_a: ArrayLike,
    positions_a: ArrayLike,
    times_b: ArrayLike,
    positions_b: ArrayLike,
    *,
    rate: float = 100.0,
    limit: float = 60.0,
) -> tuple[float, float]:
    """Estimate the time offset between the recordings of two sensors from the movement of the person.

    times_a, times_b: (T,) s from each sensor's own start.
    positions_a, positions_b: (T, J, 3) m in each sensor's frame, NaN where missing.
    rate: rate of the correlation, Hz.
    limit: largest offset, s.
    Returns: seconds to add to the times of b, and the correlation of the speeds (0..1). Below 0.5 the offset means
        nothing: the person stood still, or the recordings show different persons.

    The candidates are the peaks of the normalised cross-correlation of the joints' speeds. Because walking is periodic,
    the peak is chosen at which a rigid motion aligns the two skeletons best.
    """
    ta, tb = np.asarray(times_a, dtype=np.float64), np.asarray(times_b, dtype=np.float64)
    start, stop = min(ta[0], tb[0]), max(ta[-1], tb[-1])
    at = np.arange(start, stop, 1 / rate)
    a, b = _body_speed(ta, positions_a, at), _body_speed(tb, positions_b, at)
    width = max(1, round(0.1 * rate))  # sensors smooth differently: compare what lasts a tenth of a second
    box = np.ones(width) / width
    a, b = np.convolve(a, box, "same"), np.convolve(b, box, "same")
    n = len(at)
    size = 1 << (2 * n - 1).bit_length()

    def correlate(x: Array, y: Array) -> Array:
        return np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)

    # normalised over the part where both have data, else the longest overlap always wins
    seen_a, seen_b = ((at >= t[0]) & (at <= t[-1]) for t in (ta, tb))
    wa, wb = seen_a.astype(float), seen_b.astype(float)
    count = np.maximum(correlate(wa, wb), 1e-9)
    sa, sb = correlate(a * wa, wb), correlate(wa, b * wb)
    covariance = correlate(a * wa, b * wb) - sa * sb / count
    va = np.maximum(correlate(a * a * wa, wb) - sa**2 / count, 1e-12)
    vb = np.maximum(correlate(wa, b * b * wb) - sb**2 / count, 1e-12)
    score = covariance / np.sqrt(va * vb)
    lags = np.arange(size)
    lags = np.where(lags > size // 2, lags - size, lags)
    enough = count > min(5 * rate, 0.5 * min(wa.sum(), wb.sum()))
    score = np.where(enough & (np.abs(lags) <= limit * rate), score, -1.0)
    peaks = np.flatnonzero((score >= np.roll(score, 1)) & (score > np.roll(score, -1)) & (score > score.max() - 0.25))
    if not len(peaks):
        return 0.0, 0.0
    peaks = peaks[np.argsort(-score[peaks])][:12]
    pa, pb = np.asarray(positions_a, dtype=np.float64), np.asarray(positions_b, dtype=np.float64)
    best = int(min(peaks, key=lambda k: _apart(ta, pa, tb + lags[k] / rate, pb)))
    fine = lags[best] / rate + np.arange(-12, 13) * 0.01
    values = np.array([_apart(ta, pa, tb + o, pb) for o in fine])
    k = int(np.clip(values.argmin(), 1, len(fine) - 2))
    bend = values[k - 1] - 2 * values[k] + values[k + 1]
    shift = 0.5 * (values[k - 1] - values[k + 1]) / bend if np.isfinite(bend) and bend > 1e-9 else 0.0
    return float(fine[k] + 0.01 * np.clip(shift, -1, 1)), float(score[best])


def _apart(ta: Array, pa: Array, tb: Array, pb: Array) -> float:
    """Compute the RMS distance of the joints of two recordings after the best rigid motion, at 150 common instants or
    fewer.

    ta, tb: (T,) s on one clock.
    pa, pb: (T, J, 3) m, NaN where missing.
    Returns: m; infinity where fewer than 10 instants or 100 joints are common.
    """
    inside = np.flatnonzero((ta > tb[0]) & (ta < tb[-1]))
    inside = inside[:: max(1, len(inside) // 150)]
    if len(inside) < 10:
        return np.inf
    after = np.clip(np.searchsorted(tb, ta[inside]), 1, len(tb) - 1)
    w = ((ta[inside] - tb[after - 1]) / (tb[after] - tb[after - 1]))[:, None, None]
    a, b = pa[inside].reshape(-1, 3), (pb[after - 1] + w * (pb[after] - pb[after - 1])).reshape(-1, 3)
    use = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if use.sum() < 100:
        return np.inf
    motion = procrustes(b[use], a[use])[0]
    return float(np.sqrt(((transform(motion, b[use]) - a[use]) ** 2).sum(1).mean()))

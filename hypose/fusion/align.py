"""Bring skeletons from sensors with their own clocks and rates to common output instants.

Time is an argument of every call, so that tests and simulations run the same code as the live server.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.errors import InputError, refuse
from hypose.evidence.frame import FARTHEST_M, INFERRED, SensorReport, clean_joints
from hypose.fusion.joints import COMMON, joint_set
from hypose.geometry import Array, procrustes, transform

# ---- clocks --------------------------------------------------------------------------------------------------------
# Estimate the offset of a sensor's clock from the arrival of its messages, and the offset between two recordings from
# the movement of the person.


WINDOW_S = 10.0
"""Period of which the smallest difference is the offset, s (a drift of 100 ppm makes 1 ms in 10 s)."""
_JUMP_S, AGREE_S = 0.25, 0.025
"""s. _JUMP_S: difference from the offset above which a message is suspected. AGREE_S: largest difference between
neighbouring suspected messages that show the same jump."""
# Numbers of suspected messages in a row after which a jump is accepted: where they agree, and in any case.
_CONFIRM, _GIVE_IN = 3, 30


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


_LARGEST_OFFSET_S = 60.0
"""Largest time offset between two recordings that is searched, s."""


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
) -> tuple[float, float]:
    """Estimate the time offset between the recordings of two sensors from the movement of the person.

    times_a, times_b: (T,) s from each sensor's own start.
    positions_a, positions_b: (T, J, 3) m in each sensor's frame, NaN where missing.
    Returns: seconds to add to the times of b, and the correlation of the speeds (0..1). Below 0.5 the offset means
        nothing: the person stood still, or the recordings show different persons.

    The candidates are the peaks of the normalised cross-correlation of the joints' speeds. Because walking is periodic,
    the peak is chosen at which a rigid motion aligns the two skeletons best.
    """
    ta, tb = np.asarray(times_a, dtype=np.float64), np.asarray(times_b, dtype=np.float64)
    from scipy import optimize, signal  # take long to import

    rate = 100.0  # of the correlation, Hz
    at = np.arange(min(ta[0], tb[0]), max(ta[-1], tb[-1]), 1 / rate)
    a, b = _body_speed(ta, positions_a, at), _body_speed(tb, positions_b, at)
    width = max(1, round(0.1 * rate))  # sensors smooth differently: compare what lasts a tenth of a second
    box = np.ones(width) / width
    a, b = np.convolve(a, box, "same"), np.convolve(b, box, "same")
    correlate = partial(signal.correlate, method="fft")
    # normalised over the part where both have data, else the longest overlap always wins
    seen_a, seen_b = ((at >= t[0]) & (at <= t[-1]) for t in (ta, tb))
    wa, wb = seen_a.astype(float), seen_b.astype(float)
    count = np.maximum(correlate(wa, wb), 1e-9)
    sa, sb = correlate(a * wa, wb), correlate(wa, b * wb)
    covariance = correlate(a * wa, b * wb) - sa * sb / count
    va = np.maximum(correlate(a * a * wa, wb) - sa**2 / count, 1e-12)
    vb = np.maximum(correlate(wa, b * b * wb) - sb**2 / count, 1e-12)
    score = covariance / np.sqrt(va * vb)
    lags = signal.correlation_lags(len(at), len(at))
    enough = count > min(5 * rate, 0.5 * min(wa.sum(), wb.sum()))
    score = np.where(enough & (np.abs(lags) <= _LARGEST_OFFSET_S * rate), score, -1.0)
    peaks = np.flatnonzero((score >= np.roll(score, 1)) & (score > np.roll(score, -1)) & (score > score.max() - 0.25))
    if not len(peaks):
        return 0.0, 0.0
    peaks = peaks[np.argsort(-score[peaks])][:12]
    pa, pb = np.asarray(positions_a, dtype=np.float64), np.asarray(positions_b, dtype=np.float64)
    best = int(min(peaks, key=lambda k: _apart(ta, pa, tb + lags[k] / rate, pb)))
    near = lags[best] / rate + np.array([-0.12, 0.12])
    fine = optimize.minimize_scalar(lambda o: _apart(ta, pa, tb + o, pb), bounds=near, options={"xatol": 1e-4})
    return float(fine.x), float(score[best])


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
    return float(np.sqrt(((transform(procrustes(b[use], a[use])[0], b[use]) - a[use]) ** 2).sum(1).mean()))


# ---- output instants -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class AlignSettings:
    """Settings of the output instants.

    rate: rate of the output, Hz.
    wait: s for which a frame waits, after its instant, for sensors that have not reported yet; it bounds the latency.
    timeout: s of silence after which a sensor counts as dead and is not waited for.
    hold: s for which a skeleton is continued after its last report.
    horizon: largest time in s over which a movement is extrapolated.
    max_behind: s by which the output may lag after a pause of the whole program before frames are skipped.
    most_sensors: number of sensors beyond which new ones are refused.
    most_people: number of people per sensor beyond which new ones are refused.
    Raises: InputError for a rate, wait, timeout or hold outside its range.
    """

    rate: float = 30.0
    wait: float = 0.005
    timeout: float = 0.5
    hold: float = 0.15
    horizon: float = 0.06
    max_behind: float = 1.0
    most_sensors: int = 16
    most_people: int = 16

    def __post_init__(self) -> None:
        possible = 0 <= self.wait <= 10 and 0 < self.timeout <= 60 and 0 < self.hold <= 10
        faults = {
            f"An output rate of {self.rate:g} Hz is not possible; give 1 to 1000": not 1 <= self.rate <= 1000,
            "wait must be 0 to 10 s, timeout up to 60 s and hold up to 10 s": not possible,
        }
        refuse("", faults)


@dataclass(frozen=True)
class SensorBody:
    """One person as one sensor sees it at an instant.

    person: the sensor's number of the person.
    positions: (15, 3) m in the sensor's frame, NaN where missing.
    state: (15,) state of each joint: 0 missing, 1 inferred, 2 tracked.
    """

    person: int
    positions: Array
    state: NDArray[np.uint8]


@dataclass(frozen=True)
class SensorView:
    """One sensor at an instant.

    name: name of the sensor.
    alive: whether it reported within the time-out before the instant.
    life: number of times that it came back after a silence.
    bodies: the persons that it sees.
    """

    name: str
    alive: bool
    life: int
    bodies: tuple[SensorBody, ...]


@dataclass(frozen=True)
class Instant:
    """All sensors at one output instant.

    index: number of the instant, from 0.
    time: s on the host's clock.
    sensors: one view per sensor.
    """

    index: int
    time: float
    sensors: tuple[SensorView, ...]


_KEPT = 8
_FIT = 4


class _Track:
    """The last reports on one person of one sensor, in order of time.

    Times are those of the sensor's own clock, which keeps the right intervals when a busy machine receives reports in
    bursts.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.reports: list[tuple[Array, NDArray[np.uint8]]] = []  # positions and state

    def add(self, time: float, positions: Array, state: NDArray[np.uint8]) -> bool:
        """Insert a report in order of time; the oldest one goes where there are too many.

        time: s of the sensor's clock.
        positions: (15, 3) m.
        state: (15,) joint states.
        Returns: False for a report that is doubled or older than all that are kept.
        """
        n = len(self.times)
        at = bisect_left(self.times, time)
        if at < n and self.times[at] - time < 1e-6 or at > 0 and time - self.times[at - 1] < 1e-6:
            return False
        if at == 0 and n >= _KEPT:
            return False
        self.times.insert(at, time)
        self.reports.insert(at, (positions, state))
        if n == _KEPT:
            del self.times[0], self.reports[0]
        return True

    def at(self, time: float, period: float, s: AlignSettings) -> tuple[Array, NDArray[np.uint8]] | None:
        """Interpolate, or extrapolate for a short time, what a sensor reported.

        time: s.
        period: time between two frames of the common clock, s.
        Returns: positions and states of the joints (0 missing, 1 inferred, 2 tracked); None where no report is near.
        """
        times = self.times
        k = bisect_left(times, time)
        if k == 0:
            return self.reports[0] if times[0] - time <= 0.5 * period else None
        if k < len(times) and times[k] - times[k - 1] <= s.hold + period:
            w = (time - times[k - 1]) / (times[k] - times[k - 1])
            (a, before), (b, after) = self.reports[k - 1 : k + 1]
            nearer, known = self.reports[k - 1 if w < 0.5 else k]
            state = np.minimum(before, after)
            alone = state == 0  # a joint that one of them lacks is that of the nearer one
            return np.where(alone[:, None], nearer, a + w * (b - a)), np.where(alone, known, state)
        age = time - times[k - 1]
        if k < len(times) and times[k] - time < age:
            return self.reports[k] if times[k] - time <= 0.5 * period else None
        if age > s.hold:
            return None
        return self._ahead(k, time, period, s)

    def _ahead(self, k: int, time: float, period: float, s: AlignSettings) -> tuple[Array, NDArray[np.uint8]]:
        """Extrapolate along a straight line fitted to the last reports, at most `horizon` ahead.

        k: number of reports before the time.
        time: s of the sensor's clock.
        period: s between two reports of the sensor.
        s: settings.
        Returns: positions (15, 3) m and states (15,); tracked joints become inferred where the last report is old.
        Why: a line through two reports alone would double the noise, and holding the last report lags by its age.
        """
        last, state = self.reports[k - 1]
        age = time - self.times[k - 1]
        if age > 1.6 * period:
            state = np.minimum(state, np.uint8(INFERRED))
        first = max(0, k - _FIT)
        while k - first > 1 and self.times[k - 1] - self.times[first] > 4.5 * period:
            first += 1
        n = k - first
        if n < 3:
            return last, state
        t = np.array(self.times[first:k])
        t -= t.mean()
        spread = float(t @ t)
        if spread <= 0:
            return last, state
        # never further than they reach back: reports a few ms apart give no speed, only noise
        ahead = t[-1] + min(age, s.horizon, float(t[-1] - t[0]))
        weights = 1 / n + ahead * t / spread
        line = (weights @ np.stack([reported for reported, _ in self.reports[first:k]]).reshape(n, 45)).reshape(15, 3)
        return np.where(np.isfinite(line), line, last), state


class _Sensor:
    """State that the aligner keeps of one sensor.

    newest: time of the latest report, on the sensor's clock.
    until, since: start and end of its last silence, on the sensor's clock.
    """

    def __init__(self, name: str, s: AlignSettings) -> None:
        self.name = name
        self.until, self.since = -math.inf, -math.inf
        self.clock = SensorClock()
        self.tracks: dict[int, _Track] = {}
        self.arrival = -math.inf
        self.newest = -math.inf
        self.steps: deque[float] = deque(maxlen=31)
        self.alive = False
        self.life = -1
        self.used = self.refused = self.jumps = 0

    @property
    def period(self) -> float:
        return float(np.median(self.steps)) if self.steps else 1 / 30

    def wake(self, time: float, now: float, s: AlignSettings) -> None:
        """Handle a report after a long silence: reset the sensor where it is new or restarted.

        time: s of the sensor's clock.
        now: s of the host's clock.
        s: settings.
        Why: reports that were only late (because this machine was busy) continue the sensor's clock where the last ones
            ended; then nothing is reset.
        """
        ahead = time + self.clock.offset - now  # NaN for a new sensor
        same_clock = self.newest < time and ahead <= AGREE_S and now - self.arrival < WINDOW_S
        if same_clock and time - self.newest <= s.timeout:
            return
        if not same_clock:  # else the delay of a late line would become the clock's offset
            self.clock, self.newest, self.jumps = SensorClock(), -math.inf, 0
            self.until = self.since = -math.inf
        self.tracks.clear()
        self.steps.clear()
        self.life += 1


class Aligner:
    """Buffer that brings the reports of all sensors to the output instants n / rate after the first report.

    settings: settings of the output instants.

    Call `push` for every report and `poll` at the time `due()` or more often. A frame is made as soon as every living
    sensor has reported from its instant or later, and at the latest `wait` after its instant: late sensors are
    extrapolated, dead ones are left out. No sensor can therefore delay a frame for longer.
    """

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self.settings = settings or AlignSettings()
        self._sensors: dict[str, _Sensor] = {}
        self._start = math.nan
        self._next = 0
        self.skipped = 0

    # ---- in ----

    def push(self, report: SensorReport, now: float | None = None) -> bool:
        """Add one report of one sensor.

        report: time in s of the sensor's clock, positions in m.
        now: s on the host's monotonic clock; by default when the report arrived, else the sensor's own time.
        Returns: False where the report was not used (too late, or its time is implausible so far).
        Raises: InputError for an unknown joint set, coordinates that are not metres, or too many sensors or persons.
        """
        sensor, time, person = report.sensor, report.time, report.person
        if now is None:
            now = time if report.arrival is None else report.arrival
        s = self.settings
        if not math.isfinite(time):
            raise InputError(f"The sensor {sensor} sent the time {time}; times are seconds.")
        body = None if person is None else self._checked(sensor, report.joint_names, report.positions, report.state)
        it = self._sensors.get(sensor) or self._new(sensor, now)
        if now - it.arrival > s.timeout:
            it.wake(time, now, s)
        it.alive, it.arrival = True, now
        believed = it.clock.update(time, now) is not None
        if it.clock.jumps != it.jumps:
            it.jumps = it.clock.jumps
            it.tracks.clear()
            it.newest = it.until = it.since = -math.inf
        if not believed:
            it.refused += 1
            return False
        if time > it.newest:
            if time - it.newest > s.timeout:
                it.until, it.since = it.newest, time - it.period
            elif time - it.newest > 1e-4:
                it.steps.append(time - it.newest)
            it.newest = time
        if math.isnan(self._start):
            self._start = time + it.clock.offset
        if person is None or body is None:
            return True
        track = it.tracks.get(person)
        if track is None:
            gone = it.newest - max(1.0, 2 * s.hold)
            it.tracks = {p: t for p, t in it.tracks.items() if not t.times or t.times[-1] >= gone}
            if len(it.tracks) >= s.most_people:
                raise InputError(
                    f"The sensor {sensor} reports more than {s.most_people} persons; the others are ignored."
                )
            track = it.tracks[person] = _Track()
        fresh = track.add(time, *body)
        it.used += fresh
        it.refused += not fresh
        return fresh

    def _checked(
        self, sensor: str, names: Sequence[str], positions: ArrayLike, state: ArrayLike
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Return positions (15, 3) and state (15,) of the common joints of a report; missing joints are NaN and state
        0.
        """
        common = joint_set(tuple(names)).common
        p = np.asarray(positions, dtype=np.float64)
        q = np.asarray(state, dtype=np.uint8)
        if p.shape != (len(names), 3) or q.shape != (len(names),):
            raise InputError(f"The sensor {sensor} names {len(names)} joints but gives {p.shape[0]} positions.")
        p, q = p[common], q[common]
        if p.min() > -FARTHEST_M and p.max() < FARTHEST_M and q.min() > 0:  # the usual case; False for NaN
            return p, q
        return clean_joints(p, q, f"The sensor {sensor}", COMMON)

    def _new(self, name: str, now: float) -> _Sensor:
        """Add a sensor; where there are too many, one that has long been silent makes room.

        now: s of the host's clock.
        Raises: InputError where all sensors are alive.
        """
        s = self.settings
        if len(self._sensors) >= s.most_sensors:
            dead = [x for x in self._sensors.values() if now - x.arrival > 10 * s.timeout]
            if not dead:
                raise InputError(f"There are {s.most_sensors} sensors already; {name} is ignored.")
            del self._sensors[min(dead, key=lambda x: x.arrival).name]
        self._sensors[name] = _Sensor(name, s)
        return self._sensors[name]

    # ---- out ----

    def due(self) -> float:
        """Return the host time at which to call `poll` at the latest; infinite before the first report."""
        if math.isnan(self._start):
            return math.inf
        return self._instant(self._next) + self.settings.wait

    def poll(self, now: float) -> list[Instant]:
        """Return the frames that are ready at host time `now`, in order."""
        if math.isnan(self._start):
            return []
        s = self.settings
        for it in self._sensors.values():
            it.alive = now - it.arrival <= s.timeout
        behind = math.floor((now - s.max_behind - self._instant(self._next)) * s.rate)
        if behind > 0:
            self._next += behind
            self.skipped += behind
        out = []
        while True:
            t = self._instant(self._next)
            alive = [it for it in self._sensors.values() if it.alive]
            complete = bool(alive) and all(it.newest + it.clock.offset >= t for it in alive)
            if now < t or not (complete or now >= t + s.wait):
                return out
            out.append(Instant(self._next, t, tuple(self._view(it, t) for it in self._sensors.values())))
            self._next += 1

    def _instant(self, n: int) -> float:
        return self._start + n / self.settings.rate

    def _view(self, it: _Sensor, t: float) -> SensorView:
        """Interpolate the persons of one sensor at an instant; t: s of the host's clock."""
        s, bodies, period = self.settings, [], it.period
        t -= it.clock.offset
        # frames that are made up for after a pause of this machine may lie before the first report of a living sensor
        covered = it.alive and t <= it.newest + s.timeout and not it.until + s.timeout < t < it.since
        if it.alive:
            for person, track in it.tracks.items():
                # the sensor reported later frames without this person: it has lost the person
                lost = track.times[-1] < it.newest - 1.6 * period and track.times[-1] < t
                found = None if lost else track.at(t, period, s)
                if found is not None and found[1].any():
                    bodies.append(SensorBody(person, *found))
        return SensorView(it.name, covered, max(it.life, 0), tuple(bodies))

    def status(self, now: float) -> list[dict[str, Any]]:
        """Describe the state of each sensor at host time `now`, for display.

        Returns: name; alive (it reported within the time-out); rate of its reports, Hz; offset, s to add to its clock
            to get the host's; jumps of its clock; returns after a silence; numbers of reports used, and refused because
            they came too late or their time was implausible.
        """
        return [
            {
                "name": it.name,
                "alive": now - it.arrival <= self.settings.timeout,
                "rate": round(1 / it.period, 1) if it.steps else 0.0,
                "offset": round(it.clock.offset, 5),
                "jumps": it.clock.jumps,
                "returns": max(it.life, 0),
                "used": it.used,
                "refused": it.refused,
            }
            for it in self._sensors.values()
        ]

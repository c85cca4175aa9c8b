"""Fuse skeletons live: reports of sensors go in, one skeleton per person comes out at a steady rate with bounded
latency.

`align` handles clocks, rates, late and dead sensors; `people` finds identities and the positions of the sensors; `fit`
fuses one skeleton. Nothing here waits or uses sockets: the caller gives the time, so that the live server, tests and
benchmarks run the same code.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.fusion.align import Aligner, AlignSettings, Instant, SensorStatus
from hypose.fusion.fit import FitSettings, FitState, fit_step, start_fit
from hypose.fusion.people import PeopleTracker, SeenPerson
from hypose.geometry import Array


@dataclass(frozen=True)
class LiveSkeleton:
    """One fused person in an output frame.

    id: identifier of the person.
    joints: (15, 3) m, joints.COMMON in the frame of the first sensor.
    sd: (15,) m per axis.
    sensors: names of the sensors that see the person now.
    shares: (15, K) share of each of `LiveFrame.sensors` in each joint.
    seen: whether a sensor sees the person now; else the joints are predicted.
    """

    id: int
    joints: Array
    sd: Array
    sensors: tuple[str, ...]
    shares: Array
    seen: bool


@dataclass(frozen=True)
class LiveFrame:
    """One output frame.

    index: number of the frame, from 0.
    time: s on the host's clock that the frame describes.
    people: one skeleton per person.
    sensors: names of the sensors known so far.
    """

    index: int
    time: float
    people: tuple[LiveSkeleton, ...]
    sensors: tuple[str, ...]


class LiveFuser:
    """Live fusion of the skeletons of several people from several sensors.

    settings: settings of the output instants.

    Call `push` for every report as it arrives, and `poll` at the time `due()` or more often. All times are s of one
    monotonic host clock.
    """

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self.aligner, self.people = Aligner(settings), PeopleTracker()
        self._states: dict[int, FitState] = {}
        _warm_up()

    def push(self, report: SensorReport, now: float | None = None) -> bool:
        """Add one report of one sensor.

        now: arrival on the host's monotonic clock, s; by default that of the report.
        Returns: False where the report was not used, because it is too late or its time is implausible.
        Raises: InputError for an unknown joint set, coordinates that are not metres, or too many sensors or persons.
        """
        return self.aligner.push(report, now)

    def due(self) -> float:
        """Return the host time (s) at which to call `poll` at the latest."""
        return self.aligner.due()

    def poll(self, now: float) -> list[LiveFrame]:
        """Return the frames that are ready at host time `now`, in order."""
        return [self._fuse(instant) for instant in self.aligner.poll(now)]

    def frames(self, reports: Iterable[SensorReport]) -> Iterator[LiveFrame]:
        """Yield the fused frames of a sequence of reports, live (an iterator that waits for the next report) or
        recorded.

        Raises: InputError as `Aligner.push`; reports that cannot be used are skipped.
        """
        for r in reports:
            self.push(r)
            yield from self.poll(r.time if r.arrival is None else r.arrival)

    def status(self, now: float) -> tuple[SensorStatus, ...]:
        """Return the state of each sensor at host time `now`."""
        return self.aligner.status(now)

    def _fuse(self, instant: Instant) -> LiveFrame:
        people = self.people.update(instant)
        alive = {p.id for p in people}
        self._states = {i: s for i, s in self._states.items() if i in alive}
        names = tuple(v.name for v in instant.sensors)
        return LiveFrame(
            instant.index, instant.time, tuple(self._person(p, names, instant.time) for p in people), names
        )

    def _person(self, p: SeenPerson, names: tuple[str, ...], now: float) -> LiveSkeleton:
        """Fuse one person at an instant.

        p: the person's skeletons.
        names: names of all sensors.
        now: s of the host's clock.
        """
        positions, eyes = np.full((len(names), 15, 3), np.nan), np.full((len(names), 3), np.nan)
        state = np.zeros((len(names), 15), dtype=np.uint8)
        for k, name in enumerate(names):
            if name in p.placed:
                positions[k], state[k] = p.placed[name], p.bodies[name].state
                eyes[k] = self.people.transforms[name][:3, 3]
        before = self._states.get(p.id) or start_fit()
        self._states[p.id], estimate = fit_step(before, positions, state, now, FitSettings(), eyes)
        sd = np.sqrt(estimate.variance + estimate.systematic)
        return LiveSkeleton(p.id, estimate.joints, sd, tuple(p.bodies), estimate.shares, p.seen)


def _warm_up() -> None:
    """Compile the code that a frame needs, so that the first frame is not late."""
    standing = np.linspace(0, 1, 45).reshape(1, 15, 3)
    state = start_fit()
    for n in range(2):
        state, _ = fit_step(
            state, standing, np.full((1, 15), 2, dtype=np.uint8), n / 30, FitSettings(), np.zeros((1, 3))
        )

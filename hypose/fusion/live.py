"""Live fusion: reports of sensors in, one skeleton per person out at a steady rate, with a bound on the latency.

The pieces: `align` (clocks, rates, late and dead sensors), `people` (who is who, where the sensors stand), `fit` (one
skeleton). Nothing here waits or knows a socket: the caller says what time it is, so the live server, tests and
benchmarks run the same code.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.fusion.align import Aligner, AlignSettings, Instant, SensorStatus
from hypose.fusion.fit import FitSettings, FitState, fit_step, start_fit
from hypose.fusion.people import PeopleSettings, PeopleTracker, SeenPerson
from hypose.geometry import Array


@dataclass(frozen=True)
class LiveSettings:
    """Settings of the three pieces."""

    align: AlignSettings = field(default_factory=AlignSettings)
    people: PeopleSettings = field(default_factory=PeopleSettings)
    fit: FitSettings = field(default_factory=FitSettings)


@dataclass(frozen=True)
class LiveSkeleton:
    """One fused person.

    id.
    joints (15, 3) m (joints.COMMON) in the frame of the first sensor.
    sd (15,) m per axis.
    sensors that see the person now.
    shares (15, K): what each of `LiveFrame.sensors` carried of each joint.
    seen: some sensor sees it (else prediction).
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

    index from 0.
    time s on the host's clock that it describes.
    people.
    sensors known so far.
    """

    index: int
    time: float
    people: tuple[LiveSkeleton, ...]
    sensors: tuple[str, ...]


class LiveFuser:
    """`push` every report as it arrives, `poll` at `due()` or more often; times are of one monotonic host clock, s."""

    def __init__(self, settings: LiveSettings | None = None) -> None:
        self.settings = settings or LiveSettings()
        self.aligner = Aligner(self.settings.align)
        self.people = PeopleTracker(self.settings.people)
        self._states: dict[int, FitState] = {}
        _warm_up(self.settings.fit)

    def push(self, report: SensorReport, now: float | None = None) -> bool:
        """See `Aligner.push`."""
        return self.aligner.push(report, now)

    def due(self) -> float:
        """Host time at which `poll` has something to say at the latest."""
        return self.aligner.due()

    def poll(self, now: float) -> list[LiveFrame]:
        """Return the frames that are ready, in order."""
        return [self._fuse(instant) for instant in self.aligner.poll(now)]

    def frames(self, reports: Iterable[SensorReport]) -> Iterator[LiveFrame]:
        """The frames as reports bring them, for a caller with nothing else to do: live (an iterator that waits for the
        next report) or recorded. Reports that are of no use are passed over; see `push` for errors."""
        for r in reports:
            self.push(r)
            yield from self.poll(r.time if r.arrival is None else r.arrival)

    def status(self, now: float) -> tuple[SensorStatus, ...]:
        """What each sensor does."""
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
        positions, eyes = np.full((len(names), 15, 3), np.nan), np.full((len(names), 3), np.nan)
        state = np.zeros((len(names), 15), dtype=np.uint8)
        for k, name in enumerate(names):
            if name in p.placed:
                positions[k], state[k] = p.placed[name], p.bodies[name].state
                eyes[k] = self.people.transforms[name][:3, 3]
        before = self._states.get(p.id) or start_fit()
        self._states[p.id], estimate = fit_step(before, positions, state, now, self.settings.fit, eyes)
        sd = np.sqrt(estimate.variance + estimate.systematic)
        return LiveSkeleton(p.id, estimate.joints, sd, tuple(p.bodies), estimate.shares, p.seen)


def _warm_up(settings: FitSettings) -> None:
    """Compile what a frame needs, so that the first one is not late."""
    standing = np.linspace(0, 1, 45).reshape(1, 15, 3)
    state = start_fit()
    for n in range(2):
        state, _ = fit_step(state, standing, np.full((1, 15), 2, dtype=np.uint8), n / 30, settings, np.zeros((1, 3)))

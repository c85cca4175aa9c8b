"""Live fusion without sockets: reports go through a fuser as the live server would send them; nothing sleeps."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.fusion.people import LiveFrame, LiveFuser


def replay(
    fuser: LiveFuser, reports: Iterable[SensorReport], stopwatch: Callable[[], float] | None = None
) -> list[tuple[LiveFrame, float]]:
    """Run reports, in order of arrival, through a fuser as the live server would; nothing sleeps.

    Returns the frames, each with its latency in s: from the instant that it describes to when it is ready. With a
    stopwatch (`time.perf_counter`) the computation's own time counts as well, and delays what comes after.
    """
    out: list[tuple[LiveFrame, float]] = []
    busy_until = -np.inf

    def work(at: float, call: Callable[[float], list[LiveFrame]]) -> None:
        nonlocal busy_until
        begin = max(at, busy_until)
        before = stopwatch() if stopwatch else 0.0
        frames = call(begin)
        busy_until = begin + (stopwatch() - before if stopwatch else 0.0)
        out.extend((f, busy_until - f.time) for f in frames)

    for r in reports:
        arrival = r.time if r.arrival is None else r.arrival
        while (due := fuser.due()) < arrival:
            work(due + 1e-9, fuser.poll)

        def take(now: float, r: SensorReport = r) -> list[LiveFrame]:
            fuser.push(r, now)
            return fuser.poll(now)

        work(arrival, take)
    return out

"""Timing of short calls on machines that others use too."""

from __future__ import annotations

import time
from collections.abc import Callable


def best(call: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of the fastest of some calls: the figure that other load on the machine disturbs least.

    clock: time.thread_time (processor time of this thread) for what uses no second thread is disturbed less still."""
    seconds = []
    for _ in range(repeats):
        begin = clock()
        call()
        seconds.append(clock() - begin)
    return min(seconds)

"""Timing of short calls on machines that others use too."""

from __future__ import annotations

import time
from collections.abc import Callable


def best(call: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of some calls: the figure that other load on the machine disturbs least."""
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)

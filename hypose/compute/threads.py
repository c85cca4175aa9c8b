"""Number of threads of a call, and distribution of work over them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from functools import cache
from typing import Any, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def default_threads() -> int:
    """Return the default number of threads: NUMBA_NUM_THREADS where set, else the number of cores of this process."""
    wanted = os.environ.get("NUMBA_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    # one per process: in a forked child the parent's pool looks alive but has no threads
    """Make the pool of threads of a process (its id), once per number of threads."""
    return ThreadPoolExecutor(threads, thread_name_prefix="hypose")


def over_chunks(work: Callable[[int, int], None], n: int, threads: int | None, smallest: int = 1) -> None:
    """Call work(start, stop) on contiguous chunks of range(n), in several threads (work must release the GIL).

    threads: number of threads; None: the default.
    smallest: least size of a chunk.
    Why Python threads around serial kernels instead of numba's parallel loops: nothing is compiled twice, there is no
    process-wide number of threads, and numba's default layer must not be entered from two Python threads at once.
    """
    most = n // max(smallest, 1)
    count = min(threads if threads is not None else default_threads(), most) if most > 1 else 1
    if count <= 1:
        if n:
            work(0, n)
        return
    # more chunks than threads, taken as they come: a core may be busy with the evidence of the next frame
    pieces = min(3 * count, most)
    cuts = [n * k // pieces for k in range(pieces + 1)]
    chunks = iter(zip(cuts[:-1], cuts[1:], strict=True))  # next() on it is atomic

    def take() -> None:
        for first, last in chunks:
            work(first, last)

    waiting = [_pool(count - 1, os.getpid()).submit(take) for _ in range(count - 1)]
    try:
        take()
    finally:  # also after an error no thread may continue to work on the caller's arrays
        begun = [future for future in waiting if not future.cancel()]
        wait(begun)
    for future in begun:
        future.result()


def in_threads(work: Callable[[_Item], _Result], items: Sequence[_Item]) -> list[_Result]:
    """Compute work(item) for every item, in several threads (work must release the GIL)."""
    found: list[Any] = [None] * len(items)

    def some(first: int, last: int) -> None:
        found[first:last] = [work(item) for item in items[first:last]]

    over_chunks(some, len(items), None)
    return found


def in_background(work: Callable[[], _Result]) -> Callable[[], _Result]:
    """Start work() in another thread where one is free, in parallel to the work of the caller.

    Returns: function that waits for the result, or computes it where no thread has started.
    """
    threads = default_threads()
    if threads < 2:
        return work
    began = _pool(threads - 1, os.getpid()).submit(copy_context().run, work)
    return lambda: work() if began.cancel() else began.result()

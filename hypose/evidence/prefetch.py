"""Read coming frames and prepare their masks for tracking in another thread, while the current frame is tracked."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context

from hypose.evidence.frame import Frame, Silhouettes


def look_ahead(frames: Iterable[Frame], count: int = 2) -> Generator[Frame, None, None]:
    """Yield the same frames, read and prepared in another thread `count` frames ahead.

    An exception raised while reading a frame is raised at that frame's turn.
    """
    source = iter(frames)
    context = copy_context()  # it holds the choice of the back end
    pool = ThreadPoolExecutor(1, thread_name_prefix="ahead")
    try:
        waiting: deque[Future[Frame | None]] = deque(pool.submit(context.run, _next, source) for _ in range(count))
        while (frame := waiting.popleft().result()) is not None:
            waiting.append(pool.submit(context.run, _next, source))
            yield frame
    finally:
        pool.shutdown(cancel_futures=True)


def _next(source: Iterator[Frame]) -> Frame | None:
    """Read the next frame and prepare its masks; None at the end."""
    frame = next(source, None)
    for masks in frame.of(Silhouettes) if frame is not None else ():
        _ = masks.outlines, masks.prepared  # computed here, and kept with the masks
    return frame

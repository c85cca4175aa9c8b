"""Prepare the masks of coming frames for tracking in other threads, while the current frame is tracked.

The results depend on the masks alone. `make_ahead` announces results that other code computes, `look_ahead` computes
them for the next frames, and `outlines` and `prepared_masks` use them or compute them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace

import numpy as np

from hypose.compute.arrays import PreparedMasks, prepare_masks
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.outlines import (
    OUTLINE_POINTS,
    WORKING_HEIGHT,
    Outlines,
    ViewOutline,
    stack_outlines,
    view_outline,
)

LEAST_AREA = 200
"""px: least area by which a view's energy is divided, for a person of whom less is expected"""
_Views = Callable[[], list[ViewOutline | None] | None]


@dataclass(frozen=True)
class _Made:
    """Results kept with silhouettes; views: function that waits for the outlines; stacked, masks: as returned by
    `outlines`, `prepared_masks`.
    """

    views: _Views | None = None
    stacked: Outlines | None = None
    masks: PreparedMasks | None = None


_NOTHING = _Made()


def _keep(silhouettes: Silhouettes, made: _Made) -> None:
    object.__setattr__(silhouettes, "ahead", made)  # a frozen value with a cache, like a cached property


def make_ahead(silhouettes: Silhouettes, views: _Views) -> None:
    """Register a function that delivers the outlines of these silhouettes, which other code is computing for
    tracking.

    views: function that waits for the outlines and returns one per view (None for a view without one), or returns
        None when no outlines will come. The results are kept as long as the silhouettes.
    """
    _keep(silhouettes, _Made(views))


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
    if frame is not None and frame.silhouettes is not None:
        make_now(frame.silhouettes)
    return frame


def make_now(silhouettes: Silhouettes) -> None:
    """Compute the outlines of silhouettes and prepare their masks for the scorer now, and store both with the
    silhouettes, for masks that are tracked more than once.
    """
    made = outlines(silhouettes, OUTLINE_POINTS, WORKING_HEIGHT)
    _keep(silhouettes, _Made(None, made, prepared_masks(silhouettes)))


def outlines(silhouettes: Silhouettes, count: int = OUTLINE_POINTS, working_height: int | None = None) -> Outlines:
    """Compute the outlines of a frame's usable views, or take them from the cache.

    count: points per view.
    working_height: for tracking: a mask taller than this is shrunk, px; None: it is not shrunk.
    """
    known: _Made = silhouettes.ahead or _NOTHING
    tracking = (count, working_height) == (OUTLINE_POINTS, WORKING_HEIGHT)
    if tracking and known.stacked is not None:
        return known.stacked
    ready = known.views() if tracking and known.views is not None else None
    made, ignored, expected = list[ViewOutline | None](), silhouettes.ignored, silhouettes.expected
    for c, (w, h) in enumerate(silhouettes.rig.sizes.tolist()):
        view = None if ready is None or not silhouettes.usable[c] else ready[c]
        if silhouettes.usable[c] and view is None:
            hidden = ()
            if ignored is not None and expected is not None and silhouettes.shared[c]:
                hidden = ignored[c, :h, :w], expected.boxes[c]
            view = view_outline(silhouettes.masks[c, :h, :w], count, working_height, *hidden)
        made.append(view)
    return stack_outlines(made, count)


def pack_once(silhouettes: Silhouettes) -> None:
    """Prepare the masks for the silhouette scorer now, and store the result with the silhouettes."""
    known: _Made = silhouettes.ahead or _NOTHING
    if known.masks is None:
        _keep(silhouettes, replace(known, masks=prepared_masks(silhouettes)))


def prepared_masks(silhouettes: Silhouettes) -> PreparedMasks:
    """Prepare the masks of one frame for the silhouette scorer, or take them from the cache.

    A view without foreground is not usable, so nothing is divided by zero (Alcoverro 2014 does not say this after eq.
    2.8).
    """
    known: _Made = silhouettes.ahead or _NOTHING
    if known.masks is not None:
        return known.masks
    rig = silhouettes.rig
    norm = None
    if silhouettes.ignored is not None and silhouettes.expected is not None:
        expected = np.maximum(silhouettes.expected.areas, LEAST_AREA)
        norm = np.where(silhouettes.shared, expected, np.nan)
    made = prepare_masks(silhouettes.masks, silhouettes.usable, rig.sizes, rig.projections, silhouettes.ignored, norm)
    return made._replace(usable=made.usable & (made.areas > 0))

"""What the tracker wants of a frame's masks, made by other threads while the frame before is being tracked.

It depends on the masks alone, so the code that holds the masks may make it: `make_ahead` tells that it does,
`look_ahead` does so for the frames to come, and `outlines` and `prepared_masks` take it from there or make it.
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
    shared_outline,
    stack_outlines,
    view_outline,
)

LEAST_AREA = 200
"""px: a person of whom less is expected weighs no more than that"""
_Views = Callable[[], list[ViewOutline | None] | None]


@dataclass(frozen=True)
class _Made:
    """views: waits for the outlines for tracking; stacked, masks: what `outlines` and `prepared_masks` return."""

    views: _Views | None = None
    stacked: Outlines | None = None
    masks: PreparedMasks | None = None


_NOTHING = _Made()


def _keep(silhouettes: Silhouettes, made: _Made) -> None:
    object.__setattr__(silhouettes, "ahead", made)  # a value with a memory, as with a cached property


def make_ahead(silhouettes: Silhouettes, views: _Views) -> None:
    """Tell that the outlines for tracking of these silhouettes are being made: `views` waits for them and returns one
    per view (None where there is none), or None when they will not come. They are forgotten with the silhouettes."""
    _keep(silhouettes, _Made(views))


def look_ahead(frames: Iterable[Frame], count: int = 2) -> Generator[Frame, None, None]:
    """The same frames, taken from `frames` by another thread, `count` of them before they are asked for, and what
    tracking wants of their masks made. What taking a frame raises is raised when its turn comes."""
    source = iter(frames)
    context = copy_context()  # which back end to use is said there
    pool = ThreadPoolExecutor(1, thread_name_prefix="ahead")
    try:
        waiting: deque[Future[Frame | None]] = deque(pool.submit(context.run, _next, source) for _ in range(count))
        while (frame := waiting.popleft().result()) is not None:
            waiting.append(pool.submit(context.run, _next, source))
            yield frame
    finally:
        pool.shutdown(cancel_futures=True)


def _next(source: Iterator[Frame]) -> Frame | None:
    frame = next(source, None)
    if frame is not None and frame.silhouettes is not None:
        make_now(frame.silhouettes)
    return frame


def make_now(silhouettes: Silhouettes) -> None:
    """Makes all that tracking wants of these masks, and keeps it with them for code that tracks them more than
    once."""
    made = outlines(silhouettes, OUTLINE_POINTS, WORKING_HEIGHT)
    _keep(silhouettes, _Made(None, made, prepared_masks(silhouettes)))


def outlines(silhouettes: Silhouettes, count: int = OUTLINE_POINTS, working_height: int | None = None) -> Outlines:
    """The outlines of a frame's usable views, with `count` points each; working_height as for `view_outline`."""
    known: _Made = silhouettes.ahead or _NOTHING
    tracking = (count, working_height) == (OUTLINE_POINTS, WORKING_HEIGHT)
    if tracking and known.stacked is not None:
        return known.stacked
    ready = known.views() if tracking and known.views is not None else None
    made: list[ViewOutline | None] = []
    for c, (w, h) in enumerate(silhouettes.rig.sizes.tolist()):
        view = None if ready is None or not silhouettes.usable[c] else ready[c]
        if silhouettes.usable[c] and view is None:
            view = _outline(silhouettes, c, (w, h), count, working_height)
        made.append(view)
    return stack_outlines(made, count)


def _outline(
    silhouettes: Silhouettes, view: int, size: tuple[int, int], count: int, working_height: int | None
) -> ViewOutline:
    """The outline of one view, of size (w, h); of the known part where a part is ignored."""
    w, h = size
    mask, ignored = silhouettes.masks[view, :h, :w], silhouettes.ignored
    if ignored is None or silhouettes.expected is None or not silhouettes.shared[view]:
        return view_outline(mask, count, working_height)
    box = silhouettes.expected.boxes[view]
    return shared_outline(mask, ignored[view, :h, :w], box, count, working_height)


def pack_once(silhouettes: Silhouettes) -> None:
    """Makes the masks for the scorer now, and keeps them with the silhouettes for later use."""
    known: _Made = silhouettes.ahead or _NOTHING
    if known.masks is None:
        _keep(silhouettes, replace(known, masks=prepared_masks(silhouettes)))


def prepared_masks(silhouettes: Silhouettes) -> PreparedMasks:
    """The masks of one frame as compute's silhouette scorer takes them.

    A view without foreground is left out, never divided by zero (Alcoverro 2014, after eq. 2.8, says nothing of it).
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

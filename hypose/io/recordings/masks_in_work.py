"""The masks of a stream's frames: packed, in the making, and kept for whoever asks for a frame again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.evidence.frame import Colours
from hypose.evidence.outlines import OUTLINE_POINTS, WORKING_HEIGHT, ViewOutline, outline_of_runs
from hypose.evidence.silhouettes import MaskRuns

KEPT_BYTES = 64 << 20
"""of masks that are kept: ten minutes of four cameras"""


@dataclass(frozen=True)
class PackedMask:
    """A mask, or why there is none; its colours, where they are wanted and known, and their edges in its box."""

    runs: MaskRuns | None
    reason: str
    colours: tuple[NDArray[np.uint16], NDArray[np.uint8]] | None = None

    @property
    def area(self) -> int:
        """px, 0 where there is no mask."""
        return 0 if self.runs is None else self.runs.area

    def outline(self) -> ViewOutline | None:
        """Of the mask, for tracking, or None."""
        return None if self.runs is None else outline_of_runs(self.runs, OUTLINE_POINTS, WORKING_HEIGHT)


class KeptMasks:
    """Masks that have been made once, by view and frame, as long as there is room; those with colours take too much."""

    def __init__(self) -> None:
        self._masks, self._bytes = dict[tuple[int, int], PackedMask](), 0

    def get(self, view: int, index: int) -> PackedMask | None:
        """The one that is kept."""
        return self._masks.get((view, index))

    def keep(self, view: int, index: int, mask: PackedMask) -> PackedMask:
        """Keeps a mask, and returns it."""
        size = 0 if mask.runs is None else len(mask.runs.code)
        if mask.colours is None and self._bytes + size <= KEPT_BYTES:
            self._masks[view, index] = mask
            self._bytes += size
        return mask


class PendingMasks:
    """The masks and outlines of one frame, in the making: a task per view in that view's lane, or two, where it is not
    known from the beginning that there shall be outlines."""

    def __init__(
        self, lanes: Sequence[Executor], make: Callable[[int, int], PackedMask], index: int, outlined: bool
    ) -> None:
        def task(view: int) -> tuple[PackedMask, ViewOutline | None]:
            mask = make(view, index)
            return mask, mask.outline() if outlined else None

        self._done = [lane.submit(task, c) for c, lane in enumerate(lanes)]
        self._outlined = outlined
        self._outlines: list[Future[ViewOutline | None]] | None = None
        self.asked = False  # for the outlines, which a picture of the masks does without

    def _masks(self) -> list[PackedMask]:
        return [f.result()[0] for f in self._done]

    def masks(self) -> tuple[list[MaskRuns | None], list[str]]:
        """Of all views, and why there is none; waits for them."""
        done = self._masks()
        return [d.runs for d in done], [d.reason for d in done]

    def areas(self) -> NDArray[np.int64]:
        """(C,) px; waits for them."""
        return np.array([d.area for d in self._masks()])

    def colours(self, shape: tuple[int, ...]) -> Colours | None:
        """Of masks (C, h, w) = shape; None when no view has any."""
        codes, seen = np.zeros(shape, np.uint16), np.zeros(shape[0], np.bool_)
        edges = np.zeros((shape[0], 2, *shape[1:]), np.uint8)
        for c, found in enumerate(self._masks()):
            if found.colours is not None and found.runs is not None:
                y0, y1, x0, x1 = found.runs.box
                codes[c, y0:y1, x0:x1], edges[c, :, y0:y1, x0:x1] = found.colours
                seen[c] = True
        return Colours(codes, seen, edges) if seen.any() else None

    def begin_outlines(self, lanes: Sequence[Executor]) -> None:
        """In the lane of each view, behind its mask, which is therefore done by then."""
        if not self._outlined:
            self._outlined = True
            self._outlines = [lane.submit(_outline, f) for lane, f in zip(lanes, self._done, strict=True)]

    def outlines(self) -> list[ViewOutline | None] | None:
        """Those that were begun; None when they are not made, or no more."""
        self.asked = True
        try:
            if self._outlines is not None:
                return [f.result() for f in self._outlines]
            return [f.result()[1] for f in self._done] if self._outlined else None
        except CancelledError:  # the stream was closed
            return None

    def cancel(self) -> None:
        """Nobody wants them any more."""
        for future in [*self._done, *(self._outlines or [])]:
            future.cancel()


def _outline(done: Future[tuple[PackedMask, ViewOutline | None]]) -> ViewOutline | None:
    return done.result()[0].outline()

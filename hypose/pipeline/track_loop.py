"""Frames tracked one after the other, with checkpoints: those of a whole recording, or of a chunk of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hypose.errors import HyposeError
from hypose.evidence.ahead import look_ahead
from hypose.evidence.frame import Frame
from hypose.io.motions.results import Checkpoint
from hypose.pipeline.doubts import looked_at
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.pictures import FrameSource, tracked_frames
from hypose.tracking.tracker import (
    FrameEstimate,
    Tracker,
    TrackerState,
    estimates_from_arrays,
    estimates_to_arrays,
)


@dataclass(frozen=True)
class FrameList:
    """Frames in memory as a recording to be tracked, frame_rate Hz: of a scene, of cameras or masks of your own."""

    frames: Sequence[Frame]
    frame_rate: float = 25.0

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int, /) -> Frame:
        """Frame number index, 0 <= index < len."""
        return self.frames[index]


Progress = Callable[[str, int, int], None]
"""progress(stage, done, total) is called often; raising KeyboardInterrupt in it stops the run with its work kept."""


class Deferred:
    """A progress call whose interruption waits until `settle`: what is begun is done before, and a run that goes on
    later goes on to the same."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._stopped = progress, False

    def __call__(self, stage: str, done: int, total: int) -> None:
        """The progress of a stage; see Progress."""
        try:
            self._progress(stage, done, total)
        except KeyboardInterrupt:
            self._stopped = True

    def settle(self) -> None:
        """The KeyboardInterrupt, if there was one."""
        if self._stopped:
            raise KeyboardInterrupt


@dataclass(frozen=True)
class Keep:
    """Where a run keeps its state: the checkpoint's path; the identity of the run; every: frames between two writings,
    at least; finished: write it when all frames are done as well."""

    path: Path
    identity: Mapping[str, Any]
    every: int = 25
    finished: bool = False


@dataclass(frozen=True)
class Tracked:
    """frames: the numbers of those that are done; estimates: one for each; state: after the last of them. error: what
    ended it early; None when it is complete or was interrupted."""

    frames: range
    estimates: list[FrameEstimate]
    state: TrackerState
    complete: bool = True
    error: HyposeError | None = None


def track_frames(
    source: FrameSource,
    frames: range,
    tracker: Tracker,
    begin: TrackerState,
    subject: Subject,
    *,
    keep: Keep | None = None,
    before: Tracked | None = None,
    progress: Progress,
) -> Tracked:
    """Tracks `frames`, from the state `begin`, or behind what was done `before`.

    KeyboardInterrupt, and with `keep` a HyposeError too, end it with what is done until then; they are passed on when
    that is nothing.
    """
    state, estimates = (before.state, list(before.estimates)) if before is not None else (begin, [])
    saved, total, looks = len(estimates), len(frames), _Looks(state, estimates)
    error: HyposeError | None = None
    try:
        rest = frames[saved:]
        last = source.frame(rest[0] - 1) if rest and rest[0] > 0 else None
        with (
            contextlib.closing(look_ahead(tracked_frames(source, rest, tracker.recipe.needs, subject))) as coming,
            contextlib.closing(looks),
        ):
            for done in range(saved, total):
                progress("track", done, total)
                frame = next(coming)
                state, estimate = tracker.step(state, frame)
                looks.begin(state, partial(looked_at, tracker, estimate, frame, last))
                last = frame
                # all frames are written every time, so ever fewer times: the work of an hour of film stays linear
                if keep is not None and done + 1 - saved >= max(keep.every, saved // 20) and done + 1 < total:
                    looks.end()
                    _save(keep, Tracked(frames, estimates, looks.state))
                    saved = done + 1
        progress("track", total, total)
    except KeyboardInterrupt:
        if not estimates:
            raise
    except HyposeError as problem:
        if not estimates or keep is None:
            raise
        error = problem
    out = Tracked(frames[: len(estimates)], estimates, looks.state, error is None and len(estimates) == total, error)
    if keep is not None and (keep.finished or not out.complete):
        with (
            contextlib.suppress(HyposeError) if error is not None else contextlib.nullcontext()
        ):  # the first one counts
            _save(keep, out)
    return out


class _Looks:
    """What was seen in each frame, found out by another thread while the next one is tracked: tracking does not ask.

    state, estimates: after the last frame that has been looked at."""

    def __init__(self, state: TrackerState, estimates: list[FrameEstimate]) -> None:
        self.state, self.estimates = state, estimates
        self._context = copy_context()  # which back end to use is said there
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="look")
        self._coming: tuple[TrackerState, Future[FrameEstimate]] | None = None

    def begin(self, state: TrackerState, look: Callable[[], FrameEstimate]) -> None:
        """Of the next frame, whose estimate `look` returns; waits for the one before."""
        self.end()
        self._coming = state, self._pool.submit(self._context.run, look)

    def end(self) -> None:
        """Waits for the last one."""
        coming, self._coming = self._coming, None
        if coming is not None:
            self.estimates.append(coming[1].result())
            self.state = coming[0]

    def close(self) -> None:
        """The same, and no more after it."""
        try:
            self.end()
        finally:
            self._pool.shutdown()


def tracked_before(path: Path, identity: Mapping[str, Any], stop: int) -> Tracked | None:
    """What a checkpoint of the same run holds, complete when it reaches `stop`; None when there is none."""
    if not path.exists():
        return None
    saved = Checkpoint.load(path, identity)
    done = {k.removeprefix("done_"): v for k, v in saved.arrays.items() if k.startswith("done_")}
    estimates = estimates_from_arrays(done)
    first = int(saved.meta.get("first", 0))
    frames = range(first, first + len(estimates))
    return Tracked(frames, estimates, TrackerState.from_arrays(saved.arrays), frames.stop == stop)


def _save(keep: Keep, tracked: Tracked) -> None:
    arrays = {**tracked.state.to_arrays()}
    arrays |= {f"done_{k}": v for k, v in estimates_to_arrays(tracked.estimates).items()}
    meta = {"first": tracked.frames.start}
    Checkpoint(len(tracked.estimates), arrays, meta, keep.identity).save(keep.path)

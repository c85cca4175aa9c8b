"""Track the frames of a clip one after the other, with checkpoints."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypose.errors import HyposeError
from hypose.evidence.frame import Frame
from hypose.evidence.prefetch import look_ahead
from hypose.io.motions.results import Checkpoint
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.frame_anomalies import looked_at
from hypose.pipeline.one_camera import FrameSource, tracked_frames
from hypose.tracking.tracker import (
    FrameEstimate,
    Tracker,
    TrackerState,
    estimates_from_arrays,
    estimates_to_arrays,
)


@dataclass(frozen=True)
class FrameList:
    """Frames in memory that can be tracked like a recording, e.g. of a synthetic scene or of your own cameras.

    frame_rate: Hz.
    """

    frames: Sequence[Frame]
    frame_rate: float = 25.0

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, 0 <= index < len."""
        return self.frames[index]


StageProgress = Callable[[str, int, int], None]
"""Called often as progress(stage, done, total); raising KeyboardInterrupt in it stops the run and keeps its work."""


class Deferred:
    """Progress function that holds back a KeyboardInterrupt until `settle` is called.

    Why: work that has begun is finished first, so a resumed run continues from the same state.
    """

    def __init__(self, progress: StageProgress) -> None:
        self._progress, self._stopped = progress, False

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report the progress of a stage; see StageProgress."""
        try:
            self._progress(stage, done, total)
        except KeyboardInterrupt:
            self._stopped = True

    def settle(self) -> None:
        """Raise the KeyboardInterrupt that was held back, if there was one."""
        if self._stopped:
            raise KeyboardInterrupt


@dataclass(frozen=True)
class Keep:
    """Where and how often a run writes its checkpoint.

    path: file of the checkpoint.
    identity: identity of the run, which must match to resume it.
    every: least number of frames between two checkpoints.
    """

    path: Path
    identity: Mapping[str, Any]
    every: int = 25


@dataclass(frozen=True)
class Tracked:
    """Result of tracking frame by frame.

    estimates: of the frames that are done.
    state: state of the tracker after the last of them.
    complete: every frame was tracked.
    error: error that ended tracking early; None when it is complete or was interrupted.
    """

    estimates: list[FrameEstimate]
    state: TrackerState
    complete: bool = True
    error: HyposeError | None = None


def track_frames(
    source: FrameSource,
    tracker: Tracker,
    begin: TrackerState,
    subject: TrackedSubject,
    *,
    keep: Keep | None = None,
    before: Tracked | None = None,
    progress: StageProgress,
) -> Tracked:
    """Track the frames of a source one after the other.

    begin: state of the tracker before the first frame.
    subject: the subject, for detections that some recipes need.
    keep: where checkpoints are written; None: nowhere.
    before: result of an earlier part; tracking continues after it.
    progress: called with stage, done, total.
    Returns: the tracked frames. After a KeyboardInterrupt, and with `keep` also after a HyposeError, those done until
        then; without any the exception is raised.

    Why a second thread: the statistics of each frame do not influence tracking, so they are computed while the next
    frame is tracked.
    """
    state, estimates = (before.state, list(before.estimates)) if before is not None else (begin, [])
    saved, total, context = len(estimates), len(source), copy_context()  # it holds the choice of the back end
    looked, looking = state, list[tuple[TrackerState, Future[FrameEstimate]]]()
    error: HyposeError | None = None

    def settle() -> None:
        nonlocal looked
        while looking:
            after, found = looking.pop()
            estimates.append(found.result())
            looked = after

    try:
        rest = range(saved, total)
        last = source.frame(saved - 1) if rest and saved else None
        with contextlib.ExitStack() as stack:
            frames = look_ahead(tracked_frames(source, rest, tracker.recipe.needs, subject))
            coming = stack.enter_context(contextlib.closing(frames))
            pool = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="look"))
            stack.callback(settle)
            for done in rest:
                progress("track", done, total)
                frame = next(coming)
                state, estimate = tracker.step(state, frame)
                settle()
                looking.append((state, pool.submit(context.run, looked_at, tracker, estimate, frame, last)))
                last = frame
                # each checkpoint holds all frames, so it is written ever less often: the total work stays linear
                if keep is not None and done + 1 - saved >= max(keep.every, saved // 20) and done + 1 < total:
                    settle()
                    _save(keep, Tracked(estimates, looked))
                    saved = done + 1
        progress("track", total, total)
    except KeyboardInterrupt:
        if not estimates:
            raise
    except HyposeError as problem:
        if not estimates or keep is None:
            raise
        error = problem
    out = Tracked(estimates, looked, error is None and len(estimates) == total, error)
    if keep is not None:
        with contextlib.suppress(*(() if error is None else (HyposeError,))):  # the first error counts
            _save(keep, out)
    return out


def tracked_before(path: Path, identity: Mapping[str, Any]) -> Tracked | None:
    """Load the tracked frames from a checkpoint of the same run; None where there is none."""
    if not path.exists():
        return None
    saved = Checkpoint.load(path, identity)
    done = {k.removeprefix("done_"): v for k, v in saved.arrays.items() if k.startswith("done_")}
    return Tracked(estimates_from_arrays(done), TrackerState.from_arrays(saved.arrays), False)


def _save(keep: Keep, tracked: Tracked) -> None:
    done = {f"done_{k}": v for k, v in estimates_to_arrays(tracked.estimates).items()}
    Checkpoint(len(tracked.estimates), tracked.state.to_arrays() | done, {}, keep.identity).save(keep.path)

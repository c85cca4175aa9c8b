"""Tracks one recording: frames -> subject -> start -> tracker -> Motion, with progress, checkpoints and resume."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import HyposeError, InputError
from hypose.evidence.ahead import look_ahead
from hypose.evidence.frame import Frame
from hypose.io.bodies import save_body
from hypose.io.provenance import identity
from hypose.io.results import Checkpoint, ResultsFolder, save_motion
from hypose.pipeline.colour_detections import tracked_frames
from hypose.pipeline.subject import Subject, SubjectOptions, find_subject
from hypose.tracking.recipes import recipe
from hypose.tracking.smooth_motion import smooth_motion
from hypose.tracking.tracker import (
    FrameEstimate,
    Tracker,
    TrackerSettings,
    TrackerState,
    estimates_from_arrays,
    estimates_to_arrays,
    motion_of,
)


class FrameSource(Protocol):
    """Frames by number: hypose.io.frames.FrameStream, or any synthetic scene."""

    def __len__(self) -> int: ...

    def frame(self, index: int, /) -> Frame:
        """Frame number index, 0 <= index < len."""
        ...


@dataclass(frozen=True)
class TrackOptions:
    """What a user chooses. recipe: a preset's name; refine: contour refinement after a published recipe; evidence:
    'silhouettes', 'keypoints' or 'both'; start, height, girths: see SubjectOptions;
    subject: where the given body comes from (then `track_source` takes its body as it is); smooth: solve all frames
    together at the end; checkpoint_every: frames."""

    recipe: str = "default"
    refine: bool = False
    evidence: str = "silhouettes"
    seed: int = 0
    start: str = "auto"
    height: float | None = None
    girths: bool = True
    subject: str | None = None
    smooth: bool = True
    checkpoint_every: int = 25

    def __post_init__(self) -> None:
        if self.evidence not in ("silhouettes", "keypoints", "both"):
            raise InputError(f"There is no evidence {self.evidence!r}; choose silhouettes, keypoints or both.")

    def settings(self) -> dict[str, Any]:
        """The choices that decide the result."""
        return {k: v for k, v in asdict(self).items() if k != "checkpoint_every"}


@dataclass(frozen=True)
class TrackResult:
    """motion; the subject's body; complete: every frame was tracked; notes for the report."""

    motion: Motion
    body: Body
    complete: bool
    notes: tuple[str, ...]


Progress = Callable[[str, int, int], None]
"""progress(stage, done, total) is called often; raising KeyboardInterrupt in it stops the run with its work kept."""


def track_source(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    body: Body | None = None,
    subject: Subject | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> TrackResult:
    """Tracks the frames of a source.

    body: the template to fit (default: the human template); subject: a known subject and start, which skips the
    fitting. With `results` a checkpoint is written every `checkpoint_every` frames (later every twentieth of what is
    done), and motion.npz at the end or when interrupted. `record` is the provenance; its identity must match for
    `resume`.
    """
    report = progress or (lambda stage, done, total: None)
    total = len(source)
    if total == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    if subject is None:
        report("subject", 0, 1)
        known = options.subject is not None
        wanted = SubjectOptions(options.start, options.height, options.girths, body, frame_rate, options.seed, known)
        subject = find_subject(source.frame, total, wanted)
        report("subject", 1, 1)
    if results is not None:  # before the motion, so that what is kept of an interrupted run can be looked at
        save_body(subject.body, results.file("body.npz"))
    tracker = _tracker(subject, options, frame_rate)
    key = identity(record or {})
    state, estimates = tracker.start(subject.start), []
    if resume and results is not None and results.checkpoint.exists():
        state, estimates = _resume(Checkpoint.load(results.checkpoint, key))
    interrupted = False
    try:
        saved = len(estimates)
        rest = range(saved, total)
        with contextlib.closing(look_ahead(tracked_frames(source, rest, options.recipe, subject))) as frames:
            for index in rest:
                report("track", index, total)
                state, estimate = tracker.step(state, next(frames))
                estimates.append(estimate)
                done = len(estimates)
                # all frames are written every time, so ever fewer times: the work of an hour of film stays linear
                if results is not None and done - saved >= max(options.checkpoint_every, saved // 20) and done < total:
                    _save_checkpoint(results, state, estimates, key)
                    saved = done
        report("track", total, total)
    except KeyboardInterrupt:
        interrupted = True
        if not estimates:
            raise
        if results is not None:
            _save_checkpoint(results, state, estimates, key)
    except HyposeError as error:
        if not estimates or results is None:
            raise
        with contextlib.suppress(HyposeError):  # the first error is the one to tell
            _save_checkpoint(results, state, estimates, key)
            save_motion(_motion(subject, estimates, frame_rate, record), results.motion)
        raise type(error)(
            f"{error} The {len(estimates)} frames before are kept in {results.path}; see --resume."
        ) from error
    motion, notes = _motion(subject, estimates, frame_rate, record), subject.notes
    if options.smooth and not interrupted:
        report("smooth", 0, 1)
        smoothed = smooth_motion(subject.body, motion, np.stack([e.uncertainty.information for e in estimates]))
        motion, notes = smoothed.motion, (*notes, *smoothed.notes)
        report("smooth", 1, 1)
    if results is not None:
        save_motion(motion, results.motion)
        if not interrupted:
            results.checkpoint.unlink(missing_ok=True)
    return TrackResult(motion, subject.body, not interrupted, notes)


def _motion(
    subject: Subject, estimates: list[FrameEstimate], frame_rate: float, record: Mapping[str, Any] | None
) -> Motion:
    """The motion of the finished frames; time 0 is the first tracked frame."""
    return motion_of(subject.body, np.arange(len(estimates)) / frame_rate, estimates, record or {})


def _tracker(subject: Subject, options: TrackOptions, frame_rate: float) -> Tracker:
    made, particles = recipe(options.recipe, subject.body, frame_rate=frame_rate, refine=options.refine)
    settings = TrackerSettings(evidence=options.evidence, seed=options.seed, frame_rate=frame_rate)
    return Tracker(subject.body, made, particles, settings, subject.keypoints)


def _save_checkpoint(
    results: ResultsFolder, state: TrackerState, estimates: list[FrameEstimate], key: Mapping[str, Any]
) -> None:
    arrays = {**state.to_arrays(), **{f"done_{k}": v for k, v in estimates_to_arrays(estimates).items()}}
    Checkpoint(len(estimates), arrays, {}, key).save(results.checkpoint)


def _resume(saved: Checkpoint) -> tuple[TrackerState, list[FrameEstimate]]:
    done = {k.removeprefix("done_"): v for k, v in saved.arrays.items() if k.startswith("done_")}
    return TrackerState.from_arrays(saved.arrays), estimates_from_arrays(done)

"""A long recording in chunks that overlap, each tracked by itself, on whatever machine, and joined without a seam.

The subject is found once, for the whole recording. Every chunk finds its own start in the first half of the frames that
it shares with the one before, and has the other half to settle. What a chunk gives depends on the recording and the
settings alone: not on who tracks it, in which order, or how often it was begun.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.errors import EvidenceError, InputError
from hypose.geometry import Array
from hypose.io.motions.results import ResultsFolder, identity
from hypose.pipeline.colour_detections import tracked_frames
from hypose.pipeline.doubts import looked_at
from hypose.pipeline.first_frame import Subject, first_start
from hypose.pipeline.first_look import first_look, sentences
from hypose.pipeline.join import join, seam_notes
from hypose.pipeline.kept_findings import keep_subject, kept_subject
from hypose.pipeline.run import TrackOptions, TrackResult, finish, subject_of, tracker_of
from hypose.pipeline.track_loop import FrameSource, Keep, Progress, Tracked, track_frames, tracked_before
from hypose.tracking.costs import silhouette_iou
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.start_search import start_from_hull
from hypose.tracking.starts import KNOWN_POSES
from hypose.tracking.tracker import FrameEstimate, TrackerState

FOLDER = "chunks"
"""In the results folder while not all chunks are joined."""
OVERLAP_S = 2.0
SHORTEST_S = 10.0
"""s: what a chunk costs besides its frames (its start, the overlap) is worth as much as a second or two."""
_STARTS = 4


def chunk_ranges(total: int, frame_rate: float, chunk_s: float) -> tuple[range, ...]:
    """The frames of each chunk of a recording of `total` frames: about chunk_s seconds, all but the last OVERLAP_S
    longer. An InputError when chunk_s is too short."""
    if not chunk_s >= SHORTEST_S:
        raise InputError(f"A chunk of {chunk_s:g} s is too short; give at least {SHORTEST_S:g} s.")
    count = max(1, round(total / (chunk_s * frame_rate)))
    overlap = max(round(OVERLAP_S * frame_rate), 2)
    bounds = [total * k // count for k in range(count + 1)]
    return tuple(range(a, min(total, b + overlap)) for a, b in zip(bounds[:-1], bounds[1:], strict=True))


@dataclass(frozen=True)
class ChunkRun:
    """One recording tracked in chunks. body: the subject's own, or None. Of what
    is kept in `results` only that of the same run (`record`) is used."""

    source: FrameSource
    frame_rate: float
    options: TrackOptions
    chunk_s: float
    results: ResultsFolder
    record: Mapping[str, Any]
    body: Body | None = None

    @property
    def ranges(self) -> tuple[range, ...]:
        """The frames of each chunk."""
        if self.options.of_picture:
            raise InputError(
                "One camera alone cannot find its person in the middle of a recording; leave out the chunks."
            )
        return chunk_ranges(len(self.source), self.frame_rate, self.chunk_s)

    def subject(self, progress: Progress) -> Subject:
        """The subject, found now or before."""
        key = identity(self.record)
        found = kept_subject(self.results, key)
        if found is None:
            found = subject_of(self.source, self.frame_rate, self.options, self.body, None, key, progress)
            keep_subject(found, self.results, key)
        return found

    def chunk(self, number: int, progress: Progress) -> Tracked:
        """One chunk, tracked now or before; incomplete when it was interrupted. An error that ends it is raised; what
        was done until then is kept."""
        frames, key = self.ranges[number], identity(self.record)
        path = self.results.path / FOLDER / f"{number:04d}.npz"
        before = tracked_before(path, key, frames.stop)
        if before is not None and before.complete:
            progress("track", len(frames), len(frames))
            return before
        subject = self.subject(progress)
        tracker = tracker_of(subject, self.options, self.frame_rate)
        start: Array | None = subject.start
        first = frames.start
        if before is not None:
            first = before.frames.start
        elif number > 0:
            start, first = self._start(subject, frames)
        if start is None:
            return Tracked(frames[:0], [], tracker.start(subject.start))
        keep = Keep(path, key, self.options.checkpoint_every, finished=True)
        begin, rest = tracker.start(start), range(first, frames.stop)
        done = track_frames(self.source, rest, tracker, begin, subject, keep=keep, before=before, progress=progress)
        if done.error is not None:
            raise type(done.error)(
                f"{done.error} What was tracked before is kept in {self.results.path}; the same command goes on."
            ) from done.error
        return done

    def whole(self, progress: Progress) -> TrackResult:
        """All chunks, those that are missing tracked one after the other, joined, smoothed, and written."""
        o = self.options
        seen = () if o.of_picture else first_look(self.source, o.looks_at, o.height, self.frame_rate)
        subject = self.subject(progress)
        chunks: list[Tracked] = []
        total, done = len(self.source), 0
        for number, frames in enumerate(self.ranges):
            one = self.chunk(number, lambda stage, n, of, at=frames.start: progress(stage, at + n, total))
            chunks.append(one)
            done = frames.stop if one.complete else one.frames.stop
            if not one.complete:
                break
        tracker = tracker_of(subject, self.options, self.frame_rate)

        def follow(state: TrackerState, frames: range) -> Iterator[tuple[TrackerState, FrameEstimate]]:
            last = None
            for frame in tracked_frames(self.source, frames, tracker.recipe.needs, subject):
                state, estimate = tracker.step(state, frame)
                yield state, looked_at(tracker, estimate, frame, last)
                last = frame

        joined, seams = join(subject.body, chunks, follow, done)
        joined = replace(joined, complete=chunks[-1].complete and done == total)
        said = sentences(seen), sentences(seen, fault=False)
        out = finish(self.source, subject, tracker, joined, self.options, self.results, self.record, progress, *said)
        if out.complete:
            shutil.rmtree(self.results.path / FOLDER, ignore_errors=True)
        return replace(out, notes=(*out.notes, *seam_notes(seams)))

    def _start(self, subject: Subject, frames: range) -> tuple[Array | None, int]:
        """A pose and the frame in which it is, from the first half of the overlap, or else the first one after it in
        which the person can be found; None when there is none."""
        half = round(OVERLAP_S * self.frame_rate / 2)
        if subject.keypoints is not None:
            with contextlib.suppress(EvidenceError):
                pose, at = first_start(
                    subject.body, subject.keypoints, lambda i: self.source.frame(frames[i]), len(frames)
                )
                return pose, frames[at]
            return None, frames.stop
        found = [s for i in np.linspace(0, half, _STARTS).astype(int) if (s := self._at_hull(subject, frames[i]))]
        later = iter(frames[half :: max(1, half)])
        while not found and (t := next(later, None)) is not None:
            found = [s for s in (self._at_hull(subject, t),) if s]
        best = max(found, key=lambda s: s[0], default=None)
        return (None, frames.stop) if best is None else (best[2], best[1])

    def _at_hull(self, subject: Subject, frame: int) -> tuple[float, int, Array] | None:
        """Overlap with the masks (mean IoU), frame, and pose; None when nobody is there."""
        try:
            prepared = prepare(self.source.frame(frame), subject.body, subject.start)
            pose = start_from_hull(subject.body, prepared, KNOWN_POSES).pose
        except EvidenceError:
            return None
        return float(np.nanmean(silhouette_iou(subject.body, pose, prepared))), frame, pose

"""A recording's motion from its key points alone: all frames solved together, without a picture being decoded; and what
they say beside masks of left and right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Keypoints
from hypose.io.recordings.frames import FrameStream
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.track_loop import FrameList, FrameSource, Progress
from hypose.tracking.audit import audit_frame
from hypose.tracking.keypoint_clip import real_names, track_keypoint_clip
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.smooth_motion import Smoothed


def track_keypoints(
    source: FrameSource, frame_rate: float, subject: Subject, progress: Progress, *, sure_start: bool = False
) -> tuple[Smoothed, NDArray[np.float32]]:
    """The motion of the frames of a source (hypose.tracking.keypoint_clip), and their audits (T, J, A);
    sure_start: the start is the right way round. An EvidenceError when they have no key points."""
    frames = [replace(source.frame(i), silhouettes=None) for i in range(len(source))]
    seen = [f.keypoints for f in frames]
    named = next((k.names for k in seen if k is not None), None)
    if named is None:
        raise EvidenceError("No frame carries key points; choose an evidence that the recording has.")
    model = subject.keypoints or keypoint_model(subject.body, named)
    solved = track_keypoint_clip(
        *(subject.body, model, seen, subject.start, frame_rate),
        progress=lambda done, all_: progress("track", done, all_),
        sure_start=sure_start,
    )
    assert solved.motion.poses is not None
    audits = [audit_frame(subject.body, q, f, model) for q, f in zip(solved.motion.poses, frames, strict=True)]
    return solved, np.stack(audits)


@dataclass(frozen=True)
class NamedSides:
    """The frames of a source with key points whose sides the clip has told."""

    source: FrameSource
    keypoints: Sequence[Keypoints | None]

    def __len__(self) -> int:
        return len(self.source)

    def frame(self, index: int, /) -> Frame:
        """Frame number index."""
        return replace(self.source.frame(index), keypoints=self.keypoints[index])


def keypoints_in_memory(source: FrameSource) -> Sequence[Keypoints | None] | None:
    """The key points of a source's frames, None of a source that does not hold them in memory."""
    if isinstance(source, NamedSides | FrameStream):
        return source.keypoints
    return [f.keypoints for f in source.frames] if isinstance(source, FrameList) else None


def with_named_sides(
    source: FrameSource, frame_rate: float, subject: Subject, *, sure_start: bool = False
) -> tuple[FrameSource, Subject]:
    """A source in which key points stand beside masks, and its subject, with the sides of limbs as the names of all
    views and frames have them: a tracker that goes from frame to frame would rename them by where it takes the limbs to
    be. sure_start: that of the subject stands. A source that does not hold its key points in memory stays as it is."""
    seen = keypoints_in_memory(source)
    if seen is None or subject.keypoints is None or all(k is None for k in seen):
        return source, subject
    given = (subject.body, subject.keypoints, seen, subject.start, frame_rate)
    start, named = real_names(*given, sure_start=sure_start)
    return NamedSides(source, named), replace(subject, start=start)

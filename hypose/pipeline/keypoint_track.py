"""A recording's motion from its key points alone: all frames solved together, without a picture being decoded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.errors import EvidenceError
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.track_loop import FrameSource, Progress
from hypose.tracking.audit import audit_frame
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.smooth_motion import Smoothed


def track_keypoints(
    source: FrameSource, frame_rate: float, subject: Subject, progress: Progress
) -> tuple[Smoothed, NDArray[np.float32]]:
    """The motion of the frames of a source (hypose.tracking.keypoint_clip), and their audits (T, J, A). An
    EvidenceError when they have no key points."""
    frames = [replace(source.frame(i), silhouettes=None) for i in range(len(source))]
    seen = [f.keypoints for f in frames]
    named = next((k.names for k in seen if k is not None), None)
    if named is None:
        raise EvidenceError("No frame carries key points; choose an evidence that the recording has.")
    model = subject.keypoints or keypoint_model(subject.body, named)
    solved = track_keypoint_clip(
        subject.body, model, seen, subject.start, frame_rate, progress=lambda done, all_: progress("track", done, all_)
    )
    assert solved.motion.poses is not None
    audits = [audit_frame(subject.body, q, f, model) for q, f in zip(solved.motion.poses, frames, strict=True)]
    return solved, np.stack(audits)

"""A recording's motion from its key points alone: all frames solved together, without a picture being decoded."""

from __future__ import annotations

from hypose.errors import EvidenceError
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.track_loop import FrameSource, Progress
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.keypoint_evidence import keypoint_model
from hypose.tracking.smooth_motion import Smoothed


def track_keypoints(source: FrameSource, frame_rate: float, subject: Subject, progress: Progress) -> Smoothed:
    """The motion of the frames of a source (hypose.tracking.keypoint_clip). An EvidenceError when they have no key
    points."""
    seen = [source.frame(i).keypoints for i in range(len(source))]
    named = next((k.names for k in seen if k is not None), None)
    if named is None:
        raise EvidenceError("No frame carries key points; choose an evidence that the recording has.")
    model = subject.keypoints or keypoint_model(subject.body, named)
    return track_keypoint_clip(
        subject.body, model, seen, subject.start, frame_rate, progress=lambda done, all_: progress("track", done, all_)
    )

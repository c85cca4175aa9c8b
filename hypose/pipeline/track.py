"""A recording's poses in one call, without files: what `import hypose` offers as `track`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hypose.body.body import Body
from hypose.io.frames import FrameOptions, FrameStream
from hypose.io.recording import Recording, load_recording
from hypose.pipeline.anthropometry import load_subject
from hypose.pipeline.run import TrackOptions, TrackResult, track_source
from hypose.pipeline.track_loop import Progress


def track(
    recording: Recording | str | Path,
    options: TrackOptions | None = None,
    *,
    body: Body | None = None,
    progress: Progress | None = None,
) -> TrackResult:
    """The motion of the person in a recording (or the recording in a folder), and the body that was fitted.

    body: the subject's own, which is kept as it is (default: fitted to the recording). Nothing is written; `hypose
    track` writes files and can be resumed. An InputError names what cannot be used.
    """
    loaded = recording if isinstance(recording, Recording) else load_recording(recording)
    chosen = options or TrackOptions(height=loaded.subject_height)
    if body is not None:
        chosen = replace(chosen, subject=chosen.subject or "given")
    elif chosen.subject is not None:
        body = load_subject(chosen.subject)
    evidence = FrameOptions(silhouettes=None) if chosen.evidence == "keypoints" else None
    with FrameStream(loaded, evidence) as source:
        return track_source(source, loaded.frame_rate, chosen, body=body, progress=progress)

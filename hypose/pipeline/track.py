"""A recording's poses in one call, without files: what `import hypose` offers as `track`."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hypose.body.body import Body
from hypose.inference.layer import Recipe
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.run import TrackOptions, TrackResult, check_views, frames_wanted, track_source
from hypose.pipeline.subject_from_motion import load_subject
from hypose.pipeline.track_loop import FrameList, Progress
from hypose.tracking.frame_evidence import OwnEvidence


def track(
    recording: Recording | FrameList | str | Path,
    options: TrackOptions | None = None,
    *,
    recipe: str | Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    body: Body | None = None,
    progress: Progress | None = None,
) -> TrackResult:
    """The motion of the person in a recording (or the recording in a folder, or frames in memory), and the body.

    recipe: a preset's name, or a recipe of your own for the joints of `human()` (default: the options'). own: evidence
    of your own beside that of the recording. body: the subject's own, which is kept as it is (default: fitted to the
    recording). Nothing is written; `hypose track` writes files and can be resumed. An InputError names what cannot be
    used.
    """
    loaded = recording if isinstance(recording, Recording | FrameList) else load_recording(recording)
    height = loaded.subject_height if isinstance(loaded, Recording) else None
    chosen = options or TrackOptions(height=height)
    method = recipe if isinstance(recipe, Recipe) else None
    if isinstance(recipe, str):
        chosen = replace(chosen, recipe=recipe)
    if isinstance(loaded, Recording) and not loaded.has_pictures:
        chosen = chosen.without_pictures()
    if isinstance(loaded, Recording) and chosen.of_picture:
        check_views(loaded, True)
    if body is None and chosen.subject is not None:
        body = load_subject(chosen.subject)
    in_memory = isinstance(loaded, FrameList)
    frames = contextlib.nullcontext(loaded) if in_memory else FrameStream(loaded, frames_wanted(loaded, chosen))
    with frames as source:
        return track_source(source, loaded.frame_rate, chosen, body=body, progress=progress, method=method, own=own)

"""Track a recording in one call, without files: `track`, which `import hypose` offers."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

from hypose.body.body import Body
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.inference.layer import Recipe
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.one_of_several import (
    chosen_people,
    keypoint_people,
    people_frames,
    track_one_of,
    wanted_first,
    wanted_of,
    with_all_people,
)
from hypose.pipeline.people_run import PeopleRun
from hypose.pipeline.run import TrackResult, track_source
from hypose.pipeline.subject_from_motion import load_subject
from hypose.pipeline.track_loop import FrameList, StageProgress
from hypose.pipeline.track_options import TrackOptions, check_views, frames_wanted
from hypose.pipeline.tracked_people import PeopleResult


@overload
def track(
    recording: Recording | FrameList | str | Path,
    options: TrackOptions | None = None,
    *,
    recipe: str | Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    body: Body | None = None,
    progress: StageProgress | None = None,
    people: None = None,
) -> TrackResult: ...


@overload
def track(
    recording: Recording | FrameList | str | Path,
    options: TrackOptions | None = None,
    *,
    recipe: str | Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    body: Body | None = None,
    progress: StageProgress | None = None,
    people: str | int,
) -> PeopleResult: ...


def track(
    recording: Recording | FrameList | str | Path,
    options: TrackOptions | None = None,
    *,
    recipe: str | Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    body: Body | None = None,
    progress: StageProgress | None = None,
    people: str | int | None = None,
) -> TrackResult | PeopleResult:
    """Track the person in a recording and return motion and body; nothing is written.

    recording: a recording, its folder, or frames in memory.
    options: default: those that suit the recording.
    recipe: name of a preset, or a recipe of your own for the joints of `human()`; default: that of the options.
    own: evidence of your own in addition to that of the recording.
    body: the subject's own body, used unchanged; default: a body is fitted to the recording.
    progress: called with stage, done, total; default: a bar per stage where stderr is a terminal.
    people: None: track one person, even where several are seen. 'all', a maximum number, or the name of one person in
        recording.toml: track all people together.
    Returns: TrackResult; PeopleResult where `people` is given.
    Raises: InputError names the input that cannot be used.

    `hypose track` does the same, writes files and can be resumed.
    """
    loaded = recording if isinstance(recording, Recording | FrameList) else load_recording(recording)
    height = loaded.subject_height if isinstance(loaded, Recording) else None
    chosen = options or TrackOptions(height=height)
    method, report = recipe if isinstance(recipe, Recipe) else None, progress or _draw_bar
    if isinstance(recipe, str):
        chosen = replace(chosen, recipe=recipe)
    if isinstance(loaded, Recording):
        chosen = chosen.suited_to(loaded)
    if isinstance(loaded, Recording) and chosen.of_picture:
        check_views(loaded, True)
    if people is not None:
        if method is not None or own or body is not None or chosen.subject is not None:
            raise InputError(
                "Several people are tracked by a preset, without evidence of your own; name their bodies in "
                "recording.toml, and leave out body, own and the recipe."
            )
        return _track_people(loaded, chosen, str(people), report)
    given = {"method": method, "own": own, "progress": report}
    if isinstance(loaded, FrameList):
        body = body or given_body(chosen)
        return track_source(loaded, loaded.frame_rate, chosen, body=body, **given)
    with FrameStream(loaded, frames_wanted(loaded, chosen), progress=report) as source:
        return track_person(source, chosen, body=body, **given)


def _draw_bar(stage: str, done: int, total: int) -> None:
    if sys.stderr is not None and sys.stderr.isatty():
        bar = "#" * round(30 * done / max(1, total))
        sys.stderr.write(f"\r{stage:<12}{bar:<30} {done}/{total}" + "\n" * (done >= total))
        sys.stderr.flush()


def given_body(options: TrackOptions) -> Body | None:
    """Load the subject's own body from the file that the options name; None where they name none."""
    return None if options.subject is None else load_subject(options.subject)


def track_person(
    source: FrameStream,
    options: TrackOptions,
    *,
    body: Body | None = None,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    command: str = 'people="all"',
    **kept: Any,
) -> TrackResult:
    """Track one person in the frames of a recording.

    Where the masks show several people, all are tracked, one is returned, and a note names the `command` that returns
    all.
    kept, and the other arguments: as for `track_source`.
    """
    recording = source.recording
    all_people = with_all_people(source, options) if method is None and not own and body is None else None
    if all_people is None:
        body = body or given_body(options)
        return track_source(source, recording.frame_rate, options, body=body, method=method, own=own, **kept)
    points = keypoint_people(recording, source.rig) if options.looks_at == "both" else None
    wanted = wanted_first(recording, options)
    with all_people:
        return track_one_of(
            all_people, recording.frame_rate, options, wanted=wanted, points=points, command=command, **kept
        )


def _track_people(
    loaded: Recording | FrameList, options: TrackOptions, people: str, progress: StageProgress
) -> PeopleResult:
    wanted = wanted_of(loaded) if isinstance(loaded, Recording) else []
    count, only = chosen_people(people, wanted)
    in_memory = isinstance(loaded, FrameList)
    frames = contextlib.nullcontext(loaded) if in_memory else people_frames(loaded, options, progress)
    with frames as source:
        points = None
        if isinstance(source, FrameStream) and isinstance(loaded, Recording) and options.looks_at != "silhouettes":
            points = keypoint_people(loaded, source.rig)
        found = PeopleRun(source, loaded.frame_rate, options, count, wanted, progress=progress, points=points)()
    kept = tuple(p for p in found.people if only in (None, p.name))
    return found if not kept else replace(found, people=kept, others=found.others + len(found.people) - len(kept))

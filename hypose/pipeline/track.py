"""Track a recording in one call, without files: `track`, which `import hypose` offers."""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

from hypose.body.body import Body
from hypose.calibration.findings import INFO, Finding
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.inference.layer import Recipe
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.recordings.recording_people import load_person
from hypose.pipeline.assessment import other_people_note
from hypose.pipeline.input_checks import places_refuted
from hypose.pipeline.recorded_frames import check_views, frames_wanted, people_frames, with_all_people
from hypose.pipeline.run import PeopleResult, TrackResult, track_people, track_source
from hypose.pipeline.subject import load_subject
from hypose.pipeline.track_loop import FrameList, FrameSource, StageProgress
from hypose.pipeline.track_management import KeypointPeople, KnownPerson, said_of_places
from hypose.pipeline.track_options import TrackOptions


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
    body: the subject's own body; None: a body is fitted.
    method: recipe that replaces the recipe of the options.
    own: evidence in addition to that of the frames.
    kept: further keyword arguments of `track_source`: results, record, resume, progress.
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
        about = {"count": count, "wanted": wanted, "points": points, "progress": progress}
        found = track_people(source, loaded.frame_rate, options, **about)
    kept = tuple(p for p in found.people if only in (None, p.name))
    return found if not kept else replace(found, people=kept, others=found.others + len(found.people) - len(kept))


_COUNT = re.compile(r"[1-9][0-9]?")


def wanted_of(recording: Recording) -> list[KnownPerson]:
    """Read the prior knowledge of people from a recording: name, height, body, place and time of each [[person]]."""
    first = recording.frames.start / recording.frame_rate
    return [
        KnownPerson(
            p.name,
            p.height,
            None if p.body is None else load_subject(p.body),
            p.place,
            p.time - first,
        )
        for p in recording.people
    ]


def wanted_first(recording: Recording, options: TrackOptions) -> list[KnownPerson]:
    """Return the prior knowledge of the one person to track: the first person of recording.toml, with the requested
    body or height.
    """
    first = (wanted_of(recording) or [KnownPerson("person-1")])[0]
    body = first.body if options.subject is None else load_subject(options.subject)
    return [replace(first, height=first.height or options.height, body=body)]


def keypoint_people(recording: Recording, small: CameraRig) -> KeypointPeople | None:
    """Load the people that a recording's key points show, where they are separated by their rays; None where there are
    none.
    """
    found = load_person(recording, small)
    if not found.one.by_rays:
        return None
    return KeypointPeople(found.one.people, found.names, small)


def chosen_people(text: str, wanted: Sequence[KnownPerson]) -> tuple[int | None, str | None]:
    """Parse the option --people: 'all', a number, or a name in recording.toml.

    Returns: maximum number of people (None: all), and the only name whose results are wanted (None: all).
    Raises: InputError for other texts.
    """
    if text == "all":
        return None, None
    if _COUNT.fullmatch(text):
        return int(text), None
    if text in {w.name for w in wanted}:
        return None, text
    known = f"; recording.toml names {', '.join(w.name for w in wanted)}" if wanted else ""
    raise InputError(
        f"--people {text} is neither all, nor a number from 1 to 99, nor the name of a [[person]] in recording.toml"
        f"{known}."
    )


def track_one_of(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    wanted: Sequence[KnownPerson] = (),
    points: KeypointPeople | None = None,
    command: str = "--people all",
    **kept: Any,
) -> TrackResult:
    """Track all people together and return the result of one.

    wanted: prior knowledge of the person; without it the person nearest to the middle of the cameras' view is taken.
    points: key points sorted by person.
    command: named in the note that other people are there.
    kept: results (folder for files), record (provenance), resume (continue from the checkpoint) and progress
        (function of stage, done, total), the same as those of `track_source`.
    Returns: result of the person; not to be trusted where no person was found at the wanted place.
    """
    found = track_people(source, frame_rate, options, count=1, wanted=wanted, points=points, folders=False, **kept)
    one, more = found.people[0], found.others
    said = (other_people_note(more, "masks", command),) if more and not places_refuted(found.findings) else ()
    notes = said_of_places(wanted, 1 + more)
    found_so = [*one.findings, *said, *(Finding("places", (), f"Note: {n}", severity=INFO) for n in notes)]
    if wanted and wanted[0].place is not None and one.name != wanted[0].name:
        text = f"{wanted[0].not_found}; the result is that of another person"
        found_so.append(Finding("other person", (), text, "correct place and time of the [[person]] in recording.toml"))
    return replace(one, findings=tuple(found_so), name="", present=None)

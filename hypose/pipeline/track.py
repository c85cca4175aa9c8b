"""Track a source of frames, or a recording in one call, without files: `track`, which `import hypose` offers.

Here it is chosen which passes run: `CHECKED` and `AFTER_TRACKING` for several cameras, with one camera `IN_PICTURE`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.calibration.findings import INFO, Finding
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame
from hypose.inference.layer import Recipe
from hypose.io.motions.results import save_motion
from hypose.io.recordings.frames import FrameStream, load_person
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.assessment import (
    later,
    other_people_note,
    trace_of,
    with_trace,
)
from hypose.pipeline.input_checks import CHECKED, CHECKED_KEYPOINTS, place_sensors, places_refuted
from hypose.pipeline.one_camera import IN_PICTURE, find_in_picture
from hypose.pipeline.passes import (
    AFTER_TRACKING,
    SOLVED_TOGETHER,
    UNTIL_TRACKED,
    ClipState,
)
from hypose.pipeline.people import PeopleFinder
from hypose.pipeline.recorded_frames import check_views, frames_wanted, people_frames, with_all_people
from hypose.pipeline.run import PeopleResult, TrackResult, run_clip
from hypose.pipeline.sources import ChangedFrames, FrameList, FrameSource
from hypose.pipeline.subject import TrackedSubject, load_subject
from hypose.pipeline.track_loop import StageProgress
from hypose.pipeline.track_management import (
    KeypointPeople,
    KnownPerson,
    names_at_places,
    per_frame,
    said_of_places,
    untracked_note,
)
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
        if isinstance(loaded, FrameList):
            return track_people(loaded, loaded.frame_rate, chosen, count=chosen_people(str(people))[0], progress=report)
        with people_frames(loaded, chosen, report) as source:
            return track_named(source, chosen, str(people), progress=report)
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
    first = (wanted_of(recording) or [KnownPerson("person-1")])[0]
    body = given_body(options) or first.body
    wanted = [replace(first, height=first.height or options.height, body=body)]
    with all_people:
        return track_one_of(
            all_people, recording.frame_rate, options, wanted=wanted, points=points, command=command, **kept
        )


def track_named(source: FrameStream, options: TrackOptions, people: str, **kept: Any) -> PeopleResult:
    """Track the people of a recording and return those who are asked for.

    people: 'all', a maximum number, or the name of one person in recording.toml; where no person of this name is found,
        all are returned.
    kept: further keyword arguments of `track_people`: results, record, resume, progress.
    """
    recording = source.recording
    wanted = wanted_of(recording)
    count, only = chosen_people(people, wanted)
    points = keypoint_people(recording, source.rig) if options.looks_at != "silhouettes" else None
    about = {"count": count, "wanted": wanted, "points": points}
    found = track_people(source, recording.frame_rate, options, **about, **kept)
    named, names = [w for w in wanted if w.name == only], [p.name for p in found.people]
    total = len(names) + found.others
    absent = [f"who of several people is {only} is not known: {why}" for why in said_of_places(named, total)]
    if only is not None and only not in names:
        absent.append(
            f"{named[0].not_found}; the results are those of {', '.join(names)} instead: correct place and time of the "
            "[[person]] in recording.toml"
        )
    shown = tuple(p for p in found.people if only in (None, p.name)) or found.people
    return replace(found, people=shown, others=total - len(shown), absent="".join(absent[:1]))


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


def keypoint_people(recording: Recording, small: CameraRig) -> KeypointPeople | None:
    """Load the people that a recording's key points show, where they are separated by their rays; None where there are
    none.
    """
    found = load_person(recording, small)
    if not found.one.people:
        return None
    return KeypointPeople(found.one.people, found.names, small)


def chosen_people(text: str, wanted: Sequence[KnownPerson] = ()) -> tuple[int | None, str | None]:
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
    said = () if places_refuted(found.findings) else other_people_note(more, "masks", command)
    notes = said_of_places(wanted, 1 + more)
    found_so = [*one.findings, *said, *(Finding("places", (), f"Note: {n}", severity=INFO) for n in notes)]
    if wanted and wanted[0].place is not None and one.name != wanted[0].name:
        text = f"{wanted[0].not_found}; the result is that of another person"
        found_so.append(Finding("other person", (), text, "correct place and time of the [[person]] in recording.toml"))
    return replace(one, findings=tuple(found_so), name="", present=None)


def track_source(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    body: Body | None = None,
    subject: TrackedSubject | None = None,
    results: Path | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: StageProgress | None = None,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    find_places: bool = True,
) -> TrackResult:
    """Track one person in the frames of a source.

    frame_rate: Hz.
    body: the subject's own body, for which only the start pose is searched; None: the human template, fitted.
    subject: known body and start pose; nothing is searched.
    results: folder for motion.npz, which is written at the end or when interrupted, and for a checkpoint, which is
        written every `checkpoint_every` frames, later after each twentieth of the frames so far.
    record: provenance of the motion; to resume a run its identity must match.
    resume: continue from the checkpoint in `results`.
    progress: called with stage, done, total.
    method: recipe of your own that replaces that of the options.
    own: evidence in addition to that of the frames.
    find_places: correct depth cameras that stand elsewhere than the source says.
    Raises: InputError where the source has no frames.
    """
    clip = ClipState(
        source,
        frame_rate,
        options,
        body=body,
        method=method,
        own=own,
        results=results,
        record=record or {},
        resume=resume,
        progress=progress or (lambda stage, done, total: None),
        given=subject is not None,
    )
    if subject is not None:
        clip = replace(clip, people=(clip.at_start(subject),))
    together, alone = tuple(s for s in CHECKED if find_places or s is not place_sensors), AFTER_TRACKING
    if options.whole_clip and method is None:
        together, alone = CHECKED_KEYPOINTS, SOLVED_TOGETHER
    if options.of_picture:
        together, alone, clip = UNTIL_TRACKED, IN_PICTURE, replace(clip, find=find_in_picture)
    return run_clip(clip, together, alone)[1][0]


def track_people(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    count: int | None = None,
    wanted: Sequence[KnownPerson] = (),
    points: KeypointPeople | None = None,
    folders: bool = True,
    **kept: Any,
) -> PeopleResult:
    """Track several people in the frames of a source.

    frame_rate: Hz.
    count: most results; None: all people. Those beyond are tracked too, since they hide the others.
    wanted: prior knowledge of some of them.
    points: key points sorted by person, for the evidence 'keypoints' and 'both'.
    folders: each person has a folder of their own in the results folder; else the motion of the one person who is asked
        for is written into it.
    kept: results (folder for files), record (provenance), resume (continue from the checkpoint) and progress
        (function of stage, done, total), the same as those of `track_source`.
    Raises: InputError where the evidence cannot separate people; EvidenceError where no person is found.
    """
    kept = {"progress": lambda stage, done, total: None} | {k: v for k, v in kept.items() if v is not None}
    if options.of_picture:
        raise InputError("One camera alone cannot tell several people apart; leave out --people, or add cameras.")
    if options.looks_at == "keypoints":
        return _by_keypoints(source, frame_rate, options, count, wanted, points, kept)
    if options.looks_at == "both" and points is None:
        raise InputError("The evidence 'both' needs key points, and this recording has none; use silhouettes.")
    used = points if options.looks_at == "both" else None
    finder = PeopleFinder(source, frame_rate, options, count, wanted, used)
    clip = ClipState(source, frame_rate, options, finder=finder, folders=folders, **kept)
    clip, done = run_clip(clip, CHECKED)
    complete, names = all(p.complete for p in done), [p.name for p in clip.people]
    said = *_who_is_there(done, frame_rate), *untracked_note(clip.candidates)
    said += tuple(w.not_found for w in wanted if w.name not in names)
    said += said_of_places(wanted, len(names))
    return PeopleResult(tuple(done), complete, said, len(names) - len(done), clip.findings)


def _by_keypoints(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    count: int | None,
    wanted: Sequence[KnownPerson],
    points: KeypointPeople | None,
    kept: dict[str, Any],
) -> PeopleResult:
    """Track people by key points alone, each as if they were alone, since key points are sorted by person."""
    if points is None or not points.tracks:
        raise InputError(
            "The evidence 'keypoints' needs key points of people on whom two cameras or more agree; check them "
            "with `hypose check`, or use silhouettes."
        )
    total, done, tracks = len(source), list[TrackResult](), points.lasting(len(source))
    where, ranks = [points.tracks[k] for k in tracks], {w.name: k for k, w in enumerate(wanted)}
    names = names_at_places(wanted, len(where), lambda k, t: where[k].place(t)[:2], frame_rate)
    ranked = sorted(range(len(tracks)), key=lambda k: ranks.get(names[k], len(ranks)))
    results = kept.pop("results", None)
    for k in ranked[:count]:
        known = next((w for w in wanted if w.name == names[k]), KnownPerson(names[k]))
        first = where[k].first
        frames = ChangedFrames(source, partial(_alone, points, tracks[k]), range(first, first + len(where[k])))
        own, folder = replace(options, height=known.height or options.height), None
        if results is not None:
            folder = results / names[k]
        out = track_source(frames, frame_rate, own, body=known.body, results=folder, **kept)
        present = np.zeros(total, dtype=np.bool_)
        present[first : first + len(out.motion)] = True
        out = replace(out, motion=padded(out.motion, first, total), name=names[k], present=present)
        if folder is not None:
            save_motion(out.motion, folder / "motion.npz")
        done.append(out)
        if not out.complete:
            break
    said = *_who_is_there(done, frame_rate), *said_of_places(wanted, len(tracks))
    return PeopleResult(tuple(done), all(p.complete for p in done), said, len(tracks) - len(done))


def _alone(points: KeypointPeople, track: int, number: int, frame: Frame) -> Frame:
    """Return a frame with the key points of one track as the only evidence."""
    return replace(frame, silhouettes=None, keypoints=points.of(track, number))


def _who_is_there(people: Sequence[TrackResult], frame_rate: float) -> tuple[str, ...]:
    """Return sentences on who was there, and when."""
    said = [f"{len(people)} {'people' if len(people) != 1 else 'person'}: {', '.join(p.name for p in people)}"]
    for p in people:
        at = np.flatnonzero(p.there)
        if 0 < len(at) < len(p.motion):
            said.append(f"{p.name} is there from {at[0] / frame_rate:.1f} to {(at[-1] + 1) / frame_rate:.1f} s")
    return tuple(said)


def padded(motion: Motion, first: int, total: int) -> Motion:
    """Extend a motion of the frames first, first + 1, ... to `total` frames: outside, its first and last frame are
    repeated and marked as lost and extrapolated.
    """
    rows = np.clip(np.arange(total) - first, 0, len(motion) - 1)
    outside = (np.arange(total) < first) | (np.arange(total) >= first + len(motion))
    arrays = per_frame(motion, rows) | {"times": np.arange(total) / motion.frame_rate}
    out = replace(motion, **arrays)
    out = replace(out, lost=out.lost | outside, extrapolated=out.extrapolated | outside)
    return with_trace(out, later(trace_of(motion), first))

"""Track one person of a recording that shows several: all are tracked together, and one result is kept.

Each person's evidence leaves out what the others cover, so a result never mixes two people.

Whether masks show several people is decided view by view, without a calibration, since the calibration may be the thing
that is checked.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.calibration.findings import INFO, Finding
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Silhouettes, pieces_of
from hypose.evidence.keypoints import keypoint_names
from hypose.io.motions.results import ResultsFolder, save_motion
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.recording_people import load_person
from hypose.pipeline.assessment import other_people_note
from hypose.pipeline.input_checks import places_refuted
from hypose.pipeline.people_run import PeopleRun
from hypose.pipeline.person_paths import KeypointPeople, count_people
from hypose.pipeline.run import TrackResult
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject_from_motion import load_subject
from hypose.pipeline.track_loop import FrameSource, StageProgress
from hypose.pipeline.track_options import TrackOptions
from hypose.pipeline.tracked_people import Wanted, said_of_places


def several_apart(silhouettes: Sequence[Silhouettes], often: float = SETTINGS.several_often) -> bool:
    """Return whether at least two views show people side by side in a share of the frames larger than `often`."""
    if not silhouettes:
        return False
    usable = np.array([s.usable for s in silhouettes])
    shown = [[u and _others_in_view(m) > 1 for m, u in zip(s.masks, s.usable, strict=True)] for s in silhouettes]
    views = np.array(shown).sum(0) > often * np.maximum(usable.sum(0), 1)
    return int(views.sum()) >= SETTINGS.several_views


def _others_in_view(mask: NDArray[np.uint8]) -> int:
    """Count the large parts of a mask (h, w) that stand side by side; parts above each other count as one."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    parts = stats[1:]
    if not len(parts):
        return 0
    area, height = parts[:, cv2.CC_STAT_AREA], parts[:, cv2.CC_STAT_HEIGHT]
    first = int(area.argmax())
    large = parts[(area >= SETTINGS.several_large * area[first]) & (height >= SETTINGS.several_tall * height[first])]
    count, end = 0, -1
    for left, width in sorted(large[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_WIDTH]].tolist()):
        count += left > end
        end = max(end, left + width)
    return count


_ALL_PEOPLE = "everybody"
_COUNT = re.compile(r"[1-9][0-9]?")


def wanted_of(recording: Recording) -> list[Wanted]:
    """Read what recording.toml says about people."""
    first = recording.frames.start / recording.frame_rate
    return [
        Wanted(
            p.name,
            p.height,
            None if p.body is None else load_subject(p.body),
            p.place,
            p.time - first,
        )
        for p in recording.people
    ]


def wanted_first(recording: Recording, options: TrackOptions) -> list[Wanted]:
    """Return the prior knowledge of the one person to track: the first person of recording.toml, with the requested
    body or height.
    """
    first = (wanted_of(recording) or [Wanted("person-1")])[0]
    body = first.body if options.subject is None else load_subject(options.subject)
    return [replace(first, height=first.height or options.height, body=body)]


def keypoint_people(recording: Recording, small: CameraRig) -> KeypointPeople | None:
    """Load the people that a recording's key points show, where they are separated by their rays; None where there are
    none.
    """
    found = load_person(recording, small)
    if found is None or recording.keypoint_set is None or not found.one.by_rays:
        return None
    return KeypointPeople(found.one.people, keypoint_names(recording.keypoint_set), small)


def chosen_people(text: str, wanted: Sequence[Wanted]) -> tuple[int | None, str | None]:
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


def people_frames(recording: Recording, options: TrackOptions, progress: StageProgress | None = None) -> FrameStream:
    """Open the frames of a recording with all people in the masks, where masks are wanted.

    Raises: InputError for key points together with depth cameras.
    """
    depth = [v.name for v in recording.depth_views]
    if depth and options.looks_at != "silhouettes":
        raise InputError(
            f"Several people before depth cameras ({', '.join(depth)}) are told apart by what these measure, and not "
            f"by key points; leave out --evidence {options.looks_at}, or --people."
        )
    silhouettes = None if options.looks_at == "keypoints" else recording.silhouettes
    return FrameStream(recording, FrameSettings(silhouettes=silhouettes, people=True, colours=True), progress=progress)


def frames_to_examine(recording: Recording, progress: StageProgress | None = None) -> tuple[FrameStream, bool]:
    """Open the frames of a recording whose calibration is in doubt.

    Where several people stand side by side, the masks keep all of them. Why: which person a view shows is not known
    before the calibration is right.
    Returns: the frames, and whether several people are in the masks.
    """
    one = FrameStream(recording, progress=progress)
    depth = bool(recording.depth_views)
    alone = depth and len(recording.views) == 1
    if one.options.silhouettes is None or not recording.has_pictures or one.tells_apart or alone:
        return one, False
    whole = replace(one.options, people=True)
    all_people = FrameStream(recording, whole, one.backgrounds or None)
    if depth:  # a single depth camera keeps the largest part, or the one most like a person
        several = count_people(all_people.frame, len(all_people)) > 1
        (one if several else all_people).close()
        return (all_people, True) if several else (one, False)
    rows = np.unique(np.linspace(0, len(all_people) - 1, SETTINGS.several_looks).astype(int)).tolist()
    masks = pieces_of((all_people.frame(i) for i in rows), Silhouettes)
    several = several_apart(masks)
    if not several and several_apart(
        masks, SETTINGS.several_now_and_then
    ):  # people who pass behind each other: counted if the cameras agree
        several = count_people(all_people.frame, len(all_people)) > 1
    (one if several else all_people).close()
    return (all_people, True) if several else (one, False)


def several_seen(source: FrameSource, options: TrackOptions) -> bool:
    """Return whether the masks of a source show several people; False where masks are not used."""
    looked_at = options.looks_at != "keypoints" and not options.of_picture
    return looked_at and count_people(source.frame, len(source)) > 1


def with_all_people(source: FrameStream, options: TrackOptions) -> FrameStream | None:
    """Open the frames of a recording with all people in the masks; None where the masks do not show several, or are not
    the only evidence.
    """
    settings = source.options
    views = source.recording.views
    if settings.silhouettes is None or options.of_picture or len(source.rig) < 2 or source.tells_apart:
        return None
    if source.recording.depth_views:
        # one depth camera keeps the largest person; several depth cameras, and pictures, may show other people;
        # masks made by other programs may be of one person
        if any(view.masks is not None for view in views) or options.looks_at != "silhouettes":
            return None
    elif len(views) < 3:
        return None
    whole = FrameSettings(settings.longer_side, settings.silhouettes, people=True, colours=True)
    all_people = FrameStream(source.recording, whole, source.backgrounds or None)
    if several_seen(all_people, options):
        return all_people
    all_people.close()
    return None


def track_one_of(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    wanted: Sequence[Wanted] = (),
    points: KeypointPeople | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: StageProgress | None = None,
    command: str = "--people all",
) -> TrackResult:
    """Track all people together and return the result of one.

    wanted: prior knowledge of the person; without it the person nearest to the middle of the cameras' view is taken.
    points: key points sorted by person.
    command: named in the note that other people are there.
    The other arguments: as for `track_source`.
    Returns: result of the person; not to be trusted where no person was found at the wanted place.
    """
    report = progress or (lambda stage, done, total: None)
    run = PeopleRun(
        source,
        frame_rate,
        options,
        1,
        wanted,
        results,
        record or {},
        resume,
        report,
        points,
        under=_ALL_PEOPLE,
    )
    found = run()
    one = found.people[0]
    more = found.others
    said = (other_people_note(more, "masks", command),) if more and not places_refuted(run.looked) else ()
    notes = said_of_places(wanted, 1 + more)
    found_so = [*one.result.findings, *said, *(Finding("places", (), f"Note: {n}", severity=INFO) for n in notes)]
    if wanted and wanted[0].place is not None and one.name != wanted[0].name:
        text = f"{wanted[0].not_found}; the result is that of another person"
        found_so.append(Finding("other person", (), text, "correct place and time of the [[person]] in recording.toml"))
    out = replace(one.result, findings=tuple(found_so), complete=found.complete)
    if results is not None:
        save_motion(out.motion, results.motion)
        if found.complete:
            shutil.rmtree(results.path / _ALL_PEOPLE, ignore_errors=True)
    return out

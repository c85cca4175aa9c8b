"""Run a tracking job, as `hypose track` and `hypose demo` do with one recording, from videos to the report.

Each step writes its files before the next begins, so that a job that ends early leaves all finished work.
"""

from __future__ import annotations

import contextlib
import html
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import click
import numpy as np
from click.exceptions import Exit

from hypose.app.commands.console import ProgressCall, Stages, counted, each, ignore, print_notes, say, stopping
from hypose.app.options import TrackCommand
from hypose.app.reports.report import picture_rows, report_html
from hypose.app.reports.report_parts import (
    CONTENT_POLICY,
    DESCRIPTIONS,
    html_list,
    html_table,
    page,
    require_found,
    summarize,
)
from hypose.app.reports.result_pictures import PictureRows, Shown, colour_of, write_overlay
from hypose.app.studio.view_bundle import Rivals, ViewResult
from hypose.body.motion import Motion
from hypose.calibration.findings import REVIEW, Finding
from hypose.compute.warming import warm_up
from hypose.errors import InputError
from hypose.geometry import runs
from hypose.io.files import check_writable, claimed, write_text
from hypose.io.motions.animation import write_people_glb
from hypose.io.motions.export import export_motion, known_formats
from hypose.io.motions.marker_files import joint_residuals, write_c3d
from hypose.io.motions.results import (
    load_body,
    load_modes,
    load_motion,
    provenance,
    provenance_identity,
    results_folder,
    to_json,
    write_json,
)
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.assessment import ASSESSMENT_FILE, EXIT_UNTRUSTED, UNTRUSTED, Assessment, load_assessment
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.one_camera import POINT_STARTS, clicks_of, depth_note
from hypose.pipeline.passes import MODES
from hypose.pipeline.recorded_frames import check_views, frames_wanted, one_view, people_frames
from hypose.pipeline.run import PeopleResult, TrackResult
from hypose.pipeline.subject import SubjectOptions, load_subject, subject_file
from hypose.pipeline.track import chosen_people, track_named, track_person, wanted_of
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.recipes import citation_of

if TYPE_CHECKING:
    from hypose.pipeline.comparison import Truth


@dataclass(frozen=True)
class TrackJob:
    """Job with one recording.

    recording: its frame_range is tracked.
    options: suited to the recording.
    results: folder of the files.
    command: options of the user, and which files are wanted.
    truth: compares the motion with the true one, for synthetic recordings.
    """

    recording: Recording
    options: TrackOptions
    results: Path
    command: TrackCommand
    truth: Callable[[Motion], Truth] | None = None

    @property
    def formats(self) -> tuple[str, ...]:
        """Names of the motion files to write."""
        return split_names(self.command.formats)


def split_names(text: str) -> tuple[str, ...]:
    """Split a comma-separated list of formats.

    Raises: InputError where it is empty or a format is not known.
    """
    names = tuple(dict.fromkeys(n.strip().lower().lstrip(".") for n in text.split(",") if n.strip()))
    if not names:
        raise InputError("The list of formats is empty; give at least one, for example --formats trc,c3d.")
    known_formats(names)
    return names


def recording_of(command: TrackCommand) -> Recording:
    """Load the recording that a command names, limited to the frames and camera that the command selects."""
    loaded = choose_frames(load_recording(command.recording, command.calibration), command.frames)
    return one_view(loaded, command.camera) if command.camera is not None or command.of_picture else loaded


def job_of(command: TrackCommand, recording: Recording | None = None) -> TrackJob:
    """Make the job of a command.

    command: options of the user.
    recording: the recording where it is loaded already; None: it is loaded.
    Returns: job with options suited to the recording, and its results folder.
    """
    loaded = recording or recording_of(command)
    height = loaded.subject_height if command.height is None else command.height
    options = replace(command.options, height=height).suited_to(loaded)
    name = options.recipe
    if command.people is not None:
        name = "people" if name == "default" else f"{name}-people"
    results = results_folder(loaded.folder, name) if command.out is None else command.out
    return TrackJob(loaded, options, results, command)


@dataclass(frozen=True)
class Outcome:
    """Result of a job.

    motion: motion of the person, or of the first of several.
    complete: every frame was tracked.
    notes: for the user.
    truth: comparison with the true motion, if there is one.
    assessment: assessment of the motion; of several people the worst.
    """

    motion: Motion
    complete: bool
    notes: tuple[str, ...]
    truth: Truth | None
    assessment: Assessment


def choose_frames(recording: Recording, text: str | None) -> Recording:
    """Limit a recording to the frames of the option --frames.

    text: "A:B", B is the frame after the last; either may be left out. None: all frames.
    Raises: InputError where the text is no range inside the recording.
    """
    if text is None:
        return recording
    found = re.fullmatch(r"(\d{0,9}):(\d{0,9})", text)
    if found is None:
        raise InputError(f"--frames {text} is no range; write first:stop, for example 0:100.")
    a, b = int(found[1] or 0), int(found[2] or recording.n_frames)
    if not 0 <= a < b <= recording.n_frames:
        raise InputError(
            f"--frames {text} lies outside the recording, which has the frames 0 to {recording.n_frames - 1}; give the "
            f"first frame and the one after the last, at most 0:{recording.n_frames}."
        )
    return replace(recording, frame_range=(a, b))


def run_job(job: TrackJob, progress: ProgressCall = ignore, seconds: Mapping[str, float] | None = None) -> Outcome:
    """Track the person of a job, or several, and write all files: motions, motion files, overlay, reports.

    A single person's files lie in the results folder. Several people have a folder each in it, and next to these the
    files of all people together.
    seconds: time per stage, filled by the progress while this runs, for the report.
    Returns: the outcome; after a KeyboardInterrupt while tracking it is incomplete, with checkpoint and partial motion
        written.
    Raises: KeyboardInterrupt in any other stage; InputError where the input cannot be used.
    """
    recording, results, several = job.recording, job.results, job.command.people is not None
    check_job(job)
    check_writable(results)
    record = record_of(job)
    compile_before(progress, *(() if several else _kernels(recording, job.options)))
    before = finished_before(job, record) if job.command.resume and not several else None
    frames = (
        people_frames(recording, job.options, progress)
        if several
        else FrameStream(recording, frames_wanted(recording, job.options), progress=progress)
    )
    with frames as source:
        found = _track(job, source, record, progress) if before is None else PeopleResult((before,), True)
        people, notes = found.people, (*recording.notes, *source.notes, *found.notes)
        first = people[0]
        for one in people:
            one.save(_folder(job, one))
        truth = job.truth(first.motion) if job.truth is not None else None
        if found.complete:
            for one in people:
                said = (*notes, *one.notes)
                _export_and_report(job, one, source, progress, notes=said, seconds=seconds or {}, truth=truth)
            if several:
                _together(job, people, source, notes, progress)
    assessment = first.assessment
    if several:
        assessment = worst_assessment(people, found.absent)
        write_json(results / ASSESSMENT_FILE, assessment.document())
    said = (f"{one.name}: {n}" if one.name else n for one in people for n in one.notes)
    return Outcome(first.motion, found.complete, (*notes, *said), truth, assessment)


def compile_before(progress: ProgressCall, *parts: str) -> None:
    """Compile the kernels (compiled functions) that a run needs, before it starts.

    progress: function (stage, done, total).
    parts: names of kernel groups; without any, all groups that tracking needs.
    """
    warm_up(*parts, load=False, progress=lambda done, total: progress("compile", done, total))


def _kernels(recording: Recording, options: TrackOptions) -> tuple[str, ...]:
    """List the parts of the compiled code that a run needs for its first poses, by the names of `warm_up`; others are
    compiled while it runs.
    """
    if options.of_picture:
        return ("solver", "scorer", "outlines", "pictures", "monocular")
    depth = ("depth",) if recording.depth_views else ()
    if options.looks_at == "keypoints":
        return ("solver", *depth)
    # a given body is not fitted to outlines
    masks = ("solver", *depth, "scorer", "outlines")
    return masks if all("masks" in view.files for view in recording.views) else (*masks, "pictures")


def _track(job: TrackJob, source: FrameStream, record: Mapping[str, Any], progress: ProgressCall) -> PeopleResult:
    """Track the people of a job.

    source: frames of the recording.
    record: provenance of the run.
    """
    options, about = job.options, {"results": job.results, "record": record, "progress": progress}
    if job.command.people is not None:
        return track_named(source, options, job.command.people, resume=job.command.resume, **about)
    command = f"hypose track {shlex.quote(str(job.recording.folder))} --people all"
    one = track_person(source, options, resume=job.command.resume, command=command, **about)
    return PeopleResult((one,), one.complete)


def check_job(job: TrackJob) -> None:
    """Raise InputError for faults of a job that would otherwise show after minutes of work."""
    options = job.options
    check_views(job.recording, options.of_picture)
    split_names(job.command.formats)
    if job.command.people is not None:
        if options.subject is not None:
            raise InputError(
                "--subject is one person's body; name the bodies of several people in recording.toml, as "
                "body = ... in their [[person]]."
            )
        chosen_people(job.command.people, wanted_of(job.recording))
    if options.of_picture:
        clicks_of(options.start, job.recording)
    else:
        SubjectOptions(options.start)
    if options.subject is not None:
        load_subject(options.subject)
    if options.looks_at != "keypoints" and not options.of_picture and not job.recording.has_pictures:
        raise InputError(
            f"The evidence {options.looks_at!r} needs pictures, and {job.recording.name} has key points alone; use "
            "keypoints."
        )
    if options.looks_at == "keypoints" and not options.of_picture and job.recording.keypoint_set is None:
        raise InputError(
            "The evidence 'keypoints' needs key points, and this recording has none; add keypoints = ... to the views "
            "in recording.toml, or use silhouettes."
        )


def record_of(job: TrackJob) -> dict[str, Any]:
    """Build the provenance of a run: versions, settings and hashes of the inputs that influence the result."""
    recording, options, people = job.recording, job.options, job.command.people
    frames = recording.frames
    settings = {
        **options.settings(),
        "frames": [frames.start, frames.stop],
        "frame_rate": recording.frame_rate,
        "views": [v.name for v in recording.views],
        **({} if people is None else {"people": people}),
    }
    inputs = dict(recording.inputs)
    toml = recording.folder / "recording.toml"
    if toml.is_file():
        inputs["recording"] = toml
    if options.subject is not None:
        inputs["subject"] = subject_file(options.subject)
    if options.of_picture and options.start not in POINT_STARTS:
        inputs["clicks"] = Path(options.start)
    return provenance(options.recipe, options.seed, settings, inputs, {"threads": job.command.threads})


def finished_before(job: TrackJob, record: Mapping[str, Any]) -> TrackResult | None:
    """Load the complete motion of an earlier run with the same inputs and settings, of which only later files may be
    missing.

    record: provenance of this run.
    Returns: result of the earlier run; None without one.
    """
    results = job.results
    body = results / "body.npz"
    if (results / "checkpoint.npz").exists() or not (results / "motion.npz").exists() or not body.exists():
        return None
    motion = load_motion(results / "motion.npz")
    if to_json(provenance_identity(motion.provenance)) != to_json(provenance_identity(record)) or len(motion) != len(
        job.recording.frames
    ):
        return None
    notes, modes = ("tracked in an earlier run with the same inputs and settings",), None
    if job.options.of_picture:
        if not (results / MODES).exists():
            return None
        modes = load_modes(results / MODES)
        notes = (*notes, depth_note(motion, modes))
    return TrackResult(motion, load_body(body), True, notes, modes, judged=load_assessment(results))


_SAVED = ("motion.npz", MODES, "body.npz", "provenance.json", ASSESSMENT_FILE)
"""Files that exist before the motion files of a person are written; MODES with one camera only."""


def _folder(job: TrackJob, one: TrackResult) -> Path:
    """Return the results folder of one person; a single person, without a name, has that of the job."""
    return job.results / one.name


def _export_and_report(
    job: TrackJob,
    one: TrackResult,
    source: FrameStream,
    progress: ProgressCall,
    **about: Any,  # noqa: ANN401 (fields of the report)
) -> None:
    """Write motion files, overlay and report of one person, where they are wanted, and delete files of earlier runs.
    Several people have one overlay of all, which is not written here.

    source: frames of the recording.
    about: fields of `ViewResult` for the report.
    """
    motion, body, modes = one.motion, one.body, one.modes
    recording, results = job.recording, _folder(job, one)
    files = [results / n for n in _SAVED if n != MODES or modes is not None]
    for name in each(progress, "export", job.formats):
        files += export_motion(motion, body, results, (name,))
    video, reported = job.command.overlay and not one.name, job.command.report
    files += [results / "overlay.webm"] * video + [results / "report.html"] * reported
    if video or reported:
        view = ViewResult(
            f"{recording.name}: {one.name}" if one.name else recording.name,
            motion,
            body,
            recording,
            **about,
            citation=citation_of(job.options.recipe, job.options.refine),
            first_frame=recording.frames.start,
            rivals=Rivals.of_motion(motion) if modes is None else Rivals.of(modes.joints, modes.weights),
            assessment=one.assessment,
            files=[(p.name, DESCRIPTIONS.get(p.name, ""), 0) for p in files],
        )
        wanted, people = picture_rows(view, video) if reported else PictureRows(video), [Shown("", motion, body)]
        drawn = write_overlay(results / "overlay.webm", recording, source, people, wanted, progress)
        for _ in each(progress, "report", [view] * reported):
            write_text(results / "report.html", report_html(view, drawn))
    remove_stale(results, files)


def remove_stale(results: Path, written: Sequence[Path]) -> None:
    """Delete files of an earlier run that this run did not write, since they would be mistaken for results of this one.

    written: paths that this run wrote; other files in the folder that no run writes stay.
    """
    keep = {p.name for p in written}
    for name in DESCRIPTIONS:
        if name not in keep:
            with contextlib.suppress(OSError):
                (results / name).unlink(missing_ok=True)


# ---- several people together -----------------------------------------------------------------------------------------


def worst_assessment(people: Sequence[TrackResult], absent: str = "") -> Assessment:
    """Combine the assessments of several people: the worst word, with the sentences and frames of the people who
    have it.

    absent: sentence that the person who was asked for was not found; then the results are not to be trusted.
    """
    if absent:
        return Assessment(UNTRUSTED, (Finding("absent", (), absent),))
    assessments = {p.name: p.assessment for p in people}
    order = ("good", "look", UNTRUSTED)
    word = max((v.word for v in assessments.values()), key=order.index)
    found = [
        Finding("person", (), f"{name}: {v.sentence}", severity=REVIEW)
        for name, v in assessments.items()
        if v.word == word and v.because
    ]
    frames = tuple(r for v in assessments.values() if v.word == word for r in v.frames)
    return Assessment(word, tuple(found), () if word == UNTRUSTED else frames)


def _together(
    job: TrackJob, people: Sequence[TrackResult], source: FrameStream, notes: Sequence[str], progress: ProgressCall
) -> None:
    """Write overlay, C3D, GLB, people.json and index page of all people, and delete files of earlier runs.

    source: frames of the recording with all people.
    notes: for people.json and the page.
    """
    results, files = job.results, [job.results / ASSESSMENT_FILE]
    if job.command.overlay:
        files.append(results / "overlay.webm")
        shown = [Shown(p.name, p.motion, p.body, p.there) for p in people]
        write_overlay(files[-1], job.recording, source, shown, PictureRows(), progress)
    if "c3d" in job.formats:
        files.append(write_people_c3d(results / "motion.c3d", people))
    if "glb" in job.formats:
        files.append(results / "motion.glb")
        write_people_glb(files[-1], [(p.name, p.motion, p.body) for p in people])
    about = [
        {"name": p.name, "folder": p.name, "assessment": p.assessment.word, "there": p.spans}
        | {"stature": p.body.stature}
        for p in people
    ]
    write_json(results / "people.json", {"people": about, "notes": list(notes)})
    if job.command.report:
        files.append(results / "report.html")
        write_text(files[-1], _index(job, people, notes))
    remove_stale(results, files)


def write_people_c3d(path: Path, people: Sequence[TrackResult]) -> Path:
    """Write the joint centres of all people as one C3D with subjects; return its path.

    Points are named NAME:JOINT. The residual of a point is its standard deviation (mm), 0 where it was not measured;
    points of absent people are marked as not seen.
    """
    subjects = [p.name.replace(" ", "-").replace(":", "-") for p in people]
    names = [f"{s}:{j}" for s, p in zip(subjects, people, strict=True) for j in p.motion.skeleton.joint_names]
    points = [np.where(p.there[:, None, None], p.motion.joints, np.nan) for p in people]
    residuals = np.concatenate([joint_residuals(p.motion) for p in people], 1)
    rate = people[0].motion.frame_rate
    write_c3d(path, names, np.concatenate(points, 1), rate, residuals, subjects=subjects)
    return path


def _index(job: TrackJob, people: Sequence[TrackResult], notes: Sequence[str]) -> str:
    """Build the page with links to the reports of all people.

    notes: sentences at the end of the page.
    """
    rows = []
    for k, p in enumerate(people):
        b, g, r = colour_of(k)
        there = in_words(runs(p.there)) if not p.there.all() else "all frames"
        cells = (
            f'<span style="color:rgb({r},{g},{b})">&#9632;</span>',
            f'<a href="{html.escape(quote(p.name), quote=True)}/report.html">{html.escape(p.name)}</a>',
            f"{p.body.stature:.2f} m",
            html.escape(there),
            html.escape(p.assessment.sentence),
        )
        rows.append(cells)
    film = '<p><video src="overlay.webm" controls></video></p>' if job.command.overlay else ""
    table = html_table(rows, ("", "person", "height", "there", "assessment"))
    body = f"<h1>{html.escape(job.recording.name)}</h1>{table}{film}{html_list(notes)}"
    return page(job.recording.name, body, policy=f"{CONTENT_POLICY}; media-src 'self'")


# ---- with progress --------------------------------------------------------------------------------------------------


def track_shown(job: TrackJob) -> None:
    """Run a job with progress and print its outcome; after an interruption, print what was kept and how to continue,
    and exit with code 130.
    """
    with stopping(lambda: _kept(job)), claimed(job.results), Stages() as progress:
        outcome = run_job(job, progress, progress.seconds)
        if not outcome.complete:
            raise KeyboardInterrupt
    _report_outcome(job, outcome, progress.seconds)


def _kept(job: TrackJob) -> str:
    """Return the sentence on what an interrupted run has kept, and how to continue."""
    results, total = job.results, len(job.recording.frames)
    again = [a for a in click.get_current_context().find_root().obj or [] if a != "--resume"]
    command = f"hypose {shlex.join([*again, '--resume'])}" if again[:1] == ["track"] else "the same command"
    several = job.command.people is not None
    motions = sorted(results.glob("*/motion.npz")) if several else [results / "motion.npz"]
    motions, where = [m for m in motions if m.exists()], results if several else results / "motion.npz"
    if not motions:
        kept = " Kept: body and start of the person." if (results / "checkpoint.npz").exists() else ""
        return f"Stopped before the first frame was tracked.{kept} Go on with: {command}"
    done = f"{len(load_motion(motions[0]))} of {total} frames"
    return f"Stopped. Kept: {done} in {where}. Go on with: {command}"


def _report_outcome(job: TrackJob, outcome: Outcome, seconds: Mapping[str, float]) -> None:
    """Print the closing lines of a job, and exit with code 3 where its result is not to be trusted.

    seconds: time per stage.
    Raises: EvidenceError where the person was found in no frame.
    """
    print_notes(outcome.notes)
    views, reported = len(job.recording.rig), int(outcome.motion.n_views.max(initial=0))
    of = f"{reported} of {views}" if 0 < reported < views else f"{views}"  # largest number of views used in a frame
    speed = [f"{len(outcome.motion) / seconds['track']:.1f} frames/s"] if seconds.get("track") else []
    print_figures(job.recording.name, outcome.motion, f"in {of} view{'s' * (of != '1')}", speed)
    if outcome.truth is not None:
        say(f"Mean joint error: {outcome.truth.mean_mm:.1f} mm over {len(outcome.truth.names)} joints", "bold")
    say(f"Results: {job.results}")
    if job.command.report:
        say(f"Report:  {job.results / 'report.html'}")
    require_found(outcome.motion, job.recording.name, job.results)
    print_assessments({"": outcome.assessment})


def print_figures(name: str, motion: Motion, seen: str, more: Sequence[str] = ()) -> None:
    """Print one line with the figures of a motion.

    seen: by which views or sensors, in words.
    more: further figures.
    """
    s = summarize(motion)
    parts = [f"{counted(s.frames, 'frame')} {seen}", f"{s.lost} lost", f"{s.extrapolated} extrapolated"]
    parts += [f"mean IoU {s.iou:.3f}"] if np.isfinite(s.iou) else []
    parts += [f"median joint sd {s.sd_mm:.1f} mm"] if np.isfinite(s.sd_mm) else []
    say(f"{name}: " + ", ".join([*parts, *more]))


def print_assessments(assessments: Mapping[str, Assessment]) -> None:
    """Print the assessments by people's names ("" for a single person); exit with code 3 where one is not to be
    trusted.
    """
    for name, assessment in assessments.items():
        say(f"Assessment{' on ' if name else ''}{name}: {assessment.sentence}", "bold")
    if any(assessment.word == UNTRUSTED for assessment in assessments.values()):
        raise Exit(EXIT_UNTRUSTED)

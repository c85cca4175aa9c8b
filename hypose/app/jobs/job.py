"""Run a tracking job, as `hypose track` and `hypose demo` do with one recording, from videos to the report.

Each step writes its files before the next begins, so that a job that ends early leaves all finished work.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hypose.app.commands.console import ProgressCall, each, ignore
from hypose.app.options import TrackCommand
from hypose.app.reports.overlay import PictureRows, write_overlay
from hypose.app.reports.report import picture_rows, report_html
from hypose.app.reports.summary import DESCRIPTIONS
from hypose.app.studio.view_bundle import Rivals, in_recording
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.compute.warming import warm_up
from hypose.errors import InputError
from hypose.io.files import check_writable, read_json
from hypose.io.motions.export import export_motion, known_formats
from hypose.io.motions.results import (
    ResultsFolder,
    load_body,
    load_modes,
    load_motion,
    provenance,
    provenance_identity,
    save_body,
    to_json,
)
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.sensors.skeleton_streams import SkeletonRecording
from hypose.pipeline.assessment import ASSESSMENT_FILE, Assessment
from hypose.pipeline.first_frame import SubjectOptions
from hypose.pipeline.one_camera import POINT_STARTS, clicks_of, depth_note, one_view
from hypose.pipeline.passes import MODES
from hypose.pipeline.run import TrackResult
from hypose.pipeline.subject_from_motion import load_subject, subject_file
from hypose.pipeline.track import track_person
from hypose.pipeline.track_options import TrackOptions, check_views, frames_wanted
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
    skeletons: reports of sensors from the same time, solved together with the rest.
    """

    recording: Recording
    options: TrackOptions
    results: ResultsFolder
    command: TrackCommand
    truth: Callable[[Motion, Body], Truth] | None = None
    skeletons: SkeletonRecording | None = None

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
    """Load the recording of a command, limited to the wanted frames and camera."""
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
    results = ResultsFolder.of(loaded.folder, name) if command.out is None else ResultsFolder(command.out)
    return TrackJob(loaded, options, results, command)


@dataclass(frozen=True)
class Outcome:
    """Result of a job.

    complete: every frame was tracked.
    files: paths in the order of writing.
    notes: for the user.
    truth: comparison with the true motion, if there is one.
    assessment: of the motion; None for an incomplete one.
    """

    motion: Motion
    body: Body
    complete: bool
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    truth: Truth | None = None
    assessment: Assessment | None = None


def choose_frames(recording: Recording, text: str | None) -> Recording:
    """Limit a recording to the frames of the option --frames.

    text: "A:B", B is the frame after the last; either may be left out. None: all frames.
    Raises: InputError where the text is no range inside the recording.
    """
    if text is None:
        return recording
    first, colon, stop = text.partition(":")
    try:
        if not colon:
            raise ValueError
        a, b = int(first or 0), int(stop or recording.n_frames)
    except ValueError:
        raise InputError(f"--frames {text} is no range; write first:stop, for example 0:100.") from None
    if not 0 <= a < b <= recording.n_frames:
        raise InputError(
            f"--frames {text} lies outside the recording, which has the frames 0 to {recording.n_frames - 1}; give the "
            f"first frame and the one after the last, at most 0:{recording.n_frames}."
        )
    return replace(recording, frame_range=(a, b))


def run_job(job: TrackJob, progress: ProgressCall = ignore, seconds: Mapping[str, float] | None = None) -> Outcome:
    """Track the recording of a job, and write all files of its results folder: motion, motion files, overlay, report.

    seconds: time per stage, filled by the progress while this runs, for the report.
    Returns: the outcome; after a KeyboardInterrupt while tracking it is incomplete, with checkpoint and partial motion
        written.
    Raises: KeyboardInterrupt in any other stage; InputError where the input cannot be used.
    """
    recording, results, options = job.recording, job.results, job.options
    check_job(job)
    check_views(recording, options.of_picture)
    check_writable(results.path)
    record = record_of(job)
    compile_before(progress, *_kernels(recording, options))
    finished = finished_before(job, record) if job.command.resume else None
    with FrameStream(recording, frames_wanted(recording, options), progress=progress) as source:
        if finished is None:
            tracked = _track(job, options, source, record, progress)
            save_body(tracked.body, results.file("body.npz"))
            results.write_json("provenance.json", tracked.motion.provenance)
        else:
            tracked = finished
        notes = (*recording.notes, *source.notes, *tracked.notes)
        files = [results.motion, results.file("body.npz"), results.file("provenance.json")]
        assessment = _assessment(tracked, results, finished is not None)
        files.append(results.file(ASSESSMENT_FILE))
        if tracked.modes is not None:
            files.insert(1, results.file(MODES))
        truth = job.truth(tracked.motion, tracked.body) if job.truth is not None else None
        if not tracked.complete:
            return Outcome(tracked.motion, tracked.body, False, tuple(files), notes, truth)
        about = {"notes": notes, "seconds": seconds or {}, "truth": truth, "assessment": assessment}
        files += export_and_report(job, tracked, source, files, progress, **about)
    remove_stale(results, files)
    return Outcome(tracked.motion, tracked.body, True, tuple(files), notes, truth, assessment)


def compile_before(progress: ProgressCall, *parts: str) -> None:
    """Compile the kernels that a run needs; parts: names of parts, none: all that tracking needs."""
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
    masks = ("solver", *depth, "scorer", "outlines")
    return masks if all(view.masks is not None for view in recording.views) else (*masks, "pictures")


def _assessment(tracked: TrackResult, results: ResultsFolder, before: bool) -> Assessment:
    """Assess what was tracked, and write assessment.json.

    before: the motion is of an earlier run, whose assessment is loaded where possible.
    """
    if before:
        with contextlib.suppress(InputError, ValueError, KeyError, TypeError):
            return Assessment.of_document(read_json(results.file(ASSESSMENT_FILE), "an assessment"))
    results.write_json(ASSESSMENT_FILE, tracked.assessment.with_joints(tracked.motion))
    return tracked.assessment


def _track(
    job: TrackJob, options: TrackOptions, source: FrameStream, record: Mapping[str, Any], progress: ProgressCall
) -> TrackResult:
    """Track the person of a job, together with the skeletons of sensors where there are any.

    source: frames of the recording.
    record: provenance of the run.
    """
    if (skeletons := job.skeletons) is not None:
        from hypose.pipeline.sensor_skeletons import fuse_mixture, skeletons_at_frames

        return fuse_mixture(
            source,
            job.recording.frame_rate,
            lambda motion: skeletons_at_frames(skeletons, motion),
            options,
            progress=progress,
            results=job.results,
            record=record,
        )
    return track_person(
        source,
        options,
        results=job.results,
        record=record,
        resume=job.command.resume,
        progress=progress,
        command=f"hypose track {shlex.quote(str(job.recording.folder))} --people all",
    )


def check_job(job: TrackJob) -> None:
    """Raise InputError for faults of a job that would otherwise show after minutes of work."""
    options = job.options
    split_names(job.command.formats)
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
    """Build the provenance of a run: everything that influences the result."""
    recording, options = job.recording, job.options
    frames = recording.frames
    settings = {
        **options.settings(),
        "frames": [frames.start, frames.stop],
        "frame_rate": recording.frame_rate,
        "views": [v.name for v in recording.views],
    }
    inputs = {**recording.inputs, **({} if job.skeletons is None else job.skeletons.inputs)}
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
    body = results.file("body.npz")
    if results.checkpoint.exists() or not results.motion.exists() or not body.exists():
        return None
    motion = load_motion(results.motion)
    if to_json(provenance_identity(motion.provenance)) != to_json(provenance_identity(record)) or len(motion) != len(
        job.recording.frames
    ):
        return None
    notes, modes = ("tracked in an earlier run with the same inputs and settings",), None
    if job.options.of_picture:
        if not results.file(MODES).exists():
            return None
        modes = load_modes(results.file(MODES))
        notes = (*notes, depth_note(motion, modes))
    return TrackResult(motion, load_body(body), True, notes, modes)


def export_and_report(
    job: TrackJob,
    tracked: TrackResult,
    source: FrameStream,
    written: Sequence[Path],
    progress: ProgressCall,
    **about: Any,  # noqa: ANN401 (fields of the report)
) -> list[Path]:
    """Write motion files, overlay and report of a tracked person, where they are wanted.

    source: frames of the recording.
    written: files that exist already.
    about: fields of `ViewResult` for the report: notes, assessment, title, ...
    Returns: paths of the new files.
    """
    motion, body, results, recording = tracked.motion, tracked.body, job.results, job.recording
    files: list[Path] = []
    for name in each(progress, "export", job.formats):
        files += export_motion(motion, body, results.path, (name,))
    video, reported = job.command.overlay, job.command.report
    if not (video or reported):
        return files
    modes, report, path = tracked.modes, results.file("report.html"), results.file("overlay.mp4")
    view = in_recording(
        recording,
        motion,
        body,
        citation=citation_of(job.options.recipe, job.options.refine),
        complete=tracked.complete,
        first_frame=recording.frames.start,
        rivals=Rivals.of_motion(motion) if modes is None else Rivals.of(modes.joints, modes.weights),
        **about,
    )
    wanted = picture_rows(view, video) if reported else PictureRows(video)
    drawn = write_overlay(path, recording, source, motion, body, wanted, progress)
    files += [path] if video else []
    if reported:
        progress("report", 0, 1)
        listed = [(p.name, DESCRIPTIONS.get(p.name, ""), 0) for p in (*written, *files, report)]
        files.append(results.write_text("report.html", report_html(replace(view, files=listed), drawn)))
        progress("report", 1, 1)
    return files


def remove_stale(results: ResultsFolder, written: Sequence[Path]) -> None:
    """Delete files of an earlier run that this run did not write, since they would be mistaken for results of this one.

    written: paths that this run wrote; other files in the folder that no run writes stay.
    """
    keep = {p.name for p in written}
    for name in DESCRIPTIONS:
        if name not in keep:
            with contextlib.suppress(OSError):
                results.file(name).unlink(missing_ok=True)

"""What `hypose track --method monocular` does with one camera of a recording, from its video to the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hypose import compute
from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.jobs.job import (
    Job,
    Outcome,
    check_formats,
    export_all,
    finished_before,
    record_of,
    remove_stale,
)
from hypose.app.reports.result_pictures import Image
from hypose.errors import InputError
from hypose.io.motions.modes import load_modes
from hypose.io.motions.results import check_writable
from hypose.io.recordings.provenance import file_identity
from hypose.io.recordings.recording import Recording
from hypose.pipeline.mono_start import side_to_work_on
from hypose.pipeline.mono_stream import MonoStream, one_view
from hypose.pipeline.monocular import (
    CITATION,
    MODES,
    POINT_STARTS,
    MonoOptions,
    MonoResult,
    clicks_of,
    depth_note,
    track_stream,
)
from hypose.pipeline.run import TrackOptions
from hypose.pipeline.subject_from_motion import load_subject


def one_camera(
    recording: Recording,
    method: str,
    camera: str | None,
    given: TrackOptions,
    hypotheses: int,
    evidence: str,
    floor: float | None,
) -> tuple[Recording, MonoOptions]:
    """The recording of one camera and the options of a monocular track, from what `hypose track` was given; an
    InputError when the method does not exist or something does not go together."""
    if method not in ("multiview", "monocular"):
        raise InputError(f"There is no --method {method}; choose multiview or monocular.")
    if method == "multiview":
        raise InputError("--camera chooses one camera, and that needs --method monocular; give both or neither.")
    if given.recipe != "default" or given.refine:
        raise InputError(
            "--recipe and --refine choose the search with several cameras; leave them out with --method monocular."
        )
    options = MonoOptions(
        evidence=evidence,
        start=given.start,
        height=given.height,
        floor=floor,
        hypotheses=hypotheses,
        seed=given.seed,
        subject=given.subject,
        smooth=given.smooth,
    )
    return one_view(recording, camera), options


def run_mono_job(
    job: Job, options: MonoOptions, progress: ProgressCall = ignore, seconds: Mapping[str, float] | None = None
) -> Outcome:
    """Track one camera, export, draw and report; the recording of the job has one view (mono_stream.one_view).

    KeyboardInterrupt while tracking gives an Outcome with complete=False (checkpoint, motion and modes are on disk); in
    any other stage it is passed on.
    """
    results = job.results
    _check(job, options)
    check_writable(results.path)
    record = record_of(job)
    if options.start not in POINT_STARTS:
        record["inputs"]["clicks"] = file_identity(options.start)
    progress("compile", 0, 1)
    compute.warm_up(monocular=True)
    progress("compile", 1, 1)
    progress("background", 0, 1)
    side = side_to_work_on(job.recording, clicks_of(options, job.recording))
    with MonoStream(job.recording, options.evidence, side) as stream:
        progress("background", 1, 1)
        tracked = _earlier(job, record) if job.resume else None
        if tracked is None:
            given = load_subject(options.subject) if options.subject is not None else None
            tracked = track_stream(
                stream, options, body=given, results=results, record=record, resume=job.resume, progress=progress
            )
            results.write_json("provenance.json", record)
    notes = (*job.recording.notes, *tracked.notes)
    files = [results.motion, results.file(MODES), results.file("body.npz"), results.file("provenance.json")]
    if not tracked.complete:
        return Outcome(tracked.motion, tracked.body, False, tuple(files), notes)
    files += export_all(job, tracked.motion, tracked.body, progress)
    files += _draw(job, tracked, notes, files, progress, seconds or {})
    remove_stale(results, files)
    return Outcome(tracked.motion, tracked.body, True, tuple(files), notes)


def _check(job: Job, options: MonoOptions) -> None:
    """Refuse now what would be refused only after minutes of work."""
    check_formats(job.formats)
    if options.subject is not None:
        load_subject(options.subject)
    if options.start not in POINT_STARTS:
        if not Path(options.start).is_file():
            raise InputError(
                f"--start {options.start} is no file of clicked joints, and with one camera it can otherwise only be "
                f"{' or '.join(POINT_STARTS)}; give one of these."
            )
        clicks_of(options, job.recording)


def _earlier(job: Job, record: Mapping[str, object]) -> MonoResult | None:
    """The complete result of an earlier run, when only later files may be missing."""
    before = finished_before(job, record)
    path = job.results.file(MODES)
    if before is None or not path.exists():
        return None
    modes = load_modes(path)
    notes = (*before.notes, depth_note(before.motion, modes, before.body))
    return MonoResult(before.motion, modes, before.body, True, notes)


def _draw(
    job: Job,
    tracked: MonoResult,
    notes: Sequence[str],
    files: Sequence[Path],
    progress: ProgressCall,
    seconds: Mapping[str, float],
) -> list[Path]:
    """Overlay and report."""
    from hypose.app.reports.drawing import draw
    from hypose.app.reports.mono_overlay import write_mono_overlay
    from hypose.app.reports.report import ReportInput
    from hypose.app.studio.view_bundle import Rivals

    recording, motion, body = job.recording, tracked.motion, tracked.body
    about = ReportInput(
        title=recording.name,
        motion=motion,
        body=body,
        rig=recording.rig,
        notes=notes,
        citation=CITATION,
        seconds=dict(seconds),
        recording=recording,
        first_frame=recording.frames.start,
        rivals=Rivals.of(tracked.modes.joints, tracked.modes.weights),
    )

    def overlay(path: Path, rows: Sequence[int]) -> Mapping[int, Image]:
        return write_mono_overlay(
            path, recording, motion, tracked.modes, body, stills=rows, video=job.overlay, progress=progress
        )

    caption = "Frame {}, and all modes from the side"
    return draw(job.results, about, overlay, files, video=job.overlay, caption=caption, progress=progress)

"""`hypose track`, `demo`, `correct`, `batch` and `warm-up`: recordings that are tracked."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import click
from click.exceptions import Exit

from hypose.app.commands.console import Stages, print_note, print_notes, say
from hypose.app.options import TrackCommand
from hypose.errors import InputError
from hypose.options import MOST_FRAMES, Option, Seconds, Seed, Threads

if TYPE_CHECKING:
    from hypose.app.jobs.job import Outcome, TrackJob
    from hypose.pipeline.assessment import Assessment

_GO_ON = "Stopped. Go on with the same command."


def track_command(command: TrackCommand) -> None:
    """Do what `hypose track` is asked for."""
    from hypose.app.jobs.job import job_of, recording_of
    from hypose.app.jobs.person_job import detected
    from hypose.pipeline.detect_keypoints import wants_detector

    loaded, several = recording_of(command), command.camera is None and not command.of_picture
    if several and command.evidence != "silhouettes" and (loaded.detected or wants_detector(loaded)):
        if not loaded.detected:
            print_note(
                "note: neither key points, masks nor pictures of the empty room are given: the detector finds people."
            )
        detected(loaded, loaded.frames, yes=command.yes, why="Tracking videos alone")
        loaded = recording_of(command)
    track_shown(job_of(command, loaded))


def demo(
    out: Annotated[Path, Option("Folder to write to.")] = Path("demo"),
    seconds: Seconds = 4.0,
    seed: Seed = 1,
    threads: Threads = None,
) -> None:
    """Make a synthetic four-camera recording, track it as `hypose track` would, and compare with the truth."""
    from hypose.app.jobs.job import job_of
    from hypose.io.files import claimed
    from hypose.pipeline.comparison import compare_with
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import check_folder, write_scene

    check_folder(out)
    say(f"Writing a synthetic recording of {seconds:g} s of walking, seen by four cameras, to {out}")
    scene = make_scene("walk", rig="humaneva-4", seconds=seconds, seed=seed, distorted=True)
    with claimed(out), Stages() as progress:
        write_scene(scene, out, progress=lambda done, total: progress("render", done, total))
    say(f"Tracking it as `hypose track {shlex.quote(str(out))}` would")
    job = job_of(TrackCommand(recording=out, threads=threads))
    track_shown(replace(job, truth=compare_with(out / "truth.npz")))


def track_shown(job: TrackJob) -> None:
    """Run a job with progress, and say what came out; when it is interrupted, say what was kept and how to go on, and
    exit with code 130."""
    from hypose.app.jobs.job import run_job
    from hypose.app.jobs.people_job import run_people
    from hypose.io.files import claimed

    with stopping(lambda: _kept(job)), claimed(job.results.path), Stages() as progress:
        if job.command.people is not None:
            outcome = run_people(job, job.command.people, progress)
        else:
            outcome = run_job(job, progress, progress.seconds)
        if not outcome.complete:
            raise KeyboardInterrupt
    _report_outcome(job, outcome, progress.seconds)


@contextlib.contextmanager
def stopping(text: str | Callable[[], str] = "") -> Iterator[None]:
    """Within the block Ctrl-C, and SIGTERM likewise, end the command in order, with exit code 130.

    text: the sentence printed then."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        if text:
            say(text if isinstance(text, str) else text())
        raise Exit(130) from None
    finally:
        signal.signal(signal.SIGTERM, previous)


def _kept(job: TrackJob) -> str:
    """What an interrupted run has kept, and how to go on."""
    from hypose.io.motions.results import load_motion

    results, total = job.results, len(job.recording.frames)
    again = [a for a in click.get_current_context().find_root().obj or [] if a != "--resume"]
    command = f"hypose {shlex.join([*again, '--resume'])}" if again[:1] == ["track"] else "the same command"
    if results.checkpoint.exists():
        done = f"{len(load_motion(results.motion))} of {total} frames" if results.motion.exists() else "tracked frames"
        return f"Stopped. Kept: {done} in {results.motion}, and the state of the tracker. Go on with: {command}"
    if results.motion.exists():
        return f"Stopped. The motion is complete in {results.motion}. Write the other files with: {command}"
    return f"Stopped before the first frame was tracked, so nothing was kept. Start again with: {command}"


def _report_outcome(job: TrackJob, outcome: Outcome, seconds: Mapping[str, float]) -> None:
    """The closing lines."""
    from hypose.app.reports.summary import require_found, summarize

    s = summarize(outcome.motion)
    print_notes(outcome.notes)
    views, reported = len(job.recording.rig), int(outcome.motion.n_views.max(initial=0))
    of = f"{reported} of {views}" if 0 < reported < views else f"{views}"  # as many as ever reported anything at once
    parts = [f"{s.frames} frames in {of} views", f"{s.lost} lost", f"{s.extrapolated} extrapolated"]
    if s.iou == s.iou:
        parts.append(f"mean IoU {s.iou:.3f}")
    if s.sd_mm == s.sd_mm:
        parts.append(f"median joint sd {s.sd_mm:.1f} mm")
    if seconds.get("track"):
        parts.append(f"{s.frames / seconds['track']:.1f} frames/s")
    say(f"{job.recording.name}: " + ", ".join(parts))
    if outcome.truth is not None:
        say(f"Mean joint error: {outcome.truth.mean_mm:.1f} mm over {len(outcome.truth.names)} joints", "bold")
    say(f"Results: {job.results.path}")
    if job.command.report:
        say(f"Report:  {job.results.file('report.html')}")
    require_found(outcome.motion, job.recording.name, job.results.path)
    if outcome.assessment is not None:
        print_assessments({"": outcome.assessment})


def print_assessments(assessments: Mapping[str, Assessment]) -> None:
    """The assessment on all people by their names (none of one person); exit code 3 when one is not to be trusted."""
    from hypose.pipeline.assessment import EXIT_UNTRUSTED, UNTRUSTED

    for name, assessment in assessments.items():
        say(f"Assessment{' on ' if name else ''}{name}: {assessment.sentence}", "bold")
    if any(assessment.word == UNTRUSTED for assessment in assessments.values()):
        raise Exit(EXIT_UNTRUSTED)


def correct(
    results: Annotated[Path, Option("Results folder of hypose track.", argument=True)],
    clicks: Annotated[Path, Option("The corrected pose: starts/NAME.json, saved in hypose view.", argument=True)],
    until: Annotated[
        int | None, Option("Track again up to this frame of the recording. [default: to the end]", 1, MOST_FRAMES)
    ] = None,
    out: Annotated[Path | None, Option("Results folder. [default: RESULTS-corrected]")] = None,
    formats: Annotated[str, Option("Motion files to write.")] = "trc,c3d,bvh,glb,csv,mot",
    threads: Threads = None,
) -> None:
    """Track a result again from a frame whose pose was corrected; the frames before stay as they are."""
    from hypose.app.jobs.correct import corrected_motion, read_correction
    from hypose.app.jobs.job import split_names
    from hypose.app.reports.summary import require_found
    from hypose.app.studio.view_bundle import find_recording
    from hypose.io.files import claimed
    from hypose.io.motions.results import ResultsFolder

    recording = find_recording(results)
    if recording is None:
        raise InputError(f"{results} lies in no recording; give the results folder inside the recording's folder.")
    folder = ResultsFolder(out or results.with_name(f"{results.name}-corrected"))
    correction = read_correction(clicks)
    with claimed(folder.path), Stages() as progress:
        about = {"until": until, "formats": split_names(formats), "progress": progress}
        motion = corrected_motion(recording, ResultsFolder(results), correction, folder, **about)
    say(f"Frames {correction.frame} and after tracked again, {int(motion.lost.sum())} of {len(motion)} frames lost.")
    say(f"Results: {folder.path}")
    require_found(motion, recording.name, folder.path)


def warm_up_command(threads: Threads = None) -> None:
    """Compile what tracking, fusing and live need, so that the first run of each begins at once; once per machine, and
    again after an update. Ends with a third of a second of a made-up person tracked, report and all."""
    from hypose.app.jobs.job import job_of, run_job
    from hypose.compute.compiled import VARIABLE, cache_folder
    from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up
    from hypose.fusion.live import LiveFuser
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import write_scene

    folder, parts = cache_folder(), (*TRACKING_KERNELS, "monocular", "depth")
    if folder is None:
        raise InputError(f"There is no place for what is compiled; name a folder with {VARIABLE}.")
    before = kept(*parts)
    with tempfile.TemporaryDirectory(prefix="hypose-warm-up-") as temporary, Stages() as progress:
        warm_up(*parts, load=False, progress=lambda done, total: progress("compile", done, total))
        LiveFuser()
        scene, place = make_scene("walk", rig="humaneva-4", seconds=0.32, seed=1), Path(temporary)
        write_scene(scene, place, progress=lambda done, total: progress("render", done, total))
        run_job(job_of(TrackCommand(recording=place)), progress)
    if not kept(*parts):
        raise InputError(
            f"What was compiled could not all be kept in {folder}; make space there, see that it can be written, or "
            f"name another folder with {VARIABLE}, and run this again."
        )
    say("All of it had been compiled." if before else f"Compiled; kept in {folder}")


def batch(
    recordings: Annotated[
        tuple[Path, ...],
        Option("A table (CSV) of recordings and options, see docs/batch.md; or folders of recordings.", argument=True),
    ],
    workers: Annotated[
        int | None, Option("Processes of this computer. [default: the number of cores]", 1, 1024)
    ] = None,
    threads: Annotated[int | None, Option("Threads of each worker. [default: the cores shared]", 1, 256)] = None,
    scheduler: Annotated[str | None, Option("Address of a running Dask scheduler, tcp://HOST:8786, instead.")] = None,
    out: Annotated[
        Path | None, Option("Results folder. [default: TABLE-results beside the table, else batch-results]")
    ] = None,
    formats: Annotated[str, Option("Motion files to write.")] = "trc,csv",
    overlay: Annotated[bool, Option("Write overlay.mp4 as well.")] = False,
    dry_run: Annotated[bool, Option("Say what would be done, and do nothing.")] = False,
) -> None:
    """Track many recordings, each with options of its own; finished tasks are skipped, begun ones are resumed."""
    if scheduler is not None and (workers is not None or threads is not None):
        raise InputError("A running scheduler has its own workers; leave --workers and --threads out.")
    from hypose.app.batch import finished_metrics, ordered_tasks, require_dask, run_batch, wanted, write_table
    from hypose.app.jobs.job import split_names
    from hypose.io.files import claimed

    if not dry_run:
        require_dask("distributed")  # before all files are read
    split_names(formats)
    drafts = wanted(recordings, {"formats": formats, "overlay": overlay})
    results = out or recordings[0].parent / f"{recordings[0].stem}-results"
    if out is None and recordings[0].suffix.lower() != ".csv":
        results = Path("batch-results")
    with stopping(_GO_ON), Stages() as progress:
        tasks, refused = ordered_tasks(drafts, results, progress)
        rows = refused
        if dry_run:
            done = sum(finished_metrics(t) is not None for t in tasks)
            say(f"{len(tasks)} tasks: {done} finished, {len(tasks) - done} to do, {len(refused)} refused")
        else:
            with claimed(results):
                count = workers or os.cpu_count() or 1
                done = run_batch(tasks, results, progress, workers=count, threads=threads, scheduler=scheduler)
                rows = [*done, *refused]
                write_table(rows, results)
    for row in rows:
        if row["state"] == "failed":
            print_note(f"{row['recording']}, {row['name']}: {row['message']}")
    if dry_run:
        raise Exit(1 if refused else 0)  # as the batch itself would end
    states = [row["state"] for row in rows]
    before = sum(row.get("before", False) for row in rows)
    parts = [f"{states.count('done')} of {len(rows)} done ({before} were before)"]
    parts += [f"{states.count(s)} {s}" for s in ("failed", "stopped") if s in states]
    say(", ".join(parts))
    say(f"Table: {results / 'results.csv'}")
    if "stopped" in states:
        say(_GO_ON)
        raise Exit(130)
    if "failed" in states:
        raise Exit(1)

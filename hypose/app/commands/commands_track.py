"""`hypose demo`, `correct`, `batch` and `warm-up`: track recordings in special ways."""

from __future__ import annotations

import os
import shlex
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from click.exceptions import Exit

from hypose.app.commands.console import Stages, print_note, say, stopping
from hypose.app.options import TrackCommand
from hypose.errors import InputError
from hypose.options import MOST_FRAMES, Formats, Option, Seconds, Seed, Threads

_GO_ON = "Stopped. Go on with the same command."


def demo(
    out: Annotated[Path, Option("Folder to write to.")] = Path("demo"),
    seconds: Seconds = 4.0,
    seed: Seed = 1,
    threads: Threads = None,
) -> None:
    """Make a synthetic four-camera recording, track it as `hypose track` would, and compare with the truth."""
    from hypose.app.jobs.job import job_of
    from hypose.app.jobs.people_job import track_shown
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


def correct(
    results: Annotated[Path, Option("Results folder of hypose track.", argument=True)],
    clicks: Annotated[Path, Option("The corrected pose: starts/NAME.json, saved in hypose view.", argument=True)],
    until: Annotated[
        int | None, Option("Track again up to this frame of the recording. [default: to the end]", 1, MOST_FRAMES)
    ] = None,
    out: Annotated[Path | None, Option("Results folder. [default: RESULTS-corrected]")] = None,
    formats: Formats = "trc,c3d,bvh,glb,csv,mot",
    threads: Threads = None,
) -> None:
    """Track a result again from a frame whose pose was corrected; other frames stay unchanged."""
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
    """Compile what tracking, fusion and live tracking need, so that their first run begins at once; once per computer,
    and again after an update. At the end a third of a second of a synthetic person is tracked as a test.
    """
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
        Path | None, Option("Results folder. [default: TABLE-results next to the table, else batch-results]")
    ] = None,
    formats: Formats = "trc,csv",
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

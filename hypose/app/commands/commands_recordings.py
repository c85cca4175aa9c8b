"""`hypose init`, `demo`, `synth`, `depth-import`, `silhouettes`, `keypoints`, `batch` and `warm-up`: make
recordings, detect evidence in them, and track them in special ways.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

from click.exceptions import Exit

from hypose.app.commands.console import Stages, counted, print_note, print_notes, say, stopping
from hypose.app.options import SynthCommand, TrackCommand
from hypose.errors import EvidenceError, InputError
from hypose.io.files import claimed, natural_key, toml_text, write_text
from hypose.options import Formats, FrameSpan, Option, RecordingPath, Resume, Seconds, Seed, Threads, Yes

_GO_ON = "Stopped. Go on with the same command."


def init(
    folder: Annotated[Path, Option("Folder with the videos of one recording, one per camera.", argument=True)],
) -> None:
    """Write the recording.toml of a folder with videos, one per camera.

    It reads the folder and the folders in it, and never overwrites a recording.toml. Files named background or empty
    show the empty room, videos named board or calib are for hypose calibrate. A calibration is named calib*.toml, or is
    the only .toml in a folder calib*.
    """
    from hypose.calibration.views import find_sources
    from hypose.io.videos.video import VIDEO_ENDINGS

    target, where = folder / "recording.toml", shlex.quote(str(folder))
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give the folder with the videos of one recording.")
    if target.exists():
        raise InputError(f"{target} exists and stays as it is; the next step is: hypose check {where}")
    below = [p for p in folder.iterdir() if p.is_dir() and p.name != "results" and not p.name.startswith(".")]
    found = [p for place in (folder, *below) for p in place.iterdir() if p.suffix.lower() in VIDEO_ENDINGS]
    found = sorted((p.relative_to(folder) for p in found), key=lambda p: natural_key(str(p)))
    rooms = [p for p in found if re.search("background|empty", str(p.with_suffix("")), re.IGNORECASE)]
    videos = [
        p for p in found if p not in rooms and not re.search("board|calib", str(p.with_suffix("")), re.IGNORECASE)
    ]
    if not videos:
        raise InputError(f"{folder} holds no video ({', '.join(VIDEO_ENDINGS)}); copy one per camera there.")
    if len({p.parent for p in videos}) > 1:
        places = ", ".join(sorted({str(p.parent) for p in videos}))
        raise InputError(f"{folder} holds videos in several places ({places}); make a folder for each recording.")
    names = [source.name for source in find_sources([folder / v for v in videos])]
    made = [*folder.glob("[Cc]alib*.toml"), *folder.glob("[Cc]alib*/*.toml")]
    calibration = made[0] if len(made) == 1 else folder / "calibration.toml"
    views = []
    for video, name in zip(videos, names, strict=True):
        room = next((p for p in rooms if p.stem.startswith(video.stem)), None)
        shown = None if room is None else room.as_posix()
        views.append({"name": name, "video": video.as_posix(), "background": shown})
        say(f"{name}: {video}" + ("" if room is None else f", empty room {room}"))
    head = {"name": folder.resolve().name, "calibration": calibration.relative_to(folder).as_posix()}
    write_text(target, toml_text({**head, "view": views}))
    say(f"Written: {target}; names and empty rooms can be corrected there (docs/recordings.md).")
    if calibration.is_file():
        say(f"Next: hypose check {where}" if rooms else f"Next: hypose keypoints {where}, then hypose check {where}")
    else:
        say(
            f"Next: hypose calibrate BOARD_VIDEOS --square 30mm --out {shlex.quote(str(calibration))}, or without a "
            f"board hypose calibrate {where} --from-person --height 1.72"
        )


def silhouettes(
    recording: RecordingPath,
    folder: Annotated[
        Path | None, Option("Folder to write to. [default: results/silhouettes there]", flag="--out")
    ] = None,
    frames: FrameSpan = None,
    detector: Annotated[bool, Option("By hypose's detector of people, whatever tells the empty room.")] = False,
    yes: Yes = False,
) -> None:
    """Write the masks of the person as PNG, one folder per view, and a contact sheet."""
    from hypose.app.jobs.checking import write_sheet
    from hypose.app.jobs.job import choose_frames
    from hypose.io.recordings.frames import FrameStream, write_masks
    from hypose.io.recordings.recording import load_recording

    loaded = choose_frames(load_recording(recording), frames)
    if detector:
        from hypose.app.jobs.person_job import detected

        found = detected(loaded, loaded.frames, yes=yes, why="--detector")
        views = (replace(v, files={**v.files, "masks": found.masks(v.name)}) for v in loaded.views)
        loaded = replace(loaded, views=tuple(views))
    target = folder or loaded.folder / "results" / "silhouettes"
    with claimed(target), Stages() as progress:
        with FrameStream(loaded, progress=progress) as source:
            with stopping(f"Stopped; the masks written until then are in {target}."):
                shown = write_masks(source, target, lambda done, total: progress("masks", done, total))
            write_sheet(loaded, source, target / "sheet.jpg", 4)
    print_notes((*loaded.notes, *source.notes))
    say(f"Masks: {target} (0 and 255, undistorted, one folder per view)")
    say(f"Contact sheet: {target / 'sheet.jpg'}")
    if not shown:
        raise EvidenceError(
            f"{loaded.name}: no picture shows anybody, so all masks are empty; look at notes and contact sheet, and "
            "see whether the background of each view is the empty room from the same place."
        )
    say('To use them, corrected by hand perhaps, give each view in recording.toml: masks = "FOLDER/VIEW"')


def synth(c: SynthCommand) -> None:
    """Write a synthetic recording (`hypose synth`)."""
    from hypose.synthetic import write_recording
    from hypose.synthetic.depth_scenes import DepthScene
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.subjects import load_subjects

    if c.raw and c.keypoints:
        raise InputError("--raw writes what cameras give, and key points are not; leave one of the two out.")
    write_recording.check_folder(c.folder)
    if c.sensors and (c.raw or c.keypoints or c.corruption):
        raise InputError(
            "Depth cameras write depth maps with their own faults; leave --raw, --keypoints, --corruption out."
        )
    about = {"seconds": c.seconds, "frame_rate": c.frame_rate, "seed": c.seed, "clothing_m": c.clothing}
    names = list(load_subjects())
    who = names[int(c.subject)] if c.subject.isdigit() and int(c.subject) < len(names) else c.subject
    if c.sensors:
        scene = write_recording.walking_scene(c.motion, who, c.sensors, **about)
    else:
        scene = make_scene(c.motion, who, c.rig, corruption=c.corruption, distorted=c.distorted, **about)
    unfinished = f"Stopped; {c.folder} is not complete. Start again with the same command."
    with stopping(unfinished), claimed(c.folder, "OUT"), Stages() as progress:
        shown = partial(progress, "render")
        if isinstance(scene, DepthScene):
            path = write_recording.write_depth_scene(scene, c.folder, progress=shown)
        elif c.raw:
            path = write_recording.write_session(scene, c.folder, progress=shown)
        else:
            path = write_recording.write_scene(scene, c.folder, keypoints=c.keypoints, progress=shown)
    kind = "depth cameras (simulated)" if c.sensors else "cameras"
    say(f"{path}: {scene.name}, {counted(len(scene), 'frame')}, {len(scene.rig)} {kind}")
    if c.raw:
        board = write_recording.BOARD
        say(f"The board has {board.columns} x {board.rows} inner corners and squares of {1000 * board.square:g} mm.")


def depth_import(
    sources: Annotated[
        tuple[Path, ...],
        Option("One per camera: Azure Kinect .mkv, RealSense .bag, or a folder of maps.", argument=True),
    ],
    out: Annotated[Path, Option("New folder for the recording.")],
    empty: Annotated[
        tuple[Path, ...], Option("The empty room, one per camera in the same order (may be repeated).")
    ] = (),
    frame_rate: Annotated[
        float | None, Option("Frames per second of folders of maps, which do not tell it. [default: 30]", 1, 1000)
    ] = None,
    millimetres: Annotated[
        float, Option("Millimetres that one step of a value stands for, of folders of maps.", 0, 100, above=True)
    ] = 1.0,
    seed: Seed = 0,
) -> None:
    """Make a recording of depth cameras to track: maps, lenses, floor; several cameras are registered by the person's
    motion.
    """
    from hypose.pipeline.import_depth import import_depth

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty; give a new folder.")
    new = not out.exists()
    about = {"frame_rate": frame_rate, "millimetres": millimetres, "seed": seed}
    nothing = f"Stopped; nothing is kept in {out}. Start again with the same command."
    try:
        with stopping(nothing), claimed(out, "--out"), Stages() as progress:
            path, notes = import_depth(sources, out, empty=empty or (), progress=progress, **about)
    finally:
        if new:
            with contextlib.suppress(OSError):  # the recording is in it
                out.rmdir()
    print_notes(notes)
    say(f"{path}: {counted(len(sources), 'depth camera')}; track it with: hypose track {shlex.quote(str(out))}")


def keypoints(
    recording: RecordingPath,
    detector: Annotated[
        str | None,
        Option("Your own detector instead, FILE.py:NAME or MODULE:NAME (docs/recordings.md)."),
    ] = None,
    yes: Yes = False,
    folder: Annotated[
        Path | None, Option("Folder to write to. [default: keypoints in the recording's folder]", flag="--out")
    ] = None,
    resume: Resume = False,
    threads: Threads = None,
) -> None:
    """Detect 2D key points and masks of people in the videos, which `hypose track` then uses."""
    from hypose.app.jobs.person_job import detect, open_network_asking
    from hypose.io.keypoints.detectors import open_own_detector
    from hypose.io.keypoints.read_keypoints import KEYPOINT_FOLDER
    from hypose.io.recordings.recording import load_recording

    loaded = load_recording(recording)
    target = folder or loaded.folder / KEYPOINT_FOLDER
    chosen = open_network_asking(yes) if detector is None else open_own_detector(detector)
    found = detect(loaded, chosen, target, loaded.frames if chosen.gives_masks else None, resume=resume)
    what = "Key points and masks" if found.with_masks else "Key points"
    say(f"{what}: {found.folder} ({found.keypoint_set}, one folder per view)")
    own = loaded.folder / KEYPOINT_FOLDER
    stated = [v.files["keypoints"].absolute() for v in loaded.views if "keypoints" in v.files]
    named = any(own.absolute() not in path.parents for path in stated)
    if target.absolute() == own.absolute() and not named:
        say(f"To use them: hypose track {recording} --evidence both")
        return
    print_note("note: recording.toml decides which key points are used; to use these, say there:")
    say(f'keypoint_set = "{found.keypoint_set}"')
    for view in loaded.views:
        say(f'keypoints = "{found.view(view.name).absolute()}"  # in the [[view]] of {view.name}')


def demo(
    out: Annotated[Path, Option("Folder to write to.")] = Path("demo"),
    seconds: Seconds = 4.0,
    seed: Seed = 1,
    threads: Threads = None,
) -> None:
    """Make a synthetic four-camera recording, track it as `hypose track` would, and compare with the truth."""
    from hypose.app.jobs.job import job_of, track_shown
    from hypose.pipeline.comparison import compare_with_truth
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import check_folder, write_scene

    check_folder(out)
    say(f"Writing a synthetic recording of {seconds:g} s of walking, seen by four cameras, to {out}")
    scene = make_scene("walk", rig="humaneva-4", seconds=seconds, seed=seed, distorted=True)
    with claimed(out), Stages() as progress:
        write_scene(scene, out, progress=lambda done, total: progress("render", done, total))
    say(f"Tracking it as `hypose track {shlex.quote(str(out))}` would")
    track_shown(
        replace(
            job_of(TrackCommand(recording=out, threads=threads)),
            truth=lambda motion: compare_with_truth(out / "truth.npz", motion),
        )
    )


def warm_up_command(threads: Threads = None) -> None:
    """Compile what tracking, fusion and live tracking need, so that their first run begins at once; once per computer,
    and again after an update. At the end a third of a second of a synthetic person is tracked as a test.
    """
    from hypose.app.jobs.job import job_of, run_job
    from hypose.compute.compiled import VARIABLE, cache_folder
    from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up
    from hypose.fusion.people import LiveFuser
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
    overlay: Annotated[bool, Option("Write overlay.webm as well.")] = False,
    dry_run: Annotated[bool, Option("Say what would be done, and do nothing.")] = False,
) -> None:
    """Track many recordings, each with options of its own; finished tasks are skipped, begun ones are resumed."""
    if scheduler is not None and (workers is not None or threads is not None):
        raise InputError("A running scheduler has its own workers; leave --workers and --threads out.")
    from hypose.app.batch import COLUMNS, finished_metrics, ordered_tasks, require_dask, run_batch, wanted
    from hypose.app.jobs.job import split_names
    from hypose.app.reports.report_parts import write_csv

    if not dry_run:
        require_dask("distributed")  # before all files are read
    split_names(formats)
    drafts = wanted(recordings, formats=formats, overlay=overlay)
    results = out or recordings[0].parent / f"{recordings[0].stem}-results"
    if out is None and recordings[0].suffix.lower() != ".csv":
        results = Path("batch-results")
    with stopping(_GO_ON), Stages() as progress:
        tasks, rows = ordered_tasks(drafts, results, progress)
        if dry_run:
            done = sum(finished_metrics(t) is not None for t in tasks)
            say(f"{counted(len(tasks), 'task')}: {done} finished, {len(tasks) - done} to do, {len(rows)} refused")
        else:
            with claimed(results):
                many = {"workers": workers or os.cpu_count() or 1, "threads": threads, "scheduler": scheduler}
                rows = [*run_batch(tasks, results, progress, **many), *rows]
                write_csv(results / "results.csv", COLUMNS, ([row.get(name) for name in COLUMNS] for row in rows))
    states = [row["state"] for row in rows]
    for row in rows:
        if row["state"] == "failed":
            print_note(f"{row['recording']}, {row['name']}: {row['message']}")
    if dry_run:
        raise Exit(1 if rows else 0)  # as the batch itself would end
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

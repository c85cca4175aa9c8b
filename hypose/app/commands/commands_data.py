"""`hypose silhouettes` and `hypose synth`: masks of recordings, and recordings made up."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import Seconds, Seed, Threads, number
from hypose.errors import EvidenceError, InputError


def silhouettes(
    recording: Annotated[Path, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")],
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to write to. [default: results/silhouettes there]")
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="first:stop, counted from 0. [default: recording.toml's, else all]")
    ] = None,
) -> None:
    """Write the masks of the person as PNG, one folder per view, and a contact sheet."""
    from hypose.app.jobs.checking import write_sheet
    from hypose.app.jobs.job import choose_frames
    from hypose.io.claims import claimed
    from hypose.io.recordings.frames import FrameStream
    from hypose.io.recordings.mask_folders import write_masks
    from hypose.io.recordings.recording import load_recording

    loaded = choose_frames(load_recording(recording), frames)
    target = folder or loaded.folder / "results" / "silhouettes"
    with claimed(target), Stages() as progress:
        progress("background", 0, 1)
        with FrameStream(loaded) as source:
            progress("background", 1, 1)
            try:
                shown = write_masks(source, target, lambda done, total: progress("masks", done, total))
            except KeyboardInterrupt:
                say(f"Stopped; the masks written until then are in {target}.")
                raise typer.Exit(130) from None
            notes = source.notes
            write_sheet(loaded, source, target / "sheet.jpg", 4)
    for text in (*loaded.notes, *notes):
        note(f"note: {text}")
    say(f"Masks: {target} (0 and 255, undistorted, one folder per view)")
    say(f"Contact sheet: {target / 'sheet.jpg'}")
    if not shown:
        raise EvidenceError(
            f"{loaded.name}: no picture shows anybody, so all masks are empty; look at notes and contact sheet, and "
            "see whether the background of each view is the empty room from the same place."
        )
    say('To use them, corrected by hand perhaps, give each view in recording.toml: masks = "FOLDER/VIEW"')


def synth(
    folder: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write the recording to.")],
    motion: Annotated[
        str, typer.Option(help="walk, jog, box, wave, cross_arms, punch, sit_down, serve or combo.")
    ] = "walk",
    subject: Annotated[str, typer.Option(help="Name or number of a subject. [default: chosen by the seed]")] = "",
    rig: Annotated[str, typer.Option(help="humaneva-4, humaneva-7, ixmas-5, court-4 or ring-N.")] = "humaneva-4",
    sensors: Annotated[
        str,
        typer.Option(help="Depth cameras instead of a rig: depth-1 (in front), depth-2 (and beside), depth-3 (round)."),
    ] = "",
    seconds: Seconds = 4.0,
    frame_rate: Annotated[float, number("Frames per second.", 1, 1000)] = 25.0,
    corruption: Annotated[
        list[str] | None,
        typer.Option(help="What goes wrong: level-1, shadow, desync, ... (may be repeated)."),
    ] = None,
    clothing: Annotated[float, number("Thickness of the clothes in metres.", 0, 0.04, unit="metres")] = 0.02,
    distorted: Annotated[bool, typer.Option(help="Lenses with distortion.")] = True,
    keypoints: Annotated[
        bool, typer.Option("--keypoints", help="Write 2D key points (OpenPose JSON) as well.")
    ] = False,
    raw: Annotated[
        bool,
        typer.Option(
            "--raw", help="As it is filmed: videos of a board, the empty room and the person, to practise on."
        ),
    ] = False,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Make a synthetic recording with known truth: videos, background clips, calibration, recording.toml, truth.npz."""
    set_threads(threads)
    from hypose.io.claims import claimed
    from hypose.synthetic.film_session import BOARD, write_session
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import check_folder, write_scene

    if raw and keypoints:
        raise InputError("--raw writes what cameras give, and key points are not; leave one of the two out.")
    check_folder(folder)
    if sensors:
        if raw or keypoints or corruption:
            raise InputError(
                "Depth cameras write depth maps with their own faults; leave --raw, --keypoints, --corruption out."
            )
        _depth_cameras(folder, motion, _subject_name(subject), sensors, seconds, frame_rate, seed, clothing)
        return
    scene = make_scene(
        motion,
        _subject_name(subject),
        rig,
        seconds=seconds,
        frame_rate=frame_rate,
        seed=seed,
        corruption=tuple(corruption or ()),
        clothing_m=clothing,
        distorted=distorted,
    )
    try:
        with claimed(folder, "OUT"), Stages() as progress:

            def shown(done: int, total: int) -> None:
                progress("render", done, total)

            if raw:
                path = write_session(scene, folder, progress=shown)
            else:
                path = write_scene(scene, folder, keypoints=keypoints, progress=shown)
    except KeyboardInterrupt:
        say(f"Stopped; {folder} is not complete. Start again with the same command.")
        raise typer.Exit(130) from None
    say(f"{path}: {scene.name}, {len(scene)} frames, {len(scene.rig)} cameras")
    if raw:
        say(f"The board has {BOARD.columns} x {BOARD.rows} inner corners and squares of {1000 * BOARD.square:g} mm.")


def _depth_cameras(
    folder: Path,
    motion: str,
    subject: str,
    sensors: str,
    seconds: float,
    frame_rate: float,
    seed: int,
    clothing: float,
) -> None:
    from hypose.io.claims import claimed
    from hypose.synthetic.write_recording import walking_scene, write_depth_scene

    about = {"seconds": seconds, "frame_rate": frame_rate, "seed": seed, "clothing_m": clothing}
    scene = walking_scene(motion, subject, sensors, **about)
    try:
        with claimed(folder, "OUT"), Stages() as progress:
            path = write_depth_scene(scene, folder, progress=lambda done, total: progress("render", done, total))
    except KeyboardInterrupt:
        say(f"Stopped; {folder} is not complete. Start again with the same command.")
        raise typer.Exit(130) from None
    say(f"{path}: {scene.name}, {len(scene)} frames, {len(scene.rig)} depth cameras (simulated)")


def _subject_name(text: str) -> str:
    """A subject's name from its name or number."""
    if not text.isdigit():
        return text
    from hypose.synthetic.subjects import load_subjects

    names = list(load_subjects())
    if int(text) >= len(names):
        raise InputError(f"There is no subject {text}; the subjects are 0 to {len(names) - 1}: {', '.join(names)}.")
    return names[int(text)]

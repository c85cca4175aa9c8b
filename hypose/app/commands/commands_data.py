"""`hypose synth`, `silhouettes`, `keypoints` and `depth-import`: recordings, and the evidence in them."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hypose.app.commands.commands_track import detect, detected, open_network_asking, set_threads, stopping
from hypose.app.commands.console import Stages, print_note, say
from hypose.errors import EvidenceError, InputError
from hypose.options import FrameRange, Option, RecordingPath, Resume, Seconds, Seed, Threads, Yes

if TYPE_CHECKING:
    pass


def silhouettes(
    recording: RecordingPath,
    folder: Annotated[
        Path | None, Option("Folder to write to. [default: results/silhouettes there]", flag="--out")
    ] = None,
    frames: FrameRange = None,
    detector: Annotated[bool, Option("By hypose's detector of people, whatever tells the empty room.")] = False,
    yes: Yes = False,
) -> None:
    """Write the masks of the person as PNG, one folder per view, and a contact sheet."""
    from hypose.app.jobs.checking import write_sheet
    from hypose.app.jobs.job import choose_frames
    from hypose.io.files import claimed
    from hypose.io.recordings.frames import FrameStream, write_masks
    from hypose.io.recordings.recording import load_recording

    loaded = choose_frames(load_recording(recording), frames)
    if detector:
        found = detected(loaded, loaded.frames, yes=yes, why="--detector")
        loaded = replace(loaded, views=tuple(replace(v, masks=found.masks(v.name)) for v in loaded.views))
    target = folder or loaded.folder / "results" / "silhouettes"
    with claimed(target), Stages() as progress:
        progress("background", 0, 1)
        with FrameStream(loaded) as source:
            progress("background", 1, 1)
            with stopping(f"Stopped; the masks written until then are in {target}."):
                shown = write_masks(source, target, lambda done, total: progress("masks", done, total))
            notes = source.notes
            write_sheet(loaded, source, target / "sheet.jpg", 4)
    for text in (*loaded.notes, *notes):
        print_note(f"note: {text}")
    say(f"Masks: {target} (0 and 255, undistorted, one folder per view)")
    say(f"Contact sheet: {target / 'sheet.jpg'}")
    if not shown:
        raise EvidenceError(
            f"{loaded.name}: no picture shows anybody, so all masks are empty; look at notes and contact sheet, and "
            "see whether the background of each view is the empty room from the same place."
        )
    say('To use them, corrected by hand perhaps, give each view in recording.toml: masks = "FOLDER/VIEW"')


def synth(
    folder: Annotated[Path, Option("Folder to write the recording to.", value="OUT", argument=True)],
    motion: Annotated[str, Option("walk, jog, box, wave, cross_arms, punch, sit_down, serve or combo.")] = "walk",
    subject: Annotated[str, Option("Name or number of a subject. [default: chosen by the seed]")] = "",
    rig: Annotated[str, Option("humaneva-4, humaneva-7, ixmas-5, court-4 or ring-N.")] = "humaneva-4",
    sensors: Annotated[
        str,
        Option("Depth cameras instead of a rig: depth-1 (in front), depth-2 (and beside), depth-3 (round)."),
    ] = "",
    seconds: Seconds = 4.0,
    frame_rate: Annotated[float, Option("Frames per second.", 1, 1000)] = 25.0,
    corruption: Annotated[
        tuple[str, ...],
        Option("What goes wrong: level-1, shadow, desync, ... (may be repeated)."),
    ] = None,
    clothing: Annotated[float, Option("Thickness of the clothes in metres.", 0, 0.04, unit="metres")] = 0.02,
    distorted: Annotated[bool, Option("Lenses with distortion.")] = True,
    keypoints: Annotated[bool, Option("Write 2D key points (OpenPose JSON) as well.")] = False,
    raw: Annotated[
        bool,
        Option("As it is filmed: videos of a board, the empty room and the person, to practise on.", flag="--raw"),
    ] = False,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Make a synthetic recording with known truth: videos, background clips, calibration, recording.toml, truth.npz."""
    set_threads(threads)
    from hypose.io.files import claimed
    from hypose.synthetic.depth_scenes import DepthScene
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import (
        BOARD,
        check_folder,
        walking_scene,
        write_depth_scene,
        write_scene,
        write_session,
    )

    if raw and keypoints:
        raise InputError("--raw writes what cameras give, and key points are not; leave one of the two out.")
    check_folder(folder)
    if sensors and (raw or keypoints or corruption):
        raise InputError(
            "Depth cameras write depth maps with their own faults; leave --raw, --keypoints, --corruption out."
        )
    about = {"seconds": seconds, "frame_rate": frame_rate, "seed": seed, "clothing_m": clothing}
    who = _subject_name(subject)
    if sensors:
        scene = walking_scene(motion, who, sensors, **about)
    else:
        scene = make_scene(motion, who, rig, corruption=tuple(corruption or ()), distorted=distorted, **about)
    unfinished = f"Stopped; {folder} is not complete. Start again with the same command."
    with stopping(unfinished), claimed(folder, "OUT"), Stages() as progress:

        def shown(done: int, total: int) -> None:
            progress("render", done, total)

        if isinstance(scene, DepthScene):
            path = write_depth_scene(scene, folder, progress=shown)
        elif raw:
            path = write_session(scene, folder, progress=shown)
        else:
            path = write_scene(scene, folder, keypoints=keypoints, progress=shown)
    kind = "depth cameras (simulated)" if sensors else "cameras"
    say(f"{path}: {scene.name}, {len(scene)} frames, {len(scene.rig)} {kind}")
    if raw:
        say(f"The board has {BOARD.columns} x {BOARD.rows} inner corners and squares of {1000 * BOARD.square:g} mm.")


def _subject_name(text: str) -> str:
    """A subject's name from its name or number."""
    if not text.isdigit():
        return text
    from hypose.synthetic.subjects import load_subjects

    names = list(load_subjects())
    if int(text) >= len(names):
        raise InputError(f"There is no subject {text}; the subjects are 0 to {len(names) - 1}: {', '.join(names)}.")
    return names[int(text)]


def depth_import(
    sources: Annotated[
        tuple[Path, ...],
        Option("One per camera: Azure Kinect .mkv, RealSense .bag, Record3D .r3d, or a folder of maps.", argument=True),
    ],
    out: Annotated[Path, Option("Folder to write the recording to.")],
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
    """Make a recording of depth cameras to track: maps, lenses, floor; several are brought together by the person."""
    from hypose.io.files import claimed
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
    for text in notes:
        print_note(f"note: {text}")
    say(f"{path}: {len(sources)} depth cameras; track it with: hypose track {shlex.quote(str(out))}")


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
    set_threads(threads)
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
    named = any(v.keypoints is not None and own.absolute() not in v.keypoints.absolute().parents for v in loaded.views)
    if target.absolute() == own.absolute() and not named:
        say(f"To use them: hypose track {recording} --evidence both")
        return
    print_note("note: recording.toml decides which key points are used; to use these, say there:")
    say(f'keypoint_set = "{found.keypoint_set}"')
    for view in loaded.views:
        say(f'keypoints = "{found.view(view.name).absolute()}"  # in the [[view]] of {view.name}')

"""`hypose keypoints`: 2D key points by MediaPipe with its own model or the user's, or by any detector of the user's."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import Threads, number
from hypose.errors import InputError


def keypoints(
    recording: Annotated[Path, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")],
    model: Annotated[
        Path | None, typer.Option(help="Model bundle of MediaPipe's Pose Landmarker (.task), your own copy.")
    ] = None,
    detector: Annotated[
        str | None,
        typer.Option(help="Instead: your own detector, FILE.py:NAME or MODULE:NAME (docs/recordings.md)."),
    ] = None,
    mediapipe: Annotated[
        bool,
        typer.Option(
            "--mediapipe", help="Instead: MediaPipe with the model that it carries, set up once after asking."
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Set MediaPipe up without asking.")] = False,
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to write to. [default: keypoints in the recording's folder]")
    ] = None,
    people: Annotated[int, number("Most people looked for in a picture; tracking follows one.", 1, 100)] = 3,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run stopped.")] = False,
    threads: Threads = None,
) -> None:
    """Detect 2D key points in the videos, one OpenPose file per frame, for --evidence keypoints or both."""
    set_threads(threads)
    from hypose.io.files import claimed
    from hypose.io.keypoints.detectors import open_blazepose, open_mediapipe, open_own_detector
    from hypose.io.keypoints.read_keypoints import FOLDER
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.detect_keypoints import detect_keypoints

    if [model is not None, detector is not None, mediapipe].count(True) != 1:
        raise InputError(
            "Say what finds the key points: --mediapipe (with its own model), --model with a .task file of MediaPipe's "
            "Pose Landmarker, or --detector with one of your own (all are shown in docs/recordings.md)."
        )
    loaded = load_recording(recording)
    if mediapipe:
        _have_mediapipe(yes)
    target = folder or loaded.folder / FOLDER
    with contextlib.ExitStack() as stack:
        stack.enter_context(claimed(target))
        if detector is not None:
            chosen = open_own_detector(detector)
        elif mediapipe:
            chosen = stack.enter_context(open_mediapipe())
        else:
            assert model is not None
            chosen = stack.enter_context(open_blazepose(model, people))
        progress = stack.enter_context(Stages())
        try:
            found = detect_keypoints(
                loaded, chosen, target, resume=resume, progress=lambda done, total: progress("detect", done, total)
            )
        except KeyboardInterrupt:
            say(f"Stopped; the frames done until then are in {target}. Go on with the same command and --resume.")
            raise typer.Exit(130) from None
    say(f"Key points: {found.folder} ({found.keypoint_set}, one folder per view)")
    own = loaded.folder / FOLDER
    named = any(v.keypoints is not None and own.absolute() not in v.keypoints.absolute().parents for v in loaded.views)
    if target.absolute() == own.absolute() and not named:
        say(f"To use them: hypose track {recording} --evidence both")
        return
    note("note: recording.toml decides which key points are used; to use these, say there:")
    say(f'keypoint_set = "{found.keypoint_set}"')
    for view in loaded.views:
        say(f'keypoints = "{found.view(view.name).absolute()}"  # in the [[view]] of {view.name}')


def _have_mediapipe(yes: bool) -> None:
    """Set MediaPipe's environment up if it is not there, when the user agrees."""
    from hypose.io.keypoints.detectors import MEGABYTES, VERSION, environment_folder, is_set_up, set_up

    if is_set_up():
        return
    what = f"MediaPipe {VERSION} (Apache 2.0, with its pose model; {MEGABYTES} MB) in {environment_folder()}"
    if not yes:
        if not sys.stdin.isatty():
            raise InputError(f"This installs {what}, from the package registry; run it again with --yes to agree.")
        if not typer.confirm(f"Install {what}?"):
            raise typer.Exit(1)
    say(f"Installing {what} ...")
    set_up()

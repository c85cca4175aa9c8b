"""`hypose keypoints`: 2D key points by a detector that the user has installed, with the user's own model."""

from __future__ import annotations

import contextlib
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
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to write to. [default: keypoints in the recording's folder]")
    ] = None,
    people: Annotated[int, number("Most people looked for in a picture; tracking follows one.", 1, 100)] = 3,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run stopped.")] = False,
    threads: Threads = None,
) -> None:
    """Detect 2D key points in the videos, one OpenPose file per frame, for --evidence keypoints or both."""
    set_threads(threads)
    from hypose.io.claims import claimed
    from hypose.io.keypoints.blazepose import open_blazepose
    from hypose.io.keypoints.detected_keypoints import FOLDER
    from hypose.io.keypoints.own_detector import open_own_detector
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.detect_keypoints import detect_keypoints

    if (model is None) == (detector is None):
        raise InputError(
            "Say what finds the key points: --model with a .task file of MediaPipe's Pose Landmarker, or --detector "
            "with one of your own (both are shown in docs/recordings.md)."
        )
    loaded = load_recording(recording)
    target = folder or loaded.folder / FOLDER
    with contextlib.ExitStack() as stack:
        stack.enter_context(claimed(target))
        if detector is not None:
            chosen = open_own_detector(detector)
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

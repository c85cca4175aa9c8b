"""Prepare tracking: detect key points, measure a subject's body, and calibrate the cameras of a recording from a
person.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from click.exceptions import Exit

from hypose.app.commands.commands_check import keep_offsets
from hypose.app.commands.console import Stages, print_note, print_notes, print_table, say, stopping
from hypose.app.jobs.checking import write_image
from hypose.app.jobs.job import choose_frames, job_of, recording_of, track_shown
from hypose.app.options import CalibrateCommand, SubjectCommand, TrackCommand
from hypose.app.reports.result_pictures import Canvas, Drawing, DrawnBody, open_images
from hypose.body.default_body import human
from hypose.calibration.from_person import PersonCalibration, calibrate_from_person
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.detector import PoseDetector
from hypose.evidence.held_points import without_held
from hypose.evidence.keypoints import keypoint_names, person_size
from hypose.geometry import Array
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
from hypose.io.recordings.recording_people import candidates_of
from hypose.pipeline.detect_keypoints import detect_keypoints, wants_detector
from hypose.pipeline.mesh_subject import subject_from_mesh
from hypose.pipeline.recorded_frames import check_views
from hypose.pipeline.recording_diagnostics import window
from hypose.pipeline.subject_from_motion import (
    AnthropometryOptions,
    SubjectEstimate,
    estimate_subject,
    save_subject,
)
from hypose.tracking.starts import KNOWN_POSES

_MOST_SECONDS = 60


def person_of(loaded: Recording, lenses_known: bool, yes: bool) -> tuple[Array, tuple[str, ...]]:
    """Select the main person of each view (largest and most confident) in the middle minute of a recording.

    Key points come from the recording, else from the detector. Where the lenses are not known, detected ones are kept
    in a folder of their own, since the detector's masks fit no other lens.
    lenses_known: the recording's cameras have the right lenses.
    yes: the detector's models may be downloaded without asking.
    Returns: (C, T, K, 3) px of the stored pictures and confidence, 0 where the person is not seen; and the names of the
        key points.
    """
    few = window(loaded, round(_MOST_SECONDS * loaded.frame_rate))
    if few.keypoint_set is None:
        kept = few if lenses_known else replace(few, folder=few.folder / "results" / "uncalibrated")
        found = detected(kept, few.frames, yes=yes, why="--from-person")
        views = tuple(replace(v, keypoints=found.view(v.name)) for v in few.views)
        few = replace(few, views=views, keypoint_set=found.keypoint_set, keypoint_lag=0, keypoint_pixels="calibration")
    names = keypoint_names(str(few.keypoint_set))
    people = candidates_of(few, few.rig) or []
    points = np.zeros((len(few.views), len(few.frames), len(names), 3))
    for c, view in enumerate(points):
        for t, found in enumerate(without_held([frame[c] for frame in people], first=3)[0]):
            if found is not None and len(found):
                view[t] = max(found[..., [3, 4, 2]], key=lambda p: float(p[:, 2].sum()) * person_size(p))
    return points, names


def calibrate_recording(c: CalibrateCommand) -> tuple[CameraRig, Path]:
    """Calibrate the cameras of a recording from the person; print the result and save the offsets.

    Returns: the cameras, and the file they are to be written to.
    Raises: InputError where the height is missing or the file exists.
    """
    path, lenses = c.sources[0], c.intrinsics
    loaded = load_recording(path, lenses, uncalibrated=lenses is None)
    rig = with_focal_lengths(loaded.rig, c.focal) if c.focal else loaded.rig
    target = c.out or loaded.folder / "calibration.toml"
    if target.exists():
        raise InputError(f"{target} exists, and calibrations are never overwritten; give another name with --out.")
    height = c.height or loaded.subject_height
    if height is None:
        raise InputError("Say how tall the person is, in metres: --height 1.72 (the height gives the scale).")
    points, names = person_of(loaded, lenses is not None, c.yes)
    print_notes(loaded.notes)
    with Stages() as progress:
        found = calibrate_from_person(
            points, names, rig, height, loaded.frame_rate,
            lenses_known=lenses is not None or bool(c.focal), largest_s=c.largest, progress=progress,
        )  # fmt: skip
    _show(found)
    keep_offsets(loaded, "person", found.late.tolist(), [f"sd {s:.2f}" for s in found.sds.late])
    if np.abs(found.late).max() > 0.05:
        offsets = ",".join(f"{x:.2f}" for x in found.late)
        say(f"To bring the evidence in step: hypose sync {path} --offsets={offsets} --out NEW_FOLDER")
    return found.rig, target


def with_focal_lengths(rig: CameraRig, given: Sequence[str]) -> CameraRig:
    """Set the focal lengths of a rig to those of the option --focal.

    given: texts "PIXELS" (all cameras) or "CAMERA=PIXELS"; of two for the same camera the later counts.
    Raises: InputError where a text is not understood, or a camera has no focal length.
    """
    pixels: dict[str, float] = {}
    for text in given:
        name, _, number = text.rpartition("=")
        if not re.fullmatch(r"[1-9]\d{0,5}(\.\d+)?", number) or name not in ("", *rig.names):
            raise InputError(
                f"--focal {text!r} is not understood; write a number of pixels for all cameras, or CAMERA=PIXELS with "
                f"one of the cameras {', '.join(rig.names)}."
            )
        pixels |= dict.fromkeys([name] if name else rig.names, float(number))
    if missing := [n for n in rig.names if n not in pixels]:
        raise InputError(f"--focal: the focal length of {', '.join(missing)} is missing; add CAMERA=PIXELS.")
    cameras = []
    for c in rig:
        f, (x, y) = pixels[c.name], c.K[:2, 2]
        cameras.append(replace(c, K=np.array([[f, 0, x], [0, f, y], [0, 0, 1.0]])))
    return CameraRig(tuple(cameras))


def _show(found: PersonCalibration) -> None:
    """Print how well a calibration from a person fits."""
    sds, rows = found.sds, []
    for k, (camera, late) in enumerate(zip(found.rig, found.late, strict=True)):
        f, (x, y, z) = camera.K[0, 0], camera.position
        focal = f"{f:.0f}" + (f" +- {sds.focal[k] * f:.0f}" if sds.focal[k] else "")
        place = f"{x:.3f} {y:.3f} {z:.3f}", f"{1e3 * sds.place_m[k]:.0f}", f"{sds.turn_deg[k]:.2f}"
        rows.append((camera.name, f"{late:+.2f} +- {sds.late[k]:.2f}", focal, *place))
    columns = ("camera", "late (frames)", "focal (px)", "position (m)", "uncertain by (mm)", "turned by (deg)")
    print_table(f"Fit of the person's key points: {found.median_px:.1f} px median", columns, rows)
    for text in found.approximate:
        say(f"warning: approximate: {text}.", "yellow")


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
    options = AnthropometryOptions(
        frames=c.poses,
        tracked=max(36, 3 * c.poses),
        height=c.height if c.height is not None else loaded.subject_height,
        mass=c.mass if c.mass is not None else loaded.subject_mass,
        poses=KNOWN_POSES if c.start == "hull" else (c.start,),
        seed=c.seed,
    )
    folder = c.out or loaded.folder / "subject"
    with claimed(folder), Stages() as progress:
        with FrameStream(loaded, progress=progress) as source:
            found = estimate_subject(
                source.frame,
                len(source),
                loaded.frame_rate,
                human(),
                options,
                progress=lambda done, total: progress("subject", done, total),
            )
            body, toml = save_subject(folder, found, human(), loaded.name)
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
    rows = []
    with open_images(recording) as images:
        canvas = Canvas(recording, images)
        for k in sorted({0, len(found.frames) // 2}):
            frame, number = source.frame(found.frames[k]), recording.frames[found.frames[k]]
            pictures = [v.read(number) for v in images]
            for body, poses, iou, what in (
                (found.template, found.template_poses, found.iou_before, "before"),
                (found.body, found.poses, found.iou, "after"),
            ):
                title = f"frame {number}, {what}: mean IoU {float(np.nanmean(iou[k])):.3f}"
                drawn = DrawnBody(body, body.skin(poses[k], body.fine), body.joints(poses[k]))
                rows.append(canvas.draw(pictures, Drawing(frame.silhouettes, title, (drawn,))).copy())
    write_image(path, np.concatenate(rows))
    return path


def detect(
    loaded: Recording, detector: PoseDetector, target: Path, frames: range | None, *, resume: bool
) -> DetectedKeypoints:
    """Detect key points with progress; an interrupted run says how to continue, and exits with code 130.

    target: folder to write to.
    frames: of the recording; None: all.
    resume: skip frames that have a file.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(claimed(target))
        progress = stack.enter_context(Stages())
        kept = f"Stopped; the frames done until then are in {target}. Go on with the same command and --resume."
        with stopping(kept):
            return detect_keypoints(
                loaded,
                detector,
                target,
                resume=resume,
                frames=frames,
                progress=lambda done, total: progress("detect", done, total),
            )


def detected(loaded: Recording, frames: range, *, yes: bool, why: str) -> DetectedKeypoints:
    """Detect key points of a recording and save them in its folder; frames that were detected already are skipped.

    frames: of the recording.
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

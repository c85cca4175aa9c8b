"""Key points of a recording's videos by a detector, one file per frame and view."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError, InputError
from hypose.evidence.detector import PoseDetector, openpose_document
from hypose.geometry import Array
from hypose.io.file_names import folder_for
from hypose.io.files import read_text, write_text
from hypose.io.keypoints.read_keypoints import DetectedKeypoints, load_detected
from hypose.io.recordings.recording import Recording, View
from hypose.io.videos.video import open_video


def detect_keypoints(
    recording: Recording,
    detector: PoseDetector,
    folder: Path,
    *,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> DetectedKeypoints:
    """Look at every frame of every view and write folder/VIEW/VIEW_FRAME_keypoints.json, in pixels of the calibrated
    cameras; returns what was written, complete.

    resume: frames that have a file are not looked at again. progress(done, total) is called after every picture;
    raising KeyboardInterrupt in it stops the run with its files kept. An InputError when a view has no pictures, or
    the folder holds something else, or, with resume, another detector's points; an EvidenceError when nobody was found
    in any picture.
    """
    for view in recording.views:
        if view.source is None:
            raise InputError(
                f"View {view.name} of {recording.name} has masks only, and key points are found in pictures; give its "
                "video in recording.toml."
            )
    work = DetectedKeypoints(folder, detector.keypoint_set, detector.identity, False)
    _make_room(work, resume)
    total, done, somebody = recording.n_frames * len(recording.views), 0, False
    for view, camera in zip(recording.views, recording.rig, strict=True):
        assert view.source is not None
        folder_for(folder, view.name)
        with open_video(view.source) as reader:
            for frame in range(recording.n_frames):
                path = work.file(view.name, frame)
                if not path.exists():
                    reader.seek(frame)
                    image = next(iter(reader))
                    people = _calibrated(detector.detect(image), reader.size, camera, view)
                    write_text(path, json.dumps(openpose_document(people)) + "\n")
                somebody = somebody or '"people": []' not in read_text(path, "key points of a frame")
                done += 1
                if progress is not None:
                    progress(done, total)
    finished = replace(work, complete=True)
    finished.save()
    if not somebody:
        raise EvidenceError(
            f"The detector found nobody in any picture of {recording.name}, so the files in {folder} are empty; see "
            "whether the videos show the person upright and large enough, or use another model."
        )
    return finished


def _make_room(work: DetectedKeypoints, resume: bool) -> None:
    """An own folder, empty or with the same detector's points."""
    if work.folder.is_file():
        raise InputError(f"{work.folder} is a file; give a folder with --out.")
    before = load_detected(work.folder)
    if before is None and work.folder.is_dir() and any(not p.name.startswith(".") for p in work.folder.iterdir()):
        raise InputError(f"The folder {work.folder} holds other files; give an empty or new folder with --out.")
    if before is not None and resume:
        if (before.keypoint_set, dict(before.identity)) != (work.keypoint_set, dict(work.identity)):
            raise InputError(
                f"The key points in {work.folder} are those of another model, version or setting; run without --resume "
                "to detect anew, or give another folder with --out."
            )
    elif before is not None:
        for path in work.folder.glob("*/*_keypoints.json"):
            path.unlink()
    work.save()


def _calibrated(people: Array, size: tuple[int, int], camera: Camera, view: View) -> Array:
    """People (P, K, 3) in a stored picture of a size (width, height) -> pixels of the calibrated camera."""
    out = np.array(people, dtype=np.float64)
    scale = np.array(camera.size) / np.array(size)
    moved = (out[..., :2] + 0.5) * scale - 0.5 + view.image_shift
    # OpenPose's files say "missing" with (0, 0): a point that happens to lie there would be lost
    moved[(moved == 0).all(-1)] = 1e-3
    out[..., :2] = np.where(out[..., 2:] > 0, moved, 0.0)
    return out

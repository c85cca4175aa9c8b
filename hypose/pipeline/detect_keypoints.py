"""Detect key points in the videos of a recording, one file per frame and view, and masks where the
detector gives them.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from hypose.cameras.camera import Camera
from hypose.compute.threads import default_threads
from hypose.errors import EvidenceError, InputError
from hypose.evidence.keypoints import openpose_document
from hypose.evidence.pose_network import Crop, PoseDetector, owners_of_pixels
from hypose.geometry import Array
from hypose.io.files import folder_for, read_json, write_bytes, write_text
from hypose.io.keypoints.read_keypoints import MASKS, DetectedKeypoints, load_detected
from hypose.io.recordings.frames import working_rig
from hypose.io.recordings.object_masks import SIDECAR
from hypose.io.recordings.recording import Recording, ViewSettings
from hypose.io.recordings.recording_views import places_in_stored
from hypose.io.videos.video import open_video


def wants_detector(recording: Recording) -> bool:
    """Return whether a recording needs a detector: several cameras with pictures, and no key points, masks, background
    or depth.
    """
    views = recording.views
    reported = any({"keypoints", "masks", "background", "depth"} & v.files.keys() for v in views)
    return len(views) > 1 and not reported and all(v.source is not None for v in views)


def detect_keypoints(
    recording: Recording,
    detector: PoseDetector,
    folder: Path,
    *,
    resume: bool = False,
    frames: range | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DetectedKeypoints:
    """Detect key points in every view of a recording and write them to a folder.

    Files: folder/VIEW/VIEW_FRAME_keypoints.json in pixels of the calibrated cameras, and, where the detector gives
        masks, folder/VIEW/masks/FRAME.png, undistorted: 256 - the sum of 2^k over the people k that a pixel shows.
    resume: skip frames that have a file.
    frames: frames to detect; default: all.
    progress: called with done, total after every picture; raising KeyboardInterrupt in it stops the run and keeps its
        files.
    Returns: description of what was written.
    Raises: InputError where a view has no pictures, or the folder holds other files, or, with resume, another
        detector's points; EvidenceError where no person was found in any picture.
    """
    for view in recording.views:
        if view.source is None:
            raise InputError(
                f"View {view.name} of {recording.name} has masks only, and key points are found in pictures; give its "
                "video in recording.toml."
            )
    wanted = frames or range(recording.n_frames)
    work = DetectedKeypoints(folder, detector.keypoint_set, detector.identity, False, wanted, detector.gives_masks)
    work = _make_room(work, resume)
    total, done, found_any = len(wanted) * len(recording.views), 0, False
    small = working_rig(recording.rig)
    with contextlib.ExitStack() as stack:
        lanes = [
            _Lane(work, detector, view, camera, into)
            for view, camera, into in zip(recording.views, recording.rig, small, strict=True)
        ]
        for lane in lanes:
            stack.enter_context(lane.reader)
        # the user's own detector may not be thread-safe
        pool = stack.enter_context(ThreadPoolExecutor(default_threads() if detector.gives_masks else 1))
        for frame in wanted:
            for found in [pool.submit(lane.look, frame) for lane in lanes]:
                found_any = found.result() or found_any
                done += 1
                if progress is not None:
                    progress(done, total)
    finished = replace(work, complete=True)
    finished.save()
    if not found_any:
        raise EvidenceError(
            f"The detector found nobody in any picture of {recording.name}, so the files in {folder} are empty; see "
            "whether the videos show the person upright and large enough, or use another model."
        )
    return finished


class _Lane:
    """Pictures of one view, detected one after the other."""

    def __init__(
        self, work: DetectedKeypoints, detector: PoseDetector, view: ViewSettings, camera: Camera, small: Camera
    ) -> None:
        assert view.source is not None
        self._work, self._detector, self._view, self._camera = work, detector, view, camera
        self.reader = open_video(view.source, 1, rate=view.rate)
        self._before: tuple[int, list[Crop]] = -1, []
        folder_for(work.folder, view.name)
        if work.with_masks:
            size = {"undistorted": True, "size": list(small.size)}
            write_text(work.masks(view.name) / SIDECAR, json.dumps(size) + "\n")
            if work.frames.start and not work.file(view.name, 0).exists():  # files are counted from the first
                write_text(work.file(view.name, 0), json.dumps(openpose_document([])) + "\n")
        self._places = places_in_stored(camera, small.size, view.image_shift, self.reader.size)

    def look(self, frame: int) -> bool:
        """Detect key points in a frame, unless its files exist; return whether a person is seen."""
        name, work = self._view.name, self._work
        path = work.file(name, frame)
        if path.exists() and (not work.with_masks or work.mask(name, frame).exists()):
            return bool(_people(path))
        number, before = self._before
        if work.with_masks and number != frame - 1 and frame:
            before = _crops(work.file(name, frame - 1))
        people = self._detector.look(self.reader.read(frame), frame, before)
        people = [f for f in people if (f.points[:, 2] > 0).any()]
        self._before = frame, [f.following for f in people if f.following is not None]
        if work.with_masks:
            data = cv2.imencode(".png", np.negative(owners_of_pixels(people, self._places)))[1].tobytes()
            write_bytes(work.mask(name, frame), data, synced=False)
        points = np.array([f.points for f in people])
        document = openpose_document(_calibrated(points, self.reader.size, self._camera, self._view))
        for person, found in zip(document["people"], people, strict=True):
            if found.following is not None:
                person["following"] = [*found.following.hips.tolist(), *found.following.top.tolist()]
        write_text(path, json.dumps(document) + "\n")
        return bool(people)


def _people(path: Path) -> list[dict[str, list[float]]]:
    """Read the people in a file that was written here."""
    return read_json(path, "key points of a frame")["people"]


def _crops(path: Path) -> list[Crop]:
    """Read the image regions in which the people of a frame are expected in the next one."""
    if not path.exists():
        return []
    numbers = [np.array(p["following"]) for p in _people(path) if "following" in p]
    return [Crop(n[:2], n[2:]) for n in numbers]


def _make_room(work: DetectedKeypoints, resume: bool) -> DetectedKeypoints:
    """Prepare the output folder: empty, or with points of the same detector, to which frames are added."""
    if work.folder.is_file():
        raise InputError(f"{work.folder} is a file; give a folder with --out.")
    before = load_detected(work.folder)
    if before is None and work.folder.is_dir() and any(not p.name.startswith(".") for p in work.folder.iterdir()):
        raise InputError(f"The folder {work.folder} holds other files; give an empty or new folder with --out.")
    if before is not None and resume:
        if (before.keypoint_set, dict(before.identity)) != (work.keypoint_set, dict(work.identity)):
            raise InputError(
                f"The key points in {work.folder} are those of another model, version or setting; run without --resume "
                "to detect again, or give another folder with --out."
            )
    elif before is not None:
        for path in (*work.folder.glob("*/*_keypoints.json"), *work.folder.glob(f"*/{MASKS}/*.png")):
            path.unlink()
    work.save()
    return work


def _calibrated(people: Array, size: tuple[int, int], camera: Camera, view: ViewSettings) -> Array:
    """Convert people (P, K, 3) from pixels of a stored picture of a size (width, height) to pixels of the calibrated
    camera.
    """
    out = np.array(people, dtype=np.float64)
    if not out.size:
        return out
    scale = np.array(camera.size) / np.array(size)
    moved = (out[..., :2] + 0.5) * scale - 0.5 + view.image_shift
    # (0, 0) means "missing" in files of OpenPose: move a real point that lies there
    moved[(moved == 0).all(-1)] = 1e-3
    out[..., :2] = np.where(out[..., 2:] > 0, moved, 0.0)
    return out

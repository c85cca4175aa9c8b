"""`bench two-people`: the man of Pose2Sim's balancing clip with a second person beside him, against him alone.

--data holds pose2sim_balancing, and two_people: the two-people trial of Pose2Sim's repository (BSD-3) as a project
folder: videos/cam01.mp4 ... of Demo_MultiPerson, pose/cam01_json ... of S00_P01_T02_Participants1-2 in its history
before July 2024, Config.toml and calibration of its single-person demo. An observer stands in two of the four views.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import balancing_recording, in_memory
from hypose.geometry import Array
from hypose.io.recordings.frames import load_person, working_rig
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.videos.video import open_video
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions

_FAR = 0.5  # m from him: somebody else
_LATER = 1  # frames by which the film of two shows the same later, in all four views


def two_people(options: BenchOptions) -> BenchReport:
    """Rows man_mm, largest_mm (EVIDENCE: mean over joints and frames, and a frame's largest mean, of the distance
    between the man tracked with a second person in the recording, and alone), another_followed (frames in which the key
    points followed are more than 0.5 m from his), people (whom two views or more see)."""
    alone = balancing_recording(options.folder("pose2sim_balancing"))
    with tempfile.TemporaryDirectory(prefix="two-people-") as folder:
        return _measured(options, alone, _beside(options.folder("two_people"), alone, Path(folder)))


def _beside(folder: Path, alone: Recording, work: Path) -> Recording:
    """The recording with a second person, its pictures laid onto those of the man alone."""
    both = load_recording(folder)
    views = []
    for view, one, camera in zip(both.views, alone.views, alone.rig, strict=True):
        images = laid_onto(view.files["video"], one.files["video"], camera.size, _LATER, work / view.name)
        files = {**one.without("video").files, "images": images, "keypoints": view.files["keypoints"]}
        views.append(replace(one, files=files))  # the man's alone: shift, background
    n = len(both.frames) - _LATER
    return replace(
        both, views=tuple(views), rig=alone.rig, keypoint_lag=alone.keypoint_lag, frame_range=None, n_frames=n
    )


def _measured(options: BenchOptions, alone: Recording, both: Recording) -> BenchReport:
    n = 20 if options.quick else len(both.frames)
    small = working_rig(alone.rig)
    him, followed = (load_person(r, small) for r in (alone, both))
    assert him is not None and followed is not None
    places = [[p.one.people[0].place(t) for t in range(n)] for p in (him, followed)]
    apart = np.linalg.norm(np.array(places[0]) - np.array(places[1]), axis=1)
    rows = [
        Row("another_followed", "keypoints", float((apart > _FAR).sum()), "frames", n=n),
        Row("people", "keypoints", float(len(followed.one.people)), "people"),
    ]
    for k, evidence in enumerate(("keypoints", "both", "silhouettes")):
        options.progress(evidence, k, 3)
        first, second = (_joints(r, n, evidence) for r in (alone, both))
        distance = 1e3 * np.linalg.norm(first - second, axis=-1)
        rows.append(Row("man_mm", evidence, float(distance.mean()), "mm", float(distance.mean(1).std()), n))
        rows.append(Row("largest_mm", evidence, float(distance.mean(1).max()), "mm", n=n))
    return BenchReport(tuple(rows), {"frames": n, "extrinsics": "refined"})


def _joints(recording: Recording, n: int, evidence: str) -> Array:
    """(n, J, 3) m. Masks are made with the key points, whatever is tracked from."""
    source = in_memory(recording, n)
    kept = source.frames
    if evidence == "silhouettes":
        kept = [replace(f, keypoints=None) for f in kept]
    elif evidence == "keypoints":
        kept = [replace(f, silhouettes=None) for f in kept]
    frames = FrameList(list(kept), recording.frame_rate)
    return track_source(frames, recording.frame_rate, TrackOptions(evidence=evidence)).motion.joints


_STILLS, _ROWS, _COLUMNS = 10, 6, 3
_AGREED = 0.5
"""Peak of a phase correlation from which the patch shows the same still thing in both films."""


def laid_onto(film: Path, other: Path, size: tuple[int, int], first: int, folder: Path) -> Path:
    """The folder, with the frames of a film from `first` on as pictures of size (w, h) px in which still things are
    where they are in the other film, stretched to that size."""
    offset, scale = _between(_still(film, size), _still(other, size))
    folder.mkdir(parents=True)
    matrix = np.array([[1 + scale[0], 0, offset[0]], [0, 1 + scale[1], offset[1]]])
    with open_video(film) as frames:
        for k, image in enumerate(frames):
            if k >= first:
                flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
                laid = cv2.warpAffine(cv2.resize(image, size), matrix, size, None, flags, cv2.BORDER_REPLICATE)
                cv2.imwrite(str(folder / f"{k - first:06d}.jpg"), laid, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def _still(film: Path, size: tuple[int, int]) -> Array:
    """(h, w) edges of what stands still in a film."""
    with open_video(film) as frames:
        every = max(1, frames.n_frames // _STILLS)
        grey = [cv2.cvtColor(cv2.resize(im, size), cv2.COLOR_BGR2GRAY) for k, im in enumerate(frames) if k % every == 0]
    middle = np.median(np.stack(grey).astype(np.float32), 0).astype(np.float32)
    return np.asarray(cv2.Laplacian(cv2.GaussianBlur(middle, (0, 0), 2), cv2.CV_32F), dtype=np.float64)


def _between(film: Array, other: Array) -> tuple[Array, Array]:
    """Offset (2,) px and scale (2,): what is at x in the other picture is at x + offset + scale * x in the film's."""
    h, w = (n // k for n, k in zip(film.shape, (_ROWS, _COLUMNS), strict=True))
    at, moved, weight = [], [], []
    window = cv2.createHanningWindow((w, h), cv2.CV_64F)
    for y in range(0, _ROWS * h, h):
        for x in range(0, _COLUMNS * w, w):
            part = slice(y, y + h), slice(x, x + w)
            shift, peak = cv2.phaseCorrelate(other[part], film[part], window)
            if peak > _AGREED:
                at.append((x + w / 2, y + h / 2))
                moved.append(shift)
                weight.append(peak)
    place, shifts, peaks = np.array(at), np.array(moved), np.array(weight)
    lines = np.array([_line(place[:, axis], shifts[:, axis], peaks) for axis in range(2)])
    return lines[:, 0], lines[:, 1]


def _line(along: Array, shift: Array, peaks: Array) -> tuple[float, float]:
    """Start and slope of the shifts (n,) along an axis; patches in which somebody moved count less and less."""
    slope, start = np.polyfit(along, shift, 1, w=peaks)
    for _ in range(4):
        slope, start = np.polyfit(along, shift, 1, w=peaks / (1 + (shift - start - slope * along) ** 2))
    return float(start), float(slope)

"""`bench caliscope`: the person of Caliscope's public recording from its 2D points alone, against its triangulation.

--data holds caliscope_person, from the history of Caliscope's repository (BSD-2), tests/sessions/4_cam_recording:
camera_array.toml and the HOLISTIC folder's frametimes.csv (commit 71d96e77), its xy_HOLISTIC.csv and xyz_HOLISTIC.csv
(commit f7c314b4), and a recording.toml with the four views and world_up = "x". Four webcams without a trigger, a person
behind a desk, MediaPipe's points without scores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.leave_one_out import body_points, solved_clip, without_view
from benchmarks.multiview.real_recordings import in_memory
from hypose.cameras.camera import triangulate
from hypose.evidence.frame import Frame, Keypoints
from hypose.geometry import Array
from hypose.io.recordings.recording import load_recording

ARMS = ("shoulder", "elbow", "wrist")


def caliscope(options: BenchOptions) -> BenchReport:
    """loco_px: median distance in a camera that was left out, from what the other three say, of the points that the
    body has; baseline: the same points triangulated as Caliscope does (linear, all views alike), same samples."""
    recording = load_recording(options.folder("caliscope_person"))
    n = 60 if options.quick else len(recording.frames)
    frames, rate = in_memory(recording, n).frames, recording.frame_rate
    names = _keypoints(frames[0]).names
    errors: dict[str, list[Array]] = {"caliscope": [], "hypose": []}
    cameras = [c.name for c in recording.rig]
    for view, name in enumerate(cameras):
        options.progress(name, view, len(cameras))
        rest = [without_view(f, view) for f in frames]
        found = {"caliscope": _triangulated(rest), "hypose": body_points(*solved_clip(rest, rate))}
        given = np.stack([_keypoints(f).points[view] for f in frames])
        camera = _keypoints(frames[0]).rig[view]
        scale = recording.rig[view].size[0] / camera.size[0]
        away = {
            m: scale * np.linalg.norm(camera.project_pinhole(x) - given[..., :2], axis=-1) for m, x in found.items()
        }
        both = np.isfinite(away["caliscope"]) & np.isfinite(away["hypose"]) & (given[..., 2] > 0)
        for method, e in away.items():
            errors[method].append(np.where(both, e, np.nan))

    rows = [*_rows("", slice(None), names, errors), *_rows(", arms", slice(None), names, errors, ARMS)]
    for view, name in enumerate(cameras):
        rows += _rows(f", {name}", slice(view, view + 1), names, errors)

    return BenchReport(tuple(rows), {"frames": n})


def _rows(
    case: str, views: slice, names: Sequence[str], errors: dict[str, list[Array]], parts: Sequence[str] = ("",)
) -> list[Row]:
    """Of chosen views and of the points whose names hold one of the parts."""
    which = [k for k, n in enumerate(names) if any(p in n for p in parts)]
    values = {m: np.concatenate([v[:, which].ravel() for v in e[views]]) for m, e in errors.items()}
    count, theirs = int(np.isfinite(values["hypose"]).sum()), float(np.nanmedian(values["caliscope"]))
    ours = float(np.nanmedian(values["hypose"]))
    return [
        Row("loco_px", f"hypose{case}", ours, "px", None, count, f"caliscope{case}", theirs),
        Row("loco_px", f"caliscope{case}", theirs, "px", None, count),
    ]


def _keypoints(frame: Frame) -> Keypoints:
    assert frame.keypoints is not None
    return frame.keypoints


def _triangulated(frames: Sequence[Frame]) -> Array:
    """(T, K, 3) m: linear, from every view that shows the point, all alike; NaN with fewer than two."""
    points = np.stack([_keypoints(f).points for f in frames], 1)
    found, views = triangulate(_keypoints(frames[0]).rig, points[..., :2], (points[..., 2] > 0).astype(float))
    return np.where((views >= 2)[..., None], found, np.nan)

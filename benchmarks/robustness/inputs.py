"""`inputs`: one recording's key points in every layout that is read: the same poses, and spoilt files refused."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.robustness.keypoint_layouts import (
    LAYOUTS,
    NEED_H5PY,
    RATE,
    UNSCORED,
    detections,
    write_keypoint_recording,
    write_keypoints,
)
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError
from hypose.geometry import Array
from hypose.io.recordings.frames import load_keypoints
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.track import track
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import camera_rig

_SPOILT = 40
_SAME_PX = 1.0  # points that come back otherwise were guessed wrong


def bench_inputs(options: BenchOptions) -> BenchReport:
    """pose_difference_mm: largest distance of a joint between a layout's track and that of the same detections as
    OpenPose files. refused: share of 40 spoilt files that end in a sentence; guessed_wrong: share that is read, and not
    as what was meant."""
    frames = 30 if options.quick else 100
    cameras = camera_rig("humaneva-4", distorted=True)
    names = [n for n in LAYOUTS if n != "openpose" and not (n in NEED_H5PY and not _has_h5py())]
    results, plain = [], {}
    for done, name in enumerate(names):
        options.progress("inputs", done, len(names))
        kind = LAYOUTS[name][0]
        points = detections(kind, cameras, frames)
        if name in UNSCORED:  # the same evidence: no scores on either side
            points[..., 2] = points[..., 2] > 0
        key = (kind, name in UNSCORED)
        with tempfile.TemporaryDirectory() as folder:
            if key not in plain:
                plain[key] = _tracked(Path(folder) / "plain", "openpose", points, cameras, kind)
            joints = _tracked(Path(folder) / name, name, points, cameras, kind)
        difference = 1000 * float(np.linalg.norm(joints - plain[key], axis=-1).max())
        results.append(Row("pose_difference_mm", name, difference, "mm", n=frames))
        refused, wrong, told = _spoilt(name, cameras, 8 if options.quick else _SPOILT)
        results.append(Row("refused", name, refused, "share", n=told))
        results.append(Row("guessed_wrong", name, wrong, "share", n=told))
    options.progress("inputs", len(names), len(names))
    settings = {
        "frames": frames,
        "rig": "humaneva-4",
        "spoilt": 8 if options.quick else _SPOILT,
        "quick": options.quick,
    }
    return BenchReport(tuple(results), settings)


def _has_h5py() -> bool:
    return importlib.util.find_spec("h5py") is not None


def _written(folder: Path, name: str, points: Array, cameras: CameraRig, kind: str) -> Path:
    paths = write_keypoints(name, folder / "points", points, cameras, kind)
    return write_keypoint_recording(folder, cameras, paths, None, RATE)


def _tracked(folder: Path, name: str, points: Array, cameras: CameraRig, kind: str) -> Array:
    recording = load_recording(_written(folder, name, points, cameras, kind))
    return track(recording, TrackOptions(evidence="keypoints")).motion.joints


# ---- spoilt files ---------------------------------------------------------------------------------------------------


def _moved(scale: Array | float, offset: Array | float) -> Callable[[Array], Array]:
    def change(points: Array) -> Array:
        out = points.copy()
        out[..., :2] = np.where(points[..., 2:] > 0, points[..., :2] * scale + offset, 0)
        return out

    return change


def _changes(cameras: CameraRig, rng: np.random.Generator) -> list[Callable[[Array], Array]]:
    """What befalls positions on their way: y upwards, mirrored, other sizes, in all views or in one, other orders."""
    sizes = cameras.sizes[:, None, None].astype(np.float64)
    flip, mirror = _moved(np.array([1, -1]), (sizes - 1) * [0, 1]), _moved(np.array([-1, 1]), (sizes - 1) * [1, 0])
    factors = [_moved(f, 0.0) for f in (0.25, 1 / 3, 0.5, 2 / 3, 1.5, 2.0, 3.0, 4.0)]

    def one(change: Callable[[Array], Array], view: int) -> Callable[[Array], Array]:
        def only(points: Array) -> Array:
            out = points.copy()
            out[view] = change(points)[view]
            return out

        return only

    def shuffled(seed: int) -> Callable[[Array], Array]:
        return lambda p: p[:, :, np.random.default_rng(seed).permutation(p.shape[2])]

    whole = [flip, mirror, lambda p: p[..., [1, 0, 2]], *factors]
    single = [one(c, int(rng.integers(len(cameras)))) for c in (flip, mirror, *factors)]
    return [*whole, *single, *(shuffled(int(s)) for s in rng.integers(0, 10**6, 6))]


def _spoilt(name: str, cameras: CameraRig, count: int) -> tuple[float, float, int]:
    """Shares that are refused and guessed wrong of spoilt positions and cut files, and how many there were."""
    kind = LAYOUTS[name][0]
    points = detections(kind, cameras, 16)
    rng = np.random.default_rng(sum(name.encode()))
    refused = wrong = total = 0
    changes = _changes(cameras, rng)
    for number in range(count):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            if number < len(changes):
                _written(folder, name, changes[number](points), cameras, kind)
            else:
                _written(folder, name, points, cameras, kind)
                _damage(folder / "points", rng)
            total += 1
            try:
                found = load_keypoints(load_recording(folder))
            except HyposeError:
                refused += 1
                continue
            assert found is not None
            wrong += _otherwise(np.stack([k.points for k in found], 1), found[0].rig, points, cameras)
    return refused / total, wrong / total, total


def _damage(folder: Path, rng: np.random.Generator) -> None:
    """One of the files is cut off, or bytes of it are replaced."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.stat().st_size)
    path = files[int(rng.integers(len(files)))]
    data = bytearray(path.read_bytes())
    if rng.random() < 0.5:
        data = data[: int(rng.integers(1, len(data)))]
    else:
        for at in rng.integers(0, len(data), 6):
            data[at] = int(rng.integers(32, 127))
    path.write_bytes(bytes(data))


def _otherwise(found: Array, working: CameraRig, points: Array, cameras: CameraRig) -> bool:
    """Whether points that were read lie elsewhere than meant: what damage left out is missing, not wrong."""
    scale = (working.sizes / cameras.sizes)[:, None, None]
    flat = [c.undistort_points(p[..., :2].reshape(-1, 2)) for c, p in zip(cameras, points, strict=True)]
    wanted = (np.stack(flat).reshape(*points.shape[:3], 2) + 0.5) * scale - 0.5
    frames = min(found.shape[1], points.shape[1])
    both = (found[:, :frames, :, 2] > 0) & (points[:, :frames, :, 2] > 0)
    far = np.linalg.norm(found[:, :frames, :, :2] - wanted[:, :frames], axis=-1) > _SAME_PX
    # a handful of digits that were replaced are a detector's error, which tracking is robust to
    return bool((far & both).sum() > 0.02 * max(1, both.sum()))

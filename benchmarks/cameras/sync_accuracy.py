"""Measure how exactly known offsets between synthetic cameras are found from motion."""

from __future__ import annotations

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.synthetic.noisy_masks import LEVELS, corrupt_mask
from hypose.calibration.synchronisation import offsets_from_motion
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Silhouettes
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import Array
from hypose.synthetic.scenes import Scene, keypoint_detections, make_scene

_FINE, _RATE, _PAD = 10, 25.0, 8
FIRST_SEED = 1000
MOTIONS = {"walk": "walk", "arms": "wave"}


def late_scene(motion: str, seed: int, late: Array, seconds: float = 6.0) -> tuple[Scene, Array]:
    """A scene at ten times the frame rate, and for each camera the fine frames (C, T) that it shows when it is late by
    `late` (C,) frames of 25 frames/s."""
    scene = make_scene(
        motion, seconds=seconds + 2 * _PAD / _RATE, frame_rate=_RATE * _FINE, seed=seed, rig="humaneva-4"
    )
    frames = np.arange(int(seconds * _RATE))
    shown = np.rint((frames[None] - late[:, None] + _PAD) * _FINE).astype(int)
    return scene, np.clip(shown, 0, len(scene) - 1)


def seen_points(scene: Scene, shown: Array, noise_px: float = 4.0) -> tuple[Array, Array]:
    """Key points (C, T, K, 2) undistorted px and confidence, with white noise of noise_px at a person 250 px tall."""
    out = []
    for c, camera in enumerate(scene.rig):
        points = keypoint_detections(scene, c, 0.0)[shown[c]]
        rng = np.random.default_rng([scene.seed, 501, c])
        size = float(np.median(np.ptp(points[..., 1], axis=1)))
        points[..., :2] += rng.normal(size=points[..., :2].shape) * noise_px * size / 250
        points[..., :2] = camera.undistort_points(points[..., :2])
        out.append(points)
    stacked = np.stack(out)
    return stacked[..., :2], stacked[..., 2]


def seen_masks(scene: Scene, shown: Array, scale: float = 0.5) -> list[Silhouettes | None]:
    """T silhouettes with the faults of a decent background model (level-1)."""
    rig: CameraRig = scene.rig.pinhole().scaled(scale)
    out: list[Silhouettes | None] = []
    for t in range(shown.shape[1]):
        masks = []
        for c in range(len(rig)):
            clean = scene.clean_mask(c, int(shown[c, t]), scale)
            rng = np.random.default_rng([scene.seed, 502, c, t])
            masks.append(corrupt_mask(clean, np.zeros_like(clean), LEVELS["level-1"], rng, scale))
        out.append(make_silhouettes(masks, rig))
    return out


def sync(options: BenchOptions) -> BenchReport:
    """Largest and mean error of offsets of -5.0 to +5.0 frames (all cameras, several scenes). Cases: walk and arms from
    key points, from silhouettes, and from both."""
    seeds = options.seed_range(4, first=FIRST_SEED)
    rows: list[Row] = []
    for done, (case, motion) in enumerate(MOTIONS.items()):
        errors: dict[str, list[float]] = {"keypoints": [], "silhouettes": [], "both": []}
        for s, seed in enumerate(seeds):
            options.progress(case, done * len(seeds) + s, len(MOTIONS) * len(seeds))
            late = _late(seed, 4)
            scene, shown = late_scene(motion, seed, late)
            points, masks = seen_points(scene, shown), seen_masks(scene, shown)
            rig = scene.rig.pinhole()
            for name, evidence in (
                ("keypoints", (points, ())),
                ("silhouettes", ((np.zeros((0, 0, 0, 2)), np.zeros((0, 0, 0))), masks)),
                ("both", (points, masks)),
            ):
                found = offsets_from_motion(rig, *evidence).frames
                wrong = found - late
                errors[name] += list(np.abs(wrong - np.median(wrong)))
        for name, e in errors.items():
            rows.append(Row("sync_error_frames", f"{case}, {name}", float(np.mean(e)), "frames", n=len(e)))
            rows.append(Row("sync_error_largest_frames", f"{case}, {name}", float(np.max(e)), "frames", n=len(e)))

    settings = {"seeds": len(seeds), "first_seed": seeds.start, "frame_rate": _RATE, "seconds": 6.0}
    return BenchReport(tuple(rows), settings)


def _late(seed: int, n: int) -> Array:
    late = np.round(np.random.default_rng([seed, 500]).uniform(-5, 5, n), 1)
    late[seed % n] = 5.0 if seed % 2 else -5.0
    return late

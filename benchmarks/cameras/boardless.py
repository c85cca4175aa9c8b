"""Cameras from one person who walks about: against the true cameras of simulated rigs, and of the balancing clip."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import balancing_recording
from benchmarks.synthetic.wandering import RATE, Wandering, WanderingSettings, wandering
from hypose.app.commands.commands_calibrate import person_of
from hypose.body.default_body import human
from hypose.calibration.from_person import PersonCalibration, calibrate_from_person
from hypose.calibration.refine_points import scale_rig, transform_rig
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import HyposeError
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array, procrustes, so3_log, transform
from hypose.io.recordings.recording import Recording
from hypose.tracking.subject import shape_from_keypoints

FIRST_SEED = 100
HARD: Mapping[str, tuple[WanderingSettings, bool]] = {
    "circle, known": (WanderingSettings(motion="circle"), True),
    "circle, five cameras": (WanderingSettings(motion="circle", cameras=5), True),
    "circle, unknown": (WanderingSettings(motion="circle"), False),
    "two cameras, unknown": (WanderingSettings(cameras=2), False),
    "three cameras, unknown": (WanderingSettings(cameras=3), False),
    "in place, known": (WanderingSettings(motion="box"), True),
    "in place, unknown": (WanderingSettings(motion="box"), False),
    "4 s, known": (WanderingSettings(seconds=4.0), True),
    "4 s, unknown": (WanderingSettings(seconds=4.0), False),
    "one side, known": (WanderingSettings(spread_deg=6.0), True),
}
"""Rigs of which cameras cannot be found, or badly: settings, and whether focal lengths are given."""
_MARKS = 4.0 * np.array([[0.0, 0, 0], [0, 0, 1.0], [0.3, 0, 1.0], [0, 0.3, 1.0]])
_TAKEN = ("turn_deg", "place_mm", "place_by_height_mm", "focal_pct", "lag_frames")


def without_poses(rig: CameraRig, known: bool) -> CameraRig:
    """What is known of a rig beforehand: its lenses, or the size of its pictures."""
    cameras = []
    for c in rig:
        (w, h), f = c.size, float(max(c.size))
        guess = np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1.0]])
        lens = {} if known else {"K": guess, "distortion": np.zeros(5)}
        cameras.append(replace(c, camera_from_world=np.eye(4), **lens))
    return CameraRig(tuple(cameras))


def errors(found: PersonCalibration, true: CameraRig, late: Array) -> dict[str, list[float]]:
    """Per camera, laid onto the true rig by least squares: turn_deg and place_mm with the scale freed,
    place_by_height_mm without, focal_pct, lag_frames, up_deg; and most of them in their standard deviations."""

    def laid(rig: CameraRig) -> CameraRig:
        return transform_rig(rig, procrustes(_marks(rig), _marks(true))[0])

    def away(rig: CameraRig) -> Array:
        return np.linalg.norm(laid(rig).positions - true.positions, axis=1)

    spread = [np.linalg.norm(r.positions - r.positions.mean(0)) for r in (true, found.rig)]
    freed = scale_rig(found.rig, float(spread[0] / spread[1]))
    both = zip(true, laid(freed), strict=True)
    turns = [so3_log(b.camera_from_world[:3, :3] @ a.camera_from_world[:3, :3].T) for a, b in both]
    turn = np.degrees(np.linalg.norm(turns, axis=1))
    focal = np.array([b.K[0, 0] / a.K[0, 0] - 1 for a, b in zip(true, found.rig, strict=True)])
    lag = found.late - found.late.mean() - late + late.mean()
    upright = [
        np.degrees(np.arccos(np.clip(a.camera_from_world[:3, 2] @ b.camera_from_world[:3, 2], -1, 1)))
        for a, b in zip(true, found.rig, strict=True)
    ]
    over = [turn / found.sds.turn_deg, away(freed) / found.sds.place_m, lag / found.sds.late]
    over += [focal / found.sds.focal] if found.sds.focal.all() else []
    return {
        "turn_deg": turn.tolist(),
        "place_mm": (1e3 * away(freed)).tolist(),
        "place_by_height_mm": (1e3 * away(found.rig)).tolist(),
        "focal_pct": (100 * np.abs(focal)).tolist(),
        "lag_frames": np.abs(lag).tolist(),
        "up_deg": [float(np.mean(upright))],
        "over_turn": over[0].tolist(),
        "over_place": over[1].tolist(),
        "over_lag": over[2].tolist(),
        "over_focal": over[3].tolist() if len(over) > 3 else [],
    }


def _marks(rig: CameraRig) -> Array:
    """(4 C, 3) m: each camera's centre, and three points where it looks."""
    return np.concatenate([transform(np.linalg.inv(c.camera_from_world), _MARKS) for c in rig])


def solved(scene: Wandering, known: bool) -> dict[str, Any]:
    """The errors of one simulated rig, how long it took, and what was said of it."""
    begin = time.perf_counter()
    try:
        lenses = without_poses(scene.rig, known)
        found = calibrate_from_person(scene.points, BODY_25, lenses, scene.height, RATE, lenses_known=known)
    except HyposeError as refusal:
        return {"refused": str(refusal), "seconds": time.perf_counter() - begin}
    seconds = time.perf_counter() - begin
    return {"seconds": seconds, "told": list(found.approximate), **errors(found, scene.rig, scene.late)}


def balancing(recording: Recording, focal_known: bool = True) -> tuple[PersonCalibration, float]:
    """The cameras of a calibrated recording found again without it, the person as tall as its own calibration says, and
    that height in metres."""
    points, names = person_of(recording, True, False)
    height = measured_height(recording.rig, points, names)
    lenses = without_poses(recording.rig, focal_known)
    found = calibrate_from_person(points, names, lenses, height, recording.frame_rate, lenses_known=focal_known)
    return found, height


def measured_height(rig: CameraRig, points: Array, names: tuple[str, ...]) -> float:
    """How tall a rig says the person of points (C, T, K, 3) is, by the limbs."""
    uv = np.stack([c.undistort_points(p[..., :2]) for c, p in zip(rig, points, strict=True)])
    x, _ = triangulate(rig, uv, np.where(points[..., 2] > 0.3, points[..., 2], 0.0))
    return shape_from_keypoints(human(), x, names).scale * human().stature


def boardless(options: BenchOptions) -> BenchReport:
    """Cameras, offsets, focal lengths and vertical from one person. Cases: known and unknown focal lengths on rigs of 4
    and 5 cameras (20 s, correlated 5 px and a constant 2.5 px of every key point); balancing (with --data); rigs for
    which it cannot be done, each refused, told, or within three standard deviations."""
    seeds = options.seed_range(20, first=FIRST_SEED)
    rows: list[Row] = []
    for known, case in ((True, "known"), (False, "unknown")):
        results = []
        for done, seed in enumerate(seeds):
            options.progress(case, done, len(seeds))
            settings = WanderingSettings(cameras=4 + seed % 2)
            measure = partial(_measured, seed, settings, known)
            results.append(options.part(f"{case}-{seed}", measure))
        rows += _rows(case, results)
    silent = []
    for done, (name, (settings, known)) in enumerate(HARD.items()):
        options.progress("hard", done, len(HARD))
        part = f"hard-{name.replace(', ', '-').replace(' ', '-')}"
        result = options.part(part, partial(_measured, FIRST_SEED + done, settings, known))
        over = [abs(x) for key in ("turn", "place", "lag", "focal") for x in result.get(f"over_{key}", [])]
        beyond = bool(over) and max(over) > 3 and not result.get("told")
        rows.append(Row("refused", name, float("refused" in result), "1 = yes"))
        rows.append(Row("told", name, float("refused" in result or bool(result.get("told"))), "1 = yes"))
        silent.append(beyond)
    rows.append(Row("silently_wrong", "hard", float(sum(silent)), "rigs", n=len(silent)))
    if options.data is not None:
        folder = options.folder("pose2sim_balancing")
        for known, case in ((True, "balancing"), (False, "balancing, unknown")):
            options.progress(case, 0, 1)
            rows += _rows(case, [options.part(case.replace(", ", "-"), partial(_balancing, folder, known))])
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "scene": asdict(WanderingSettings())}
    return BenchReport(tuple(rows), settings)


def _measured(seed: int, settings: WanderingSettings, known: bool) -> dict[str, Any]:
    return solved(wandering(seed, settings), known)


def _balancing(folder: Path, known: bool) -> dict[str, Any]:
    recording = balancing_recording(folder)
    begin = time.perf_counter()
    found, _ = balancing(recording, known)
    seconds = time.perf_counter() - begin
    late = np.zeros(len(recording.rig))
    return {"seconds": seconds, "told": list(found.approximate), **errors(found, recording.rig, late)}


def _rows(case: str, results: list[dict[str, Any]]) -> list[Row]:
    good = [r for r in results if "refused" not in r]
    rows = [Row("refused", case, float(len(results) - len(good)), "clips", n=len(results))]
    if not good:
        return rows
    for metric in (*_TAKEN, "up_deg"):
        values = np.concatenate([r[metric] for r in good])
        unit = metric.rpartition("_")[2]
        rows.append(Row(metric, case, float(np.median(values)), unit, n=len(values)))
        rows.append(Row(f"{metric}_p90", case, float(np.percentile(values, 90)), unit, n=len(values)))
        rows.append(Row(f"{metric}_largest", case, float(values.max()), unit, n=len(values)))
    for key in ("turn", "place", "lag", "focal"):
        values = np.concatenate([r[f"over_{key}"] for r in good])
        if len(values):
            rms = float(np.sqrt(np.mean(values**2)))
            rows.append(Row("error_over_sd", f"{case}, {key}", rms, "rms", n=len(values)))
    rows.append(Row("seconds", case, float(np.median([r["seconds"] for r in good])), "s", n=len(good)))
    return rows

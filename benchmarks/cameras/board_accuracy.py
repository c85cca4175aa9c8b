"""`./run bench calibration`: boards in front of synthetic cameras with known truth, and real boards."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.depth_sensors.fusion_benchmarks import jitter
from benchmarks.multiview.real_recordings import uu4cam_recording
from benchmarks.synthetic.calibration_boards import BoardScene, compare_rigs, film_board, ring_of_cameras
from hypose.calibration.boards import Board, BoardDetection
from hypose.calibration.bundle import board_poses, calibrate_lens, collect_observations, project_with_derivatives
from hypose.calibration.from_boards import BoardCalibration, CalibrateOptions, calibrate_from_boards
from hypose.calibration.rig import RigCalibration, calibrate_rig
from hypose.calibration.views import BoardFootage
from hypose.cameras.camera import CameraRig
from hypose.evidence.hull import hull_iou, visual_hull
from hypose.geometry import Array, se3, se3_inverse, skew, so3_exp
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.pipeline.run import track_source
from hypose.pipeline.track_options import TrackOptions

NOISE_PX = 0.25


def boards(options: BenchOptions) -> BenchReport:
    """Synthetic rigs of five cameras and 60 board frames with 0.25 px of noise; with data the ChArUco board of four
    webcams and the floor board of uu4cam, and what the latter's calibration is worth for hulls and poses.

    Synthetic figures are the worst camera's per seed. Positions: after a rigid motion without scale onto the truth,
    and with the first camera laid on its truth. No setting was chosen on these seeds."""
    seeds = options.seed_range(5)
    rows: list[Row] = []
    cases = (
        ("9x6 board", Board("chessboard", 9, 6, 0.08), False),
        ("8x6 board numbered either way", Board("chessboard", 8, 6, 0.08), False),
        ("9x6 board, fisheye", Board("chessboard", 9, 6, 0.08), True),
    )
    for k, (case, board, fisheye) in enumerate(cases):
        options.progress("synthetic", k, len(cases))
        rows += _synthetic(case, board, fisheye, seeds)
    settings: dict[str, object] = {"seeds": list(seeds), "noise_px": NOISE_PX, "frames": 60, "cameras": 5}
    if options.data is not None and (options.data / "caliscope_charuco").is_dir():
        options.progress("caliscope_charuco", 0, 1)
        rows += _caliscope(options.data / "caliscope_charuco", options)
    if options.data is not None and (options.data / "uu4cam").is_dir():
        options.progress("uu4cam", 0, 1)
        rows += _uu4cam(options.data / "uu4cam", options)
    return BenchReport(tuple(rows), settings)


def solve_scene(scene: BoardScene) -> RigCalibration:
    """Lenses and places of the scene's cameras from its corners alone."""
    lenses = [
        calibrate_lens(c.name, s, scene.board, c.size, fisheye=c.fisheye)
        for c, s in zip(scene.rig, scene.sightings, strict=True)
    ]
    return calibrate_rig(lenses, scene.sightings, scene.board)


def _synthetic(case: str, board: Board, fisheye: bool, seeds: Sequence[int]) -> list[Row]:
    focal, position, relative, rms, seconds = [], [], [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        scene = film_board(ring_of_cameras(rng, fisheye=fisheye), board, rng, noise_px=NOISE_PX, turn=True)
        begin = time.perf_counter()
        found = solve_scene(scene)
        seconds.append(time.perf_counter() - begin)
        errors = compare_rigs(found.rig, scene.rig)
        focal.append(errors.focal_px.max())
        position.append(1e3 * errors.position_m.max())
        relative.append(1e3 * errors.relative_m.max())
        rms.append(found.rms_px)
    return [
        row("focal_error_px", case, focal, "px"),
        Row("focal_error_px, worst seed", case, float(np.max(focal)), "px", n=len(focal)),
        row("position_error_mm", case, position, "mm"),
        Row("position_error_mm, worst seed", case, float(np.max(position)), "mm", n=len(position)),
        row("position_error_mm, from the first camera", case, relative, "mm"),
        row("rms_px", case, rms, "px", baseline="noise", baseline_value=NOISE_PX),
        row("seconds", case, seconds, "s"),
    ]


def _agreement(case: str, rig: CameraRig, given: CameraRig) -> list[Row]:
    errors = compare_rigs(rig, given)
    return [
        Row("agreement_mm, worst camera", case, float(1e3 * errors.position_m.max()), "mm", n=len(rig)),
        Row("agreement_deg, worst camera", case, float(np.rad2deg(errors.rotation_rad.max())), "deg", n=len(rig)),
    ]


def fit_of_poses(rig: CameraRig, fit: RigCalibration, board: Board) -> float:
    """rms (px, per coordinate) with which another rig explains the same corners, when only the boards may move."""
    used = {c: dict(seen) for c, seen in fit.sightings.items()}
    squares, count = 0.0, 0
    for frame in sorted({f for seen in used.values() for f in seen}):
        who = [c for c, seen in used.items() if frame in seen]
        best = None
        for c in who:
            for pose, _ in board_poses(rig[c], used[c][frame], board.points):
                start = (se3_inverse(rig[c].camera_from_world) @ pose)[None]
                error = _board_alone(rig, start, board, {c: {frame: used[c][frame]} for c in who}, frame)
                best = error if best is None or (error**2).sum() < (best**2).sum() else best
        if best is not None and np.isfinite(best).all():
            squares, count = squares + float((best**2).sum()), count + best.size
    return float(np.sqrt(squares / max(count, 1)))


def _board_alone(
    rig: CameraRig, start: Array, board: Board, seen: dict[int, dict[int, BoardDetection]], frame: int
) -> Array:
    """Residuals (M, 2) px after Gauss-Newton on the board's pose alone."""
    obs = collect_observations(seen, [frame])
    pose = start[0]
    residual = np.full((len(obs), 2), np.inf)
    for _ in range(15):
        rows, errors = [], []
        for c in np.unique(obs.camera):
            at = obs.camera == c
            turned = board.points[obs.corner[at]] @ pose[:3, :3].T
            camera = rig[int(c)]
            x = (turned + pose[:3, 3]) @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
            if (x[:, 2] <= 0).any():
                return residual
            uv, by_point, _ = project_with_derivatives(camera, x)
            by_world = by_point @ camera.camera_from_world[:3, :3]
            rows.append(np.concatenate([-by_world @ skew(turned), by_world], -1).reshape(-1, 6))
            errors.append(obs.pixels[at] - uv)
        residual = np.concatenate(errors)
        step = np.linalg.lstsq(np.concatenate(rows), residual.ravel(), rcond=None)[0]
        pose = se3(so3_exp(step[:3]) @ pose[:3, :3], pose[:3, 3] + step[3:])
        if np.abs(step).max() < 1e-9:
            break
    return residual


def _caliscope(folder: Path, options: BenchOptions) -> list[Row]:
    session = folder / "post_optimization"
    given = read_any(session / "camera_array.toml")[0]
    sources = [BoardFootage(f"cam_{n}", session / f"calibration/extrinsic/cam_{n}.mp4") for n in range(4)]
    board = Board("charuco", 4, 5, 0.054, 0.75 * 0.054, "DICT_4X4_1000", inverted=True)
    rows = []
    for case, lenses in (("caliscope_charuco, given lenses", given), ("caliscope_charuco, own lenses", None)):
        found = calibrate_from_boards(sources, board, CalibrateOptions(lenses, progress=options.progress))
        rows += _real(case, found, given, board)
    return rows


def _real(case: str, found: BoardCalibration, given: CameraRig, board: Board) -> list[Row]:
    alone = [
        board_poses(found.rig[c], s, board.points)[0][1]
        for c, seen in found.fit.sightings.items()
        for s in seen.values()
    ]
    return [
        Row("rms_px", case, found.fit.rms_px, "px", n=len(found.fit.errors)),
        Row("rms_px, left out", case, float(len(found.fit.dropped)), "boards", n=len(alone) + len(found.fit.dropped)),
        Row("rms_px, each camera by itself", case, float(np.median(alone)), "px", n=len(alone)),
        Row("rms_px, the given rig on the same corners", case, fit_of_poses(given, found.fit, board), "px"),
        *_agreement(case, found.rig, given),
    ]


def _uu4cam(folder: Path, options: BenchOptions) -> list[Row]:
    """Lenses given (the clip shows one board position), places from the board clip; then hulls and a tracked man."""
    recording = uu4cam_recording(folder)
    board = Board("chessboard", 8, 6, 0.115)
    sources = [BoardFootage(f"cam{n}", folder / f"cam{n}" / "checkerboard.avi") for n in range(1, 5)]
    found = calibrate_from_boards(sources, board, CalibrateOptions(recording.rig, progress=options.progress))
    rows = _real("uu4cam", found, recording.rig, board)
    own = replace(recording, rig=found.rig)
    for case, rec in (("uu4cam", own), ("uu4cam, given calibration", recording)):
        rows += _hulls(case, rec, options)
    n = 100 if options.quick else recording.n_frames or len(recording.frames)
    with FrameStream(replace(own, frame_range=(0, n))) as stream:
        options.progress("uu4cam, track", 0, 1)
        result = track_source(stream, recording.frame_rate, TrackOptions())
        motion = result.motion
        joints = motion.joints
        slow = restlessness(joints, round(recording.frame_rate / 2))
        rows += [
            Row("jitter_mm", "uu4cam", 1e3 * jitter(joints), "mm", n=len(joints)),
            Row("jitter_mm, from the mean of half a second", "uu4cam", 1e3 * slow, "mm", n=len(joints)),
        ]
        rows.append(Row("iou, tracked body", "uu4cam", 1 - float(np.nanmean(motion.cost)), "1", n=len(joints)))
    return rows


def restlessness(joints: Array, window: int) -> float:
    """m: median over joints (T, J, 3) and frames of the distance from the joint's mean over `window` frames around."""
    half = max(1, window // 2)
    padded = np.concatenate([np.repeat(joints[:1], half, 0), joints, np.repeat(joints[-1:], half, 0)])
    total = np.cumsum(np.concatenate([np.zeros((1, *joints.shape[1:])), padded]), 0)
    mean = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return float(np.median(np.linalg.norm(joints - mean, axis=-1)[half:-half]))


def _hulls(case: str, recording: Recording, options: BenchOptions) -> list[Row]:
    ious, volumes = [], []
    with FrameStream(recording) as stream:
        indices = range(0, len(stream), 60 if options.quick else 20)
        for k, i in enumerate(indices):
            options.progress(case, k, len(indices))
            frame = stream.frame(i)
            assert frame.silhouettes is not None
            hull = visual_hull(frame.silhouettes, voxel=0.02)
            ious.append(hull_iou(hull, frame.silhouettes))
            volumes.append(1e3 * hull.volume)
    worst = float(np.mean(ious, 0).min())
    return [
        Row("hull_iou, worst view", case, worst, "1", n=len(ious)),
        Row("hull_volume_l", case, float(np.mean(volumes)), "l", n=len(volumes)),
    ]

"""`./run bench calibration`: boards in front of synthetic cameras with known truth, and real boards."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.real_recordings import uu4cam_recording
from benchmarks.synthetic.calibration_boards import BoardScene, compare_rigs, film_board, ring_of_cameras
from hypose.calibration.board_fit import board_poses, calibrate_lens
from hypose.calibration.boards import Board
from hypose.calibration.from_boards import BoardCalibration, CalibrateOptions, calibrate_from_boards
from hypose.calibration.rig import RigCalibration, calibrate_rig
from hypose.calibration.views import BoardFootage
from hypose.cameras.camera import CameraRig
from hypose.io.calibrations.calibration_formats import read_any

NOISE_PX = 0.25


def boards(options: BenchOptions) -> BenchReport:
    """Synthetic rigs of five cameras and 60 board frames with 0.25 px of noise; with data the ChArUco board of four
    webcams and the floor board of uu4cam.

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
        *_agreement(case, found.rig, given),
    ]


def _uu4cam(folder: Path, options: BenchOptions) -> list[Row]:
    """Lenses given (the clip shows one board position), places from the board clip."""
    recording = uu4cam_recording(folder)
    board = Board("chessboard", 8, 6, 0.115)
    sources = [BoardFootage(f"cam{n}", folder / f"cam{n}" / "checkerboard.avi") for n in range(1, 5)]
    found = calibrate_from_boards(sources, board, CalibrateOptions(recording.rig, progress=options.progress))
    return _real("uu4cam", found, recording.rig, board)

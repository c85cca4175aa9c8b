"""Recordings small enough to run whole commands on hundreds of times: masks, board pictures, skeletons, depth
pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.synthetic.calibration_boards import film_board, ring_of_cameras
from benchmarks.synthetic.sensors import SensorModel, simulate
from benchmarks.synthetic.skeleton_folders import write_folder
from hypose.app.jobs.checking import write_image
from hypose.app.live.simulated_sensors import builtin_joints, ring_sensors
from hypose.calibration.boards import Board
from hypose.fusion.joints import COMMON
from hypose.gestures.depth_pictures import KINECT
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.recordings.recording import Recording, ViewSettings, write_recording
from hypose.io.sensors.skeleton_files import SensorStream, SkeletonRecording
from hypose.pipeline.gesture_files import SessionWriter
from hypose.synthetic.scenes import Scene, camera_rig, make_scene
from hypose.synthetic.write_recording import board_from_sheet, board_sheet

BOARD = Board("chessboard", 6, 5, 0.12)
"""The board of `write_board_pictures`."""


def small_scene(seed: int, frames: int, motion: str = "walk") -> Scene:
    """Four cameras of 160 x 120 px around a person; 25 frames/s."""
    return make_scene(motion, "neutral", camera_rig("humaneva-4").scaled(0.25), seconds=frames / 25, seed=seed)


def write_masks(scene: Scene, folder: Path) -> Path:
    """A recording folder of the scene's masks alone (PNG): nothing to decode, so a run is little more than tracking."""
    cameras = scene.given_rig.pinhole()
    for camera in cameras:
        (folder / camera.name).mkdir(parents=True, exist_ok=True)
    for t, frame in enumerate(scene.mask_frames()):
        assert frame.silhouettes is not None
        for c, camera in enumerate(cameras):
            mask = frame.silhouettes.masks[c, : camera.size[1], : camera.size[0]]
            write_image(folder / camera.name / f"{t:05d}.png", 255 * mask)
    views = tuple(ViewSettings(c.name, {"masks": folder / c.name}) for c in cameras)
    write_recording(Recording(folder, folder.name, cameras, views, scene.frame_rate, None, keypoint_set=None), folder)
    return folder


def write_board_pictures(folder: Path, seed: int = 0, frames: int = 10, cameras: int = 2) -> Path:
    """boards/CAMERA/*.png of a chessboard that all cameras see, and lenses.toml with their true lenses."""
    rng = np.random.default_rng(seed)
    lenses = ring_of_cameras(rng, 6).pinhole()
    chosen = lenses.select(lenses.names[:cameras])
    world = film_board(chosen, BOARD, rng, 8 * frames, lying=1).boards
    sheet, to_board = board_sheet(BOARD), board_from_sheet(BOARD)
    for camera in chosen:
        (folder / "boards" / camera.name).mkdir(parents=True, exist_ok=True)
        for f, world_from_board in enumerate(world[:: max(1, len(world) // frames)][:frames]):
            camera_from_board = camera.camera_from_world @ world_from_board
            homography = camera.K @ camera_from_board[:3, [0, 1, 3]] @ to_board
            picture = cv2.warpPerspective(sheet, homography, camera.size, borderValue=110.0, flags=cv2.INTER_AREA)
            picture = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
            write_image(folder / "boards" / camera.name / f"{f:03d}.png", picture)
    write_calibration(chosen, folder / "lenses.toml")
    return folder


def write_skeletons(folder: Path, seed: int = 0, seconds: float = 8.0) -> Path:
    """A folder of the skeletons of three depth sensors around a person."""
    rng = np.random.default_rng(seed)
    joints = builtin_joints("box", seconds, rng)
    seen = simulate(joints, np.zeros(len(joints)), ring_sensors([-50, 0, 50]), rng, SensorModel(), np.zeros((0, 7)))
    streams = tuple(
        SensorStream(
            name,
            seen.times,
            seen.positions[:, k, None],
            seen.state[:, k, None],
            np.zeros((len(seen), 1), np.int64),
            COMMON,
        )
        for k, name in enumerate(seen.sensor_names)
    )
    write_folder(SkeletonRecording(folder.name, streams, streams[0].name, {}, common_clock=True), folder)
    return folder


def write_gesture_session(folder: Path, gesture: str = "pause", seed: int = 5) -> Path:
    """A recorded session of three small depth pictures of noise, each with the gesture: enough for a forest to grow
    from, not for one that finds anything."""
    rng = np.random.default_rng(seed)
    session = SessionWriter(folder, [gesture], KINECT, (32, 24))
    for n in range(3):
        session.add(n / 10, rng.integers(500, 4000, (24, 32)).astype(np.uint16), "positive", 0, 1, (16.0, 12.0))
    session.close()
    return folder

"""Boards in front of synthetic cameras: corners with noise, and how far a calibration is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hypose.calibration.boards import Board, BoardDetection
from hypose.cameras.camera import Camera, CameraRig
from hypose.geometry import Array, procrustes, se3, se3_inverse, so3_exp, so3_log, transform

_SLANT = 0.4  # cosine of the steepest view of a board that a detector still reads


@dataclass(frozen=True)
class BoardScene:
    """True cameras, world_from_board (F, 4, 4) and the noisy corners seen: per camera, by frame."""

    rig: CameraRig
    board: Board
    boards: Array
    sightings: tuple[dict[int, BoardDetection], ...]


def ring_of_cameras(
    rng: np.random.Generator, count: int = 5, radius: float = 3.2, *, fisheye: bool = False
) -> CameraRig:
    """Cameras of 640 x 480 px on a ring, looking inwards and down, each with its own lens."""
    cameras = []
    for i in range(count):
        angle = 2 * np.pi * i / count + rng.normal(0, 0.05)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), 1.6 + rng.uniform(-0.4, 0.6)])
        forward = np.array([0, 0, 1.0]) + rng.normal(0, 0.1, 3) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        f = 560 * np.exp(rng.normal(0, 0.02)) if not fisheye else 300 * np.exp(rng.normal(0, 0.02))
        k = np.array([[f, 0, 318 + rng.normal(0, 5)], [0, f * 0.997, 243 + rng.normal(0, 5)], [0, 0, 1]])
        lens = np.array([-0.28 + rng.normal(0, 0.02), 0.1, 5e-4, -3e-4, 0.0])
        if fisheye:
            lens = np.array([-0.02, 0.005, 0.0, 0.0]) + rng.normal(0, 0.002, 4)
        pose = se3(rotation, -rotation @ centre)
        cameras.append(Camera(f"cam{i + 1}", k, lens, pose, (640, 480), fisheye))
    return CameraRig(tuple(cameras))


def film_board(
    rig: CameraRig,
    board: Board,
    rng: np.random.Generator,
    frames: int = 60,
    noise_px: float = 0.25,
    *,
    lying: int = 1,
    turn: bool = False,
) -> BoardScene:
    """A board carried through the middle of the rig; the first `lying` frames on the floor, in the origin.

    turn: each camera numbers the corners in any of the ways the pattern allows, as detectors do."""
    centre = board.points.mean(0)
    poses = []
    for f in range(frames):
        if f < lying:
            # z of the board points into it, so downwards
            poses.append(se3(np.diag([1.0, -1.0, -1.0]), -np.diag([1.0, -1.0, -1.0]) @ centre))
            continue
        # facing sideways at any azimuth, tilted
        facing = rng.uniform(0, 2 * np.pi)
        up = np.deg2rad(rng.uniform(-10, 45))
        front = np.array([np.cos(facing) * np.cos(up), np.sin(facing) * np.cos(up), np.sin(up)])
        z = -front
        x = np.cross([0, 0, 1.0], z)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z], 1) @ so3_exp([0, 0, rng.normal(0, 0.5)])
        place = np.array([*rng.uniform(-0.9, 0.9, 2), rng.uniform(0.5, 1.8)])
        poses.append(se3(rotation, place - rotation @ centre))
    sightings: list[dict[int, BoardDetection]] = []
    for camera in rig:
        seen: dict[int, BoardDetection] = {}
        for f, pose in enumerate(poses):
            world = transform(pose, board.points)
            uv = camera.project(world)
            towards = camera.position - world.mean(0)
            slant = float(-pose[:3, 2] @ towards / np.linalg.norm(towards))
            inside = np.isfinite(uv).all() and (uv > 8).all() and (uv < np.array(camera.size) - 9).all()
            if inside and slant > _SLANT:
                number = rng.integers(len(board.turns)) if turn else 0
                ids = np.arange(len(uv))
                s = BoardDetection(ids, uv + rng.normal(0, noise_px, uv.shape), 2.0)
                seen[f] = s.turned(board.turns[number])
        sightings.append(seen)
    return BoardScene(rig, board, np.stack(poses), tuple(sightings))


@dataclass(frozen=True)
class RigErrors:
    """Per camera (C,), after the rigid motion (no scale) that brings the camera centres and axes together: position m,
    rotation rad; focal px: the larger of fx and fy. relative_m: positions when the first cameras' poses are laid on
    each other instead."""

    position_m: Array
    rotation_rad: Array
    focal_px: Array
    relative_m: Array


def compare_rigs(found: CameraRig, true: CameraRig) -> RigErrors:
    """How far `found` is from `true`, camera by camera in their order."""
    turns = [t.camera_from_world[:3, :3].T @ f.camera_from_world[:3, :3] for f, t in zip(found, true, strict=True)]
    turn = Rotation.from_matrix(turns).mean().as_matrix()
    if len(found) >= 3:
        # centres and axes: points half a metre before each camera count as well
        a = np.concatenate([_marks(c) for c in found])
        b = np.concatenate([_marks(c) for c in true])
        align = procrustes(a, b)[0]
    else:
        align = se3(turn, true.positions.mean(0) - turn @ found.positions.mean(0))
    moved = [f.camera_from_world @ se3_inverse(align) for f in found]
    position = np.array([np.linalg.norm(se3_inverse(m)[:3, 3] - t.position) for m, t in zip(moved, true, strict=True)])
    rotation = np.linalg.norm(
        np.stack([so3_log(m[:3, :3] @ t.camera_from_world[:3, :3].T) for m, t in zip(moved, true, strict=True)]), axis=1
    )
    focal = np.array([np.abs(np.diag(f.K)[:2] - np.diag(t.K)[:2]).max() for f, t in zip(found, true, strict=True)])
    first = se3_inverse(true[0].camera_from_world) @ found[0].camera_from_world
    relative = np.array(
        [
            np.linalg.norm(se3_inverse(f.camera_from_world @ se3_inverse(first))[:3, 3] - t.position)
            for f, t in zip(found, true, strict=True)
        ]
    )
    return RigErrors(*(np.asarray(v, dtype=np.float64) for v in (position, rotation, focal, relative)))


def _marks(camera: Camera) -> Array:
    axes = camera.camera_from_world[:3, :3]
    return np.concatenate([camera.position[None], camera.position + 0.5 * axes])

"""A scene as it is filmed: videos of a board, of the empty room and of the person, and nothing else. What a newcomer
has, to practise the whole way on it, from calibration to the motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from hypose.calibration.boards import Board
from hypose.geometry import Array, se3
from hypose.io.file_names import file_name
from hypose.io.videos.video import VideoWriter
from hypose.synthetic.board_pictures import BoardPainter
from hypose.synthetic.scenes import Image, Scene
from hypose.synthetic.write_recording import write_truth

BOARD = Board("chessboard", 9, 6, 0.08)
"""Corners and size of the board that is filmed."""
_EMPTY_S = 2.0
_STATIONS, _LYING = 28, 25
_HELD, _MOVED = (5, 10), (4, 10)
"""Places to which the board is carried; frames on the floor; frames (from, to) held in a place, and carried on."""


def write_session(scene: Scene, folder: str | Path, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write board/NAME.mp4, empty/NAME.mp4 and walk/NAME.mp4 for each camera, and truth.npz (see `write_scene`), in the
    world that the board on the floor gives: the first corner is the origin, its first row x. Returns the folder.
    progress(done, total) is called after every picture."""
    folder = Path(folder)
    write_truth(scene, folder)
    poses = carried_board(BOARD, np.random.default_rng([scene.seed, 31]))
    empty = round(_EMPTY_S * scene.frame_rate)
    total, done = len(scene.rig) * (len(poses) + empty + len(scene)), 0
    for c, camera in enumerate(scene.rig):
        w, h = (n // 2 * 2 for n in camera.size)
        for name, pictures in (
            ("board", _boards(scene, c, poses)),
            ("empty", scene.background_frames(c, empty)),
            ("walk", scene.rgb_frames(c)),
        ):
            (folder / name).mkdir(exist_ok=True)
            with VideoWriter(folder / name / f"{file_name(camera.name)}.mp4", scene.frame_rate, (w, h)) as writer:
                for picture in pictures:
                    writer.write(picture[:h, :w])
                    done += 1
                    if progress is not None:
                        progress(done, total)
    return folder


def _boards(scene: Scene, view: int, poses: Array) -> Iterator[Image]:
    """The pictures of one camera while the board is carried about."""
    painter = BoardPainter(scene.rig[view], BOARD)
    for n, pose in enumerate(poses):
        paint = partial(painter, world_from_board=pose)
        yield scene.room_frame(view, n / scene.frame_rate - 60.0, -1000 - n, paint)


def carried_board(board: Board, rng: np.random.Generator) -> Array:
    """(F, 4, 4) world_from_board of each frame: from place to place, held still in each, at last flat on the floor."""
    centre = board.points.mean(0)
    places, turns = [], []
    for _ in range(_STATIONS):
        facing, up = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(-5, 45))
        z = -np.array([np.cos(facing) * np.cos(up), np.sin(facing) * np.cos(up), np.sin(up)])  # into the board
        x = np.cross([0, 0, 1.0], z)
        x /= np.linalg.norm(x)
        upright = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], 1))
        turns.append(upright * Rotation.from_rotvec([0, 0, rng.normal(0, 0.4)]))
        places.append([*rng.uniform(-1.3, 1.3, 2), rng.uniform(0.4, 2.1)])
    lying = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    turns.append(lying)
    places.append(lying.apply(centre))
    steps = []
    for n in range(_STATIONS):
        moved = rng.integers(*_MOVED)
        steps += [float(n)] * rng.integers(*_HELD) + [n + (k + 1) / (moved + 1) for k in range(moved)]
    steps += [float(_STATIONS)] * _LYING
    path = np.array(places)
    middle = np.stack([np.interp(steps, np.arange(len(path)), path[:, k]) for k in range(3)], 1)
    rotation = Slerp(np.arange(len(path)), Rotation.concatenate(turns))(steps)
    return np.stack([se3(r.as_matrix(), m - r.apply(centre)) for r, m in zip(rotation, middle, strict=True)])

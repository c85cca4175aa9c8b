"""Write a scene as a recording folder, as a user would have it: videos, background clips, calibration, key points."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from hypose.body.default_body import JOINT_NAMES
from hypose.calibration.boards import Board
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.evidence.keypoints import openpose_document
from hypose.geometry import Array, Image, se3, transform, unit
from hypose.io.files import atomic_path, file_name, write_text
from hypose.io.recordings.recording import Recording, ViewSettings, write_recording
from hypose.io.sensors.depth import write_depth_png
from hypose.io.videos.video import writing_video
from hypose.synthetic.depth_scenes import DepthScene, depth_rig, depth_scene, to_profile, turning
from hypose.synthetic.render_rgb import LIGHT
from hypose.synthetic.scenes import Scene, keypoint_detections, make_scene

# Function that is called with the numbers of steps done and in total.
_Progress = Callable[[int, int], None]


def check_folder(folder: Path) -> None:
    """Raise InputError where a recording cannot be written to the folder because something else is there.

    A folder that `write_scene` has begun is allowed, and is written again.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder.")
    if folder.is_dir() and not (folder / "truth.npz").is_file():
        if any(not p.name.startswith(".") for p in folder.iterdir()):
            raise InputError(f"The folder {folder} holds other files; give an empty or new folder.")


def write_truth(scene: Scene | DepthScene, folder: Path) -> None:
    """Write truth.npz: times (T,) s, joints (T, 19, 3) m, rotations (T, 19, 3, 3), joint_names, stature m.

    Write it first, because `check_folder` recognises an unfinished folder by it.
    """
    with atomic_path(folder / "truth.npz") as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            times=scene.times,
            joints=scene.joints,
            rotations=scene.rotations,
            joint_names=np.array(JOINT_NAMES),
            stature=np.array(scene.subject.stature),
        )


def write_scene(
    scene: Scene,
    folder: str | Path,
    *,
    background_frames: int = 25,
    keypoints: bool = False,
    progress: _Progress = lambda done, total: None,
) -> Path:
    """Write a scene to a folder as a recording.

    scene: the scene.
    folder: gets videos/NAME.mp4 and background/NAME.mp4 per camera (width and height even, the calibration to match),
        calibration.toml with the rig that the user has, recording.toml and truth.npz.
    background_frames: number of pictures of the empty room per camera.
    keypoints: whether to write pose/NAME_json/ with one OpenPose BODY_25 file per frame.
    progress(done, total): called after every picture.
    Returns: path of recording.toml.
    """
    folder = Path(folder)
    write_truth(scene, folder)
    for sub in ("videos", "background"):
        (folder / sub).mkdir(exist_ok=True)
    rig = CameraRig(tuple(_even(c) for c in scene.given_rig))
    step = _counter(progress, len(rig) * (len(scene) + background_frames))
    views = []
    for c, camera in enumerate(rig):
        size = camera.size
        name = file_name(camera.name)
        video, background = folder / "videos" / f"{name}.mp4", folder / "background" / f"{name}.mp4"
        for path, pictures in (
            (background, iter(scene.background_frames(c, background_frames))),
            (video, scene.rgb_frames(c)),
        ):
            _write_video(path, scene.frame_rate, size, pictures, step)
        files = {"video": video, "background": background}
        if keypoints:
            files["keypoints"] = pose = folder / "pose" / f"{name}_json"
            pose.mkdir(parents=True, exist_ok=True)
            points = keypoint_detections(scene, c)
            for t, people in enumerate(points):
                document = openpose_document(people[None])
                write_text(pose / f"{name}_{t:012d}_keypoints.json", json.dumps(document))
        views.append(ViewSettings(camera.name, files))
    recording = Recording(
        folder,
        scene.name,
        rig,
        tuple(views),
        scene.frame_rate,
        None,
        keypoint_set="BODY_25" if keypoints else None,
        n_frames=len(scene),
    )
    return write_recording(recording, folder)


def _counter(progress: _Progress, total: int) -> Callable[[], None]:
    """Make a function that reports one more step of `total` at each call."""
    done = itertools.count(1)
    return lambda: progress(next(done), total)


def _write_video(
    path: Path, frame_rate: float, size: tuple[int, int], pictures: Iterable[Image], step: Callable[[], None]
) -> None:
    """Write pictures as a video.

    path: path of the file.
    frame_rate: Hz.
    size: (width, height) px, to which pictures are cut.
    pictures: (h, w, 3) BGR.
    step: called after each picture.
    """
    with writing_video(path, frame_rate, size) as writer:
        for picture in pictures:
            writer.write(picture[: size[1], : size[0]])
            step()


def _even(camera: Camera) -> Camera:
    """Cut off the last row or column of a camera with odd sides, because videos need even ones."""
    return replace(camera, size=(camera.size[0] // 2 * 2, camera.size[1] // 2 * 2))


EMPTY_FRAMES = 20


def walking_scene(
    motion: str, subject: str, sensors: str, *, seconds: float, frame_rate: float, seed: int, clothing_m: float = 0.02
) -> DepthScene:
    """Make a scene of a built-in motion in front of depth sensors, by a subject who turns to both profiles.

    motion: a name of motions.MOTIONS.
    subject: name of the subject ("": chosen by the seed).
    sensors: name of the rig (`depth_rig`).
    seconds, frame_rate: s and Hz.
    seed: seed of all random numbers.
    clothing_m: thickness of the clothes, m.
    """
    scene = make_scene(motion, subject, seconds=seconds, frame_rate=frame_rate, seed=seed, clothing_m=clothing_m)
    heading = to_profile(len(scene), seed)
    return depth_scene(turning(scene.performance, scene.subject, heading), scene.subject, depth_rig(sensors), seed=seed)


def write_depth_scene(scene: DepthScene, folder: str | Path, progress: _Progress = lambda done, total: None) -> Path:
    """Write a scene of depth sensors to a folder as a recording.

    folder: gets depth/NAME/ and background/NAME/ with 16-bit PNG in millimetres, calibration.toml, recording.toml and
        truth.npz.
    progress(done, total): called after every map.
    Returns: path of recording.toml.
    """
    folder = Path(folder)
    write_truth(scene, folder)
    step = _counter(progress, len(scene.rig) * (len(scene) + EMPTY_FRAMES))
    views = []
    for c, camera in enumerate(scene.rig):
        depth, empty = folder / "depth" / camera.name, folder / "background" / camera.name
        for target, count, make in ((empty, EMPTY_FRAMES, scene.empty_map), (depth, len(scene), scene.depth_map)):
            target.mkdir(parents=True, exist_ok=True)
            for t in range(count):
                write_depth_png(target / f"{t:06d}.png", make(c, t))
                step()
        views.append(ViewSettings(camera.name, {"depth": depth, "background": empty}))
    recording = Recording(
        folder, scene.name, scene.rig, tuple(views), scene.frame_rate, None, keypoint_set=None, n_frames=len(scene)
    )
    return write_recording(recording, folder)


# ---- film session ----------------------------------------------------------------------------------------------------
# A scene as it is filmed: videos of a board, of the empty room and of the person, and nothing else. A newcomer can
# practise the whole procedure on it, from calibration to the motion.


SQUARE_PX = 40
_RIM = 1  # squares of white paper around the pattern
_FINE = 3  # rays per pixel and axis


def board_sheet(board: Board) -> NDArray[np.float32]:
    """Draw a board as grey levels (h, w), SQUARE_PX pixels per square, with a white rim of one square."""
    cells = (np.indices((board.rows + 1, board.columns + 1)).sum(0) % 2) * 210.0 + 20
    inner = np.kron(cells, np.ones((SQUARE_PX, SQUARE_PX)))
    return np.pad(inner, _RIM * SQUARE_PX, constant_values=235.0).astype(np.float32)


def board_from_sheet(board: Board) -> Array:
    """Compute the transform (3, 3) from the sheet's pixels to the board's metres; the origin is the
    first inner corner.
    """
    scale = board.square / SQUARE_PX
    shift = -(1 + _RIM) * board.square + 0.5 * scale
    return np.array([[scale, 0, shift], [0, scale, shift], [0, 0, 1]])


@dataclass(frozen=True)
class BoardPainter:
    """Painter that draws a board into pictures of one camera with its lens; nothing else may be in front of the board.

    camera: the camera.
    board: the board; its back is plain cardboard.
    """

    camera: Camera
    board: Board

    def __call__(self, picture: NDArray[np.float32], world_from_board: Array) -> None:
        """Draw the board at a pose (4, 4) into a picture (h, w, 3), in place."""
        h, w = self._sheet.shape
        rim = np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]]) - 0.5
        flat = np.c_[rim, np.ones(len(rim))] @ board_from_sheet(self.board).T
        uv = self.camera.project(transform(world_from_board, np.c_[flat[:, :2], np.zeros(len(flat))]))
        if not np.isfinite(uv).all():
            return  # behind the camera
        low, high = np.floor(uv.min(0)).astype(int) - 3, np.ceil(uv.max(0)).astype(int) + 4
        (x0, y0), (x1, y1) = np.maximum(low, 0), np.minimum(high, self.camera.size)
        if x0 >= x1 or y0 >= y1:
            return
        camera_from_board = self.camera.camera_from_world @ world_from_board
        homography = self.camera.K @ camera_from_board[:3, [0, 1, 3]] @ board_from_sheet(self.board)
        fine = cv2.resize(self._ideal[y0:y1, x0:x1], None, fx=_FINE, fy=_FINE, interpolation=cv2.INTER_LINEAR)
        at = cv2.perspectiveTransform(np.asarray(fine), np.linalg.inv(homography))
        covered = np.asarray(((at > -0.5) & (at < (w - 0.5, h - 0.5))).all(-1), dtype=np.float32)
        front = float(camera_from_board[:3, 2] @ camera_from_board[:3, 3]) > 0  # its z points into it
        x, y = (np.ascontiguousarray(at[..., k], dtype=np.float32) for k in range(2))
        seen = cv2.remap(self._sheet, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        normal = world_from_board[:3, 2] * (-1 if front else 1)
        light = 0.6 + 0.4 * max(0.0, float(normal @ LIGHT))
        grey = np.asarray(seen if front else np.full_like(covered, 120.0), dtype=np.float32)
        lit = covered * grey * np.float32(light)
        size = (x1 - x0, y1 - y0)
        part = cv2.resize(covered, size, interpolation=cv2.INTER_AREA)[..., None]
        tone = cv2.resize(lit, size, interpolation=cv2.INTER_AREA)[..., None]
        picture[y0:y1, x0:x1] = (1 - part) * picture[y0:y1, x0:x1] + tone

    @cached_property
    def _sheet(self) -> NDArray[np.float32]:
        return board_sheet(self.board)

    @cached_property
    def _ideal(self) -> NDArray[np.float32]:
        """(h, w, 2) pixel at which a camera without distortion sees what each pixel sees."""
        w, h = self.camera.size
        grid = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1)
        return self.camera.undistort_points(grid).astype(np.float32)


BOARD = Board("chessboard", 9, 6, 0.08)
"""The board that is filmed: corners, and size of a square in m."""
_EMPTY_S = 2.0
_STATIONS, _LYING = 28, 25
# Constants of the carried board. _STATIONS: number of places to which it is carried. _LYING: number of frames on the
# floor. _HELD: least and largest number of frames in a place. _MOVED: least and largest number of frames between two
# places.
_HELD, _MOVED = (5, 10), (4, 10)


def write_session(scene: Scene, folder: str | Path, *, progress: _Progress = lambda done, total: None) -> Path:
    """Write the videos of a film session: a carried board, the empty room, and the person.

    scene: the scene.
    folder: gets board/NAME.mp4, empty/NAME.mp4 and walk/NAME.mp4 for each camera, and truth.npz.
    progress(done, total): called after every picture.
    Returns: the folder.

    The world is that of the board on the floor: its first corner is the origin, its first row the x axis.
    """
    folder = Path(folder)
    write_truth(scene, folder)
    poses = carried_board(BOARD, np.random.default_rng([scene.seed, 31]))
    empty = round(_EMPTY_S * scene.frame_rate)
    step = _counter(progress, len(scene.rig) * (len(poses) + empty + len(scene)))
    for c, camera in enumerate(scene.rig):
        painter = BoardPainter(camera, BOARD)
        boards = (
            scene.room_frame(c, n / scene.frame_rate - 60.0, -1000 - n, partial(painter, world_from_board=pose))
            for n, pose in enumerate(poses)
        )
        for name, pictures in (
            ("board", boards),
            ("empty", scene.background_frames(c, empty)),
            ("walk", scene.rgb_frames(c)),
        ):
            (folder / name).mkdir(exist_ok=True)
            path = folder / name / f"{file_name(camera.name)}.mp4"
            _write_video(path, scene.frame_rate, _even(camera).size, pictures, step)
    return folder


def carried_board(board: Board, rng: np.random.Generator) -> Array:
    """Make the poses world_from_board (F, 4, 4) of a carried board: held still in each place, at last flat on the
    floor.
    """
    centre = board.points.mean(0)
    places, turns = [], []
    for _ in range(_STATIONS):
        facing, up = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(-5, 45))
        z = -np.array([np.cos(facing) * np.cos(up), np.sin(facing) * np.cos(up), np.sin(up)])  # into the board
        x = unit(np.cross([0, 0, 1.0], z))
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

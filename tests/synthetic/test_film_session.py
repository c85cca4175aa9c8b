"""A scene as it is filmed: the board where it should be in the picture, carried about and laid on the floor."""

import numpy as np
import pytest

from hypose.calibration.boards import make_detector
from hypose.geometry import se3, so3_exp, transform
from hypose.io.videos.video import open_video
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import BOARD, BoardPainter, write_session


@pytest.fixture(scope="module")
def scene():
    return make_scene("walk", "neutral", camera_rig("humaneva-4", distorted=True), seconds=0.08, seed=3)


def test_corners_are_seen_where_the_lens_puts_them(scene):
    camera = scene.rig[1]
    axes = camera.camera_from_world[:3, :3].T @ so3_exp([0.3, -0.4, 0.2])
    pose = se3(axes, np.array([0.2, -0.1, 1.1]) - axes @ BOARD.points.mean(0))
    picture = scene.room_frame(1, 0.0, -5, lambda p: BoardPainter(camera, BOARD)(p, pose))
    found = make_detector(BOARD)(picture.mean(2).astype(np.uint8))
    truth = camera.project(transform(pose, BOARD.points))
    nearest = np.linalg.norm(found.pixels[:, None] - truth, axis=-1).min(1)
    assert len(found.pixels) == len(truth) and nearest.max() < 0.2


def test_a_session_is_videos_and_the_truth(tmp_path):
    small = make_scene("walk", "neutral", camera_rig("ring-1").scaled(0.2), seconds=0.08, seed=3)
    write_session(small, tmp_path)
    lengths = {}
    for name in ("board", "empty", "walk"):
        with open_video(tmp_path / name / f"{small.rig[0].name}.mp4") as video:
            lengths[name] = video.n_frames
    assert lengths["walk"] == 2 and lengths["empty"] == 50 and lengths["board"] > 300
    assert {p.name for p in tmp_path.iterdir()} == {"board", "empty", "walk", "truth.npz"}

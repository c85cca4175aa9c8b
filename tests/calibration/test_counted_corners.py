"""The corners of a chessboard are counted in its pictures."""

import cv2
import numpy as np
import pytest

from hypose.calibration.views import BoardFootage, count_corners
from hypose.errors import CalibrationError
from tests.calibration.painted_boards import paint
from tests.calibration.test_from_boards import BOARD, board_poses, make_rig


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    base = tmp_path_factory.mktemp("photos")
    for camera in list(make_rig())[:2]:
        (base / camera.name).mkdir()
        for f, pose in enumerate(board_poses(4)):
            cv2.imwrite(str(base / camera.name / f"{f}.png"), paint(BOARD, camera, pose))
    return base


def test_corners_are_counted(photos):
    sources = [BoardFootage(p.name, p) for p in sorted(photos.iterdir())]
    assert count_corners(sources) == (max(BOARD.size), min(BOARD.size))


def test_pictures_without_a_board_say_what_to_do(tmp_path):
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((120, 160, 3), 90, np.uint8))
    with pytest.raises(CalibrationError, match="--chessboard COLUMNSxROWS"):
        count_corners([BoardFootage("cam1", tmp_path)])

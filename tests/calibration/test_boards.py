"""Boards: numbering, accuracy of corners on painted pictures, overexposure, oblique far boards, bad boards."""

import numpy as np
import pytest

from hypose.calibration.boards import Board, make_detector
from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.geometry import se3, so3_exp
from tests.calibration.painted_boards import paint, texture

CHESS = Board("chessboard", 7, 5, 0.04)
CHARUCO = Board("charuco", 5, 4, 0.05, 0.037)


def camera(f=600.0, size=(640, 480)):
    k = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1.0]])
    return Camera("cam", k, np.zeros(5), np.eye(4), size)


def pose(board, tilt, distance):
    r = so3_exp(tilt)
    return se3(r, np.array([0.02, -0.01, distance]) - r @ board.points.mean(0))


def gray(picture):
    return np.ascontiguousarray(picture[..., 0])


@pytest.mark.parametrize("board", [CHESS, CHARUCO, Board("charuco", 4, 5, 0.05, 0.03, inverted=True)])
@pytest.mark.parametrize("tilt", [[0.1, 0.2, 0.0], [-0.5, 0.3, 0.4], [0.2, -0.7, 2.5]])
def test_corners_are_found_with_their_numbers(board, tilt, rng):
    where = pose(board, tilt, 0.7)
    s = make_detector(board)(gray(paint(board, camera(), where, rng)))
    assert s is not None
    true = camera().project(board.points @ where[:3, :3].T + where[:3, 3])
    turned = [turn[s.ids] for turn in board.turns]
    error = min((s.pixels - true[ids] for ids in turned), key=lambda e: np.abs(e).max())
    if board is CHARUCO:
        assert len(s.ids) >= 6
    assert np.sqrt(np.mean(error**2)) < (0.05 if board.kind == "chessboard" else 0.15)
    assert 1.5 < s.edge_px < 3.5


def test_overexposed_small_oblique_board(rng):
    """White that has grown leaves gaps at the corners, along which edge-based refinement slides."""
    board = Board("chessboard", 8, 6, 0.115)
    cam = camera(480)
    where = pose(board, [1.05, 0.2, 0.6], 4.2)
    picture = paint(board, cam, where, rng, sheet=texture(board, grow=6))
    s = make_detector(board)(gray(picture))
    assert s is not None
    true = cam.project(board.points @ where[:3, :3].T + where[:3, 3])
    error = min((s.pixels - true[turn] for turn in board.turns), key=lambda e: np.abs(e).max())
    assert np.sqrt(np.mean(error**2)) < 0.15


def test_no_board_is_found_where_there_is_none(rng):
    noise = rng.integers(0, 255, (300, 400)).astype(np.uint8)
    for board in (CHESS, CHARUCO):
        assert make_detector(board)(noise) is None
        assert make_detector(board)(np.zeros((120, 160), np.uint8)) is None


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (("chessboard", 2, 6, 0.1), "3 to 100 inner corners"),
        (("chessboard", 8, 6, 115.0), "give 1 mm to 5 m, with the unit"),
        (("charuco", 5, 4, 0.05, 0.06), "must be smaller than the squares"),
        (("charuco", 5, 4, 0.05, 0.03, "DICT_9X9"), "is not known; the dictionaries are DICT"),
    ],
)
def test_impossible_boards_are_refused(fields, message):
    with pytest.raises(InputError, match=message):
        Board(*fields)


def test_too_few_markers_in_the_dictionary():
    with pytest.raises(InputError, match="has 50 markers, a board of 20 x 20 squares needs 200"):
        make_detector(Board("charuco", 20, 20, 0.05, 0.03, "DICT_4X4_50"))

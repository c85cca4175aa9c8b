"""From painted pictures to a rig: files, lenses, floors, and what is said when boards are not found."""

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.calibration_boards import compare_rigs
from hypose.calibration.boards import Board
from hypose.calibration.from_boards import BoardsNotFound, CalibrateOptions, calibrate_from_boards
from hypose.calibration.views import BoardFootage, count_corners, diagnose, find_sources, look_for_board
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import se3, so3_exp
from tests.calibration.painted_boards import paint

BOARD = Board("chessboard", 6, 5, 0.06)
SIZE = (320, 240)


def make_rig():
    cameras = []
    for i, angle in enumerate((-0.5, 0.0, 0.5)):
        centre = np.array([1.6 * np.sin(angle), -1.6 * np.cos(angle), 1.0])
        forward = np.array([0, 0, 0.35]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        r = np.stack([right, np.cross(forward, right), forward])
        k = np.array([[330.0, 0, 160], [0, 330, 118], [0, 0, 1]])
        cameras.append(Camera(f"cam{i + 1}", k, np.zeros(5), se3(r, -r @ centre), SIZE))
    return CameraRig(tuple(cameras))


def board_poses(count):
    """The first lies on the floor, the others are held towards the cameras."""
    rng = np.random.default_rng(3)
    down = np.diag([1.0, -1.0, -1.0])
    out = [se3(down, -down @ BOARD.points.mean(0))]
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    for _ in range(count - 1):
        r = upright @ so3_exp([rng.uniform(-0.7, 0.2), rng.uniform(-0.6, 0.6), rng.normal(0, 0.3)])
        out.append(se3(r, np.array([*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.3, 0.7)]) - r @ BOARD.points.mean(0)))
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three folders of 14 photos; a dark, a blurred and an empty one among those of cam3."""
    base = tmp_path_factory.mktemp("boards")
    rng = np.random.default_rng(1)
    for camera in make_rig():
        (base / camera.name).mkdir()
        for f, pose in enumerate(board_poses(14)):
            picture = paint(BOARD, camera, pose, rng)
            if camera.name == "cam3" and f == 5:
                picture = np.full_like(picture, 8)
            if camera.name == "cam3" and f == 6:
                picture = cv2.GaussianBlur(picture, (0, 0), 4)
            if camera.name == "cam3" and f == 7:
                picture = np.full_like(picture, 110)
            cv2.imwrite(str(base / camera.name / f"{f:03d}.png"), picture)
    return base


@pytest.fixture(scope="module")
def result(folder):
    return calibrate_from_boards(find_sources([folder]), BOARD, CalibrateOptions(floor=0))


def test_photos_to_rig(result):
    rig = make_rig()
    assert result.rig.names == rig.names
    assert result.fit.rms_px < 0.1
    errors = compare_rigs(result.rig, rig)
    assert errors.focal_px.max() < 3
    assert errors.position_m.max() < 0.015
    # the floor: heights over the lying board are right
    np.testing.assert_allclose(result.rig.positions[:, 2], rig.positions[:, 2], atol=0.03)
    assert "The floor is where the board lies in frame 0" in result.notes[-1]


def test_why_pictures_show_no_board(result):
    third = result.views[2]
    assert third.looks[5].reason == "too dark"
    assert third.looks[6].reason == "blurred"
    assert third.looks[7].reason in ("no board found", "blurred")
    assert "the board was found in" in third.summary() and "1 x too dark" in third.summary()
    assert 0.2 < third.coverage <= 1


@pytest.mark.slow
def test_wrong_pattern_size_is_named(folder):
    wrong = Board("chessboard", 7, 6, 0.06)
    sources = [BoardFootage("cam2", folder / "cam2")]
    with pytest.raises(
        BoardsNotFound, match=r"a chessboard of 6 x 5 inner corners was seen instead.*count the corners"
    ):
        calibrate_from_boards(sources, wrong)


@pytest.mark.slow
def test_other_markers_are_named(tmp_path):
    shown = Board("charuco", 6, 5, 0.06, 0.045, "DICT_5X5_1000")
    camera = make_rig()[1]
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    pose = se3(upright, np.array([0, 0, 0.45]) - upright @ shown.points.mean(0))
    big = Camera("c", camera.K * [[2, 1, 2], [1, 2, 2], [1, 1, 1]], np.zeros(5), camera.camera_from_world, (640, 480))
    picture = paint(shown, big, pose)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    cv2.imwrite(str(tmp_path / "m.png"), picture[:, ::-1])
    for file, asked, words in (
        ("a.png", Board("charuco", 6, 5, 0.06, 0.045, "DICT_4X4_1000"), "another dictionary, DICT_5X5_1000"),
        ("a.png", Board("charuco", 5, 6, 0.06, 0.045, "DICT_5X5_1000"), "columns and rows exchanged"),
        ("m.png", shown, "mirrored"),
        ("a.png", Board("charuco", 6, 5, 0.06, 0.045, "DICT_5X5_1000", inverted=True), "black on white"),
    ):
        (view,) = look_for_board([BoardFootage("c", tmp_path / file)], asked)
        assert not view.sightings
        assert words in diagnose(view, asked)


def test_corners_are_counted_and_pictures_without_a_board_say_what_to_do(folder, tmp_path):
    assert count_corners([BoardFootage("cam2", folder / "cam2")]) == (max(BOARD.size), min(BOARD.size))
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((120, 160, 3), 90, np.uint8))
    with pytest.raises(CalibrationError, match="--chessboard COLUMNSxROWS"):
        count_corners([BoardFootage("cam1", tmp_path)])


def test_sources(folder, tmp_path):
    assert [s.name for s in find_sources([folder])] == ["cam1", "cam2", "cam3"]
    assert [s.name for s in find_sources([folder / "cam1", folder / "cam2"])] == ["cam1", "cam2"]
    (tmp_path / "a.txt").write_text("x")
    for wrong, words in (
        ("none", "does not exist"),
        ("", "holds no board videos"),
        ("a.txt", "is neither a video nor"),
    ):
        with pytest.raises(InputError, match=words):
            find_sources([tmp_path / wrong])


@pytest.mark.slow
def test_real_floor_board(shared_data):
    """Four cameras, one lying board of 20 x 10 px per square, overexposed, the same turned by 180 degrees."""
    from benchmarks.multiview.real_recordings import uu4cam_recording

    data = shared_data("uu4cam")
    given = uu4cam_recording(data).rig
    board = Board("chessboard", 8, 6, 0.115)
    sources = [BoardFootage(f"cam{n}", data / f"cam{n}" / "checkerboard.avi") for n in range(1, 5)]
    found = calibrate_from_boards(sources, board, CalibrateOptions(lenses=given, max_frames=12))
    assert found.fit.rms_px < 0.2
    errors = compare_rigs(found.rig, given)
    assert np.rad2deg(errors.rotation_rad).max() < 3  # numbered the right way round
    assert sum("decided by the floor" in n for n in found.notes) == 3
    np.testing.assert_allclose(found.rig.positions[:, 2], [1.4, 1.42, 1.36, 1.37], atol=0.05)

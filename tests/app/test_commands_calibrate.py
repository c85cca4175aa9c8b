"""`hypose calibrate`: boards to a file and a contact sheet, conversion, measured points, and errors in one sentence."""

import cv2
import numpy as np
import pytest

from hypose.app.commands.commands_calibrate import parse_length
from hypose.errors import InputError
from hypose.io.calibrations.calibration_formats import read_any, write_calibration
from tests.app.conftest import fails
from tests.calibration.painted_boards import paint
from tests.calibration.test_from_boards import BOARD, board_poses, make_rig


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    base = tmp_path_factory.mktemp("pictures")
    for camera in make_rig():
        (base / camera.name).mkdir()
        for f, pose in enumerate(board_poses(4)):
            cv2.imwrite(str(base / camera.name / f"{f}.png"), paint(BOARD, camera, pose))
    write_calibration(make_rig(), base / "lenses.toml")
    return base


def test_boards(hypose, pictures, tmp_path):
    board = ("--chessboard", "6x5", "--square", "6cm", "--intrinsics", pictures / "lenses.toml", "--floor", 0)
    code, said, err = hypose("calibrate", pictures, *board, "--out", tmp_path / "rig.toml")
    assert code == 0 and "Joint fit of all boards" in said and str(tmp_path / "rig.toml") in said, err
    assert read_any(tmp_path / "rig.toml")[0].names == ("cam1", "cam2", "cam3")
    sheet = cv2.imread(str(tmp_path / "rig.png"))
    assert sheet is not None and sheet.shape[1] == 1560 and sheet.std() > 10


def test_a_board_that_is_not_found_leaves_a_sheet(hypose, pictures, tmp_path):
    board = ("--chessboard", "9x8", "--square", "60mm", "--out", tmp_path / "a.toml")
    refused = hypose("calibrate", pictures / "cam1", *board)
    fails(refused, "No chessboard of 9 x 8 inner corners", "What was seen is in")
    assert (tmp_path / "a.png").is_file() and not (tmp_path / "a.toml").exists()


def test_conversion(hypose, pictures, tmp_path):
    assert hypose("calibrate", "--convert", pictures / "lenses.toml", "--out", tmp_path / "x.toml")[0] == 0
    np.testing.assert_allclose(read_any(tmp_path / "x.toml")[0].positions, make_rig().positions, atol=1e-9)
    code, _, err = hypose("calibrate", "--convert", pictures / "lenses.toml", "--out", tmp_path / "extri.yml")
    assert code == 2 and "name the calibration .toml" in err


def test_points(hypose, pictures, tmp_path):
    rig = make_rig()
    places = {"a": [0, 0, 0], "b": [0.5, 0, 0], "c": [0, 0.5, 0], "d": [0.1, 0.1, 0.7], "e": [-0.4, 0.2, 0.4]}
    lines = ["[points]", *(f"{n} = {p}" for n, p in places.items())]
    for camera in rig:
        lines += [f"[clicks.{camera.name}]", *(f"{n} = {camera.project(p).tolist()}" for n, p in places.items())]
    (tmp_path / "p.toml").write_text("\n".join(lines))
    given = ("--points", tmp_path / "p.toml", "--intrinsics", pictures / "lenses.toml", "--out", tmp_path / "o.toml")
    code, said, _ = hypose("calibrate", *given)
    assert code == 0 and "Fit of the points: 0.00 px rms" in said
    np.testing.assert_allclose(read_any(tmp_path / "o.toml")[0].positions, rig.positions, atol=1e-4)


@pytest.mark.parametrize(("text", "metres"), [("115mm", 0.115), ("4.5 cm", 0.045), ("1in", 0.0254), (".1m", 0.1)])
def test_lengths(text, metres):
    assert parse_length(text, "--square") == pytest.approx(metres)
    with pytest.raises(InputError, match="write a number with its unit"):
        parse_length("12", "--square")


def test_lenses_of_unknown_pictures_are_refused(hypose, tmp_path):
    """A file that does not say how large its pictures are: the size would have to be guessed."""
    (tmp_path / "lens.yml").write_text(
        "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 900., 0., 640., 0., 900., 360., 0., 0., 1. ]\n"
    )
    (tmp_path / "points.toml").write_text("[points]\n")
    given = ("--points", tmp_path / "points.toml", "--intrinsics", tmp_path / "lens.yml", "--out", tmp_path / "c.toml")
    no_size = "--intrinsics: lens.yml does not say how large the images of lens are, and lenses fit only pictures"
    fails(hypose("calibrate", *given), no_size, "add the size")
    assert not (tmp_path / "c.toml").exists()

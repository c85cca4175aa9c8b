"""Sentences that lead to the next step: wrong units, exchanged colours, guessed sizes, empty results, names."""

from dataclasses import replace

import cv2
import pytest

from benchmarks.robustness.small_recordings import write_skeletons
from hypose.calibration.boards import Board
from hypose.calibration.views import Source, diagnose, look_for_board
from hypose.errors import InputError
from hypose.gestures.model import check_gesture_name
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.motions.results import load_motion, save_motion


def said(result):
    code, _, err = result
    assert code == 2 and "Traceback" not in err, err
    return err[err.index("error: ") :].strip()


def test_milliseconds_are_not_taken_for_seconds(hypose, tmp_path):
    folder = write_skeletons(tmp_path / "rec", seconds=1.0)
    rows = [line.split(",") for line in (folder / "frames.csv").read_text().splitlines()]
    late = [rows[0], *([s, n, f"{1000 * float(t):.1f}"] for s, n, t in rows[1:])]
    (folder / "frames.csv").write_text("\n".join(map(",".join, late)) + "\n")
    sentence = said(hypose("fuse", folder))
    assert "the frames of the sensor sensor0 lie 33.3 s apart, and times are seconds" in sentence
    assert "divide milliseconds by 1000" in sentence


@pytest.mark.parametrize(("inverted", "advice"), [(False, "give --inverted"), (True, "leave --inverted out")])
def test_exchanged_colours_name_the_option(tmp_path, inverted, advice):
    board = Board("charuco", 5, 7, 0.04, 0.03, "DICT_4X4_1000")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    sheet = cv2.aruco.CharucoBoard((5, 7), 0.04, 0.03, dictionary).generateImage((500, 700), marginSize=40)
    (tmp_path / "cam1").mkdir()
    cv2.imwrite(str(tmp_path / "cam1" / "0.png"), sheet if inverted else 255 - sheet)
    wrong = replace(board, inverted=inverted)
    (views,) = look_for_board([Source("cam1", tmp_path / "cam1")], wrong)
    assert not views.sightings and advice in diagnose(views, wrong)


def test_a_guessed_size_of_a_lens_says_how_to_give_it(tmp_path):
    matrix = (
        '<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>{}</data></camera_matrix>'
    )
    text = f"<opencv_storage>{matrix.format('600 0 320 0 600 240 0 0 1')}%s</opencv_storage>"
    (tmp_path / "cam.xml").write_text(text % "")
    rig, notes = read_any(tmp_path / "cam.xml")
    assert rig[0].size == (640, 480)
    assert "640 x 480 px, twice the principal point, is assumed" in " ".join(notes)
    assert "add image_width and image_height" in " ".join(notes)
    (tmp_path / "cam.xml").write_text(text % "<image_width>648</image_width><image_height>486</image_height>")
    rig, notes = read_any(tmp_path / "cam.xml")
    assert rig[0].size == (648, 486) and "assumed" not in " ".join(notes)


def test_a_result_of_no_frames_has_no_report(hypose, tracked, tmp_path):
    motion = load_motion(tracked / "motion.npz")
    fields = ("times", "poses", "joints", "joint_covariance", "lost", "extrapolated", "n_views", "cost", "doubtful")
    fields += ("p_wrong", "doubtful_joints", "angle_sd", "systematic_covariance", "rivals", "rival_weights")
    none = {name: v[:0] for name in fields if (v := getattr(motion, name)) is not None}
    save_motion(replace(motion, **none), tmp_path / "motion.npz")
    assert "no frames" in said(hypose("report", tmp_path / "motion.npz"))
    assert "no frames" in said(hypose("report", tmp_path)) and not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("name", ["--flag", "-rf", "", "a b", "../x", "x" * 65, "a\x1b"])
def test_a_gesture_is_no_option_of_a_command(hypose, tmp_path, name):
    with pytest.raises(InputError, match="is no name for a gesture"):
        check_gesture_name(name)
    for command in ("record", "train"):
        assert "no - in front" in said(hypose("gesture", command, tmp_path / "out.npz", f"--gesture={name}"))
    assert not list(tmp_path.iterdir())


def test_names_of_gestures():
    for name in ("tee", "ok-2", "_x", "Größe"):
        check_gesture_name(name)

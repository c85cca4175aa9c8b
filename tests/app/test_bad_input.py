"""Every input a user can spoil ends in one sentence that names it and the next step, exit code 2, and no traceback."""

import io
import json
import re
import shutil
import zipfile

import numpy as np
import pytest

from hypose.app.commands import commands_data
from tests.app.conftest import fails


def replace_in(path, old, new):
    text = path.read_text()
    assert re.search(old, text), text
    path.write_text(re.sub(old, new, text, count=1))


def test_missing_video(hypose, recording):
    (recording / "videos" / "cam2.mp4").unlink()
    fails(hypose("track", recording), "cam2", "does not exist", "correct the path")


def test_empty_silhouettes(hypose, recording):
    for name in ("cam1", "cam2", "cam3", "cam4"):
        shutil.copy(recording / "background" / f"{name}.mp4", recording / "videos" / f"{name}.mp4")
    fails(hypose("track", recording), "silhouettes in at least two views", "hypose silhouettes")


def test_nan_in_the_calibration(hypose, recording):
    replace_in(recording / "calibration.toml", r"translation = \[[^,]*,", "translation = [nan,")
    fails(hypose("track", recording), "calibration.toml, camera cam1: translation contains NaN", "calibrate again")


def test_foreign_json_among_the_key_points(hypose, recording):
    folder = recording / "pose"
    folder.mkdir()
    for t in range(8):
        (folder / f"{t:06d}.json").write_text(json.dumps({"cats": [1, 2, 3]}))
    replace_in(recording / "recording.toml", r"\[\[view\]\]\n", '[[view]]\nkeypoints = "pose"\n')
    fails(hypose("track", recording, "--evidence", "both"), "pose is not a file or folder of key points of OpenPose")


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (("--recipe", "hfp"), ("--recipe hfp is not possible", "default, sir, apf")),
        (("--start", "sitting"), ("There is no start 'sitting'", "hands-up")),
        (("--evidence", "depth"), ("--evidence depth", "keypoints")),
        (("--evidence", "keypoints"), ("key points",)),
        (("--start", "keypoints"), ("needs key points", "hull")),
        (("--frames", "5:99"), ("lies outside the recording", "0 to 7", "at most 0:8")),
        (("--frames", "three"), ("--frames three is no range", "0:100")),
        (("--formats", "trc,fbx"), ("There is no export format 'fbx'", "trc, c3d, bvh, glb")),
        (("--formats", ","), ("list of formats is empty",)),
        (("--threads", "0"), ("--threads 0 is not possible",)),
        (("--height", "17.5"), ("17.5", "metres")),
        (("--calibration", "nowhere.toml"), ("nowhere.toml", "does not exist")),
    ],
)
def test_options_that_cannot_be(hypose, tiny, tmp_path, arguments, fragments):
    fails(hypose("track", tiny, "--out", tmp_path, "--no-overlay", *arguments), *fragments)


def npz(path, **arrays):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)


def test_archive_with_python_objects(hypose, tracked, tmp_path):
    class Payload:
        def __reduce__(self):
            return (open, (str(tmp_path / "owned"), "w"))

    buffer = io.BytesIO()
    np.save(buffer, np.array([Payload()], dtype=object), allow_pickle=True)
    folder = shutil.copytree(tracked, tmp_path / "results")
    npz(folder / "motion.npz", joints=buffer.getvalue())
    fails(hypose("export", folder), "motion.npz is not a motion of hypose", "give the motion.npz")
    npz(folder / "body.npz", coarse_vertices=buffer.getvalue())
    shutil.copy(tracked / "motion.npz", folder)
    fails(hypose("export", folder), "body.npz is not a body of hypose")
    assert not (tmp_path / "owned").exists()


def test_results_without_a_body(hypose, tracked, tmp_path):
    shutil.copy(tracked / "motion.npz", tmp_path)
    fails(hypose("export", tmp_path), "body.npz does not exist", "results folder")


def test_results_that_do_not_exist(hypose, tmp_path):
    fails(hypose("export", tmp_path / "nowhere"), "nowhere does not exist")


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (("--motion", "moonwalk"), ("There is no motion 'moonwalk'", "walk, jog")),
        (("--rig", "circle"), ("circle", "ring-N")),
        (("--subject", "nobody"), ("There is no subject 'nobody'", "neutral")),
        (("--subject", "999"), ("There is no subject 999",)),
        (("--corruption", "rain"), ("There is no corruption 'rain'", "table")),
        (("--seconds", "-1"), ("--seconds -1 is not possible",)),
        (("--clothing", "0.5"), ("0.5", "0.04")),
    ],
)
def test_synthetic_scenes_that_cannot_be(hypose, tmp_path, arguments, fragments):
    fails(hypose("synth", tmp_path / "out", *arguments), *fragments)


@pytest.mark.parametrize("command", ["synth", "demo --out"])
def test_a_folder_with_other_files_is_left_alone(hypose, tmp_path, command):
    (tmp_path / "thesis.txt").write_text("years of work")
    fails(hypose(*command.split(), tmp_path), "holds other files", "empty or new folder")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_a_depth_camera_that_is_given_twice_ends_in_a_sentence_and_leaves_no_folder(hypose, tmp_path):
    (tmp_path / "maps").mkdir()
    twice = hypose("depth-import", tmp_path / "maps", tmp_path / "maps", "--out", tmp_path / "rec")
    fails(twice, "maps is given twice", "every camera once")
    assert not (tmp_path / "rec").exists()


def test_debug_shows_where_the_error_came_from(hypose, tmp_path):
    code, _, err = hypose("track", tmp_path / "nowhere", "--debug")
    assert code == 2
    assert "Traceback" in err and "load_recording" in err


def test_a_bug_is_called_one(hypose, monkeypatch):
    def broken(text):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(commands_data, "_subject_name", broken)
    code, _, err = hypose("synth", "out")
    assert code == 1
    assert "Traceback" not in err
    assert "should not have happened (ZeroDivisionError: division by zero)" in err and "--debug" in err

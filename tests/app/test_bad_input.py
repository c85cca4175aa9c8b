"""Every input a user can spoil ends in one sentence that names it and the next step, exit code 2, and no traceback."""

import io
import json
import re
import shutil
import zipfile

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import write_skeletons
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


@pytest.fixture(scope="session")
def skeletons(tmp_path_factory):
    """A recording of three depth sensors; read only."""
    return write_skeletons(tmp_path_factory.mktemp("skeletons") / "rec", seconds=1.0)


MONO = "track TINY --out out --recipe monocular --camera cam2 --hypotheses 2"
CANNOT_BE = [
    ("track TINY --out out --recipe hfp", "--recipe hfp is not possible", "default, sir, apf"),
    ("track TINY --out out --start sitting", "There is no start 'sitting'", "hands-up"),
    ("track TINY --out out --evidence depth", "--evidence depth", "keypoints"),
    ("track TINY --out out --evidence keypoints", "key points"),
    ("track TINY --out out --start keypoints", "needs key points", "hull"),
    ("track TINY --out out --frames 5:99", "lies outside the recording", "0 to 7", "at most 0:8"),
    ("track TINY --out out --frames three", "--frames three is no range", "0:100"),
    ("track TINY --out out --formats trc,fbx", "There is no export format 'fbx'", "trc, c3d, bvh, glb"),
    ("track TINY --out out --formats ,", "list of formats is empty"),
    ("track TINY --out out --threads 0", "--threads 0 is not possible"),
    ("track TINY --out out --height 17.5", "17.5", "metres"),
    ("track TINY --out out --calibration nowhere.toml", "nowhere.toml", "does not exist"),
    ("track TINY --out out --subject stranger", "stranger does not exist"),
    ("track TINY --out out --recipe monocular --camera cam9", "no camera 'cam9'; it has cam1, cam2, cam3, cam4"),
    ("track TINY --out out --recipe monocular", "has 4 cameras (cam1, cam2, cam3, cam4); name one with --camera"),
    ("track TINY --out out --camera cam2", "one camera, cam2, and this needs two or more", "--recipe monocular"),
    ("track TINY --out out --floor 0", "The recipe 'default' has no option 'floor'", "choose the recipe monocular"),
    ("track TINY --out out --evidence edges", "no evidence 'edges'; choose silhouettes, keypoints or both"),
    (MONO, "has no key points and no clicks were given"),
    (f"{MONO} --recipe hpf", "has one camera, cam2, and this needs two or more"),
    (f"{MONO} --start t", "--start t is no file of clicked joints"),
    (f"{MONO} --evidence keypoints", "has no key points; add keypoints"),
    ("track nowhere --floor nan", "--floor nan is not possible; give -100 to 100 metres."),
    ("track nowhere --seed -1", "--seed -1 is not possible; give 0 or more."),
    ("export nowhere", "nowhere does not exist"),
    ("synth out --motion moonwalk", "There is no motion 'moonwalk'", "walk, jog"),
    ("synth out --rig circle", "circle", "ring-N"),
    ("synth out --subject stranger", "There is no subject 'stranger'", "neutral"),
    ("synth out --subject 999", "There is no subject '999'"),
    ("synth out --corruption rain", "There is no corruption 'rain'", "table"),
    ("synth out --seconds -1", "--seconds -1 is not possible"),
    ("synth out --clothing 0.5", "0.5", "0.04"),
    ("demo --seconds 0", "--seconds 0 is not possible; give more than 0 and at most 3600 seconds."),
    ("gesture run nowhere --threshold -1", "--threshold -1 is not possible; give more than 0 and at most 1000000 cm²."),
    ("check TINY --from tea", "choose auto, keypoints or silhouettes"),
    ("check TINY --out check.png --samples 1 --frames 0 --refine --from keypoints", "has no key points"),
    ("check TINY --height 17", "give 0.4 to 2.8 metres"),
    ("check TINY --keep cam9", "no camera cam9"),
    ("check nowhere --samples -3", "--samples -3 is not possible; give 1 to 10000."),
    ("sync TINY --by smell", "choose motion, sound or flash"),
    ("sync TINY --offsets 1,2", "4 numbers of frames are needed"),
    ("sync TINY --offsets 0,40,0,0", "have no frame in common"),
    ("sync TINY --offsets 1,a,2,3", "are no numbers"),
    ("sync TINY --largest 0", "is not possible"),
    ("sync TINY", "at least 16 consecutive frames"),
    ("sync TINY --by flash", "at least 12 frames are needed"),
    ("subject", "Give either a recording's folder or --mesh"),
    ("subject TINY --start lying", "--start lying is not possible"),
    ("subject TINY --poses 0", "--poses 0 is not possible"),
    ("subject TINY --height 170", "--height 170 is not possible; give 0.5 to 2.5 metres"),
    ("fuse", "nothing to fuse"),
    ("fuse absent", "does not exist"),
    ("fuse SKELETONS --method magic", "--method magic is not possible"),
    ("fuse SKELETONS --formats bvh", "needs poses"),
    ("fuse SKELETONS --formats doc", "no export format"),
    ("fuse SKELETONS --reference s9", "has no sensor 's9'"),
    ("fuse SKELETONS --rate 0", "not possible"),
    ("fuse SKELETONS --up left", "--up left"),
    ("fuse SKELETONS --live", "leave one of the two out"),
    ("fuse --live --udp 99999", "is not possible; give 0 to 65535"),
    ("fuse --live --osc nowhere", "HOST:PORT"),
    ("fuse --live --token abc", "8 to 128"),
    ("calibrate", "Give board videos"),
    ("calibrate x --convert y", "Give board videos"),
    ("calibrate x", "Say which board it is"),
    ("calibrate x --chessboard 8x6", "Say how large the board's squares are"),
    ("calibrate x --chessboard 8by6 --square 3cm", "'8by6' is not understood; write COLUMNSxROWS"),
    ("calibrate x --chessboard 8x6 --square 115", "write a number with its unit"),
    ("calibrate x --charuco 8x6 --square 3cm", "Say how large the ChArUco board's markers are"),
    ("calibrate x --chessboard 8x6 --square 3cm", "x does not exist; give the board videos"),
    ("calibrate --convert none.toml", "none.toml does not exist"),
    ("calibrate --convert none.toml --out a.json", "cannot be written: name the calibration"),
    ("calibrate --points none.toml", "none.toml does not exist"),
    ("batch none.csv", "none.csv does not exist"),
    ("batch TINY --workers 0", "give 1 to 1024"),
    ("batch TINY --scheduler tcp://127.0.0.1:1 --workers 2", "leave --workers"),
    ("batch TINY --formats fbx", "fbx"),
    ("keypoints TINY --detector none.py:D", "does not exist"),
    ("report nowhere", "does not exist"),
    ("report .", "motion.npz does not exist"),
    ("view nowhere", "does not exist"),
    ("report TRACKED --out .", "is a folder"),
    ("cite magic", "default, sir"),
]
"""Command lines, a fixture in capitals for the folder that it makes; what the sentence must contain."""


@pytest.mark.parametrize("case", CANNOT_BE, ids=[line for line, *_ in CANNOT_BE])
def test_what_cannot_be_done_is_one_sentence(hypose, request, tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    line, *fragments = case
    words = [request.getfixturevalue(w.lower()) if w.isupper() and len(w) > 3 else w for w in line.split()]
    fails(hypose(*words), *fragments)


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
    fails(hypose("export", folder), "motion.npz is not a motion", "give the motion.npz")
    npz(folder / "body.npz", coarse_vertices=buffer.getvalue())
    shutil.copy(tracked / "motion.npz", folder)
    fails(hypose("export", folder), "body.npz is not a body")
    assert not (tmp_path / "owned").exists()


def test_results_without_a_body(hypose, tracked, tmp_path):
    shutil.copy(tracked / "motion.npz", tmp_path)
    fails(hypose("export", tmp_path), "body.npz does not exist", "results folder")


@pytest.mark.parametrize("command", ["synth", "demo --out"])
def test_a_folder_with_other_files_is_left_alone(hypose, tmp_path, command):
    (tmp_path / "thesis.txt").write_text("years of work")
    fails(hypose(*command.split(), tmp_path), "holds other files", "empty or new folder")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_debug_shows_where_the_error_came_from(hypose, tmp_path):
    code, _, err = hypose("track", tmp_path / "nowhere", "--debug")
    assert code == 2
    assert "Traceback" in err and "load_recording" in err


def test_a_bug_is_called_one(hypose, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("hypose.synthetic.scenes.make_scene", broken)
    code, _, err = hypose("synth", "out")
    assert code == 1
    assert "Traceback" not in err
    assert "should not have happened (ZeroDivisionError: division by zero)" in err and "--debug" in err

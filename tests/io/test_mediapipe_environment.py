"""MediaPipe in an environment of its own: the pipe to it and what can go wrong, with a stand-in for the library."""

from __future__ import annotations

import os
import stat
import sys

import numpy as np
import pytest

from hypose.app.cli import main
from hypose.errors import InputError
from hypose.io.keypoints import detectors as environment
from hypose.io.recordings.recording import load_recording
from tests.io.recordings import make_recording

LIBRARY = """
import sys
print("noise on stdout")  # as the real one writes it
__version__ = "0.10.21"

class _Point:
    def __init__(self, x, y, visibility):
        self.x, self.y, self.visibility = x, y, visibility

class _Found:
    pose_landmarks = None

class _Landmarks:
    def __init__(self, landmark):
        self.landmark = landmark

class Pose:
    def __init__(self, static_image_mode, model_complexity):
        assert static_image_mode and model_complexity == 1

    def process(self, picture):
        found = _Found()
        if picture.max() == 255:
            raise RuntimeError("as the real one may")
        if picture.max():  # RGB: the blue of a BGR picture comes last
            share = picture[0, 0, 2] / 200
            found.pose_landmarks = _Landmarks([_Point(share, 0.5, 0.9)] * 32 + [_Point(1.5, 0.5, 0.9)])
        return found

class solutions:
    class pose:
        Pose = Pose
"""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """An environment whose Python is this one, with a stand-in for the library."""
    if sys.platform == "win32":
        pytest.skip("a script stands in for the environment's Python")
    folder = tmp_path / "environment"
    (folder / "lib").mkdir(parents=True)
    (folder / "lib" / "mediapipe.py").write_text(LIBRARY)
    python = folder / "python"
    numpy = os.path.dirname(os.path.dirname(np.__file__))
    lines = f"import sys; sys.path[:0] = [{str(folder / 'lib')!r}, {numpy!r}]"
    run = f"{lines}; import runpy; runpy.run_path(sys.argv[-1], run_name='__main__')"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} -I -c "{run}" "$2"\n')
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(environment, "environment_folder", lambda: folder)
    monkeypatch.setattr(environment, "environment_python", lambda: python)
    return folder


def picture(blue, shape=(40, 80)):
    out = np.zeros((*shape, 3), np.uint8)
    out[..., 0] = blue
    return out


def test_pictures_go_out_and_points_come_back(stand_in):
    with environment.open_mediapipe() as detector:
        assert detector.keypoint_set == "BLAZEPOSE_33" and detector.identity["version"] == "0.10.21"
        (person,) = detector.detect(picture(100))
        np.testing.assert_allclose(person[0], [0.5 * 80 - 0.5, 0.5 * 40 - 0.5, 0.9])
        np.testing.assert_array_equal(person[32], 0)  # guessed outside of the picture
        assert detector.detect(picture(0, (30, 20))).shape == (0, 33, 3)
        assert detector.detect(picture(50, (1081, 1921)))[0, 0, 0] == pytest.approx(0.25 * 1921 - 0.5)
    assert detector.process.returncode is not None


def test_a_worker_that_dies_is_one_sentence(stand_in):
    with environment.open_mediapipe() as detector, pytest.raises(InputError, match="stopped answering; delete"):
        detector.detect(picture(255))


def test_the_command_detects_with_it(stand_in, tmp_path, capsys):
    folder = make_recording(tmp_path / "rec")
    with pytest.raises(SystemExit) as caught:
        main(["keypoints", str(folder), "--mediapipe"])
    assert not caught.value.code, capsys.readouterr().err
    assert "BLAZEPOSE_33, one folder per view" in capsys.readouterr().out
    assert load_recording(folder).keypoint_set == "BLAZEPOSE_33"


def test_nothing_is_installed_without_being_asked(tmp_path, monkeypatch, capsys):
    folder = make_recording(tmp_path / "rec")
    monkeypatch.setattr(environment, "environment_folder", lambda: tmp_path / "cache" / "mediapipe")
    monkeypatch.setattr(environment, "_run", lambda command: pytest.fail("something was run"))
    with pytest.raises(SystemExit) as caught:
        main(["keypoints", str(folder), "--mediapipe"])
    assert caught.value.code == 2 and "again with --yes to agree" in capsys.readouterr().err
    assert not (tmp_path / "cache").exists()

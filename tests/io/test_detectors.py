"""The optional detector: without mediapipe installed, against a stand-in with the same interface (mediapipe 1.2)."""

from __future__ import annotations

import os
import stat
import sys
import zipfile
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from hypose.app.cli import main
from hypose.errors import InputError
from hypose.evidence.detector import PoseDetector, openpose_document
from hypose.evidence.keypoints import BLAZEPOSE_33, parse_openpose
from hypose.io.keypoints import detectors as environment
from hypose.io.keypoints.detectors import open_blazepose
from hypose.io.recordings.recording import load_recording
from tests.io.recordings import make_recording


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "pose_landmarker.task"
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr("pose_detector.tflite", b"a")
        bundle.writestr("pose_landmarks_detector.tflite", b"b")
    return path


def landmark(x, y, visibility=0.9, presence=1.0):
    return SimpleNamespace(x=x, y=y, z=0.0, visibility=visibility, presence=presence)


def install(monkeypatch, people, broken=None):
    """A module `mediapipe` whose landmarker finds `people` (image -> lists of landmarks) and notes what it was told."""
    told = {}

    class Landmarker:
        @classmethod
        def create_from_options(cls, options):
            if broken is not None:
                raise broken
            told["options"] = options
            return cls()

        def __enter__(self):
            return self

        def __exit__(self, *error):
            told["closed"] = True

        def detect(self, image):
            told["image"] = image
            return SimpleNamespace(pose_landmarks=people(image.data))

    def record(**given):
        return SimpleNamespace(**given)

    vision = SimpleNamespace(
        PoseLandmarkerOptions=record, PoseLandmarker=Landmarker, RunningMode=SimpleNamespace(IMAGE="image")
    )
    module = ModuleType("mediapipe")
    module.__version__ = "1.2.2"
    module.tasks = SimpleNamespace(vision=vision, BaseOptions=record)
    module.Image, module.ImageFormat = record, SimpleNamespace(SRGB="rgb")
    monkeypatch.setitem(sys.modules, "mediapipe", module)
    return told


def test_landmarks_become_pixels_with_confidence(monkeypatch, model):
    person = [landmark(0.5, 0.25)] * 33
    person[1] = landmark(0.0, 1.0, 0.8, 0.5)
    person[2] = landmark(1.2, 0.5)
    person[3] = landmark(0.1, float("nan"))
    person[4] = landmark(0.1, 0.1, visibility=3.0, presence=None)
    told = install(monkeypatch, lambda image: [person, person])
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[..., 0] = 200  # blue
    with open_blazepose(model, 2) as detector:
        assert isinstance(detector.keypoint_set, str)
        found = detector.detect(picture)
        wanted: PoseDetector = detector
        assert wanted.identity["people"] == 2 and len(wanted.identity["model"]) == 64
    assert found.shape == (2, 33, 3)
    assert np.allclose(found[0, 0], [29.5, 9.5, 0.9])  # pixel centres are at integers
    assert np.allclose(found[0, 1], [-0.5, 39.5, 0.4])
    assert (found[:, 2:4] == 0).all()  # beyond the picture, not finite
    assert found[0, 4, 2] == 1.0  # some models give the argument of the sigmoid
    assert told["closed"] and told["options"].running_mode == "image" and told["options"].num_poses == 2
    assert told["options"].base_options.model_asset_path == str(model)
    assert told["image"].image_format == "rgb" and told["image"].data[0, 0].tolist() == [0, 0, 200]


def test_nobody_is_nobody(monkeypatch, model):
    install(monkeypatch, lambda image: [])
    with open_blazepose(model) as detector:
        assert detector.detect(np.zeros((8, 8, 3), np.uint8)).shape == (0, 33, 3)


def test_files_are_read_back(model):
    rng = np.random.default_rng(0)
    people = rng.uniform(1, 100, (2, 33, 3))
    people[..., 2] = rng.uniform(0.1, 1, (2, 33))
    nobody = np.zeros((1, 33, 3))
    document = openpose_document(np.concatenate([people, nobody]))
    assert np.allclose(parse_openpose(document, BLAZEPOSE_33), people, atol=1e-3)


def test_what_cannot_be_used_is_told_in_a_sentence(monkeypatch, model, tmp_path):
    def error(path, people=3):
        with pytest.raises(InputError) as told, open_blazepose(path, people):
            pass
        return str(told.value)

    monkeypatch.setitem(sys.modules, "mediapipe", None)  # as if it were not installed
    assert 'pip install "hypose[mediapipe]"' in error(model)
    assert "none.task does not exist" in error(tmp_path / "none.task")
    other = tmp_path / "other.task"
    other.write_bytes(b"no archive")
    assert "no model bundle" in error(other)
    with zipfile.ZipFile(other, "w") as bundle:
        bundle.writestr("hand_landmarks_detector.tflite", b"a")
    assert "no model of a pose" in error(other)
    assert "1 to 20" in error(model, 0)
    install(monkeypatch, lambda image: [], ValueError("The model is not\na valid Flatbuffer buffer"))
    assert "1.2.2 cannot use the model" in error(model) and "not a valid Flatbuffer" in error(model)


# ---- test mediapipe environment ------------------------------------------------------------------------------------
# MediaPipe in an environment of its own: the pipe to it and what can go wrong, with a stand-in for the library.


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

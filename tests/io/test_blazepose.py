"""The optional detector: without mediapipe installed, against a stand-in with the same interface (mediapipe 1.2)."""

from __future__ import annotations

import sys
import zipfile
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.detector import PoseDetector, openpose_document
from hypose.evidence.keypoints import BLAZEPOSE_33, parse_openpose
from hypose.io.keypoints.detectors import open_blazepose


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

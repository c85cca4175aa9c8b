"""`hypose keypoints` with a detector of the user's own, and `hypose track` on what it wrote."""

import json

import numpy as np
import pytest

from hypose.evidence.keypoints import BLAZEPOSE_33, BODY_25, parse_openpose
from hypose.io.keypoints.detectors import OwnDetector
from hypose.io.recordings.frames import load_keypoints
from hypose.io.recordings.recording import load_recording


class Detector:
    """Finds what the recording's own files say, in the order in which pictures are shown."""

    keypoint_set = "BLAZEPOSE_33"

    def __init__(self, people, identity=None):
        self.people, self.looked, self.identity = people, 0, identity or {"model": "a"}

    def detect(self, image):
        assert image.ndim == 3 and image.dtype == np.uint8
        self.looked += 1
        return next(self.people)


def as_blazepose(path):
    people = parse_openpose(path.read_bytes(), BODY_25)
    out = np.zeros((len(people), 33, 3))
    for k, name in enumerate(BLAZEPOSE_33):
        if name in BODY_25:
            out[:, k] = people[:, BODY_25.index(name)]
    return out


@pytest.fixture
def prepared(keypoint_recording, monkeypatch):
    """The recording without key points of its own, and put(...) to install a detector that finds them again."""
    views = [sorted((keypoint_recording / "pose" / f"cam{c}_json").glob("*.json")) for c in range(1, 5)]
    files = [p for frame in zip(*views, strict=True) for p in frame]
    toml = keypoint_recording / "recording.toml"
    lines = toml.read_text().splitlines()
    toml.write_text("\n".join(line for line in lines if not line.startswith("keypoint")))

    def put(skip=0, **more):
        detector = Detector((as_blazepose(p) for p in files[skip:]), **more)

        def opened(text):
            return OwnDetector(detector, detector.keypoint_set, detector.identity, text)

        monkeypatch.setattr("hypose.io.keypoints.detectors.open_own_detector", opened)
        return detector

    return keypoint_recording, put


@pytest.mark.slow
def test_detected_key_points_are_tracked(hypose, prepared, tmp_path):
    recording, put = prepared
    truth = np.load(recording / "truth.npz")["joints"]
    detector = put()
    code, out, err = hypose("keypoints", recording, "--detector", "any")
    assert code == 0, err
    assert detector.looked == 4 * 30 and "--evidence both" in out
    loaded = load_recording(recording)
    assert loaded.keypoint_set == "BLAZEPOSE_33" and any("hypose keypoints wrote" in n for n in loaded.notes)
    code, out, err = hypose(
        "track", recording, "--evidence", "both", "--out", tmp_path / "r", "--formats", "trc", "--no-overlay"
    )
    assert code == 0, err
    from hypose.io.motions.results import load_motion

    motion = load_motion(tmp_path / "r" / "motion.npz")
    names = motion.skeleton.joint_names
    at = [names.index(n) for n in ("left_knee", "right_knee", "left_elbow", "right_wrist", "left_ankle")]
    assert np.median(np.linalg.norm(motion.joints[:, at] - truth[:, at], axis=-1)) < 0.06


def test_an_interrupted_detection_goes_on(hypose, prepared):
    recording, put = prepared
    folder = recording / "keypoints"

    first = put()
    stopped = first.detect

    def detect(image):
        if first.looked == 40:
            raise KeyboardInterrupt
        return stopped(image)

    first.detect = detect
    code, out, _ = hypose("keypoints", recording, "--detector", "any")
    assert code == 130 and "--resume" in out
    assert len(list(folder.glob("*/*.json"))) == 40
    loaded = load_recording(recording)
    assert loaded.keypoint_set is None and any("not complete" in n for n in loaded.notes)

    put(identity={"model": "another"})
    code, _, err = hypose("keypoints", recording, "--detector", "any", "--resume")
    assert code == 2 and "another model, version or setting" in err
    second = put(skip=40)
    code, _, err = hypose("keypoints", recording, "--detector", "any", "--resume")
    assert code == 0, err
    assert second.looked == 80
    resumed = load_keypoints(load_recording(recording))
    third = put()
    code, _, err = hypose("keypoints", recording, "--detector", "any")
    assert code == 0 and third.looked == 120
    retracked = load_keypoints(load_recording(recording))
    assert all((a.points == b.points).all() for a, b in zip(resumed, retracked, strict=True))


def test_scaled_and_shifted_pictures_give_points_of_the_calibration(hypose, prepared):
    recording, put = prepared
    toml = recording / "recording.toml"
    toml.write_text(toml.read_text().replace('name = "cam2"', 'name = "cam2"\nimage_shift = [3.0, -2.0]', 1))
    put()
    code, _, err = hypose("keypoints", recording, "--detector", "any")
    assert code == 0, err
    original = as_blazepose(sorted((recording / "pose" / "cam2_json").glob("*.json"))[0])[0]
    found = parse_openpose((recording / "keypoints" / "cam2" / f"cam2_{0:012d}_keypoints.json").read_bytes())[0]
    seen = original[:, 2] > 0
    assert np.allclose(found[seen, :2] - original[seen, :2], [3.0, -2.0], atol=2e-3)


def test_bad_input_is_told_in_a_sentence(hypose, prepared, tmp_path, monkeypatch):
    recording, put = prepared
    put()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "other.txt").write_text("mine")
    code, _, err = hypose("keypoints", recording, "--detector", "any", "--out", tmp_path / "full")
    assert code == 2 and "holds other files" in err and "Traceback" not in err
    code, out, err = hypose("keypoints", recording, "--detector", "any", "--out", tmp_path / "new")
    assert code == 0 and 'keypoint_set = "BLAZEPOSE_33"' in out  # elsewhere: what to say in recording.toml
    (recording / "keypoints").mkdir()
    (recording / "keypoints" / "detector.json").write_text("{")
    code, _, err = hypose("track", recording)
    assert code == 2 and "is damaged" in err
    (recording / "keypoints" / "detector.json").write_text(json.dumps({"keypoint_set": "X", "complete": True}))
    code, _, err = hypose("track", recording, "--evidence", "keypoints")
    assert code == 2 and "has none" in err  # no view has a folder there
    monkeypatch.undo()
    code, _, err = hypose("keypoints", recording, "--detector", "none.py:D")
    assert code == 2 and "does not exist" in err

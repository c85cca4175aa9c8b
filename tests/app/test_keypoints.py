"""Key points: detected by a detector of the user's own and tracked, and recordings of key points alone."""

import json

import numpy as np
import pytest

from benchmarks.robustness.keypoint_layouts import (
    RATE,
    detections,
    walker,
    write_keypoint_recording,
    write_keypoints,
)
from hypose.body.default_body import human
from hypose.errors import InputError
from hypose.evidence.keypoints import BLAZEPOSE_33, BODY_25
from hypose.io.keypoints.detectors import OwnDetector, open_own_detector
from hypose.io.keypoints.keypoint_files import parse_openpose
from hypose.io.motions.marker_files import write_trc
from hypose.io.motions.results import load_motion
from hypose.io.recordings.frames import load_keypoints
from hypose.io.recordings.recording import load_recording
from hypose.synthetic.scenes import camera_rig
from tests.app.conftest import fails
from tests.io.recordings import make_recording

FRAMES = 30


class Detector:
    """Finds what the recording's own files say, in the order in which pictures are shown."""

    keypoint_set = "BLAZEPOSE_33"

    def __init__(self, people, identity=None, stop=None):
        self.people, self.looked, self.identity, self.stop = people, 0, identity or {"model": "a"}, stop

    def detect(self, image):
        assert image.ndim == 3 and image.dtype == np.uint8
        if self.looked == self.stop:
            raise KeyboardInterrupt
        self.looked += 1
        return next(self.people)


def as_blazepose(path):
    people = parse_openpose(path.read_bytes())
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


def test_an_interrupted_detection_goes_on(hypose, prepared):
    recording, put = prepared
    command = ("keypoints", recording, "--detector", "any")
    put(stop=40)
    code, out, _ = hypose(*command)
    assert code == 130 and "--resume" in out
    assert len(list((recording / "keypoints").glob("*/*.json"))) == 40
    loaded = load_recording(recording)
    assert loaded.keypoint_set is None and any("not complete" in n for n in loaded.notes)
    put(identity={"model": "another"})
    fails(hypose(*command, "--resume"), "another model, version or setting")
    again = put(skip=40)
    assert hypose(*command, "--resume")[0] == 0 and again.looked == 80
    assert load_recording(recording).keypoint_set == "BLAZEPOSE_33"


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


def test_bad_folders_of_key_points_are_told_in_a_sentence(hypose, prepared, tmp_path):
    recording, put = prepared
    put()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "other.txt").write_text("mine")
    command = ("keypoints", recording, "--detector", "any", "--out")
    fails(hypose(*command, tmp_path / "full"), "holds other files")
    code, out, _ = hypose(*command, tmp_path / "new")
    assert code == 0 and 'keypoint_set = "BLAZEPOSE_33"' in out  # elsewhere: what to say in recording.toml
    (recording / "keypoints").mkdir()
    (recording / "keypoints" / "detector.json").write_text("{")
    fails(hypose("track", recording), "is damaged")
    said = {"keypoint_set": "X", "complete": True, "frames": [0, 5]}
    (recording / "keypoints" / "detector.json").write_text(json.dumps(said))
    fails(hypose("track", recording, "--evidence", "keypoints"), "has none")  # no view has a folder there


# ---- recordings without pictures


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A recording of key points alone; read only."""
    folder, cameras = tmp_path_factory.mktemp("alone"), camera_rig("humaneva-4", distorted=True)
    found = detections("HALPE_26", cameras, FRAMES)
    paths = write_keypoints("mmpose-results", folder / "points", found, cameras, "HALPE_26")
    return write_keypoint_recording(folder, cameras, paths)


def test_from_key_points_to_a_comparison(hypose, alone, tmp_path):
    code, out, err = hypose("track", alone, "--out", tmp_path / "r")
    assert code == 0, err
    assert "Key points: MMPose results, HALPE_26 (by their names)" in out + err
    names = {p.name for p in (tmp_path / "r").iterdir()}
    assert {"motion.npz", "motion.trc", "motion.c3d", "motion.mot", "overlay.webm", "report.html"} <= names
    motion, truth = load_motion(tmp_path / "r" / "motion.npz"), human().joints(walker(FRAMES))
    limbs = [motion.skeleton.joint(f"{s}_{p}") for s in ("left", "right") for p in ("knee", "ankle", "elbow", "wrist")]
    assert np.linalg.norm(motion.joints - truth, axis=-1)[:, limbs].mean() < 0.02
    write_trc(tmp_path / "truth.trc", motion.skeleton.joint_names, truth, RATE)
    code, out, _ = hypose("compare", tmp_path / "r", tmp_path / "truth.trc", "--max-mm", 20)
    assert code == 0 and "joints, offsets aside: median" in out


def test_what_needs_pictures_says_so(hypose, alone, tmp_path):
    refused = hypose("track", alone, "--evidence", "both", "--out", tmp_path / "r")
    fails(refused, "needs pictures, and", "has key points alone; use keypoints")
    fails(hypose("silhouettes", alone, "--out", tmp_path / "masks"), "silhouettes are made from pictures")


def test_check_looks_at_key_points_alone(hypose, alone, tmp_path):
    code, out, err = hypose("check", alone, "--out", tmp_path / "check.png")
    assert code == 0, err
    assert "Key points seen with confidence above 0.3" in out and (tmp_path / "check.png").is_file()


# ---- a detector of the user's own


PLUGIN = """
import numpy as np

class Detector:
    keypoint_set = "COCO_17"
    identity = {"detector": "mine", "version": 1}

    def detect(self, image):
        grey = image.mean()
        points = np.stack([10 + np.arange(17), 20 + np.arange(17), np.full(17, 3.5)], 1)
        points[5:, 2] = 0  # a head
        return points[None] + [0, 0, 0 * grey]
"""


def test_a_detector_in_a_file(hypose, tmp_path):
    folder = make_recording(tmp_path / "rec")
    (tmp_path / "mine.py").write_text(PLUGIN)
    code, out, _ = hypose("keypoints", folder, "--detector", f"{tmp_path / 'mine.py'}:Detector")
    assert code == 0 and "COCO_17, one folder per view" in out
    recording = load_recording(folder)
    assert recording.keypoint_set == "COCO_17"
    points = np.stack([k.points for k in load_keypoints(recording)])
    assert (points[:, :, :5, 2] > 0.5).all() and points[..., 2].max() <= 1  # scores of 3.5 are scaled
    assert hypose("keypoints", folder, "--detector", f"{tmp_path / 'mine.py'}:Detector", "--resume")[0] == 0


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("mine.py", "", r"--detector .*mine\.py is not understood; write FILE\.py:NAME"),
        ("none.py:D", None, r"none\.py does not exist"),
        ("mine.py:D", "x = 1", r"is no detector; it needs a class with keypoint_set, identity and detect"),
        ("mine.py:D", "import not_there_at_all", r"cannot be made \(ModuleNotFoundError: .*\); correct it"),
        ("mine.py:D", "D = 5", r"is no detector; it needs a class"),
        ("mine.py:D", "class D:\n    def __init__(self): 1 / 0", r"cannot be made \(ZeroDivisionError"),
        ("mine.py:D", "class D:\n keypoint_set = 'X'\n def detect(self, i): pass", r"There is no key-point set 'X'"),
        ("mine.py:D", "class D:\n keypoint_set = 'COCO_17'\n identity = {'a': {1}}\n def detect(self, i): pass",
         r"The identity of .* must be a table"),
    ],
)  # fmt: skip
def test_what_is_no_detector(tmp_path, text, code, message):
    if code is not None:
        (tmp_path / "mine.py").write_text(code)
    with pytest.raises(InputError, match=message):
        open_own_detector(f"{tmp_path}/{text}")


@pytest.mark.parametrize("answer", ["None", "'people'", "[[1, 2]]", "[[[1, 2, 3]] * 18]"])
def test_wrong_answers_are_named(tmp_path, answer):
    (tmp_path / "mine.py").write_text(
        f"class D:\n    keypoint_set = 'COCO_17'\n    def detect(self, image):\n        return {answer}\n"
    )
    detector = open_own_detector(f"{tmp_path}/mine.py:D")
    with pytest.raises(InputError, match=r"answers with .*; its set COCO_17 needs people x 17 x 3"):
        detector.look(np.zeros((4, 4, 3), np.uint8))

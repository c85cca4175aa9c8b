"""`hypose keypoints --detector`: a detector of ten lines in a file of the user's own."""

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.keypoints.detectors import open_own_detector
from hypose.io.recordings.frames import load_keypoints
from hypose.io.recordings.recording import load_recording
from tests.io.recordings import make_recording

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
        ("mine.py:D", "x = 1", r"has no D; it needs a class with keypoint_set, identity and detect"),
        ("mine.py:D", "import not_there_at_all", r"cannot be loaded \(ModuleNotFoundError: .*\); correct it"),
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
        detector.detect(np.zeros((4, 4, 3), np.uint8))

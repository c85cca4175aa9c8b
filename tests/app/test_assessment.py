"""How `hypose track` ends: with an assessment, and a code of its own when the result is not to be trusted."""

import json
from dataclasses import replace

import numpy as np
import pytest

import hypose as package
from hypose.calibration.findings import Finding
from hypose.cameras.camera import CameraRig
from hypose.pipeline.assessment import UNTRUSTED, Assessment

LIGHT = ("--evidence", "keypoints", "--no-overlay", "--formats", "csv")


def test_a_good_recording_ends_as_good(hypose, keypoint_recording, tmp_path):
    code, out, _ = hypose("track", keypoint_recording, "--out", tmp_path / "out", *LIGHT)
    assert code == 0 and "Assessment: Good" in out
    assert json.loads((tmp_path / "out" / "assessment.json").read_text())["assessment"] == "good"


@pytest.mark.slow
def test_a_world_upside_down_ends_as_not_to_be_trusted(hypose, keypoint_recording, tmp_path):
    path = keypoint_recording / "calibration.toml"
    rig, _ = package.read_calibration(path)
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = [replace(c, camera_from_world=c.camera_from_world @ turned) for c in rig]
    package.write_calibration(CameraRig(tuple(cameras)), path)
    code, out, err = hypose("track", keypoint_recording, "--out", tmp_path / "out", *LIGHT)
    assert code == 3, out + err
    assert "Not to be trusted, because" in out and "up" in out
    assert json.loads((tmp_path / "out" / "assessment.json").read_text())["assessment"] == "not to be trusted"
    assert (tmp_path / "out" / "motion.npz").is_file()


def test_who_goes_on_with_a_result_is_told_when_it_is_not_to_be_trusted(hypose, tracked, tmp_path):
    for name in ("motion.npz", "body.npz"):
        (tmp_path / name).write_bytes((tracked / name).read_bytes())
    doubted = Assessment(UNTRUSTED, (Finding("swapped", (), "the cameras are exchanged"),))
    for kept, reported in (
        ("{", False),
        (json.dumps(Assessment("good").document()), False),
        (json.dumps(doubted.document()), True),
    ):
        (tmp_path / "assessment.json").write_text(kept, encoding="utf-8")
        for command in (("export", "--formats", "trc"), ("gait",), ("compare", tracked, "--out", tmp_path / "table")):
            code, _, err = hypose(command[0], tmp_path, *command[1:])
            assert code == 0, err
            assert ("Not to be trusted, because: the cameras are exchanged." in " ".join(err.split())) == reported

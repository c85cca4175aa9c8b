"""Recordings without any picture: checked, tracked, exported and compared from their key points."""

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
from hypose.io.motions.marker_files import write_trc
from hypose.io.motions.results import load_motion
from hypose.synthetic.scenes import camera_rig

FRAMES = 30


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    cameras = camera_rig("humaneva-4", distorted=True)
    paths = write_keypoints(
        "mmpose-results", folder / "points", detections("HALPE_26", cameras, FRAMES), cameras, "HALPE_26"
    )
    return write_keypoint_recording(folder, cameras, paths)


def test_from_key_points_to_a_comparison(hypose, recording, tmp_path):
    code, out, err = hypose("track", recording, "--out", tmp_path / "r")
    assert code == 0, err
    assert "Key points: MMPose results, HALPE_26 (by their names)" in out + err
    names = {p.name for p in (tmp_path / "r").iterdir()}
    assert {"motion.npz", "motion.trc", "motion.c3d", "motion.mot", "overlay.mp4", "report.html"} <= names
    motion, truth = load_motion(tmp_path / "r" / "motion.npz"), human().joints(walker(FRAMES))
    limbs = [motion.skeleton.joint(f"{s}_{p}") for s in ("left", "right") for p in ("knee", "ankle", "elbow", "wrist")]
    assert np.linalg.norm(motion.joints - truth, axis=-1)[:, limbs].mean() < 0.02
    write_trc(tmp_path / "truth.trc", motion.skeleton.joint_names, truth, RATE)
    code, out, _ = hypose("compare", tmp_path / "r", tmp_path / "truth.trc", "--max-mm", 20)
    assert code == 0 and "joints, offsets aside: median" in out


def test_what_needs_pictures_says_so(hypose, recording, tmp_path):
    code, _, err = hypose("track", recording, "--evidence", "both", "--out", tmp_path / "r")
    assert code == 2 and "needs pictures, and" in err and "has key points alone; use keypoints" in err
    code, _, err = hypose("silhouettes", recording, "--out", tmp_path / "masks")
    assert code == 2 and "silhouettes are made from pictures" in err


def test_check_looks_at_key_points_alone(hypose, recording, tmp_path):
    code, out, err = hypose("check", recording, "--out", tmp_path / "check.png")
    assert code == 0, err
    assert "Key points seen with confidence above 0.3" in out and (tmp_path / "check.png").is_file()

"""`hypose check` with the doctor and --refine, and `hypose sync`, on the tiny recording."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from hypose.app.jobs import checking
from hypose.calibration.refine_points import CameraChange
from hypose.geometry import so3_exp, so3_log
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.depth import read_depth_png
from hypose.pipeline.recording_diagnostics import ALL_VIEWS, LEFT_OUT, Refinement
from hypose.synthetic.write_recording import walking_scene, write_depth_scene
from tests.app.conftest import fails


def test_the_command_writes_evidence_in_step(hypose, tiny, tmp_path):
    code, out, err = hypose("sync", tiny, "--offsets", "0,1,-0.5,0", "--out", tmp_path / "step")
    assert code == 0, err
    assert "cam2: 1.00 frames late (as given)" in out
    assert len(list((tmp_path / "step" / "masks" / "cam2").glob("*.png"))) == 8
    assert json.loads((tmp_path / "step" / "masks" / "cam2" / "hypose-masks.json").read_text())["undistorted"]
    code, out, err = hypose("sync", tmp_path / "step", "--offsets", "0,0,0,0")
    assert code == 0, err


def test_depth_maps_are_brought_in_step(hypose, tmp_path):
    scene = walking_scene("walk", "", "depth-2", seconds=0.2, frame_rate=25.0, seed=2)
    write_depth_scene(scene, tmp_path / "rec")
    code, _, err = hypose("sync", tmp_path / "rec", "--offsets", "0,2", "--out", tmp_path / "step")
    assert code == 0, err
    made = load_recording(tmp_path / "step")
    for view, late in zip(made.views, (0, 2), strict=True):
        for k, file in enumerate(sorted(view.files["depth"].iterdir())):
            seen = read_depth_png(tmp_path / "rec/depth" / view.name / f"{k + late:06d}.png") if k + late < 5 else 0.0
            assert np.array_equal(read_depth_png(file), np.broadcast_to(seen, (288, 320)))
    assert made.n_frames == 5 and "background" in made.views[0].files


def test_an_existing_calibration_is_never_overwritten(hypose, recording):
    before = (recording / "calibration.toml").read_bytes()
    refused = hypose("check", recording, "--refine", "--to", recording / "calibration.toml")
    fails(refused, "never overwritten")
    assert (recording / "calibration.toml").read_bytes() == before


def test_a_refinement_that_moves_cameras_far_needs_a_word(hypose, keypoint_recording, monkeypatch):
    """A camera more than 10 degrees off is more often another person's key points than a calibration so wrong."""
    found = Refinement(
        read_any(keypoint_recording / "calibration.toml")[0],
        "keypoints",
        (1, 2, 3),
        tuple(CameraChange(f"cam{k}", 67.0 if k == 2 else 0.1, 0.1, 1.0, 3.0) for k in (1, 2, 3)),
        {LEFT_OUT: (9.0, 1.0), ALL_VIEWS: (9.0, 1.0)},
    )
    monkeypatch.setattr(checking, "refine_recording", lambda *_, **__: found)
    given = ("check", keypoint_recording, "--frames", "0", "--samples", "1")
    code, out, err = hypose(*given, "--refine")
    assert code == 1 and "takes cam2 more than 10 degrees" in out and "--refine=far" in out, out + err
    assert not (keypoint_recording / "results" / "calibration_refined.toml").exists()
    code, out, err = hypose(*given, "--refine=far")
    assert code == 0 and (keypoint_recording / "results" / "calibration_refined.toml").exists(), out + err
    assert replace(found, changes=(CameraChange("cam1", 1.0, 0.6, 1.0, 3.0),)).far == ("cam1",)
    found = replace(
        found, residuals={LEFT_OUT: (6.07, 6.14), ALL_VIEWS: (9.0, 1.0)}
    )  # all cameras agree better, and lie worse
    code, out, _ = hypose(*given, "--refine=far")
    assert code == 1 and "not better on frames that it was not found on" in out


@pytest.mark.slow
def test_check_writes_a_refined_calibration_and_says_how_to_use_it(hypose, keypoint_recording):
    path = keypoint_recording / "calibration.toml"
    true = read_any(path)[0]
    text = path.read_text()
    block = next(p for p in re.split(r"(?=\[cam\d\])", text) if p.startswith("[cam2]"))
    rotation, translation = (
        np.array(json.loads(re.search(rf"{key} = (.*)", block).group(1))) for key in ("rotation", "translation")
    )
    turn = so3_exp(np.radians([0, 2.0, 0]))  # about the camera's own centre
    spoilt = re.sub(r"rotation = .*", f"rotation = {so3_log(turn @ so3_exp(rotation)).tolist()}", block)
    spoilt = re.sub(r"translation = .*", f"translation = {(turn @ translation).tolist()}", spoilt)
    path.write_text(text.replace(block, spoilt))
    code, out, err = hypose("check", keypoint_recording, "--frames", "30", "--samples", "1")
    assert code == 1 and "fault: cam2:" in out and "hypose check --refine" in out, out + err
    code, out, err = hypose("check", keypoint_recording, "--frames", "30", "--samples", "1", "--refine")
    assert code == 0, out + err
    new = read_any(keypoint_recording / "results" / "calibration_refined.toml")[0]
    assert "hypose track" in out and "frames not used" in out
    off = [
        np.degrees(np.linalg.norm(so3_log(a.camera_from_world[:3, :3] @ b.camera_from_world[:3, :3].T)))
        for a, b in zip(true, new, strict=True)
    ]
    assert off[1] < 1.0 and np.median(off) < 0.6  # of 2 degrees; the person is 65 px tall
    hypose("check", keypoint_recording, "--frames", "0", "--samples", "1", "--refine")
    assert (keypoint_recording / "results" / "calibration_refined-2.toml").is_file()

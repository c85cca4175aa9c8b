"""What the View screen and the report are fed: the block of bytes, the pictures of any frame, the results folder."""

import gzip
import json
import re
import shutil
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hypose.app.reports import report
from hypose.app.reports.report import drawn_of, report_html
from hypose.app.studio.view_bundle import load_view, view_bundle
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.io.motions.results import load_motion, save_motion
from hypose.io.recordings.recording import load_recording
from tests.bundles import read_bundle


@pytest.fixture
def folder(tiny, tracked, tmp_path):
    """The recording with its results where hypose puts them."""
    shutil.copytree(tiny, tmp_path / "walk")
    return shutil.copytree(tracked, tmp_path / "walk" / "results" / "default")


# ---- the block


def test_rival_poses_come_from_the_motion_itself(folder):
    motion = load_motion(folder / "motion.npz")
    t, d = motion.poses.shape
    rivals = np.full((t, 2, d), np.nan, np.float32)
    rivals[3, 0] = motion.poses[3]
    rivals[3, 0, :3] += 1
    weights = np.zeros((t, 2), np.float32)
    weights[3, 0] = 0.3
    save_motion(replace(motion, rivals=rivals, rival_weights=weights), folder / "motion.npz")
    found = read_bundle(view_bundle(load_view(folder)))[1]
    assert found["rival_rows"].tolist() == [3]
    np.testing.assert_allclose(found["rival_joints"][0, 0], motion.skeleton.forward(motion.poses[3])[1] + 1, atol=1e-5)
    assert np.isfinite(found["rival_joints"]).all((2, 3)).sum() == 1
    np.testing.assert_allclose(found["rival_weights"][3], [0.7, 0.3, np.nan], rtol=1e-6)
    save_motion(replace(motion, rivals=rivals, rival_weights=0 * weights), folder / "motion.npz")
    assert "rival_joints" not in read_bundle(view_bundle(load_view(folder)))[1]


@pytest.mark.parametrize("shape", [(8, 1), (5, 3)])
def test_modes_that_are_alone_or_of_another_motion_are_no_rivals(folder, shape):
    np.savez(folder / "modes.npz", joints=np.zeros((*shape, 19, 3)), weights=np.ones(shape))
    assert "rival_joints" not in read_bundle(view_bundle(load_view(folder)))[1]


def test_a_block_holds_what_the_result_holds(folder):
    result = load_view(folder)
    header, arrays = read_bundle(view_bundle(result))
    motion, body = result.motion, result.body
    assert header["frames"] == len(motion) and header["title"] == load_recording(folder.parents[1]).name
    assert [c["name"] for c in header["cameras"]] == ["cam1", "cam2", "cam3", "cam4"]
    assert all(c["pictures"] and len(c["distortion"]) == 5 for c in header["cameras"])
    np.testing.assert_allclose(arrays["joints"], motion.joints, atol=1e-6)
    np.testing.assert_array_equal(arrays["times"], motion.times)
    assert header["truth"]["mean_mm"] > 0 and arrays["truth_joints"].shape == motion.joints.shape
    assert "Gauss-Newton" in header["citation"] and "stature" in dict(header["subject"])
    assert arrays["fine_vertices"].shape == body.fine.vertices.shape
    # rotation, rest joints and weights give the body that Python skins
    turn = Rotation.from_quat(arrays["rotations"][4]).as_matrix()
    index, weight = arrays["fine_skin_index"], arrays["fine_skin_weight"]
    local = arrays["fine_vertices"][:, None] - arrays["rest_joints"][index]
    moved = arrays["joints"][4][index] + np.einsum("vkij,vkj->vki", turn[index], local)
    skinned = np.einsum("vk,vki->vi", weight, moved)
    assert len(turn) == len(header["joint_names"])
    np.testing.assert_allclose(skinned, body.skin(motion.poses[4], body.fine), atol=2e-5)


# ---- the folder


def test_what_cannot_be_read_is_left_out_and_named(folder):
    (folder / "modes.npz").write_bytes(b"no archive")
    assert any("Other poses are not shown" in note for note in load_view(folder).notes)
    (folder / "body.npz").write_bytes(b"nonsense")
    (folder.parents[1] / "truth.npz").write_bytes(b"nonsense")
    result = load_view(folder)
    assert result.body is None and result.truth is None
    assert any("body.npz" in n for n in result.notes) and any("truth.npz" in n for n in result.notes)
    (folder.parents[1] / "calibration.toml").unlink()
    result = load_view(folder)
    assert result.recording is None and any("cannot be shown" in n for n in result.notes)


# ---- pictures


# ---- the report


@pytest.fixture
def built(tmp_path, monkeypatch):
    """A front end of two lines."""
    static = tmp_path / "static"
    static.mkdir()
    (static / "report.js").write_text('console.log("</script>")')
    (static / "report.css").write_text(".viewer { color: red }")
    monkeypatch.setattr(report, "_STATIC", static)
    return static


def part(page, name):
    return re.search(rf'<script[^>]* id="{name}">(.*?)</script>', page, re.DOTALL).group(1)


def test_a_report_carries_the_result_and_pictures(folder, built):
    result = load_view(folder)
    page = report_html(result, drawn_of(result))
    header, arrays = read_bundle(gzip.decompress(b64decode(part(page, "hypose-result"))))
    assert header["frames"] == 8 and header["citation"] == result.citation
    np.testing.assert_array_equal(arrays["rotations"], read_bundle(view_bundle(result))[1]["rotations"])
    stored = json.loads(part(page, "hypose-pictures"))
    assert stored["rows"] == list(range(8)) and all(len(files) == 4 for files in stored["files"])
    assert b64decode(stored["files"][0][0])[:2] == b"\xff\xd8"
    assert '<\\/script>")' in page and report.PLACE in page and "default-src 'none'" in page


def test_without_the_front_end_a_report_has_its_text(folder, built):
    (built / "report.js").unlink()
    page = report_html(load_view(folder))
    assert "<script" not in page and "hypose-viewer" not in page and "Subject" in page


def test_the_report_command_writes_where_it_is_told(folder, built, hypose, tmp_path):
    code, out, err = hypose("report", folder, "--out", tmp_path / "here.html")
    assert code == 0, err
    assert str(tmp_path / "here.html") in out and report.PLACE in (tmp_path / "here.html").read_text()


# ---- what is wrong


def test_low_confidence_the_assessment_and_the_sd_of_angles_come_with_the_motion(folder):
    motion = load_motion(folder / "motion.npz")
    t, j = motion.joints.shape[:2]
    low = np.zeros((t, j), dtype=bool)
    low[2:6, motion.skeleton.joint("left_wrist")] = True
    probability = np.where(low, np.float32(0.6), np.float32(0.01))
    probability[7] = np.nan
    about = {"low_confidence_joints": low, "low_confidence": low.any(1), "error_probability": probability}
    sd = np.full((t, len(ANGLE_NAMES)), np.radians(2), np.float32)
    save_motion(replace(motion, angle_sd=sd, **about), folder / "motion.npz")
    (folder / "assessment.json").unlink(missing_ok=True)
    header, arrays = read_bundle(view_bundle(load_view(folder)))
    np.testing.assert_array_equal(arrays["low_confidence_joints"], low)
    percent = np.where(np.arange(t)[:, None] == 7, 255, np.where(low, 60, 1))
    np.testing.assert_array_equal(arrays["error_probability"], percent)
    knee, tx = ANGLE_NAMES.index("knee_angle_l"), ANGLE_NAMES.index("pelvis_tx")
    assert arrays["angle_sd"].shape == arrays["angles"].shape
    np.testing.assert_allclose(arrays["angle_sd"][knee], 2, rtol=1e-6)  # degrees, as the angles are
    np.testing.assert_allclose(arrays["angle_sd"][tx], np.radians(2), rtol=1e-6)  # metres
    assert header["assessment"]["word"] == "look" and "left wrist may be wrong" in header["assessment"]["sentence"]

"""`hypose track`, `export` and what an interruption leaves: everything through the command line."""

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import replace

import ezc3d
import numpy as np
import pytest

import hypose as package
from hypose.app.jobs.job import DESCRIPTIONS
from hypose.calibration.findings import Finding
from hypose.cameras.camera import CameraRig
from hypose.io.motions.marker_files import read_trc
from hypose.io.motions.results import load_body, load_motion
from hypose.io.videos.video import open_video
from hypose.pipeline.assessment import UNTRUSTED, Assessment
from hypose.synthetic.metrics import joint_errors
from tests.app.conftest import write_tiny
from tests.conftest import HANG_S

LIGHT = ("--no-overlay", "--formats", "trc")


def test_the_files_of_a_result_are_of_the_recorded_motion(tracked, tiny):
    assert {p.name for p in tracked.iterdir()} == set(DESCRIPTIONS) - {"modes.npz"}  # several cameras have one mode
    motion = load_motion(tracked / "motion.npz")
    assert len(motion) == 8 and motion.frame_rate == pytest.approx(25)
    assert not motion.lost.any() and not motion.extrapolated.any()
    with np.load(tiny / "truth.npz") as truth:
        assert joint_errors(motion.joints, truth["joints"]).mean() < 0.08  # the person is 60 px tall
    points = ezc3d.c3d(str(tracked / "motion.c3d"))["data"]["points"][:3].transpose(2, 1, 0) / 1000
    np.testing.assert_allclose(points, motion.joints, atol=1e-6)
    assert read_trc(tracked / "motion.trc").points.shape == motion.joints.shape
    assert load_body(tracked / "body.npz").skeleton.joint_names == motion.skeleton.joint_names
    with open_video(tracked / "overlay.webm") as video:
        assert (video.n_frames, video.size) == (8, (320, 266))


def test_the_closing_lines_tell_what_came_out(hypose, tiny, tmp_path):
    code, out, err = hypose("track", tiny, "--out", tmp_path, "--frames", "1:4", *LIGHT)
    assert code == 0, err
    assert re.search(r"3 frames in 4 views, 0 lost, 0 extrapolated, mean IoU 0\.\d+", out)
    assert str(tmp_path / "report.html") in out
    assert "Track: 3/3" in err
    assert load_motion(tmp_path / "motion.npz").provenance["settings"]["frames"] == [1, 4]
    assert not (tmp_path / "overlay.webm").exists() and not (tmp_path / "motion.c3d").exists()


@pytest.mark.slow
def test_a_published_recipe_with_refinement(hypose, tiny, tmp_path):
    code, _, err = hypose("track", tiny, "--recipe", "hpf", "--refine", "--frames", "1:4", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    assert load_motion(tmp_path / "motion.npz").provenance["recipe"] == "hpf"


def test_export_writes_the_chosen_formats_again(hypose, tracked, tmp_path):
    code, out, err = hypose("export", tracked, "--formats", "bvh,.TRC", "--out", tmp_path)
    assert code == 0, err
    assert {p.name for p in tmp_path.iterdir()} == {"motion.bvh", "motion.trc"}
    assert (tmp_path / "motion.trc").read_bytes() == (tracked / "motion.trc").read_bytes()
    assert str(tmp_path / "motion.bvh") in out


def test_ctrl_c_before_the_first_frame_keeps_the_body_and_says_so(interrupted, tiny, tmp_path):
    code, out, _ = interrupted("track", 0, "track", tiny, "--out", tmp_path / "out", *LIGHT)
    assert code == 130 and "Kept: body and start" in out


@pytest.mark.slow
def test_ctrl_c_after_tracking_keeps_the_motion_and_resume_writes_the_rest(
    hypose, interrupted, tiny, tracked, tmp_path
):
    arguments = ("track", tiny, "--out", tmp_path / "out")
    code, out, _ = interrupted("overlay", 3, *arguments)
    assert code == 130 and "Kept: 8 of 8 frames" in out and not (tmp_path / "out" / "overlay.webm").exists()
    code, _, err = hypose(*arguments, "--resume")
    assert code == 0 and "Track:" not in err  # it was not tracked again
    assert (tmp_path / "out" / "motion.npz").read_bytes() == (tracked / "motion.npz").read_bytes()
    assert {p.name for p in (tmp_path / "out").iterdir()} == set(DESCRIPTIONS) - {"modes.npz"}  # of one camera only


@pytest.mark.slow
def test_the_number_of_threads_does_not_change_the_bytes(hypose, tiny, tmp_path, monkeypatch):
    for count in ("1", "2"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", count)
        assert hypose("track", tiny, "--out", tmp_path / count, "--frames", "4:7", *LIGHT)[0] == 0
    assert (tmp_path / "1" / "motion.npz").read_bytes() == (tmp_path / "2" / "motion.npz").read_bytes()


# ---- processes that are killed


@pytest.fixture(scope="module")
def longer(tmp_path_factory):
    """60 frames: checkpoints are written every 25."""
    return write_tiny(tmp_path_factory.mktemp("longer") / "walk", 2.4)


def command(recording, out, *more):
    return [
        *(sys.executable, "-m", "hypose.app", "track", str(recording), "--out", str(out)),
        *("--no-overlay", "--formats", "trc", *more),
    ]


def run(*arguments):
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(command(*arguments), capture_output=True, text=True, env=environment, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def begun(longer, out):
    """A run that has written two checkpoints: one before the first frame, and one after some frames."""
    process = subprocess.Popen(command(longer, out), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    deadline, written = time.monotonic() + HANG_S, set()
    while len(written) < 2:
        assert process.poll() is None and time.monotonic() < deadline
        written |= {p.stat().st_mtime_ns for p in out.glob("checkpoint.npz")}
        time.sleep(0.02)
    return process


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_bytes(longer, tmp_path):
    run(longer, tmp_path / "whole")
    with begun(longer, tmp_path / "killed") as process:
        process.kill()
    assert not (tmp_path / "killed" / "motion.npz").exists()
    said = run(longer, tmp_path / "killed", "--resume")
    assert "Track: 25/60" in said or "Track: 50/60" in said  # it went on, it did not start again
    whole, killed = (tmp_path / name / "motion.npz" for name in ("whole", "killed"))
    assert len(load_motion(whole)) == 60 and killed.read_bytes() == whole.read_bytes()


@pytest.mark.slow
def test_sigterm_is_an_orderly_stop(longer, tmp_path):
    process = begun(longer, tmp_path)
    process.terminate()
    out, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 130 and "Kept: " in out and "--resume" in out
    assert 25 <= len(load_motion(tmp_path / "motion.npz")) < 60


# ---- the assessment


POINTS = ("--evidence", "keypoints", "--no-overlay", "--formats", "csv")


def test_a_good_recording_ends_as_good(hypose, keypoint_recording, tmp_path):
    code, out, _ = hypose("track", keypoint_recording, "--out", tmp_path / "out", *POINTS)
    assert code == 0 and "Assessment: Good" in out
    assert json.loads((tmp_path / "out" / "assessment.json").read_text())["assessment"] == "good"


@pytest.mark.slow
def test_a_world_upside_down_ends_as_not_to_be_trusted(hypose, keypoint_recording, tmp_path):
    path = keypoint_recording / "calibration.toml"
    rig, _ = package.read_calibration(path)
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = [replace(c, camera_from_world=c.camera_from_world @ turned) for c in rig]
    package.write_calibration(CameraRig(tuple(cameras)), path)
    code, out, err = hypose("track", keypoint_recording, "--out", tmp_path / "out", *POINTS)
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

"""The View screen and the report in Chromium: what needs results of its own (the rest: web/tests/view.path.mjs)."""

import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.studio.long_results import long_result
from hypose.app.cli import run_cli
from hypose.app.reports.report import PLACE, drawn_of, report_html
from hypose.app.reports.result_pictures import as_shown
from hypose.app.studio.view_bundle import load_view
from hypose.calibration.findings import REVIEW, Finding
from hypose.io.motions.results import load_body, load_motion, save_motion
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.assessment import assess
from hypose.pipeline.comparison import compare_with_truth
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import write_scene
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving
from tests.app.studio.spoilt import ARM, ROWS, spoil_arm


def flagged(source, target):
    """The run with two lost frames and an extrapolated one."""
    motion = load_motion(source / "motion.npz")
    n = np.arange(len(motion))
    target.mkdir(parents=True)
    sure = {"low_confidence": n < 0, "low_confidence_joints": np.zeros_like(motion.low_confidence_joints)}
    save_motion(replace(motion, lost=(n == 6) | (n == 7), extrapolated=n == 3, **sure), target / "motion.npz")
    shutil.copy(source / "body.npz", target)


def one_camera(source, target):
    """The run with modes beside it, as a track with one camera has them: three poses, in the last frame only one."""
    motion = load_motion(source / "motion.npz")
    shutil.copytree(source, target)
    joints = motion.joints[:, None] + np.array([0.0, 0.25, -0.3])[:, None, None]
    joints[-1, 1:] = np.nan
    weights = np.tile([0.62, 0.3, 0.08], (len(motion), 1))
    weights[-1] = 1, np.nan, np.nan
    np.savez(target / "modes.npz", joints=joints, weights=weights)


def expected(recording, results, row=5):
    """What skinning and projection give in Python, and the regions that hold a joint with 90 %."""
    body, motion = load_body(results / "body.npz"), load_motion(results / "motion.npz")
    vertices = body.skin(motion.poses[row])
    cameras = []
    for view, camera in zip(recording.views, recording.rig, strict=True):
        pixels = as_shown(view, camera, camera.size).project(vertices)
        cameras.append({"points": vertices.ravel().tolist(), "pixels": pixels.ravel().tolist()})
    regions = chi2.ppf(0.9, 3) * motion.joint_covariance[row].astype(float)
    spread = {"joints": motion.joints[row].tolist(), "regions": regions.tolist()}
    return {"row": row, "vertices": vertices.ravel().tolist(), "cameras": cameras, **spread}


@pytest.mark.slow
def test_flags_and_comparison(served, page, tmp_path):
    root = shutil.copytree(served, tmp_path / "root")
    default = root / "walk" / "results" / "default"
    flagged(default, default.with_name("flagged"))
    one_camera(default, default.with_name("monocular"))
    (root / "expected.json").write_text(json.dumps(expected(load_recording(root / "walk"), default)))
    with serving(root) as client:
        go(WEB / "tests" / "view_own.walk.mjs", client.address, root, tmp_path)


@pytest.mark.long
def test_ten_minutes(served, page, tmp_path):
    root = tmp_path / "root"
    long_result(served / "walk" / "results" / "default", root / "long", 15_000)
    with serving(root) as client:
        said = go(WEB / "tests" / "view_long.walk.mjs", client.address, root, tmp_path)
    measured = json.loads(said.strip().splitlines()[-1])
    sys.stdout.write(f"\nView: {measured}\n")
    assert all(np.isfinite(v) for v in measured.values())


def true_pixels(recording, motion, row, cameras):
    """Where the joints of a spoilt arm are in the pictures as recorded: {camera: {joint: [x, y]}}."""
    at = [motion.skeleton.joint(n) for n in ARM]
    found = {}
    for name in cameras:
        k = recording.rig.names.index(name)
        shown = as_shown(recording.views[k], recording.rig[k], recording.rig[k].size)
        seen = shown.project(motion.joints[row, at])
        found[name] = dict(zip(ARM, seen.tolist(), strict=True))
    return found


@pytest.fixture(scope="module")
def longer(tmp_path_factory):
    """A recording of 1.6 s with its result, large enough that a limb can be told to a few centimetres."""
    root = tmp_path_factory.mktemp("longer")
    scene = make_scene("walk", "neutral", camera_rig("humaneva-4", distorted=True).scaled(0.5), seconds=1.6, seed=3)
    write_scene(scene, root / "walk", background_frames=10)
    with pytest.raises(SystemExit) as stopped:
        run_cli(["track", str(root / "walk"), "--formats", "csv", "--no-overlay"])
    assert stopped.value.code in (None, 0)
    return root


@pytest.mark.long
def test_a_spoilt_arm_is_seen_and_put_right(longer, page, tmp_path):
    """Seen by `n`, corrected in six actions, and below 40 mm from the truth in the frames around afterwards."""
    root = shutil.copytree(longer, tmp_path / "root")
    results = root / "walk" / "results" / "default"
    good = load_motion(results / "motion.npz")
    spoilt = spoil_arm(results)
    recording = load_recording(root / "walk")
    pixels = true_pixels(recording, good, ROWS.start, ("cam1", "cam3"))
    (root / "expected.json").write_text(json.dumps({"first": ROWS.start, "joints": pixels}))
    with serving(root) as client:
        go(WEB / "tests" / "correct.walk.mjs", client.address, root, tmp_path)
    corrected = load_motion(root / "corrected.npz")
    truth = root / "walk" / "truth.npz"
    arm = [compare_with_truth(truth, good, 0).names.index(n) for n in ARM]
    off = {
        n: 1000 * compare_with_truth(truth, m, 0).distances[ROWS][:, arm]
        for n, m in (("spoilt", spoilt), ("now", corrected))
    }
    sys.stdout.write(
        f"\nArm, mm from the truth: spoilt {off['spoilt'].mean():.0f}, corrected {off['now'].mean():.0f}\n"
    )
    assert off["spoilt"].mean() > 200 and off["now"].mean(0).max() < 40


@pytest.mark.slow
def test_much_said_of_a_result_covers_nothing(served, page, tmp_path, monkeypatch):
    """A long assessment and the button to the next doubt, in all sizes of the window."""
    root = shutil.copytree(served, tmp_path / "root")
    results = root / "walk" / "results" / "default"
    spoilt = spoil_arm(results, slice(2, 6))
    reported = assess(
        spoilt, [Finding("late", (), f"camera {k} may be late by {k} frames", severity=REVIEW) for k in range(8)]
    )
    (results / "assessment.json").write_text(json.dumps(reported.document()))
    monkeypatch.setenv("ONLY", "view,view-quality")
    with serving(root) as client:
        go(WEB / "tests" / "layout.path.mjs", client.address, root, tmp_path)


@pytest.mark.slow
def test_a_report_is_the_same_view_from_disk(served, page, tmp_path):
    result = load_view(served / "walk" / "results" / "default")
    text = report_html(result, drawn_of(result))
    assert PLACE in text
    file = tmp_path / "report with spaces.html"
    file.write_text(text, encoding="utf-8")
    go(WEB / "tests" / "report.walk.mjs", file.as_uri(), tmp_path, tmp_path)

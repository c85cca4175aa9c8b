"""`hypose check`, `silhouettes`, `synth`, `demo`, the report and the pictures."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hypose.app.reports.report import report_html
from hypose.app.reports.result_pictures import mask_outline
from hypose.app.studio.view_bundle import ViewResult
from hypose.body.default_body import human
from hypose.compute.parts import covered
from hypose.io.motions.results import load_body, load_motion
from hypose.io.recordings.recording import load_recording
from hypose.io.videos.video import open_video
from hypose.synthetic.scenes import camera_rig


def test_check_shows_every_camera_and_finds_nothing_wrong(hypose, tiny, tmp_path):
    code, out, err = hypose("check", tiny, "--out", tmp_path / "sheet.png")
    assert code == 0, out + err
    for name in ("cam1", "cam2", "cam3", "cam4", "cam1.mp4", "160x120", "No problem found"):
        assert name in out
    heights = [float(h) for h in re.findall(r"litres, (\d\.\d+) m high", out)]
    assert len(heights) == 5 and 1.4 < np.median(heights) < 2.1
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] == 320


def test_check_warns_of_a_view_that_contradicts_the_others(hypose, recording):
    # the calibration now says that camera 2 stands where camera 1 does: what it sees does not fit the others
    path = recording / "calibration.toml"
    parts = re.split(r"(?=\[cam\d\])", path.read_text())
    first, second = (next(p for p in parts if p.startswith(f"[cam{k}]")) for k in (1, 2))
    for key in ("rotation", "translation"):
        value = re.search(rf"{key} = .*", first).group(0)
        parts[parts.index(second)] = second = re.sub(rf"{key} = .*", lambda m, value=value: value, second)
    path.write_text("".join(parts))
    code, out, _ = hypose("check", recording)
    assert code == 1
    assert "warning: " in out and "calibration" in out


def test_masks_can_be_given_back(hypose, recording):
    code, out, err = hypose("silhouettes", recording)
    assert code == 0, err
    folder = recording / "results" / "silhouettes"
    assert len(list((folder / "cam3").glob("*.png"))) == 8 and str(folder) in out
    assert (folder / "sheet.jpg").is_file()
    toml = recording / "recording.toml"
    given = re.sub(r'name = "(cam\d)"\n', r'name = "\1"\nmasks = "results/silhouettes/\1"\n', toml.read_text())
    toml.write_text(given)
    assert all("masks" in v.files for v in load_recording(recording).views)
    code, out, err = hypose("check", recording)
    assert code == 0, out + err


def test_synth_writes_what_was_asked_for(hypose, tmp_path):
    arguments = ("--motion", "wave", "--subject", "1", "--rig", "ring-2", "--seconds", "0.12", "--corruption", "desync")
    code, out, err = hypose("synth", tmp_path / "scene", *arguments, "--keypoints", "--frame-rate", "50")
    assert code == 0, err
    assert "6 frames, 2 cameras" in out
    loaded = load_recording(tmp_path / "scene")
    assert loaded.frame_rate == 50 and loaded.n_frames == 6 and loaded.keypoint_set == "BODY_25"
    with np.load(tmp_path / "scene" / "truth.npz") as truth:
        assert truth["joints"].shape == (6, 19, 3)


# ---- report


@pytest.fixture
def result(tracked, tiny):
    return load_motion(tracked / "motion.npz"), load_body(tracked / "body.npz"), load_recording(tiny)


def test_the_report_holds_pictures_and_origin_and_loads_nothing(tracked):
    page = (tracked / "report.html").read_text()
    assert "default-src 'none'" in page and not re.search(r"<script[^>]*\bsrc", page)
    page = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    targets = re.findall(r'(?:src|href|action|data|poster)\s*=\s*"([^"]*)"', page)
    assert targets and all(t.startswith(("data:", "#")) for t in targets)
    assert not re.search(r"@import|url\(\s*['\"]?(?!#)|<script|<iframe", page)
    assert page.count("data:image/jpeg;base64,") >= 4
    assert all(text in page for text in ("stature", "sha256", "motion.c3d", "Gauss-Newton"))


def test_the_report_says_what_went_wrong(result):
    motion, body, recording = result
    lost = np.arange(8) >= 5
    nothing = np.full(8, np.nan)
    bad = replace(motion, lost=lost, extrapolated=lost, cost=nothing, joint_covariance=np.full((8, 19, 3, 3), np.nan))
    notes = ['View <cam1>: "dark" & blurred']
    page = report_html(ViewResult("a < b", bad, body, recording, notes=notes, complete=False))
    assert "View &lt;cam1&gt;: &quot;dark&quot; &amp; blurred" in page and "a &lt; b" in page
    assert "interrupted" in page and "No silhouettes were used" in page
    assert "<b>3</b><span>frames lost" in page


# ---- pictures


def test_the_outline_of_an_undistorted_mask_lies_on_the_recorded_person():
    camera, body = camera_rig("humaneva-4", distorted=True)[0], human()
    working = camera.scaled((480, 360)).pinhole()
    pose = np.zeros(body.skeleton.dof)
    pose[:3] = 0.3, -0.6, 0.95
    vertices = body.skin(pose, body.fine)

    def shape(uv, size):
        depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        return covered(uv, depth, body.fine.faces, size[::-1]).astype(np.uint8)

    mask = shape(working.project_pinhole(vertices), working.size)
    recorded = shape(camera.project(vertices), camera.size)
    distance = cv2.distanceTransform(1 - recorded, cv2.DIST_L2, 5) + cv2.distanceTransform(recorded, cv2.DIST_L2, 5)
    outlines = mask_outline(camera, working, mask)
    uv = np.rint(np.concatenate(outlines)[:, 0] / 16).astype(int)
    assert len(uv) > 100
    off = distance[uv[:, 1], uv[:, 0]]
    assert np.percentile(off, 95) < 3 and off.mean() < 1.5
    moved = np.rint(working.scaled((640, 480)).project_pinhole(vertices) - camera.project(vertices))
    assert np.abs(moved).max() > 2  # without the lens it would show


def test_the_overlay_marks_the_person(tracked, tiny):
    with open_video(tracked / "overlay.webm") as video, open_video(tiny / "videos" / "cam1.mp4") as plain:
        overlay = video.read(4)[26 : 26 + 120, :160].astype(int)
        image = plain.read(4).astype(int)
    changed = np.abs(overlay - image).max(2) > 25
    rows, columns = np.nonzero(changed[20:])  # below the view's name
    assert 40 < len(rows) < 0.2 * changed.size
    assert np.ptp(columns) < 60

"""Recordings over the wire: facts, pictures, masks tried out and kept, clicked joints."""

import json
from urllib.parse import quote

import cv2
import numpy as np
import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.pictures import OpenRecording
from hypose.app.studio.recordings import Recordings
from hypose.io.motions.results import load_body, load_motion
from hypose.io.recordings.recording import load_recording
from hypose.synthetic.write_recording import walking_scene, write_depth_scene
from tests.app.studio.conftest import serving


def image(client, path):
    status, headers, data = client.ask(path)
    assert status == 200 and headers["content-type"] == "image/jpeg", data[:300]
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def test_a_recording_says_what_it_is(studio):
    r = studio.get(f"/api/recordings/{studio.recording}")
    assert r["problem"] is None and r["frames"] == 8 and r["frame_rate"] == pytest.approx(25)
    assert [v["video"] for v in r["views"]] == [f"cam{k}.mp4" for k in (1, 2, 3, 4)]
    assert r["cameras"][0]["size"] == [160, 120] and np.shape(r["cameras"][0]["K"]) == (3, 3)
    assert r["mask_settings"]["threshold"] == 4.0 and r["check"] is None and r["subject"] is None


def test_a_recording_that_cannot_be_used_says_why(own_studio, folder):
    (folder / "walk" / "calibration.toml").write_text("nonsense")
    r = own_studio.get(f"/api/recordings/{own_studio.recording}")
    assert "calibration.toml" in r["problem"] and r["views"] == [] and r["results"]


def test_pictures_are_undistorted_and_masks_follow_the_settings(studio):
    base = f"/api/recordings/{studio.recording}/image/cam1"
    plain = image(studio, f"{base}/4.jpg?width=120")
    assert plain.shape == (90, 120, 3)
    usual = image(studio, f"{base}/4.jpg?mask=only") > 127
    timid = image(studio, f"{base}/4.jpg?mask=only&settings=" + quote('{"threshold": 40, "min_sd": 30}')) > 127
    assert 0.01 < usual.mean() < 0.3 and timid.mean() < 0.8 * usual.mean()
    assert not np.array_equal(image(studio, f"{base}/4.jpg?mask=edge"), image(studio, f"{base}/4.jpg?mask=fill"))
    # frames in any order are the same frames
    later, again = image(studio, f"{base}/7.jpg"), image(studio, f"{base}/4.jpg?width=120")
    assert later.shape == (120, 160, 3) and np.array_equal(again, plain)


@pytest.mark.slow
def test_depth_views_are_pictures_and_cut_out_by_depth(tmp_path):
    """In Set up and in View; near is bright, and what no setting changes is said to have none."""
    scene = walking_scene("wave", "", "depth-1", seconds=0.2, frame_rate=25.0, seed=5)
    write_depth_scene(scene, tmp_path / "depth")
    with serving(tmp_path) as client:
        id = client.recording
        (view,) = client.get(f"/api/recordings/{id}")["views"]
        assert view["depth"] == view["name"] and view["masks"] is None
        base = f"/api/recordings/{id}/image/{view['name']}/2.jpg"
        plain, person = image(client, base), image(client, f"{base}?mask=only") > 127
        assert plain[person].mean() > 1.5 * plain[~person].mean() and 0.02 < person.mean() < 0.3
    pictures = OpenRecording(load_recording(tmp_path / "depth"), (0, 5))
    jpeg = pictures.row(2, 640)[8:]
    (lines,) = pictures.outlines(2)
    pictures.close()
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert shown.std() > 30 and max(map(len, lines)) > 40


def test_mask_settings_are_kept_in_the_recording_and_used(own_studio, folder):
    id = own_studio.recording
    before = (folder / "walk" / "recording.toml").read_text()
    saved = own_studio.get(f"/api/recordings/{id}/mask-settings", {"threshold": 6.5, "shadow": False})
    assert saved["threshold"] == 6.5 and saved["shadow"] is False and saved["close_px"] == 5
    options = load_recording(folder / "walk").silhouettes
    assert options.threshold == 6.5 and not options.shadow
    assert own_studio.get(f"/api/recordings/{id}")["mask_settings"]["threshold"] == 6.5
    own_studio.get(f"/api/recordings/{id}/mask-settings", {})
    assert (folder / "walk" / "recording.toml").read_text() == before
    for bad in ({"threshold": -1}, {"treshold": 4}, {"shadow": 1}, {"shadow_range": [0.5]}):
        assert "settings" in own_studio.get(f"/api/recordings/{id}/mask-settings", bad, status=400)["error"]


@pytest.fixture(scope="module")
def pose(served):
    folder = served / "walk" / "results" / "default"
    return load_body(folder / "body.npz"), load_motion(folder / "motion.npz").poses[4]


def clicks(client, pose, cameras, joints=None):
    body, q = pose
    rig = load_recording(client.studio.catalog.items("recording")[0].path).rig.pinhole()
    centres = dict(zip(body.skeleton.joint_names, body.joints(q), strict=True))
    names = [j["joint"] for j in client.get("/api/click-joints") if j["joint"] in centres]
    out = []
    for name in cameras:
        uv = rig.select([name])[0].project_pinhole(np.stack([centres[n] for n in names]))
        points = [{"joint": n, "x": x, "y": y} for n, (x, y) in zip(names, uv.tolist(), strict=True)]
        out.append({"camera": name, "points": [p for p in points if joints is None or p["joint"] in joints]})
    return out


def test_clicks_in_two_views_give_the_pose(studio, pose):
    views = clicks(studio, pose, ["cam1", "cam2"])
    ask = {"recording": studio.recording, "frame": 4, "views": views}
    fit = studio.get("/api/fit-clicks", ask)
    error = np.linalg.norm(np.array(fit["joints"]) - pose[0].joints(pose[1]), axis=1)
    # another body than the one that was clicked: the usual person of the recording's height
    assert error.mean() < 0.06 and fit["rms_px"] < 2.0 and fit["depth_sd"] is None and fit["alternatives"] == []
    assert len(fit["pose"]) == 36 and np.shape(fit["rotations"]) == (19, 4) and np.shape(fit["covariance"]) == (19, 6)
    dragged = studio.get("/api/fit-clicks", {**ask, "start": fit["pose"]})
    assert abs(dragged["rms_px"] - fit["rms_px"]) < 0.1


def test_one_view_says_how_uncertain_depth_is_and_what_else_it_could_be(studio, pose):
    ask = {"recording": studio.recording, "frame": 4, "views": clicks(studio, pose, ["cam1"])}
    fit = studio.get("/api/fit-clicks", ask)
    assert fit["rms_px"] < 2.0 and 0.05 < fit["depth_sd"] < 1.0 and "distance" in fit["notes"][0]
    assert np.array(fit["joint_sd"]).mean() > 0.05
    best = np.array(fit["joints"])
    for other in fit["alternatives"]:
        assert np.linalg.norm(np.array(other["joints"]) - best, axis=1).max() > 0.05 and other["cost"] >= 0


def test_a_correction_stays_near_what_was_tracked(studio, pose):
    views = clicks(studio, pose, ["cam1"], {"left_wrist"})
    views[0]["points"][0]["x"] += 6
    fit = studio.get("/api/fit-clicks", {"result": studio.result, "frame": 4, "views": views})
    moved = np.linalg.norm(np.array(fit["joints"]) - pose[0].joints(pose[1]), axis=1)
    names = pose[0].skeleton.joint_names
    wrist = moved[names.index("left_wrist")]
    assert wrist > 0.03 and np.median(moved) < 0.3 * wrist and wrist == moved.max()


@pytest.mark.parametrize(
    "change",
    [
        {"views": []},
        {"views": "all"},
        {"views": [{"camera": "cam9", "points": []}]},
        {"views": [{"camera": "cam1", "points": [{"joint": "tail", "x": 1, "y": 1}]}]},
        {"views": [{"camera": "cam1", "points": [{"joint": "neck", "x": None, "y": 1}]}]},
        {"views": [{"camera": "cam1", "points": [{"joint": "neck", "x": 1, "y": 1}]}]},
        {"frame": "first"},
        {"height": 20},
        {"start": [0.0]},
        {"recording": None},
    ],
)
def test_clicks_that_cannot_be_are_answered_with_a_sentence(studio, pose, change):
    ask = {"recording": studio.recording, "frame": 4, "views": clicks(studio, pose, ["cam1"])}
    assert studio.get("/api/fit-clicks", {**ask, **change}, status=400)["error"].endswith(".")


def test_points_of_the_picture_as_recorded_have_the_lens_taken_out(own_studio, folder, pose):
    """The same joints clicked in undistorted pixels and in those of the recorded picture are the same pose."""
    recording = load_recording(folder / "walk")
    views = clicks(own_studio, pose, ["cam2"], {"left_wrist", "left_elbow"})
    body, q = pose
    camera, shift = recording.rig.select(["cam2"])[0], np.asarray(recording.views[1].image_shift)
    assert np.abs(camera.distortion).max() > 0
    names = [p["joint"] for p in views[0]["points"]]
    seen = camera.project(body.joints(q)[[body.skeleton.joint(n) for n in names]]) - shift
    points = [{"joint": n, "x": x + 4, "y": y} for n, (x, y) in zip(names, seen.tolist(), strict=True)]
    recorded = [{"camera": "cam2", "recorded": True, "points": points}]
    ask = {"result": own_studio.result, "frame": 4}
    fit = own_studio.get("/api/fit-clicks", {**ask, "views": recorded})
    assert np.abs(np.array(fit["pose"]) - q).max() > 1e-3  # what was moved by four pixels is followed
    id = own_studio.recording
    saved = {**ask, "views": recorded, "name": "arm", "since": 2, "until": 7}
    own_studio.get(f"/api/recordings/{id}/starts", saved, status=201)
    assert own_studio.get(f"/api/recordings/{id}/starts", {**saved, "name": "../x"}, status=400)["error"]
    assert own_studio.get(f"/api/recordings/{id}")["starts"] == ["arm"]
    kept = json.loads((folder / "walk" / "starts" / "arm.json").read_text())
    again = own_studio.get("/api/fit-clicks", {**ask, "views": kept["views"]})
    np.testing.assert_allclose(again["pose"], fit["pose"], atol=1e-9)
    assert (kept["since"], kept["until"], kept["result"]) == (2, 7, own_studio.result)
    assert own_studio.get(f"/api/recordings/{id}/starts", {**saved, "since": "x"}, status=400)["error"]
    # another correction of the same frame leaves the first as it is
    before = (folder / "walk" / "starts" / "arm.json").read_text()
    second = own_studio.get(f"/api/recordings/{id}/starts", {**saved, "until": 6}, status=201)
    assert second["name"] == "arm-2" and (folder / "walk" / "starts" / "arm.json").read_text() == before
    assert json.loads((folder / "walk" / "starts" / "arm-2.json").read_text())["until"] == 6


def test_open_recordings_are_bounded(folder, monkeypatch):
    recordings = Recordings(Catalog(folder))
    first = recordings.opened(folder / "walk")
    assert recordings.opened(folder / "walk") is first
    monkeypatch.setattr("hypose.app.studio.recordings._OPEN", 1)
    part, other = recordings.opened(folder / "walk", (0, 4)), recordings.opened(folder / "walk", (2, 4))
    assert part is not first and other is not part
    assert recordings.opened(folder / "walk", (2, 4)) is other  # the last used one stays, the others went
    assert recordings.opened(folder / "walk") is not first
    before = part.row(1, 64)
    recordings.close()
    assert part.row(1, 64) == before  # what is still in use opens again

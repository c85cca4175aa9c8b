"""Folders are looked into where they lie, and become recordings by a recording.toml that names the files in them."""

import shutil

import cv2
import numpy as np
import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import plan_job
from hypose.errors import InputError


@pytest.fixture
def filmed(folder):
    """A folder of two cameras: their videos, an empty room, a calibration, and what says nothing."""
    walk, place = folder / "walk", folder / "days" / "monday"
    for k in (1, 2):
        for name in ("walk", "board"):
            (place / name).mkdir(parents=True, exist_ok=True)
            shutil.copy(walk / "videos" / f"cam{k}.mp4", place / name / f"cam{k}.mp4")
    (place / "empty").mkdir()
    shutil.copy(walk / "background" / "cam1.mp4", place / "empty")
    shutil.copy(walk / "calibration.toml", place)
    (place / "notes.txt").write_text("what was filmed")
    return place


def wish(*roles, **more):
    views = [{"name": f"c{k}", "camera": f"cam{k}", **{r: f"{f}/cam{k}.mp4" for r, f in roles}} for k in (1, 2)]
    return {"folder": "days/monday", "name": "mine", "views": views, **more}


VIDEO, BOARD = ("video", "walk"), ("board", "board")


def test_a_folder_says_what_in_it_can_be_part_of_a_recording(own_studio, filmed):
    top = own_studio.get("/api/folder")
    assert top["path"] == "" and {f["path"] for f in top["folders"]} == {"days", "walk"} and top["files"] == []
    found = own_studio.get("/api/folder?path=days/monday&within")
    assert found["name"] == "monday" and found["recording"] is None and found["left_out"] == 0
    assert own_studio.get(f"/api/folder?path={filmed}&within") == found
    files = {f["path"]: f for f in found["files"]}
    assert set(files) == {"calibration.toml", "empty/cam1.mp4"} | {
        f"{f}/cam{k}.mp4" for f in ("board", "walk") for k in (1, 2)
    }
    assert files["calibration.toml"]["cameras"] == ["cam1", "cam2", "cam3", "cam4"]
    assert files["walk/cam1.mp4"]["kind"] == "video" and files["walk/cam1.mp4"]["frames"] == 8
    status, _, data = own_studio.ask("/api/folder/picture.jpg?path=days/monday/walk/cam1.mp4")
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert status == 200 and shown.shape == (120, 160, 3) and shown.std() > 10
    recording = own_studio.get("/api/folder?path=walk&within")
    assert recording["recording"] and recording["files"] == []
    assert any(
        f["path"] == "background/cam1.mp4"
        for f in own_studio.get(f"/api/folder?recording={recording['recording']}")["files"]
    )


def test_folders_with_a_file_per_frame_are_one_of_them(own_studio, filmed):
    for name, count in (("images/cam1", 4), ("photos", 2)):
        (filmed / name).mkdir(parents=True)
        for n in range(count):
            cv2.imwrite(str(filmed / name / f"{n:06d}.png"), np.zeros((12, 16, 3), np.uint8))
    (filmed / "walk" / "broken.mp4").write_bytes(b"no video")
    files = {f["path"]: f for f in own_studio.get("/api/folder?path=days/monday&within")["files"]}
    assert files["images/cam1"]["kind"] == "images" and files["images/cam1"]["frames"] == 4
    assert files["photos/000000.png"]["kind"] == "image"
    assert files["walk/broken.mp4"]["kind"] == "other" and "days" not in files["walk/broken.mp4"]["problem"]


def test_nothing_outside_of_the_served_folder_is_looked_into(own_studio, folder, filmed, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    shutil.copy(folder / "walk" / "videos" / "cam1.mp4", outside)
    (filmed / "link").symlink_to(outside)
    (filmed / "link.mp4").symlink_to(outside / "cam1.mp4")
    found = own_studio.get("/api/folder?path=days/monday&within")
    assert not any("link" in f["path"] for f in (*found["files"], *found["folders"]))
    for path in ("..", "days/monday/link", str(outside), "/etc", "days/../../outside"):
        assert "outside of root" in own_studio.get(f"/api/folder?path={path}&within", status=400)["error"]
        assert own_studio.ask(f"/api/folder/picture.jpg?path={path}")[0] == 400
    for path in ("none", "%00", "x" * 5000):
        assert "not there" in own_studio.get(f"/api/folder?path={path}", status=400)["error"]
    for view in ("../../../outside/cam1.mp4", "link.mp4", str(outside / "cam1.mp4"), "../../walk/videos/cam1.mp4"):
        ask = wish(VIDEO, calibration="calibration.toml")
        ask["views"][0]["video"] = view
        assert "lie" in own_studio.get("/api/recordings", ask, status=400)["error"]
    ask = wish(VIDEO, calibration="calibration.toml", folder=str(outside))
    assert "outside" in own_studio.get("/api/recordings", ask, status=400)["error"]
    assert not (filmed / "recording.toml").exists()


def test_a_folder_becomes_a_recording_and_its_files_stay(own_studio, filmed):
    before = sorted(filmed.rglob("*"))
    ask = wish(VIDEO, calibration="calibration.toml", frame_rate=25)
    ask["views"][0]["background"] = "empty/cam1.mp4"
    refused = own_studio.get("/api/recordings", {**ask, "frame_rate": -3}, status=400)["error"]
    assert "frame_rate" in refused and sorted(filmed.rglob("*")) == before
    made = own_studio.get("/api/recordings", ask, status=201)
    assert made["frames"] == 8 and made["path"] == "days/monday" and made["name"] == "mine" and len(made["views"]) == 2
    assert sorted(filmed.rglob("*")) == sorted([*before, filmed / "recording.toml"])
    assert own_studio.get("/api/recordings", ask, status=409)["error"]


@pytest.mark.parametrize(
    "change", [{"name": None}, {"views": []}, {"views": [{"video": 0}]}, {"folder": None}, {"calibration": "x"}]
)
def test_a_wish_that_means_nothing_makes_no_recording(own_studio, filmed, change):
    ask = {**wish(VIDEO, calibration="calibration.toml"), **change}
    assert own_studio.get("/api/recordings", ask, status=400)["error"].endswith(".")
    assert not (filmed / "recording.toml").exists()


def test_what_is_to_be_calibrated_is_a_recording_already(own_studio, folder, filmed):
    made = own_studio.get("/api/recordings", wish(VIDEO, BOARD), status=201)
    assert made["board"] == {"cameras": ["cam1", "cam2"], "calibrated": True, "sheet": None}
    (filmed / "calibration.toml").unlink()
    made = own_studio.get(f"/api/recordings/{made['id']}")
    assert not made["board"]["calibrated"] and made["problem"] is None and len(made["views"]) == 2
    boards = [str(filmed / "board" / f"cam{k}.mp4") for k in (1, 2)]
    ask = {"recording": made["id"], "options": {"square": "80mm"}}
    assert plan_job("calibrate", ask, Catalog(folder)).arguments == (
        *("calibrate", *boards, "--square=80mm", "--out", str(filmed / "calibration.toml")),
        *("--sheet", str(filmed / "results" / "calibration.png")),
    )
    shutil.copy(folder / "walk" / "calibration.toml", filmed)
    seen = own_studio.get(f"/api/recordings/{made['id']}")
    assert seen["problem"] is None and [v["name"] for v in seen["views"]] == ["c1", "c2"]


def test_every_camera_needs_its_clip_of_the_board(own_studio, folder, filmed):
    ask = wish(VIDEO, BOARD)
    del ask["views"][1]["board"]
    assert "no board of cam2" in own_studio.get("/api/recordings", ask, status=400)["error"]
    assert not (filmed / "recording.toml").exists()


def test_without_any_board_the_cameras_are_found_from_the_person(own_studio, folder, filmed):
    ask = wish(VIDEO, BOARD)
    for view in ask["views"]:
        del view["board"]
    (filmed / "calibration.toml").unlink()
    made = own_studio.get("/api/recordings", ask, status=201)
    board = own_studio.get(f"/api/recordings/{made['id']}")["board"]
    assert board == {"cameras": [], "calibrated": False, "sheet": None}
    planned = plan_job("calibrate", {"recording": made["id"], "options": {"height": 1.72}}, Catalog(folder))
    assert planned.arguments == ("calibrate", str(filmed), "--from-person", "--height=1.72")


def test_offsets_give_a_recording_of_their_own(folder):
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")
    made = plan_job("in_step", {"recording": item.id, "options": {"offsets": [-1, 0.25, 0, 2]}}, catalog)
    target = folder / "walk-in-step"
    assert made.arguments == ("sync", str(item.path), "--offsets=-1,0.25,0,2", "--out", str(target))
    assert made.makes == catalog.id_of("recording", target) and made.recording == item.id
    for bad in ({}, {"offsets": []}, {"offsets": [float("nan")]}, {"offsets": ["/x"]}):
        with pytest.raises(InputError):
            plan_job("in_step", {"recording": item.id, "options": bad}, catalog)

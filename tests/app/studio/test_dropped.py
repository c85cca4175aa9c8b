"""Dropped clips of a board, and the recordings that are made of them."""

import json

import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import plan
from hypose.errors import InputError


def put(client, name, data, status=201):
    return client.get(f"/api/uploads/{name}", method="PUT", data=data, status=status)


@pytest.fixture
def filmed(own_studio, folder):
    """The wish for a recording of two cameras with clips of a board and without a calibration."""
    walk = folder / "walk"

    def wish():
        views = []
        for k in (1, 2):
            clip = (walk / "videos" / f"cam{k}.mp4").read_bytes()
            files = {role: put(own_studio, f"{role}{k}.mp4", clip)["upload"] for role in ("video", "board")}
            views.append({"name": f"cam {k}", "camera": f"cam {k}", **files})
        return {"name": "raw", "views": views}

    return wish


def test_what_is_to_be_calibrated_is_a_recording_already(own_studio, folder, filmed):
    made = own_studio.get("/api/recordings", filmed(), status=201)
    assert made["board"] == {"cameras": ["cam_1", "cam_2"], "calibrated": False, "sheet": None}
    assert "no calibration" in made["problem"] and made["views"] == []
    catalog = Catalog(folder)
    path = folder / "raw"
    ask = {"recording": made["id"], "options": {"square": "80mm"}}
    boards = [str(path / "board" / f"cam_{k}.mp4") for k in (1, 2)]
    assert plan("calibrate", ask, catalog).arguments == (
        *("calibrate", *boards, "--square", "80mm", "--out", str(path / "calibration.toml")),
        *("--sheet", str(path / "results" / "calibration.png")),
    )
    # its calibration calls the cameras as their files are called
    text = (folder / "walk" / "calibration.toml").read_text()
    (path / "calibration.toml").write_text(text.replace("cam1", "cam_1").replace("cam2", "cam_2"))
    seen = own_studio.get(f"/api/recordings/{made['id']}")
    assert seen["problem"] is None and [v["name"] for v in seen["views"]] == ["cam 1", "cam 2"]
    assert seen["board"]["calibrated"] and [c["name"] for c in seen["cameras"]] == ["cam_1", "cam_2"]


def test_every_camera_needs_its_clip_of_the_board(own_studio, folder, filmed):
    wish = filmed()
    del wish["views"][1]["board"]
    assert "no clip of the board of cam 2" in own_studio.get("/api/recordings", wish, status=400)["error"]
    assert not (folder / "raw").exists()
    with pytest.raises(InputError, match="no clips of a board"):
        plan("calibrate", {"recording": own_studio.get("/api/state")["recordings"][0]["id"]}, Catalog(folder))


def test_offsets_give_a_recording_of_their_own(folder):
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")
    made = plan("in_step", {"recording": item.id, "options": {"offsets": [-1, 0.25, 0, 2]}}, catalog)
    target = folder / "walk-in-step"
    assert made.arguments == ("sync", str(item.path), "--offsets=-1,0.25,0,2", "--out", str(target))
    assert made.makes == catalog.id_of("recording", target) and made.recording == item.id
    for bad in ({}, {"offsets": []}, {"offsets": ["x"]}, {"offsets": "1,2"}):
        with pytest.raises(InputError):
            plan("in_step", {"recording": item.id, "options": bad}, catalog)
    assert plan("refine", {"recording": item.id, "options": {"far": True}}, catalog).arguments[2:] == (
        "--refine",
        "--far",
    )


def test_what_was_found_of_the_timing_is_shown(own_studio, folder):
    (folder / "walk" / "results" / "sync.json").write_text(
        json.dumps({"by": "motion", "views": [{"name": "cam1", "late": 1.5, "told": "sd 0.02"}]})
    )
    id = own_studio.get("/api/state")["recordings"][0]["id"]
    assert own_studio.get(f"/api/recordings/{id}")["sync"]["views"][0]["late"] == 1.5

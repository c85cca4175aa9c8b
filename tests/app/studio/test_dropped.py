"""Dropped folders of pictures, key points, masks and board clips, and the recordings that are made of them."""

import io
import json
import tarfile

import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.dropped_folders import unpack
from hypose.app.studio.job_kinds import plan
from hypose.errors import InputError
from hypose.io.recordings.recording import load_recording


def tar(files):
    """(name, bytes) as the archive that the page makes of a folder; a name that ends in @ is a link."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        for name, data in files:
            info = tarfile.TarInfo(name.rstrip("@"))
            info.size = len(data)
            if name.endswith("@"):
                info.type, info.linkname, info.size = tarfile.SYMTYPE, "/etc/passwd", 0
            archive.addfile(info, io.BytesIO(data))
    return out.getvalue()


def put(client, name, data, status=201):
    return client.get(f"/api/uploads/{name}", method="PUT", data=data, status=status)


def people(x):
    """A frame of OpenPose in which somebody stands at x."""
    points = [v for k in range(25) for v in (x + k, 20 + 3 * k, 0.9)]
    return json.dumps({"people": [{"pose_keypoints_2d": points}]}).encode()


def test_a_folder_with_a_file_per_frame_is_one_upload(own_studio, folder):
    frames = [(f"cam1_{n:012d}_keypoints.json", people(40 + n)) for n in range(8)]
    points = put(own_studio, "cam1_json.folder", tar(frames))
    assert points["kind"] == "keypoints" and points["frames"] == 8 and points["name"] == "cam1_json"
    assert put(own_studio, "one.json", frames[0][1])["kind"] in ("keypoints", "other")
    mixed = put(own_studio, "odd.folder", tar([("a.json", b"{}"), ("b.png", b"x")]))
    assert mixed["kind"] == "other" and "several kinds" in mixed["problem"]
    walk = folder / "walk"
    text = put(own_studio, "calibration.toml", (walk / "calibration.toml").read_bytes())
    videos = {k: put(own_studio, f"cam{k}.mp4", (walk / "videos" / f"cam{k}.mp4").read_bytes()) for k in (1, 2)}
    views = [{"name": f"cam{k}", "camera": f"cam{k}", "video": v["upload"]} for k, v in videos.items()]
    views[0]["keypoints"] = points["upload"]
    made = own_studio.get("/api/recordings", {"name": "p", "calibration": text["upload"], "views": views}, status=201)
    assert made["views"][0]["keypoints"].endswith("_cam1_json") and made["problem"] is None and made["board"] is None
    assert load_recording(folder / "p").keypoint_set is not None


@pytest.mark.parametrize(
    "files",
    [
        [("a.json", b"{}"), ("x@", b"")],
        [("a.json", b"{}"), ("b/a.json", b"{}")],
        [(".hidden.json", b"{}")],
        [("a\\b.json", b"{}")],
    ],
)
def test_what_an_archive_may_not_hold(own_studio, folder, files):
    assert "cannot be taken" in put(own_studio, "x.folder", tar(files), status=400)["error"]
    assert not any(p.is_file() for p in (folder / ".studio-uploads").rglob("*"))


def test_what_is_in_an_archive_is_bounded(tmp_path):
    (tmp_path / "x.folder").write_bytes(tar([("a.png", b"0" * 3000), ("b.png", b"0" * 3000)]))
    with pytest.raises(InputError, match="too much"):
        unpack(tmp_path / "x.folder", tmp_path / "x", 5000)


def test_an_archive_that_broke_off_is_refused(own_studio, folder):
    data = tar([("a.png", b"0" * 3000)])
    assert "drop it again" in put(own_studio, "x.folder", data[:1500], status=400)["error"]
    assert not any(p.is_file() for p in (folder / ".studio-uploads").rglob("*"))


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

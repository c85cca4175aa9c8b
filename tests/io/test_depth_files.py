"""Recordings of depth cameras: lenses as their makers write them, maps, and what is wrong with a file."""

import json
import sys
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.io.calibrations.calibration_text import write_calibration
from hypose.io.sensors.depth import _numbers, azure_camera, open_depth, write_depth_png

LENS = [0.513, 0.517, 0.4928, 0.4929, 0.5, -0.02, -0.003, 0.9, 0.09, -0.01, 0, 0, 2e-4, 1e-4]
CAMERA = {"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": {"ModelParameters": LENS}}
AZURE = {"CalibrationInformation": {"Cameras": [CAMERA]}}


def test_modes_of_an_azure_kinect_share_one_lens():
    wide = azure_camera("k", AZURE, (640, 576), "a.mkv")
    binned = azure_camera("k", AZURE, (320, 288), "a.mkv")
    assert wide.K[0, 0] == pytest.approx(504.6, abs=0.1) and wide.K[0, 2] == pytest.approx(332.8, abs=0.1)
    assert binned.K[0, 0] == pytest.approx(wide.K[0, 0] / 2)
    # pixels of the binned mode are twice as large and begin at the same place
    assert 2 * (binned.K[0, 2] + 0.5) == pytest.approx(wide.K[0, 2] + 0.5)
    assert wide.distortion[[0, 1, 2, 3, 4]].tolist() == [0.5, -0.02, 1e-4, 2e-4, -0.003]
    with pytest.raises(InputError, match="100 x 100"):
        azure_camera("k", AZURE, (100, 100), "a.mkv")
    with pytest.raises(InputError, match="not known"):
        azure_camera("k", {}, (640, 576), "a.mkv")


def test_a_folder_of_maps_with_its_lens(tmp_path, rng):
    maps = rng.uniform(1, 3, (2, 20, 30)).round(3).astype(np.float32)
    for k, m in enumerate(maps):
        (tmp_path / "left").mkdir(exist_ok=True)
        write_depth_png(tmp_path / "left" / f"{k}.png", m)
    with pytest.raises(InputError, match="no calibration.toml"):
        open_depth(tmp_path / "left")
    k = np.array([[25.0, 0, 14.5], [0, 26, 9.5], [0, 0, 1]])
    cameras = [Camera(n, k + 0.0, np.zeros(5), np.eye(4), (30, 20)) for n in ("left", "right")]
    write_calibration(CameraRig(tuple(cameras)), tmp_path / "calibration.toml")
    found = open_depth(tmp_path / "left")
    assert found.camera.name == "left" and np.allclose(found.camera.K, k)
    frames = list(found.frames)
    assert len(frames) == 2 and np.abs(frames[1].depth - maps[1]).max() < 6e-4
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match="no PNG"):
        open_depth(tmp_path / "other")
    with pytest.raises(InputError, match="no recording of a depth camera"):
        open_depth(tmp_path / "calibration.toml")


def test_files_are_numbered_by_frames_or_one_after_the_other():
    def numbers(*names):
        return _numbers([Path(n) for n in names]).tolist()

    assert numbers("d_0004.png", "d_0006.png", "d_0010.png", "d_0012.png") == [0, 1, 3, 4]
    assert numbers("1305031102.160407.png", "1305031102.194330.png", "1305031102.226738.png") == [0, 1, 2]  # times
    assert numbers("front.png", "later.png") == [0, 1] and numbers("7.png") == [0]
    assert numbers("1.png", "01.png") == [0, 1]


def record3d(path, depth, **changed):
    about = {"K": [1000.0, 0, 0, 0, 1000.0, 0, 479.5, 359.5, 1], "w": 960, "h": 720, "dw": 8, "dh": 6, "fps": 30}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(about | changed))
        for n, d in enumerate(depth):
            archive.writestr(f"rgbd/{n}.depth", d.astype("<f4").tobytes())


def test_a_capture_of_record3d(tmp_path, rng, monkeypatch):
    depth = rng.uniform(0.5, 3, (11, 6, 8)).astype(np.float32)
    depth[3, 0, 0] = np.nan
    path = tmp_path / "walk.r3d"
    record3d(path, depth)
    # the packing is another library's: here it packs nothing
    monkeypatch.setitem(sys.modules, "liblzfse", types.SimpleNamespace(decompress=lambda data: data))
    found = open_depth(path)
    assert found.camera.size == (8, 6)
    assert found.camera.K[0, 0] == pytest.approx(1000 * 8 / 960)
    assert found.camera.K[0, 2] == pytest.approx(3.5) and found.camera.K[1, 2] == pytest.approx(2.5)
    frames = list(found.frames)
    assert len(frames) == 11 and frames[10].time == pytest.approx(1 / 3)
    assert np.array_equal(frames[10].depth, depth[10])  # in the order of their numbers
    assert frames[3].depth[0, 0] == 0
    for changed in ({"K": [1.0]}, {"w": 0}, {"dw": 1e400}, {"K": None}):
        record3d(path, depth, **changed)
        with pytest.raises(InputError, match="does not say its lens"):
            open_depth(path)
    record3d(path, depth, K=[0.0] * 9)
    with pytest.raises(InputError, match="unusable"):
        open_depth(path)
    record3d(path, depth[:, :3])
    with pytest.raises(InputError, match="were expected"):
        list(open_depth(path).frames)
    monkeypatch.setitem(sys.modules, "liblzfse", None)
    with pytest.raises(InputError, match="pip install pyliblzfse"):
        open_depth(path)
    path.write_bytes(b"no zip")
    with pytest.raises(InputError, match="no Record3D capture"):
        open_depth(path)

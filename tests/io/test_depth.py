"""Recordings of depth cameras: lenses as their makers write them, maps, and what is wrong with a file."""

import gc
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.sensors.depth import _numbers, azure_camera, open_depth, open_realsense, read_realsense, write_depth_png
from tests import missing

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


# ---- test realsense ------------------------------------------------------------------------------------------------
# RealSense recordings, written by the library's own software device.


SIZE = (64, 48)


@pytest.fixture
def library(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("HOME", str(tmp_path_factory.mktemp("home")))  # the library counts what `record` does
    yield missing.module("pyrealsense2", "RealSense recordings", "pip install 'hypose[realsense]'")
    gc.collect()  # it counts when the last of its objects goes


def record(rs, path, images, scale=0.001, kind="depth", rate=30):
    """A recording of images (h, w) uint16."""
    width, height = SIZE
    device = rs.software_device()
    sensor = device.add_sensor("Stereo Module")
    sensor.add_read_only_option(rs.option.depth_units, scale)
    lens = rs.intrinsics()
    lens.width, lens.height, lens.ppx, lens.ppy, lens.fx, lens.fy = width, height, 31.5, 23.5, 60.0, 61.0
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.fmt = (
        (rs.stream.depth, rs.format.z16) if kind == "depth" else (rs.stream.infrared, rs.format.y16)
    )
    stream.index, stream.uid, stream.width, stream.height, stream.fps, stream.bpp = 0, 0, width, height, rate, 2
    stream.intrinsics = lens
    profile = sensor.add_video_stream(stream)
    recorder = rs.recorder(str(path), device)
    recorded, queue = recorder.query_sensors()[0], rs.frame_queue(50)
    recorded.open(profile)
    recorded.start(queue)
    for n, image in enumerate(images):
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp = np.ascontiguousarray(image), 2 * width, 2
        frame.timestamp, frame.domain, frame.frame_number = (
            5000 + 1000 * n / rate,
            rs.timestamp_domain.hardware_clock,
            n,
        )
        frame.profile, frame.depth_units = profile.as_video_stream_profile(), scale
        sensor.on_video_frame(frame)
        queue.wait_for_frame(1000)
    recorded.stop()
    recorded.close()
    del recorder, recorded, sensor, device  # the file is complete when nobody holds it
    gc.collect()


def test_every_frame_comes_back_in_metres(library, tmp_path, rng):
    images = rng.integers(0, 8000, (12, SIZE[1], SIZE[0])).astype(np.uint16)
    record(library, tmp_path / "a.db3", images, scale=0.0005)
    made = read_realsense(tmp_path / "a.db3")
    assert np.allclose(made.camera.K, [[60, 0, 31.5], [0, 61, 23.5], [0, 0, 1]]) and made.camera.size == SIZE
    assert not made.camera.distortion.any()
    frames = list(made.frames)
    assert len(frames) == 12
    np.testing.assert_allclose([f.time for f in frames], np.arange(12) / 30, atol=1e-6)
    for frame, image in zip(frames, images, strict=True):
        assert frame.depth.dtype == np.float32
        np.testing.assert_allclose(frame.depth, image * 0.0005, rtol=1e-6)


def test_a_recording_without_depth_is_refused(library, tmp_path):
    record(library, tmp_path / "a.db3", np.zeros((3, SIZE[1], SIZE[0]), np.uint16), kind="infrared")
    with pytest.raises(InputError, match=r"a\.db3"):
        read_realsense(tmp_path / "a.db3")


def test_missing_files_and_cameras_are_named(library, tmp_path):
    with pytest.raises(InputError, match="none"):
        read_realsense(tmp_path / "none.db3")
    with pytest.raises(InputError, match="There is no RealSense camera 123"):
        open_realsense("123")


def test_without_the_library_the_next_step_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    importlib.invalidate_caches()
    for call in (lambda: read_realsense(tmp_path / "a.db3"), open_realsense):
        with pytest.raises(InputError, match=r"pip install .hypose\[realsense\]"):
            call()

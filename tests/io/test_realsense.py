"""RealSense recordings, written by the library's own software device."""

import gc
import importlib
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.sensors.depth import open_realsense, read_realsense
from tests import missing

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
    assert made.intrinsics == pytest.approx((60.0, 61.0, 31.5, 23.5)) and made.size == SIZE and not made.distorted
    shutil.rmtree(Path.home() / ".rum", ignore_errors=True)
    frames = list(made.frames)
    assert len(frames) == 12 and not any(Path.home().iterdir()), "the library has left its counts in the home"
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
        with pytest.raises(InputError, match=r"pip install hypose\[realsense\]"):
            call()

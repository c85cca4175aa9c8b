"""Depth of RealSense cameras: their recordings (.bag, .db3) and the camera itself. Needs pyrealsense2 (an extra)."""

from __future__ import annotations

import contextlib
import importlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.io.file_names import utf8_path
from hypose.io.files import readable_size
from hypose.io.sensors.depth import MAX_SIDE, DepthFrame

_MAX_BYTES = 256 * 2**30
_PATIENCE_MS = 2000
"""Without a frame for so long, a recording is at its end and a camera is gone."""


@dataclass(frozen=True)
class RealSenseDepth:
    """intrinsics (fx, fy, cx, cy) px of the depth maps, which is what `depth.depth_at_joints` takes; size (width,
    height) px; distorted: the camera reports lens distortion, which the intrinsics do not hold; frames: each read once,
    time in s from the first."""

    intrinsics: tuple[float, float, float, float]
    size: tuple[int, int]
    distorted: bool
    frames: Iterator[DepthFrame]


def read_realsense(path: str | Path) -> RealSenseDepth:
    """The depth of a recording that RealSense's own tools wrote (.bag, in newer versions .db3), as fast as it can be
    read. An InputError for anything else, and when pyrealsense2 is missing."""
    library = _library()
    path = Path(path)
    readable_size(path, "a RealSense recording (.bag or .db3)", _MAX_BYTES)
    config = library.config()
    try:
        with utf8_path(path) as name:
            config.enable_device_from_file(name, repeat_playback=False)
            return _opened(library, config, str(path), recorded=True)
    except RuntimeError as error:
        raise InputError(
            f"{path} cannot be played by pyrealsense2 {library.__version__} ({_short(error)}); give a recording "
            "that RealSense's tools wrote, in the form that this version writes (.bag or .db3)."
        ) from None


def open_realsense(serial: str | None = None) -> RealSenseDepth:
    """The depth of a connected camera, by its serial number if there are several. The frames end when the camera is
    unplugged; closing the iterator stops the camera."""
    library = _library()
    config = library.config()
    config.enable_stream(library.stream.depth)
    with _no_report_at_home():
        found = {d.get_info(library.camera_info.serial_number) for d in library.context().query_devices()}
    if not found or (serial is not None and serial not in found):
        there = f"the connected ones are {', '.join(sorted(found))}" if found else "none is connected"
        which = "No RealSense camera can be used" if serial is None else f"There is no RealSense camera {serial}"
        raise InputError(f"{which}: {there}; check the cable and the serial number.")
    if serial is not None:
        config.enable_device(serial)
    try:
        return _opened(library, config, f"the RealSense camera {serial or min(found)}", recorded=False)
    except RuntimeError as error:
        raise InputError(
            f"The RealSense camera {serial or min(found)} does not start ({_short(error)}); close other programs that "
            "use it and plug it in again."
        ) from None


def _library() -> Any:
    os.environ["RS2_RUM_CLOUD_ENABLED"] = "0"  # since 2.59 it counts what is used; nothing is sent
    try:
        return importlib.import_module("pyrealsense2")  # an extra: not there for everyone, type checkers included
    except ModuleNotFoundError:
        raise InputError(
            "RealSense cameras and their recordings need pyrealsense2, which is not installed; run: pip install "
            "hypose[realsense]."
        ) from None
    except ImportError as error:  # a library of the system's is not there
        raise InputError(
            f"RealSense cameras and their recordings need pyrealsense2, which cannot be loaded ({error}); install what "
            "it names (Debian: apt install libusb-1.0-0)."
        ) from None


def _opened(library: Any, config: Any, what: str, recorded: bool) -> RealSenseDepth:
    pipeline = library.pipeline()
    if recorded:  # said before it starts, else frames are dropped when reading is slower than recording was
        playback = config.resolve(library.pipeline_wrapper(pipeline)).get_device().as_playback()
        playback.set_real_time(False)
    profile = pipeline.start(config)
    device = profile.get_device()
    try:
        lens = profile.get_stream(library.stream.depth).as_video_stream_profile().get_intrinsics()
        scale = float(device.first_depth_sensor().get_depth_scale())
    except RuntimeError:
        pipeline.stop()
        with _no_report_at_home():
            del pipeline, profile, device
        raise InputError(f"{what} has no depth; record with the depth stream switched on.") from None
    if not (0 < lens.width <= MAX_SIDE and 0 < lens.height <= MAX_SIDE and 0 < scale < 1):
        pipeline.stop()
        raise InputError(f"{what}: depth maps of {lens.width} x {lens.height} in steps of {scale:g} m cannot be used.")
    frames = _frames(pipeline, scale, what)
    return RealSenseDepth((lens.fx, lens.fy, lens.ppx, lens.ppy), (lens.width, lens.height), any(lens.coeffs), frames)


def _frames(pipeline: Any, scale: float, what: str) -> Iterator[DepthFrame]:
    first, last, frames, frame = None, -np.inf, None, None
    try:
        while True:
            ok, frames = pipeline.try_wait_for_frames(_PATIENCE_MS)
            if not ok:
                return
            frame = frames.get_depth_frame()
            if not frame or frame.timestamp <= last:  # the same frame again, with a new one of another stream
                continue
            first, last = frame.timestamp if first is None else first, frame.timestamp
            depth = np.asarray(frame.get_data(), dtype=np.uint16).astype(np.float32) * np.float32(scale)
            yield DepthFrame((frame.timestamp - first) / 1000, depth)
    except RuntimeError as error:
        raise InputError(f"{what} cannot be read any further ({_short(error)}); record again.") from None
    finally:
        pipeline.stop()
        with _no_report_at_home():
            del pipeline, frames, frame


@contextlib.contextmanager
def _no_report_at_home() -> Iterator[None]:
    """Where the last of the library's objects are let go: since 2.59 it writes its counts to ~/.rum then."""
    home = os.environ.get("HOME")
    with tempfile.TemporaryDirectory(prefix="hypose-") as folder:
        os.environ["HOME"] = folder
        try:
            yield
        finally:
            os.environ.pop("HOME") if home is None else os.environ.update(HOME=home)


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120].rstrip(".")

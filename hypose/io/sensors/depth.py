"""Depth maps: 16-bit PNG in millimetres, recordings of depth cameras, and connected depth cameras.

A depth map is (h, w) float32 in metres, 0 for a hole, with pixel centres at integer coordinates.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.cameras.camera import Camera
from hypose.errors import InputError, extra
from hypose.geometry import Array, DepthMap
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.files import numbers_of, read_bytes, readable_size, utf8_path, write_bytes
from hypose.io.videos.video import (
    CameraImage,
    CameraSource,
    Played,
    StreamEnded,
    VideoReader,
    decode,
    list_images,
    png_header,
    sequence_numbers,
)
from hypose.json_text import parse_json

MAX_SIDE = 4096
# PNG filters do not predict noisy depth better: without a filter, files are a third
# smaller, and no slower to write.
DEPTH_PNG = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_COMPRESSION, 1)
_MAX_BYTES = 64 * 2**20


def write_depth_png(path: str | Path, depth: ArrayLike) -> None:
    """Write a depth map (h, w), m, as a 16-bit PNG in whole millimetres; holes and depths beyond 65 m become 0."""
    mm = np.asarray(depth, dtype=np.float64) * 1000
    write_millimetres_png(path, np.where(np.isfinite(mm) & (mm > 0) & (mm < 65535.5), np.rint(mm), 0).astype(np.uint16))


def write_millimetres_png(path: str | Path, depth: NDArray[np.uint16]) -> None:
    """Write a depth map (h, w) in whole millimetres, 0 for a hole, as a 16-bit PNG."""
    write_bytes(path, cv2.imencode(".png", depth, DEPTH_PNG)[1].tobytes(), synced=False)


# Value of a hole, mm, that some recorders write in place of 0.
_NOT_MEASURED = 65535


def read_depth_png(path: str | Path) -> DepthMap:
    """Read a 16-bit PNG in millimetres as a depth map.

    The size in its header is checked before anything is unpacked.

    Returns: (h, w) m; 0 for a hole.
    Raises: InputError where the file is not such a PNG, too large or damaged.
    """
    data = read_bytes(path, "a 16-bit depth PNG", _MAX_BYTES)
    width, height, *kind = png_header(data)
    if kind != [16, 0] or not 1 <= width <= MAX_SIDE or not 1 <= height <= MAX_SIDE:
        raise InputError(
            f"{path} is not a grey 16-bit PNG of at most {MAX_SIDE} x {MAX_SIDE} px; depth maps are such PNG, in "
            "millimetres."
        )
    image = decode(data)
    if image is None or image.dtype != np.uint16 or image.shape != (height, width):
        raise InputError(f"{path} is a damaged PNG; write it again.")
    return np.where(image < _NOT_MEASURED, image, 0).astype(np.float32) / np.float32(1000)


def sample_depth(
    depth: DepthMap, positions: ArrayLike, intrinsics: tuple[float, float, float, float], y_up: bool = False
) -> Array:
    """Look up the depth map at the pixels of joints.

    positions: (J, 3) joints in the sensor's frame, m.
    intrinsics: fx, fy, cx, cy, px.
    y_up: the joints' y axis points up; that of the image always points down.
    Returns: (J,) depths, m; 0 for holes and for joints outside the image.
    """
    p = np.asarray(positions, dtype=np.float64)
    fx, fy, cx, cy = intrinsics
    out = np.zeros(len(p))
    ok = np.isfinite(p).all(-1) & (np.nan_to_num(p[:, 2]) > 0.05)
    x, y, z = p[ok, 0], p[ok, 1] * (-1 if y_up else 1), p[ok, 2]
    u, v = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    values = np.zeros(len(u))
    values[inside] = depth[v[inside].astype(int), u[inside].astype(int)]
    out[ok] = values
    return out


@dataclass(frozen=True)
class DepthFrame:
    """A depth map and its time.

    time: s from the start of the recording.
    depth: (h, w) float32 m.
    """

    time: float
    depth: DepthMap


@dataclass(frozen=True)
class DepthFile:
    """Depth maps of one depth camera, from a recording or from the connected camera.

    camera: the lens; its pose is the identity.
    frames: depth maps, each read once; times in s from the first, with gaps where frames were lost.
    """

    camera: Camera
    frames: Iterator[DepthFrame]


def read_azure_mkv(path: str | Path) -> tuple[dict[str, Any], Iterator[DepthFrame]]:
    """Read the calibration and the depth maps of an Azure Kinect recording (.mkv).

    The depth track is 16-bit big-endian grey in millimetres, named DEPTH.

    Returns: content of the recording's calibration.json, and an iterator over the depth maps.
    Raises: InputError where PyAV (extra azure) is not installed or the file has no depth track.
    """
    library = extra("av", "An Azure Kinect recording", "azure", "PyAV")
    readable_size(path, "an Azure Kinect recording (.mkv)", 64 * 2**30)
    try:
        with utf8_path(Path(path)) as name:
            container = library.open(name, metadata_errors="replace")
    except (library.error.FFmpegError, OSError):
        raise InputError(f"{path} is not a video that can be opened; give an Azure Kinect recording (.mkv).") from None
    # the track's title, or the name of a tag, says that it holds depth
    said = [(s, {str(k).upper(): str(v) for k, v in s.metadata.items()}) for s in container.streams.video]
    tracks = [s for s, tags in said if "DEPTH" in " ".join([tags.get("TITLE", ""), *tags]).upper()]
    if not tracks:
        container.close()
        raise InputError(f"{path} has no depth track; record with k4arecorder and depth switched on.")
    calibration: dict[str, Any] = {}
    for stream in (s for s in container.streams if s.type == "attachment"):
        if str(stream.metadata.get("filename", "")).endswith(".json"):
            with contextlib.suppress(ValueError, AttributeError, TypeError, RecursionError):
                calibration = calibration or dict(parse_json(bytes(stream.data)[: 1 << 20].rstrip(b"\0")))
    return calibration, _azure_frames(container, tracks[0], str(path), library)


def _azure_frames(container: Any, track: Any, path: str, library: Any) -> Iterator[DepthFrame]:
    """Decode the depth track of an open recording of PyAV (`library`), and close it at the end."""
    with container:
        try:
            for frame in container.decode(track):
                if frame.width > MAX_SIDE or frame.height > MAX_SIDE:
                    raise InputError(f"{path}: depth maps of {frame.width} x {frame.height} are too large.")
                # PyAV turns gray16be into the machine's own byte order
                image = np.asarray(frame.to_ndarray(), dtype=np.uint16)
                yield DepthFrame(float(frame.time or 0.0), image.astype(np.float32) / np.float32(1000))
        except library.error.FFmpegError:
            raise InputError(f"{path} is damaged or cut off; copy it again from where it was recorded.") from None


# ---- realsense -----------------------------------------------------------------------------------------------------
# Depth of RealSense cameras: their recordings (.bag, .db3) and the camera itself. Needs pyrealsense2 (an extra).


_MAX_RECORDING_BYTES = 256 * 2**30
# Time without a frame, ms, after which a recording is at its end and a camera is disconnected.
_PATIENCE_MS = 2000


def read_realsense(path: str | Path) -> DepthFile:
    """Read the depth of a RealSense recording (.bag, in newer versions .db3), as fast as possible.

    Raises: InputError where the file is not such a recording or pyrealsense2 is not installed.
    """
    library = _library()
    path = Path(path)
    readable_size(path, "a RealSense recording (.bag or .db3)", _MAX_RECORDING_BYTES)
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


def open_realsense(serial: str | None = None) -> DepthFile:
    """Start a connected RealSense camera and read its depth.

    The frames end when the camera is disconnected; closing the iterator stops the camera.

    serial: serial number of the camera; None for the only one.
    Raises: InputError where there is no such camera or it does not start.
    """
    library = _library()
    config = library.config()
    config.enable_stream(library.stream.depth)
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
    os.environ["RS2_RUM_CLOUD_ENABLED"] = "0"  # since 2.59 it counts uses; this prevents sending
    libusb = "install the system's libusb (Debian: apt install libusb-1.0-0)"
    return extra("pyrealsense2", "Depth of RealSense cameras and their recordings", "realsense", or_else=libusb)


def _opened(library: Any, config: Any, what: str, recorded: bool) -> DepthFile:
    """Start the depth stream of a camera or recording.

    library: the module pyrealsense2.
    config: its configuration, with the device or file.
    what: the camera or file, for the error messages.
    recorded: it is a file, which is read as fast as possible.
    Returns: the camera, with the lens distortion that it reports, and its depth maps.
    Raises: InputError where there is no usable depth; RuntimeError of the library where it does not start.
    """
    pipeline = library.pipeline()
    if recorded:  # set before the start, otherwise frames are dropped when reading is slower than recording
        playback = config.resolve(library.pipeline_wrapper(pipeline)).get_device().as_playback()
        playback.set_real_time(False)
    profile = pipeline.start(config)
    device = profile.get_device()
    try:
        lens = profile.get_stream(library.stream.depth).as_video_stream_profile().get_intrinsics()
        scale = float(device.first_depth_sensor().get_depth_scale())
    except RuntimeError:
        pipeline.stop()
        raise InputError(f"{what} has no depth; record with the depth stream switched on.") from None
    if not (0 < lens.width <= MAX_SIDE and 0 < lens.height <= MAX_SIDE and 0 < scale < 1):
        pipeline.stop()
        raise InputError(f"{what}: depth maps of {lens.width} x {lens.height} in steps of {scale:g} m cannot be used.")
    frames = _frames(pipeline, scale, what)
    figures, size = (lens.fx, lens.fy, lens.ppx, lens.ppy), (lens.width, lens.height)
    return DepthFile(_pinhole(Path(what).stem, figures, size, np.array(lens.coeffs, dtype=np.float64)), frames)


def _frames(pipeline: Any, scale: float, what: str) -> Iterator[DepthFrame]:
    """Read the depth frames of a running pipeline of pyrealsense2, and stop it at the end.

    scale: size of a step of the values, m.
    what: camera or file, for the error message.
    """
    first, last = None, -np.inf
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


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120].rstrip(".")


# ---- depth files ---------------------------------------------------------------------------------------------------
# Recordings of depth cameras of all known makes: their lens and their maps, one after the other.
#
# Azure Kinect (.mkv), RealSense (.bag, .db3), and a folder of 16-bit PNG in millimetres with a
# calibration.toml next to them (Orbbec and others export such frames).


ENDINGS = (".mkv", ".bag", ".db3")
# Depth modes of the Azure Kinect by size: side of the sensor's picture, px, and origin of the mode's picture in it.
_MODES = {(640, 576): (1024, 192, 180), (320, 288): (512, 96, 90), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0)}
FOLDER_RATE = 30.0
"""Frames per second of a folder of depth maps, where none is given."""


def open_depth(path: str | Path, frame_rate: float = FOLDER_RATE, millimetres: float = 1.0) -> DepthFile:
    """Open a recording of one depth camera: .mkv, .bag, .db3, or a folder of 16-bit PNG.

    frame_rate: frames/s of a folder of maps.
    millimetres: size of one step of the values in a folder of maps, mm.
    Raises: InputError where the recording cannot be used.
    """
    path = Path(path)
    if path.is_dir():
        return _folder(path, frame_rate, millimetres)
    readers = {".mkv": _azure, ".bag": read_realsense, ".db3": read_realsense}
    ending = path.suffix.lower()
    if ending not in readers:
        raise InputError(
            f"{path} is no recording of a depth camera that is known; give {', '.join(ENDINGS)}, or a folder of 16-bit "
            "PNG in millimetres."
        )
    found = readers[ending](path)
    if readers[ending] is read_realsense and np.any(found.camera.distortion):
        raise InputError(
            f"{path}: this RealSense reports a distorted lens, which its figures do not hold; record the depth stream "
            "as the camera rectifies it."
        )
    return found


def _pinhole(
    name: str, lens: tuple[float, float, float, float], size: tuple[int, int], distortion: Array | None = None
) -> Camera:
    fx, fy, cx, cy = lens
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return Camera(name, k, np.zeros(5) if distortion is None else distortion, np.eye(4), size)


def _folder(path: Path, frame_rate: float, millimetres: float) -> DepthFile:
    files = list_images(path)
    if not files:
        raise InputError(f"{path} has no PNG; give the folder of the depth maps.")
    places = (f / "calibration.toml" for f in (path, path.parent, path.parent.parent))
    calibration = next((c for c in places if c.is_file()), None)
    if calibration is None:
        raise InputError(f"{path} has no calibration.toml with the camera's lens; put one next to the maps.")
    rig, _ = read_any(calibration, "auto")
    names = [c.name for c in rig]
    if len(rig) > 1 and path.name not in names:
        raise InputError(f"{calibration} has the cameras {', '.join(names)}; call the folder {path} as one of them.")
    camera = rig[names.index(path.name)] if path.name in names else rig[0]

    def frames() -> Iterator[DepthFrame]:
        for number, file in zip(_numbers(files), files, strict=True):
            depth = read_depth_png(file)
            if depth.shape[::-1] != camera.size:
                raise InputError(
                    f"{file} is {depth.shape[1]} x {depth.shape[0]} px, the lens in {calibration} is for "
                    f"{camera.size[0]} x {camera.size[1]} px; give that of the depth maps, not of the colour pictures."
                )
            yield DepthFrame(number / frame_rate, depth if millimetres == 1 else depth * np.float32(millimetres))

    return DepthFile(Camera(path.name, camera.K, camera.distortion, np.eye(4), camera.size, camera.fisheye), frames())


def _numbers(files: Sequence[Path]) -> NDArray[np.int64]:
    """Number the frames of a folder (T,).

    The numbers in the files' names are used where they count in equal steps, so that lost files leave a gap; otherwise
    the files are counted.
    """
    numbers = sequence_numbers(files)
    steps = np.zeros(0, np.int64) if numbers is None else np.diff(numbers)
    usual = int(np.median(steps)) if len(steps) else 0
    if numbers is None or usual < 1 or (steps % usual).any():
        return np.arange(len(files))
    return (numbers - numbers[0]) // usual


def _azure(path: Path) -> DepthFile:
    calibration, frames = read_azure_mkv(path)
    first = next(frames, None)
    if first is None:
        raise InputError(f"{path} has no depth frame; copy it again if it was cut off, else record for longer.")
    height, width = first.depth.shape
    camera = azure_camera(path.stem, calibration, (width, height), str(path))
    # the container's time starts with its first track
    return DepthFile(camera, (DepthFrame(f.time - first.time, f.depth) for f in itertools.chain([first], frames)))


def azure_camera(name: str, calibration: Mapping[str, Any], size: tuple[int, int], where: str) -> Camera:
    """Compute the depth camera of an Azure Kinect from its calibration.json.

    calibration: content of calibration.json.
    size: width and height of the depth maps, px, which identify the mode of the sensor.
    where: the recording, for the error messages.
    Raises: InputError where the size or the calibration is unknown.
    Source: cropping and scaling of depth modes in the Azure Kinect Sensor SDK.
    """
    cameras = calibration.get("CalibrationInformation", {}).get("Cameras", [])
    own = [c for c in cameras if str(c.get("Location", "")).endswith("D0")]
    if not own or size not in _MODES:
        raise InputError(
            f"{where}: the lens of maps of {size[0]} x {size[1]} px is not known; record in a mode of the sensor "
            f"({', '.join(f'{w} x {h}' for w, h in _MODES)})."
        )
    with numbers_of(f"{where}: its calibration of the depth camera"):
        p = [float(v) for v in own[0]["Intrinsics"]["ModelParameters"]]
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = p[:14]
    side, left, top = _MODES[size]
    lens = fx * side, fy * side, cx * side - left - 0.5, cy * side - top - 0.5
    return _pinhole(name, lens, size, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))


# ---- depth sources -------------------------------------------------------------------------------------------------
# Depth cameras as image sources: a RealSense, and folders of depth maps played at their own speed.


DEPTH_PREFIX, REALSENSE = "depth:", "realsense"
"""Start of a depth camera's address: a folder of maps, and a camera, whose serial number may follow."""


def is_depth(address: str) -> bool:
    """Test whether an address is that of a depth camera."""
    return address.startswith(DEPTH_PREFIX) or address == REALSENSE or address.startswith(f"{REALSENSE}:")


def open_depth_camera(address: str, rate: float, begin: float | None = None) -> CameraSource:
    """Open a depth camera by its address.

    address: `realsense`, `realsense:SERIAL`, or `depth:FOLDER` with 16-bit PNG in millimetres.
    rate: Hz at which a folder is played.
    begin: time of a folder's first map, s of the monotonic clock; now by default.
    Returns: a source whose images are depth maps (h, w), float32 m.
    Raises: InputError where it cannot be opened.
    """
    if not address.startswith(DEPTH_PREFIX):
        serial = address.partition(":")[2]
        return _RealSense(open_realsense(serial or None), address)
    folder = Path(address.removeprefix(DEPTH_PREFIX))
    if not folder.is_dir():
        raise InputError(f"There is no folder {folder}; a depth recording is a folder of 16-bit PNG in millimetres.")
    return Played(_Maps(folder), rate, time.monotonic() if begin is None else begin)


class _RealSense:
    """A connected RealSense camera as a `CameraSource`."""

    live = True

    def __init__(self, found: DepthFile, what: str) -> None:
        self._what, self._frames = what, found.frames

    def read(self) -> CameraImage:
        """Wait for the next depth map; StreamEnded where the camera is disconnected."""
        try:
            frame = next(self._frames, None)
        except InputError as error:  # it may be plugged in again
            raise StreamEnded(str(error)) from None
        if frame is None:
            raise StreamEnded(f"{self._what} delivers nothing more.")
        return CameraImage(time.monotonic(), frame.time, frame.depth)

    def close(self) -> None:
        """Stop the camera."""
        close = getattr(self._frames, "close", None)
        if close is not None:
            close()


class _Maps(VideoReader):
    """A folder of depth maps (16-bit PNG, mm), which are read as maps (h, w), float32 m."""

    def read(self, index: int | None = None, out: Any = None) -> Any:
        """Read a map by its number; a damaged one becomes a map without depth."""
        number = self.position if index is None else index
        self.seek(number + 1)
        try:
            return read_depth_png((self._images or [])[number])
        except InputError:
            return np.zeros((1, 1), np.float32)

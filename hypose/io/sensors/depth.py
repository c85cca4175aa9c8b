"""Depth maps: 16-bit PNG in millimetres, and the first readers of sensors' own recordings.

A depth map is (h, w) float32 in metres, 0 = hole, pixel centres at whole numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.errors import InputError, extra
from hypose.geometry import Array
from hypose.io.file_names import utf8_path
from hypose.io.files import read_bytes, readable_size, write_bytes
from hypose.io.videos.video import PNG_SIGNATURE, is_cut_png
from hypose.json_text import parse_json

DepthMap = NDArray[np.float32]
MAX_SIDE = 4096
# Steps of a noisy depth picture are no better predicted from the pixel beside: without a filter files are a third
# smaller, and no slower to write.
DEPTH_PNG = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_COMPRESSION, 1)
_MAX_BYTES = 64 * 2**20


def write_depth_png(path: str | Path, depth: ArrayLike) -> None:
    """Write a depth map (h, w) m as 16-bit PNG in whole millimetres; holes and what is beyond 65 m become 0."""
    mm = np.asarray(depth, dtype=np.float64) * 1000
    write_millimetres_png(path, np.where(np.isfinite(mm) & (mm > 0) & (mm < 65535.5), np.rint(mm), 0).astype(np.uint16))


def write_millimetres_png(path: str | Path, depth: NDArray[np.uint16]) -> None:
    """Write a depth map (h, w) that is in whole millimetres already, 0 = hole, as 16-bit PNG."""
    ok, data = cv2.imencode(".png", depth, DEPTH_PNG)
    if not ok:
        raise InputError(f"{path}: a depth map of shape {depth.shape} cannot be written; it must be (height, width).")
    write_bytes(path, data.tobytes(), synced=False)


def read_depth_png(path: str | Path) -> DepthMap:
    """Read a 16-bit PNG in millimetres; the size in its header is checked before anything is unpacked."""
    data = read_bytes(path, "a 16-bit depth PNG", _MAX_BYTES)
    if not data.startswith(PNG_SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        raise InputError(f"{path} is not a PNG; depth maps are 16-bit PNG in millimetres.")
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if bits != 16 or colour != 0 or not 1 <= width <= MAX_SIDE or not 1 <= height <= MAX_SIDE:
        raise InputError(
            f"{path} is a PNG of {width} x {height} with {bits} bits, colour type {colour}; depth maps are grey, 16 "
            f"bit and at most {MAX_SIDE} x {MAX_SIDE}."
        )
    cut = is_cut_png(data)
    image = None if cut else cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.shape != (height, width):
        raise InputError(f"{path} is a damaged PNG; write it again.")
    return image.astype(np.float32) / np.float32(1000)


def depth_at_joints(
    depth: DepthMap, positions: ArrayLike, intrinsics: tuple[float, float, float, float], y_up: bool = False
) -> Array:
    """Depth map's value (J,) m at the pixels of joints (J, 3) m in the sensor's frame; 0 where there is none.

    intrinsics (fx, fy, cx, cy) px; y_up: the joints' y axis points up, the image's down.
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
    """time: s from the recording's start; depth (h, w) float32 m."""

    time: float
    depth: DepthMap


def read_azure_mkv(path: str | Path) -> tuple[dict[str, Any], Iterator[DepthFrame]]:
    """Calibration (the recording's calibration.json) and depth frames of an Azure Kinect recording (.mkv).

    Needs PyAV (extra azure). The depth track is 16-bit big-endian grey in millimetres, named DEPTH.
    """
    library = extra("av", "An Azure Kinect recording", "azure", "PyAV")
    readable_size(path, "an Azure Kinect recording (.mkv)", 64 * 2**30)
    try:
        with utf8_path(Path(path)) as name:
            container = library.open(name, metadata_errors="replace")
    except (library.error.FFmpegError, OSError):
        raise InputError(f"{path} is not a video that can be opened; give an Azure Kinect recording (.mkv).") from None
    tracks = [s for s in container.streams.video if "DEPTH" in _title(s)]
    if not tracks:
        container.close()
        raise InputError(f"{path} has no depth track; record with k4arecorder and depth switched on.")
    calibration = _calibration(container)
    return calibration, _azure_frames(container, tracks[0], str(path), library)


def _title(stream: Any) -> str:
    tags = {str(k).lower(): str(v) for k, v in stream.metadata.items()}
    return " ".join([tags.get("title", ""), *(k for k in tags)]).upper()


def _calibration(container: Any) -> dict[str, Any]:
    for stream in container.streams:
        if stream.type == "attachment" and str(stream.metadata.get("filename", "")).endswith(".json"):
            try:
                value = parse_json(bytes(stream.data)[: 1 << 20].rstrip(b"\0"))
            except (ValueError, AttributeError, TypeError, RecursionError):
                continue
            if isinstance(value, dict):
                return value
    return {}


def _azure_frames(container: Any, track: Any, path: str, library: Any) -> Iterator[DepthFrame]:
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

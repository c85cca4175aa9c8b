"""Recordings of depth cameras, of whatever make: their lens and their maps, one after the other.

Azure Kinect (.mkv), RealSense (.bag, .db3), Record3D (.r3d), and a folder of 16-bit PNG in millimetres with a
calibration.toml beside them (Orbbec and others export such frames).
"""

from __future__ import annotations

import importlib
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.files import open_file, unreadable
from hypose.io.sensors.depth import MAX_SIDE, DepthFrame, read_azure_mkv, read_depth_png
from hypose.io.sensors.realsense import read_realsense
from hypose.io.videos.video import list_images
from hypose.json_text import parse_json

ENDINGS = (".mkv", ".bag", ".db3", ".r3d")
_MODES = {(640, 576): (1024, 192, 180), (320, 288): (512, 96, 90), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0)}
"""Of the Azure Kinect: the size of the sensor's picture in pixels, and where the mode's picture begins in it."""
FOLDER_RATE = 30.0
"""Frames per second of a folder of maps of which nobody knows it."""
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError)
"""What a zip raises that is none, is cut off, or is locked by a password."""
_PACKED_BYTES = 64 * 2**20
"""of one entry of a capture"""


@dataclass(frozen=True)
class DepthFile:
    """camera: the lens, at the origin; frames: each read once, time in s from the first; where frames were lost the
    times leave a gap."""

    camera: Camera
    frames: Iterator[DepthFrame]


def open_depth(path: str | Path, frame_rate: float = FOLDER_RATE, millimetres: float = 1.0) -> DepthFile:
    """A recording of one depth camera; an InputError names what cannot be used and what can.

    frame_rate (per s), millimetres that one step of a value stands for: of a folder of maps, which tells neither."""
    path = Path(path)
    ending = path.suffix.lower()
    if path.is_dir():
        return _folder(path, frame_rate, millimetres)
    if ending == ".mkv":
        return _azure(path)
    if ending in (".bag", ".db3"):
        found = read_realsense(path)
        if found.distorted:
            raise InputError(
                f"{path}: this RealSense reports a distorted lens, which its figures do not hold; record the depth "
                "stream as the camera rectifies it."
            )
        return DepthFile(_pinhole(path.stem, found.intrinsics, found.size), found.frames)
    if ending == ".r3d":
        return _record3d(path)
    raise InputError(
        f"{path} is no recording of a depth camera that is known; give {', '.join(ENDINGS)}, or a folder of 16-bit PNG "
        "in millimetres."
    )


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
        raise InputError(f"{path} has no calibration.toml with the camera's lens; put one beside the maps.")
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
    """(T,) which frame each file of a folder is: by its number where the files are numbered in steps of one size, so
    that lost ones leave a gap; else one after the other (names of other kinds, times)."""
    plain = np.arange(len(files))
    parts = [re.split(r"(\d+)(?=\D*$)", f.name) for f in files]
    if any(len(p) != 3 or len(p[1]) > 15 for p in parts) or len({(p[0], p[2]) for p in parts}) > 1:
        return plain
    numbers = np.array([int(p[1]) for p in parts], dtype=np.int64)
    steps = np.diff(numbers)
    usual = int(np.median(steps)) if len(steps) else 0
    return plain if usual < 1 or (steps % usual).any() else (numbers - numbers[0]) // usual


def _azure(path: Path) -> DepthFile:
    calibration, frames = read_azure_mkv(path)
    first = next(frames, None)
    if first is None:
        raise InputError(f"{path} has no depth frame; copy it again if it was cut off, else record for longer.")
    height, width = first.depth.shape
    camera = azure_camera(path.stem, calibration, (width, height), str(path))

    def all_frames() -> Iterator[DepthFrame]:
        yield DepthFrame(0.0, first.depth)
        for frame in frames:  # the container counts from when its first track began
            yield DepthFrame(frame.time - first.time, frame.depth)

    return DepthFile(camera, all_frames())


def azure_camera(name: str, calibration: Mapping[str, Any], size: tuple[int, int], where: str) -> Camera:
    """The depth camera of an Azure Kinect's calibration.json for maps of this size (a mode of the sensor). Source: how
    the Azure Kinect Sensor SDK crops and scales the sensor's picture for its depth modes."""
    cameras = calibration.get("CalibrationInformation", {}).get("Cameras", [])
    own = [c for c in cameras if str(c.get("Location", "")).endswith("D0")]
    if not own or size not in _MODES:
        raise InputError(
            f"{where}: the lens of maps of {size[0]} x {size[1]} px is not known; record in a mode of the sensor "
            f"({', '.join(f'{w} x {h}' for w, h in _MODES)})."
        )
    try:
        p = [float(v) for v in own[0]["Intrinsics"]["ModelParameters"]]
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = p[:14]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{where}: its calibration has no lens of the depth camera; record again.") from None
    side, left, top = _MODES[size]
    lens = fx * side, fy * side, cx * side - left - 0.5, cy * side - top - 0.5
    return _pinhole(name, lens, size, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))


def _record3d(path: Path) -> DepthFile:
    """A capture of the Record3D app: a zip with `metadata` (JSON) and rgbd/N.depth, float32 metres packed by LZFSE."""
    try:
        archive = zipfile.ZipFile(open_file(path, "a Record3D capture (.r3d)", 64 * 2**30))
        about = parse_json(_unpacked(archive, "metadata"))
        k = [float(v) for v in about["K"]]
        width, height = int(about["dw"]), int(about["dh"])
        # K is stored column by column, for the colour pictures
        sx, sy = width / int(about["w"]), height / int(about["h"])
        lens = k[0] * sx, k[4] * sy, (k[6] + 0.5) * sx - 0.5, (k[7] + 0.5) * sy - 0.5
        rate = float(about.get("fps", 60))
    except OSError as error:
        raise unreadable(path, error) from None
    except _DAMAGED:
        raise InputError(f"{path} is no Record3D capture, or is cut off; share it from the app again.") from None
    except (LookupError, ValueError, TypeError, ArithmeticError, AttributeError, RecursionError):
        raise InputError(f"{path} does not say its lens and size; share it again with a newer Record3D.") from None
    usable = 1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE and 1 <= rate <= 1000
    if not (usable and np.isfinite(lens).all() and min(lens[:2]) > 0):
        raise InputError(
            f"{path}: depth maps of {width} x {height} px, a lens of {lens[0]:g} px, {rate:g} Hz: unusable."
        )
    try:
        library: Any = importlib.import_module("liblzfse")  # an extra: not there for everyone, type checkers included
    except ImportError:
        raise InputError(
            "Record3D captures need pyliblzfse, which is not installed; run: pip install pyliblzfse."
        ) from None
    names = sorted((n for n in archive.namelist() if n.endswith(".depth")), key=_number)
    if not names:
        raise InputError(f"{path} has no depth; record it in Record3D with the depth sensor.")

    def frames() -> Iterator[DepthFrame]:
        for name in names:
            try:
                values = np.frombuffer(library.decompress(_unpacked(archive, name)), dtype="<f4")
            except Exception:  # the library's own error
                raise InputError(f"{path}: {name} is damaged; share it from the app again.") from None
            if values.size != width * height:
                raise InputError(f"{path}: {name} has {values.size} values, {width} x {height} were expected.")
            depth = np.nan_to_num(values.reshape(height, width), nan=0.0, posinf=0.0, neginf=0.0)
            time = (_number(name) - _number(names[0])) / rate
            yield DepthFrame(time, np.maximum(depth, 0).astype(np.float32))

    return DepthFile(_pinhole(path.stem, lens, (width, height)), frames())


def _number(name: str) -> int:
    stem = Path(name).stem
    return int(stem) if stem.isdecimal() else 0


def _unpacked(archive: zipfile.ZipFile, name: str) -> bytes:
    """An entry, which says itself how large it will be."""
    if archive.getinfo(name).file_size > _PACKED_BYTES:
        raise zipfile.BadZipFile(name)
    return archive.read(name)

"""Camera calibration files of the TOML family (Pose2Sim, anipose, FreeMoCap, Caliscope); all: `calibration_formats`.

The TOML family has one table per camera:

    [cam_01]
    name = "cam_01"
    size = [1088, 1920]                   # width, height, px
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    distortions = [k1, k2, p1, p2, k3]    # OpenCV; four fisheye coefficients with fisheye = true
    rotation = [rx, ry, rz]               # camera_from_world: Rodrigues vector (rad) or 3 x 3 matrix
    translation = [tx, ty, tz]            # camera_from_world
    fisheye = false

    [metadata]
    unit = "m"                            # of the translations; absent in files of other programs

Caliscope nests the tables under [cameras]. Pose2Sim and Caliscope write metres, anipose and FreeMoCap the
unit of the calibration board, usually millimetres. Nobody records which, so `unit="auto"` decides by size:
cameras whose typical distance from each other (for a single camera: from the world's origin) exceeds 50 are
in millimetres, since rigs wider than 50 m and rigs narrower than 50 mm are both implausible.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array, se3, so3_exp, so3_log
from hypose.io import files
from hypose.io.files import write_text

MAX_FILE_BYTES = 5_000_000
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# Above this typical camera distance the numbers cannot be metres, below it they cannot be millimetres.
_UNIT_LIMIT = 50.0
_NOT_CAMERAS = {"metadata", "capture_volume", "charuco", "checkerboard", "board"}
# Spellings met in files of the family; the first one is what we write.
_KEYS = {
    "size": ("size", "image_size", "resolution"),
    "matrix": ("matrix", "K", "camera_matrix", "intrinsic_matrix"),
    "distortions": ("distortions", "distortion", "dist", "dist_coeffs", "distortion_coefficients"),
    "rotation": ("rotation", "R", "rvec"),
    "translation": ("translation", "T", "t", "tvec"),
}


def find_calibration(folder: Path) -> Path | None:
    """The calibration file in a folder: calibration.toml, else the only .toml that holds cameras, else
    .qca.txt.

    With several, the last in natural order of their names; None when there is none.
    """
    if (folder / "calibration.toml").is_file():
        return folder / "calibration.toml"
    if not folder.is_dir():
        return None
    candidates = [p for p in folder.iterdir() if p.is_file()]
    tomls = [p for p in candidates if p.suffix.lower() == ".toml" and p.name.lower() != "config.toml"]
    tomls = [p for p in tomls if "calib" in p.name.lower() or "camera" in p.name.lower()] or tomls
    found = tomls or [p for p in candidates if p.name.lower().endswith(".qca.txt")]
    return max(found, key=lambda p: natural_key(p.name), default=None)


def write_calibration(rig: CameraRig, path: str | Path, unit: str = "m") -> None:
    """Write the rig as a TOML file that hypose, Pose2Sim and anipose read; unit: that of the rig's translations."""
    lines = []
    for camera in rig:
        lines += [
            f"[{toml_key(camera.name)}]",
            f"name = {toml_value(camera.name)}",
            f"size = {toml_value([int(s) for s in camera.size])}",
            f"matrix = {toml_value(camera.K)}",
            f"distortions = {toml_value(np.ravel(camera.distortion))}",
            f"rotation = {toml_value(so3_log(camera.camera_from_world[:3, :3]))}",
            f"translation = {toml_value(camera.camera_from_world[:3, 3])}",
            f"fisheye = {toml_value(camera.fisheye)}",
            "",
        ]
    lines += ["[metadata]", "adjusted = false", "error = 0.0", f'unit = "{unit}"', ""]
    write_text(path, "\n".join(lines))


def toml_value(value: Any) -> str:
    """A TOML literal of a string, bool, number, sequence or array; floats keep every bit (repr)."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)  # nan, inf and 1e-07 are TOML as they are
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # JSON's escapes are TOML's
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise TypeError(f"no TOML literal for {type(value).__name__}")


def toml_key(key: str) -> str:
    """A TOML key, quoted where needed."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key under which cam2 comes before cam10."""
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p.lower()) for p in re.split(r"(\d+)", name) if p]


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """The tables of a TOML text; a ValueError with a short reason, whatever is wrong with it."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, integers of thousands of digits
        raise ValueError(str(error)) from None


def read_text(path: Path) -> str:
    """Text of a calibration file of at most MAX_FILE_BYTES; a CalibrationError otherwise."""
    if path.is_dir():
        raise CalibrationError(f"{path} is a folder; name the calibration file in it.")
    if not path.is_file():
        raise CalibrationError(f"The calibration file {path} does not exist; check the path, or run hypose calibrate.")
    try:
        return files.read_text(path, "a calibration", MAX_FILE_BYTES)
    except InputError as error:
        raise CalibrationError(str(error)) from None


# ---- TOML family -------------------------------------------------------------------------------------------


def read_toml(path: Path, text: str, unit: str) -> tuple[CameraRig, tuple[str, ...]]:
    """`calibration_formats.read_any` for the text of a TOML file."""
    try:
        document = parse_toml(path, text)
    except ValueError as error:
        raise CalibrationError(f"{path} is not valid TOML: {error}; correct it or calibrate again.") from None
    tables: dict[str, Any] = {k: v for k, v in document.items() if k.lower() not in _NOT_CAMERAS}
    nested = document.get("cameras")
    if isinstance(nested, Mapping):  # Caliscope: [cameras.0]
        tables = {f"cam_{k}" if str(k).isdecimal() else str(k): v for k, v in nested.items()}
    cameras, notes = [], []
    for key, table in tables.items():
        if not isinstance(table, Mapping) or not any(k in table for k in _KEYS["matrix"] + _KEYS["rotation"]):
            continue
        pose_missing = _get(table, "rotation") is None or _get(table, "translation") is None
        if table.get("ignore") is True and pose_missing:
            notes.append(f"{path.name}: camera {key} is marked ignore and has no pose; it is left out.")
            continue
        cameras.append(_camera_from_table(path, key, table))
    if not cameras:
        raise CalibrationError(
            f"{path} holds no cameras: each needs a table with size, matrix, distortions, rotation and "
            "translation; name a calibration file of Pose2Sim, anipose, FreeMoCap or Caliscope."
        )
    metadata = document.get("metadata")
    stated = metadata.get("unit", metadata.get("units")) if isinstance(metadata, Mapping) else None
    if unit == "auto" and stated in UNITS:
        unit = stated
    elif unit == "auto":
        unit, note = guess_unit(path, cameras)
        notes += note
    if UNITS[unit] != 1:
        cameras = [rescaled(c, UNITS[unit]) for c in cameras]
    return rig_of(path, cameras), tuple(notes)


def _get(table: Mapping[str, Any], key: str) -> Any:
    return next((table[k] for k in _KEYS[key] if k in table), None)


def _camera_from_table(path: Path, key: str, table: Mapping[str, Any]) -> Camera:
    name = table.get("name")
    name = str(name) if isinstance(name, str | int) and str(name) else key
    where = f"{path}, camera {name}"

    def numbers(field: str, shapes: tuple[tuple[int, ...], ...], default: Array | None = None) -> Array:
        value = _get(table, field)
        if value is None and default is not None:
            return default
        if value is None:
            raise CalibrationError(f"{where}: the entry {field} is missing; calibrate this camera again.")
        array = as_numbers(value)
        if array is None or (shapes and array.shape not in shapes):
            got = "something else" if array is None else f"shape {array.shape}"
            allowed = " or ".join(" x ".join(map(str, s)) for s in shapes) or "a list"
            raise CalibrationError(
                f"{where}: {field} must be numbers of shape {allowed}, got {got}; correct this entry."
            )
        if not np.isfinite(array).all():
            raise CalibrationError(
                f"{where}: {field} contains NaN or infinity, so this camera's calibration failed; calibrate it again."
            )
        return array

    size = numbers("size", ((2,),))
    k = numbers("matrix", ((3, 3),))
    distortions = numbers("distortions", (), np.zeros(5)).ravel()
    rotation = numbers("rotation", ((3,), (3, 1), (1, 3), (3, 3)))
    translation = numbers("translation", ((3,), (3, 1), (1, 3))).ravel()
    fisheye = table.get("fisheye", False)
    if not isinstance(fisheye, bool):
        raise CalibrationError(f"{where}: fisheye must be true or false, got {fisheye!r}; correct this entry.")
    matrix = so3_exp(rotation.ravel()) if rotation.size == 3 else rotation
    return checked_camera(where, name, k, distortions, matrix, translation, size, fisheye)


def as_numbers(value: Any) -> Array | None:
    """A (nested, rectangular) list of numbers as float64, None for anything else (text, booleans, ragged
    lists)."""

    def plain(v: Any) -> bool:
        if isinstance(v, list):
            return all(plain(x) for x in v)
        return isinstance(v, int | float) and not isinstance(v, bool)

    try:
        return np.array(value, dtype=np.float64) if plain(value) else None
    except (ValueError, OverflowError, RecursionError):
        return None


def checked_camera(
    where: str,
    name: str,
    k: Array,
    distortions: Array,
    rotation: Array,
    translation: Array,
    size: Array,
    fisheye: bool = False,
) -> Camera:
    """A camera of the numbers of a file; a CalibrationError, beginning with `where`, says which are implausible."""
    w, h = size
    if not (1 <= w <= 100_000 and 1 <= h <= 100_000 and float(w).is_integer() and float(h).is_integer()):
        raise CalibrationError(
            f"{where}: size must be the image's width and height in whole pixels, got {w:g} x {h:g}; correct "
            "this entry."
        )
    if not np.allclose(k[2], [0, 0, 1], atol=1e-9) or abs(k[1, 0]) > 1e-9:
        raise CalibrationError(
            f"{where}: matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}; it may have "
            "been written transposed: exchange its rows and columns."
        )
    if not (0 < k[0, 0] < 1e6 and 0 < k[1, 1] < 1e6 and np.abs(k[:2, 2]).max() < 1e6):
        raise CalibrationError(
            f"{where}: focal lengths must be positive pixel numbers, got matrix {k.tolist()}; calibrate it again."
        )
    if not np.abs(rotation.T @ rotation - np.eye(3)).max() <= 1e-2 or np.linalg.det(rotation) < 0:  # NaN as well
        raise CalibrationError(
            f"{where}: rotation is not a rotation matrix (its rows must be perpendicular unit vectors, "
            "right-handed); correct this entry or calibrate again."
        )
    if not np.abs(translation).max() <= 1e7:
        raise CalibrationError(
            f"{where}: translation {translation.tolist()} is farther than any camera stands; calibrate it again."
        )
    n = len(distortions)
    allowed = (0, 1, 2, 4) if fisheye else (0, 1, 2, 4, 5, 8, 12, 14)
    if n not in allowed:
        raise CalibrationError(
            f"{where}: {n} distortion coefficients; OpenCV's model has {', '.join(map(str, allowed[3:]))} of "
            "them, so write them in OpenCV's order (k1 k2 p1 p2 k3 ...)."
        )
    if n < 4:
        distortions = np.concatenate([distortions, np.zeros(4 - n)])
    # Printed digits are few: the nearest exact rotation, so that inverses and products stay exact.
    u, _, vt = np.linalg.svd(rotation)
    return Camera(name, k, distortions, se3(u @ vt, translation), (int(w), int(h)), fisheye)


def guess_unit(path: Path, cameras: list[Camera]) -> tuple[str, list[str]]:
    """Unit of translations by their size (see the module), and a sentence when they are not taken as metres."""
    centres = np.array([c.position for c in cameras])
    if len(cameras) > 1:
        i, j = np.triu_indices(len(cameras), 1)
        typical = float(np.median(np.linalg.norm(centres[i] - centres[j], axis=1)))
        what = "typical distance between the cameras"
    else:
        typical = float(np.linalg.norm(centres[0]))
        what = "distance of the camera from the origin"
    if typical <= _UNIT_LIMIT:
        return "m", []
    return "mm", [
        f"{path.name}: translations are taken as millimetres because the {what} is {typical:.0f} (= "
        f"{typical / 1000:.2f} m); set the calibration unit to m or cm if that is wrong."
    ]


def rescaled(camera: Camera, factor: float) -> Camera:
    """The camera with its translation multiplied."""
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= factor
    return Camera(camera.name, camera.K, camera.distortion, pose, camera.size, camera.fisheye)


def rig_of(path: Path, cameras: list[Camera]) -> CameraRig:
    """The rig of a file's cameras; errors name the file."""
    try:
        return CameraRig(tuple(cameras))
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None

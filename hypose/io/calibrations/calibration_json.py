"""Calibrations in JSON: K, R, t per camera (CMU Panoptic's layout and its many relatives), or 3 x 4 projections.

A camera is a table with K (or intrinsics) and R, t (or rvec, tvec, or RT, extrinsics of 3 x 4 or 4 x 4), which are
camera_from_world, distCoef (OpenCV's order) and resolution; or with P, a projection matrix without distortion. The
cameras are a list, or a table by name, at the top or under "cameras". Source: Panoptic Studio's calibration_*.json,
whose lengths are centimetres and which names panel and node of every camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, so3_exp
from hypose.io.calibrations.calibration_toml import (
    UNITS,
    as_numbers,
    checked_camera,
    guess_unit,
    read_text,
    rescaled,
    rig_of,
)
from hypose.json_text import parse_json

_K = ("K", "matrix", "intrinsic", "intrinsics", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "mtx", "k")
_LENS = ("distCoef", "dist", "distortion", "distortions", "dist_coeffs", "distCoeffs", "distortion_coefficients", "D")
_SIZE = ("resolution", "size", "image_size", "imgSize", "img_size", "imageSize")
_ROTATION = ("R", "rotation", "rvec", "rotation_matrix", "r")
_TRANSLATION = ("t", "T", "translation", "tvec", "translation_vector")
_POSE = ("RT", "Rt", "extrinsic", "extrinsics", "camera_from_world", "world_to_camera", "w2c", "extrinsic_matrix")
_PROJECTION = ("P", "projection", "projection_matrix", "proj")


def read_json(path: Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of a JSON file, world in metres, and what was assumed; a CalibrationError names file and camera."""
    try:
        document = parse_json(read_text(path))
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} is not valid JSON: {error}; export the calibration again.") from None
    tables = _tables(document)
    if not tables:
        raise CalibrationError(
            f"{path} holds no cameras: each needs K, R and t (or a 3 x 4 matrix P); export the calibration again."
        )
    notes: list[str] = []
    guessed: list[str] = []
    cameras = [_camera(path, name, table, guessed) for name, table in tables.items()]
    if guessed:
        notes.append(_size_note(path, guessed, cameras))
    stated = document.get("unit", document.get("units")) if isinstance(document, Mapping) else None
    if unit == "auto" and stated in UNITS:
        unit = stated
    elif unit == "auto" and all("panel" in t and "node" in t for t in tables.values()):
        unit = "cm"
        notes.append(f"{path.name}: translations are taken as centimetres, as CMU Panoptic's are.")
    elif unit == "auto":
        unit, more = guess_unit(path, cameras)
        notes += more
    return rig_of(path, [rescaled(c, UNITS[unit]) for c in cameras]), tuple(notes)


def _tables(document: Any) -> dict[str, Mapping[str, Any]]:
    inside = document.get("cameras", document) if isinstance(document, Mapping) else document
    if isinstance(inside, Mapping):
        found = {str(k): v for k, v in inside.items()}
    elif isinstance(inside, list):
        found = {f"cam_{i}": v for i, v in enumerate(inside)}
    else:
        return {}
    wanted = {*_K, *_PROJECTION}
    tables = {k: v for k, v in found.items() if isinstance(v, Mapping) and wanted & v.keys()}
    names = {k: v.get("name", v.get("camera", k)) for k, v in tables.items()}
    distinct = all(isinstance(n, str) and n for n in names.values()) and len(set(names.values())) == len(names)
    return {names[k] if distinct else k: v for k, v in tables.items()}


def _camera(path: Path, name: str, table: Mapping[str, Any], guessed: list[str]) -> Camera:
    where = f"{path}, camera {name}"

    def numbers(keys: tuple[str, ...], shapes: tuple[tuple[int, ...], ...]) -> Array | None:
        key = next((k for k in keys if k in table), None)
        if key is None:
            return None
        array = as_numbers(table[key])
        if array is None or (shapes and array.shape not in shapes) or not np.isfinite(array).all():
            allowed = " or ".join(" x ".join(map(str, s)) for s in shapes) or "a list"
            raise CalibrationError(f"{where}: {key} must be finite numbers of shape {allowed}; correct this entry.")
        return array

    vectors = ((3,), (3, 1), (1, 3))
    projection = numbers(_PROJECTION, ((3, 4),))
    k, rotation = numbers(_K, ((3, 3),)), numbers(_ROTATION, (*vectors, (3, 3)))
    translation, pose = numbers(_TRANSLATION, vectors), numbers(_POSE, ((3, 4), (4, 4)))
    lens = numbers(_LENS, ())
    if k is None and projection is not None:
        k, rotation, translation = decomposed(projection, where)
    elif pose is not None and (rotation is None or translation is None):
        rotation, translation = pose[:3, :3], pose[:3, 3]
    if k is None or rotation is None or translation is None:
        missing = "K" if k is None else "R" if rotation is None else "t"
        raise CalibrationError(f"{where}: {missing} is missing; export the calibration again.")
    turn = so3_exp(rotation.ravel()) if rotation.size == 3 else rotation
    size = _size(where, table)
    if size is None:
        size = twice_the_centre(k)
        guessed.append(name)
    return checked_camera(
        where, name, k, np.zeros(5) if lens is None else lens.ravel(), turn, translation.ravel(), size
    )


def _size(where: str, table: Mapping[str, Any]) -> Array | None:
    value = next((table[k] for k in _SIZE if k in table), None)
    if value is None and {"width", "height"} <= table.keys():
        value = [table["width"], table["height"]]
    if isinstance(value, Mapping):
        value = [value.get("width"), value.get("height")]
    if value is None:
        return None
    array = as_numbers(value)
    if array is None or array.shape != (2,):
        raise CalibrationError(f"{where}: the size must be width and height in px; correct this entry.")
    return array


def twice_the_centre(k: Array) -> Array:
    """The size that a picture is guessed to have when a file does not say it."""
    return np.maximum(1, np.round(2 * k[:2, 2]))


def _size_note(path: Path, guessed: list[str], cameras: list[Camera]) -> str:
    sizes = {c.name: f"{c.size[0]} x {c.size[1]}" for c in cameras}
    return (
        f"{path.name} does not say how large the images of {', '.join(guessed)} are; twice the principal point "
        f"({sizes[guessed[0]]} px) is assumed. If that is wrong, add resolution to each camera of the file."
    )


def decomposed(projection: Array, where: str) -> tuple[Array, Array, Array]:
    """K, rotation and translation of a projection matrix (3, 4) of any scale, without skew in K.

    Source: Hartley and Zisserman, Multiple View Geometry, 6.2.4 (RQ decomposition)."""
    m = projection[:, :3]
    if not np.isfinite(m).all() or abs(np.linalg.det(m)) < 1e-12 * max(1e-30, np.abs(m).max()) ** 3:
        raise CalibrationError(f"{where}: P is no projection matrix (its left part has no inverse); correct it.")
    if np.linalg.det(m) < 0:
        projection, m = -projection, -m
    q, r = np.linalg.qr(np.flipud(m).T)
    k, rotation = np.flipud(np.fliplr(r.T)), np.flipud(q.T)
    signs = np.diag(np.sign(np.diag(k)))
    k, rotation = k @ signs, signs @ rotation
    translation = np.linalg.solve(k, projection[:, 3])
    k = k / k[2, 2]
    if abs(k[0, 1]) > 0.01 * k[0, 0]:
        raise CalibrationError(
            f"{where}: P has oblique pixels (skew {k[0, 1]:.3g}), which no camera here can have; calibrate it again."
        )
    k[0, 1] = 0.0
    return k, rotation, np.asarray(translation, dtype=np.float64)

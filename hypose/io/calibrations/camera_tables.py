"""Conversion of camera tables of calibration files to cameras, whichever program wrote them.

A camera is a table with an intrinsic matrix (3 x 3, 4 x 4, or fx fy cx cy), lens coefficients in OpenCV's order, the
picture's size, and a pose: a rotation (vector, matrix, quaternion) with a translation, or one matrix. Poses are
camera_from_world unless the table states otherwise (`camera_to_world`, `world2cam: false`). Alternatively it has a 3 x
4 projection matrix. Other keys are ignored, with a note about those that no known program writes. Unknown words for
lens model, direction or unit are refused, because a wrong guess would give a wrong result without any sign.

Kalibr chains its poses from camera to camera (T_cn_cnm1). The world of Kalibr and of MC-Calib is that of their first
camera.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, refuse
from hypose.geometry import Array, se3, se3_inverse, so3_exp

# ---- cameras from numbers ------------------------------------------------------------------------------------------
# Common parts of all readers of calibrations: conversion of numbers to checked cameras, missing picture sizes and
# units.
#
# Pose2Sim and Caliscope write metres; anipose and FreeMoCap write the unit of the calibration board, usually
# millimetres. Where the file does not state the unit, the size decides: cameras whose typical distance from each
# other (for a single camera: from the world's origin) exceeds 50 are in millimetres.
# Why: rigs wider than 50 m and rigs narrower than 50 mm are both implausible.


MAX_FILE_BYTES = 5_000_000
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# Above this typical camera distance the numbers cannot be metres, below it they cannot be millimetres.
_UNIT_LIMIT = 50.0


def as_numbers(value: Any) -> Array | None:
    """Convert a number, a (nested, rectangular) list of numbers or an array to float64; None for anything else."""

    def plain(v: Any) -> bool:
        if isinstance(v, list):
            return all(plain(x) for x in v)
        return isinstance(v, int | float | np.ndarray) and not isinstance(v, bool)

    try:
        return np.array(value, dtype=np.float64) if plain(value) else None
    except (TypeError, ValueError, OverflowError, RecursionError):
        return None


def numbers(where: str, table: Mapping[str, Any], keys: tuple[str, ...], *shapes: tuple[int, ...]) -> Array:
    """Get the finite numbers of a table's first key that is present.

    A row of numbers is accepted for a matrix, and a matrix of one row or column for a row.

    where: start of the error messages.
    keys: alternative names of the entry.
    shapes: accepted shapes; none for a row of any length.
    Raises: CalibrationError where the entry is missing or wrong.
    """
    array = numbers_if_any(where, table, keys, *shapes)
    if array is None:
        raise CalibrationError(f"{where}: {keys[0]} is missing; add this entry, or calibrate the camera again.")
    return array


def numbers_if_any(
    where: str, table: Mapping[str, Any], keys: tuple[str, ...], *shapes: tuple[int, ...]
) -> Array | None:
    """Get the finite numbers of a table's first key that is present.

    where: start of the error messages.
    keys: alternative names of the entry.
    shapes: accepted shapes; none for a row of any length.
    Returns: array of one of the shapes; None where the table has none of the keys.
    Raises: CalibrationError where the entry is wrong.
    """
    key = next((k for k in keys if table.get(k) is not None), None)
    if key is None:
        return None
    array = as_numbers(table[key])
    size = 0 if array is None else array.size
    fitting = (s for s in shapes or ((size,),) if size == math.prod(s))  # a vector may be given as a row or column
    shape = None if array is None else next((s for s in fitting if array.shape == s or 1 in (array.ndim, len(s))), None)
    if array is None or shape is None:
        got = f"shape {array.shape}" if array is not None and array.ndim else repr(table[key])[:40]
        allowed = " or ".join(" x ".join(map(str, s)) for s in shapes) or "a list"
        raise CalibrationError(f"{where}: {key} must be numbers of shape {allowed}, got {got}; correct this entry.")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{where}: {key} contains NaN or infinity; correct this entry, or calibrate again.")
    return array.reshape(shape)


class RigFile:
    """Builder of the camera rig of one calibration file.

    path: the file, for error messages.
    unit: unit of the translations; "auto" to determine it from the distances. Readers of formats that define it set it.
    Attributes:
    notes: sentences about assumptions that were made.
    """

    def __init__(self, path: Path, unit: str = "auto") -> None:
        self.path, self.unit, self.notes = path, unit, list[str]()
        self._cameras, self._guessed = list[Camera](), list[str]()

    def where(self, name: str) -> str:
        """Format the start of messages about a camera."""
        return f"{self.path}, camera {name}"

    def add(
        self,
        name: str,
        k: Array,
        distortion: Array | None,
        rotation: Array,
        translation: Array,
        size: Array | None,
        fisheye: bool = False,
    ) -> None:
        """Add a camera from the numbers of the file.

        k: (3, 3) intrinsic matrix, px.
        distortion: OpenCV's coefficients; None for no distortion.
        rotation: camera_from_world, a matrix (3, 3) or rotation vector (3,).
        translation: (3,) camera_from_world, in the file's unit.
        size: width and height, px; None for twice the principal point, with a note.
        fisheye: the coefficients are the four of OpenCV's fisheye model.
        Raises: CalibrationError where a number is implausible.
        """
        if size is None:
            size = np.maximum(1, np.round(2 * k[:2, 2]))
            self._guessed.append(name)
        rotation = so3_exp(rotation) if rotation.size == 3 else rotation
        distortion = np.zeros(5) if distortion is None else distortion
        self._cameras.append(_checked(self.where(name), name, k, distortion, rotation, translation, size, fisheye))

    def rig(self) -> tuple[CameraRig, tuple[str, ...]]:
        """Build the rig, its world in metres, and return it with the notes.

        Raises: CalibrationError where there are no cameras.
        """
        if not self._cameras:
            raise CalibrationError(
                f"{self.path} holds no cameras: each needs an intrinsic matrix, a rotation and a translation, or a "
                "projection matrix; give a calibration file, or export it again."
            )
        if self._guessed:
            w, h = next(c.size for c in self._cameras if c.name == self._guessed[0])
            self.notes.append(
                f"{self.path.name} does not say how large the images of {', '.join(self._guessed)} are; {w} x {h} px, "
                "twice the principal point, is assumed. If that is wrong, add the size to each camera of the file."
            )
        unit = self._likely_unit() if self.unit == "auto" else self.unit
        for i, a in enumerate(self._cameras):
            pose = a.camera_from_world
            same = [c.name for c in self._cameras[i + 1 :] if np.allclose(c.camera_from_world, pose)]
            if same and not np.array_equal(pose, np.eye(4)):  # cameras of lens-only files are at the origin
                self.notes.append(f"{self.path.name}: cameras {a.name} and {same[0]} stand in one place; correct one.")
        try:
            return CameraRig(tuple(rescaled(c, UNITS[unit]) for c in self._cameras)), tuple(self.notes)
        except CalibrationError as error:
            raise CalibrationError(f"{self.path}: {error}") from None

    def _likely_unit(self) -> str:
        """Determine the unit, "m" or "mm", from the distances of the cameras; a note says so for millimetres."""
        centres = np.array([c.position for c in self._cameras])
        if len(centres) > 1:
            i, j = np.triu_indices(len(centres), 1)
            typical, what = np.median(np.linalg.norm(centres[i] - centres[j], axis=1)), "distance between the cameras"
        else:
            typical, what = np.linalg.norm(centres[0]), "distance of the camera from the origin"
        if typical <= _UNIT_LIMIT:
            return "m"
        self.notes.append(
            f"{self.path.name}: translations are taken as millimetres because the typical {what} is {typical:.0f} (= "
            f"{typical / 1000:.2f} m); set the calibration unit to m or cm if that is wrong."
        )
        return "mm"


def rescaled(camera: Camera, factor: float) -> Camera:
    """Copy a camera with its translation multiplied by a factor."""
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= factor
    return replace(camera, camera_from_world=pose)


def _checked(
    where: str, name: str, k: Array, distortion: Array, rotation: Array, translation: Array, size: Array, fisheye: bool
) -> Camera:
    """Make a camera of numbers, as `RigFile.add` takes them, after checking that they are plausible.

    where: start of the error messages.
    rotation: camera_from_world (3, 3); the nearest exact rotation is used.
    Raises: CalibrationError where a number is implausible; it names the first.
    """
    (w, h), n = size, len(distortion)
    allowed = (0, 1, 2, 4) if fisheye else (0, 1, 2, 4, 5, 8, 12, 14)
    whole = float(w).is_integer() and float(h).is_integer()
    faults = {
        f"size must be the image's width and height in whole pixels, got {w:g} x {h:g}; correct this entry": not (
            1 <= w <= 100_000 and 1 <= h <= 100_000 and whole
        ),
        f"matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}; it may have been written transposed: "
        "exchange its rows and columns": not np.allclose(k[2], [0, 0, 1], atol=1e-9) or abs(k[1, 0]) > 1e-9,
        f"focal lengths must be positive pixel numbers, got matrix {k.tolist()}; calibrate it again": not (
            0 < k[0, 0] < 1e6 and 0 < k[1, 1] < 1e6 and np.abs(k[:2, 2]).max() < 1e6
        ),
        "rotation is not a rotation matrix (its rows must be perpendicular unit vectors, right-handed); correct this "
        "entry or calibrate again": not np.abs(rotation.T @ rotation - np.eye(3)).max() <= 1e-2  # NaN as well
        or np.linalg.det(rotation) < 0,
        f"translation {translation.tolist()} is farther than any camera stands; calibrate it again": not (
            np.abs(translation).max() <= 1e7
        ),
        f"{n} distortion coefficients; OpenCV's model has {', '.join(map(str, allowed[3:]))} of them, so write them in "
        "OpenCV's order (k1 k2 p1 p2 k3 ...)": n not in allowed,
    }
    refuse(f"{where}: ", faults, CalibrationError)
    distortion = np.concatenate([distortion, np.zeros(max(4 - len(distortion), 0))])
    # Files have few digits: use the nearest exact rotation, so that inverses and products stay exact.
    u, _, vt = np.linalg.svd(rotation)
    return Camera(name, k, distortion, se3(u @ vt, translation), (int(w), int(h)), fisheye)


def decomposed(projection: Array, where: str) -> tuple[Array, Array, Array]:
    """Decompose a projection matrix (3, 4) of any scale.

    where: start of the error messages.
    Returns: K (3, 3) without skew, rotation (3, 3), translation (3,).
    Raises: CalibrationError where it is not the matrix of a camera.
    Source: Hartley and Zisserman, Multiple View Geometry, 6.2.4 (RQ decomposition).
    """
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


# ---- tables --------------------------------------------------------------------------------------------------------
Table = Mapping[str, Any]
# The spellings that programs use; the first is hypose's own.
_MATRIX = (
    *("matrix", "K", "camera_matrix", "cameraMatrix", "Camera_Matrix", "CameraMatrix", "intrinsic_matrix"),
    *("intrinsic", "intrinsics", "mtx", "k"),
)
_LENS = (
    *("distortions", "distortion", "dist", "distCoef", "dist_coeffs", "distCoeffs", "distortion_coefficients"),
    *("Distortion_Coefficients", "DistortionCoeffs", "distortion_coeffs", "distortion_vector", "D"),
)
_SINGLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_SIZE = ("size", "image_size", "resolution", "imgSize", "img_size", "imageSize")
_WIDTH = ("image_width", "image_Width", "img_width", "width")
_HEIGHT = ("image_height", "image_Height", "img_height", "height")
_ROTATION = ("rotation", "R", "rvec", "rotation_vectors", "rotation_matrix", "extrinsic_r", "r")
_TRANSLATION = ("translation", "T", "t", "tvec", "translation_vectors", "translation_vector", "extrinsic_t")
_POSE = (
    *("camera_from_world", "RT", "Rt", "extrinsic", "extrinsics", "world_to_camera", "world2camera", "w2c"),
    *("extrinsic_matrix", "camera_pose_matrix", "T_cam_world"),
)
_INVERSE_POSE = ("camera_to_world", "cam_to_world", "world_from_camera", "c2w", "T_world_cam", "T_wc")
_UNORDERED = ("quaternion", "quat", "orientation")
_QUATERNION = ("quaternion_wxyz", "quaternion_xyzw", "qvec", *_UNORDERED)
_PROJECTION = ("P", "projection", "projection_matrix", "proj")
_CHAINED = "T_cn_cnm1"
_DIRECTION = {"world2cam": True, "world_to_cam": True, "cam2world": False}
_AXES = ("convention", "coordinate_system", "camera_convention")
_MODEL = ("fisheye", "fisheye_model", "is_fisheye", "distortion_model", "distortion_type", "lens_model", "camera_model")
_FISHEYE = {"fisheye", "equidistant", "kannala_brandt", "kannalabrandt", "kb4", "opencv_fisheye", "true", "1"}
_BROWN = {"radtan", "plumb_bob", "rational_polynomial", "brown", "brown_conrady", "standard", "false", "0"}
_NEUTRAL = {"pinhole", "perspective", "opencv", "none", "full_opencv", ""}
_PASSED_OVER = {
    *("name", "camera", "camera_name", "id", "cam_id", "camera_id", "serial", "label", "index", "type", "class_name"),
    *("rotation_count", "error", "exposure", "grid_count", "ignore", "panel", "node", "unit", "units", "fps"),
    *("calibration_time", "nr_of_frames", "board_width", "board_height", "square_size", "flags", "rms", "metadata"),
    *("avg_reprojection_error", "reprojection_error", "per_view_reprojection_errors", "image_points", "points"),
    *("rectification_matrix", "cam_overlaps", "rostopic", "timeshift_cam_imu", "T_cam_imu", "camera_group"),
    *(
        "verified_resolutions",
        "position",
        "center",
        "centre",
        "rotation_EulerAngles",
        "frame_rate",
        *("CreationDate", "calibDataSource", "nb_camera", "version", "date", "camera_count"),
    ),
}
_UNDERSTOOD = {
    *_MATRIX, *_LENS, *_SINGLE, *_SIZE, *_WIDTH, *_HEIGHT, *_ROTATION, *_TRANSLATION, *_POSE, *_INVERSE_POSE,
    *_QUATERNION, *_PROJECTION, _CHAINED, *_DIRECTION, *_AXES, *_MODEL, *_PASSED_OVER,
}  # fmt: skip
_UNIT_WORDS = {
    "m": "m", "meter": "m", "metre": "m", "cm": "cm", "centimeter": "cm", "centimetre": "cm",
    "mm": "mm", "millimeter": "mm", "millimetre": "mm",
}  # fmt: skip
_NOT_CAMERAS = {"metadata", "capture_volume", "charuco", "checkerboard", "board"}
# Keys that a document may state once, for all its cameras.
_SHARED = {*_AXES, *_MODEL, *_DIRECTION, *_SIZE, *_WIDTH, *_HEIGHT}


def tables_of(document: Any, name: str) -> dict[str, Table]:
    """Find the tables of the cameras in a document.

    name: name of a single camera that has none.
    Returns: tables by camera name.
    """
    if isinstance(document, Mapping) and any(isinstance(document.get(k), list | np.ndarray) for k in _MATRIX):
        return {str(document.get("camera_name") or name): document}
    nested = document.get("cameras", document) if isinstance(document, Mapping) else document
    outer = document if isinstance(document, Mapping) else {}
    inner = outer.get("metadata")
    stated = {**(inner if isinstance(inner, Mapping) else {}), **outer}
    shared = {k: v for k, v in stated.items() if k in _SHARED and not isinstance(v, Mapping)}
    if isinstance(nested, list):
        nested = {f"cam_{i}": v for i, v in enumerate(nested)}
    wanted = {*_MATRIX, *_PROJECTION}
    if not isinstance(nested, Mapping):
        return {}
    found = {
        f"cam_{k}" if str(k).isdecimal() else str(k): {**shared, **v}
        for k, v in nested.items()
        if isinstance(v, Mapping) and str(k).lower() not in _NOT_CAMERAS and wanted & v.keys()
    }
    names = [_own_name(v) or k for k, v in found.items()]
    return dict(zip(names if len(set(names)) == len(names) else found, found.values(), strict=True))


def strange_keys(document: Any, tables: Mapping[str, Table]) -> list[str]:
    """List the keys of cameras, and keys of a document next to its cameras with plain values, that are not understood.

    tables: tables of the cameras, as `tables_of` finds them.
    """
    keys = {k for table in tables.values() for k in table}
    if isinstance(document, Mapping):
        keys |= {k for k, v in document.items() if isinstance(v, str | int | float)}
    return sorted(str(k) for k in keys if k not in _UNDERSTOOD)


def _own_name(table: Table) -> str:
    """Get the camera's name from its table; of a ROS topic, the parts that are not a type of picture."""
    topic = [p for p in str(table.get("rostopic", "")).split("/") if p and not re.match(r"image|compressed", p)]
    name = table.get("name", table.get("camera", "_".join(topic)))
    return str(name) if isinstance(name, str | int) else ""


def unit_of(document: Any, unit: str, where: str) -> str:
    """Choose the unit of length: the given one, else the one that the document states, else "auto".

    where: the file, for the error message.
    Raises: CalibrationError where the stated unit is not known.
    """
    if unit != "auto" or not isinstance(document, Mapping):
        return unit
    inner = document.get("metadata")
    stated = [t[k] for t in (inner, document) if isinstance(t, Mapping) for k in ("unit", "units") if k in t]
    if not stated:
        return "auto"
    word = str(stated[0]).lower()
    known = _UNIT_WORDS.get(word, _UNIT_WORDS.get(word.removesuffix("s"), ""))
    if known not in UNITS:
        raise CalibrationError(
            f"{where}: the unit {stated[0]!r} is not known; set the calibration unit to m, cm or mm."
        )
    return known


def add_cameras(rig: RigFile, tables: Mapping[str, Table]) -> None:
    """Add the cameras of tables to a rig.

    Cameras without a pose are left out, with a note, where others have one. Where none has one, all are put at the
    origin.

    Raises: CalibrationError that names file, camera and key.
    """
    kalibr = any(_CHAINED in t for t in tables.values())
    poses = dict[str, Array | None]()
    chained = np.eye(4)  # Kalibr's poses are relative to the camera before, the first is at the origin
    for name, table in tables.items():
        step = numbers_if_any(rig.where(name), table, (_CHAINED,), (4, 4)) if kalibr else None
        chained = chained if step is None else step @ chained
        poses[name] = chained if kalibr else _pose(rig.where(name), table)
    placed = [name for name, pose in poses.items() if pose is not None]
    if tables and not placed:
        rig.notes.append(
            f"{rig.path.name} has no camera poses; the cameras are put at the origin. These are lenses "
            "alone: run hypose calibrate with --intrinsics and this file."
        )
    if kalibr or any("camera_pose_matrix" in t for t in tables.values()):
        rig.notes.append(
            f"{rig.path.name}: the world is the first camera's, so z does not point up; results lie on their side."
        )
    for name, table in tables.items():
        pose = poses[name]
        if pose is None and placed:
            rig.notes.append(f"{rig.path.name}: camera {name} has no rotation and translation; it is left out.")
            continue
        pose = np.eye(4) if pose is None else pose
        where = rig.where(name)
        k = _matrix(where, table)
        rig.add(name, k, _lens(where, table), pose[:3, :3], pose[:3, 3], _size(where, table), _fisheye(where, table))


def _pose(where: str, table: Table) -> Array | None:
    """Get the pose camera_from_world (4, 4) of a table, in the file's unit.

    Returns: None where the table has neither rotation nor translation.
    Raises: CalibrationError where one of them is missing or a value is wrong.
    """
    if not any(k in table for k in _MATRIX):
        _, rotation, translation = decomposed(numbers(where, table, _PROJECTION, (3, 4)), where)
        return _joined(rotation, translation)
    for key in _AXES:
        if str(table.get(key, "opencv")).lower() not in ("opencv", "cv"):
            raise CalibrationError(f"{where}: {key} {table[key]!r} is not known; export with OpenCV's camera axes.")
    outward = [reported == want for k, want in _DIRECTION.items() if isinstance(reported := table.get(k), bool)]
    inverse = bool(outward) and not outward[0]
    matrix = numbers_if_any(where, table, _POSE, (3, 4), (4, 4))
    if matrix is None and (matrix := numbers_if_any(where, table, _INVERSE_POSE, (3, 4), (4, 4))) is not None:
        inverse = True
    if matrix is not None:
        pose = _joined(matrix[:3, :3], matrix[:3, 3])
    else:
        rotation = _rotation(where, table)
        translation = numbers_if_any(where, table, _TRANSLATION, (3,))
        if rotation is None and translation is None:
            return None
        if rotation is None or translation is None:
            missing = "rotation" if rotation is None else "translation"
            raise CalibrationError(f"{where}: {missing} is missing; add this entry, or calibrate the camera again.")
        pose = _joined(rotation, translation)
    return se3_inverse(pose) if inverse else pose


def _joined(rotation: Array, translation: Array) -> Array:
    return se3(so3_exp(rotation) if rotation.size == 3 else rotation, translation)


def _rotation(where: str, table: Table) -> Array | None:
    """Get the rotation of a table: a vector (3,), rad, or a matrix (3, 3).

    Returns: None where the table has none.
    Raises: CalibrationError where it is wrong, or a quaternion whose order is not stated.
    """
    key = next((k for k in _QUATERNION if k in table), None)
    if key is None:
        return numbers_if_any(where, table, _ROTATION, (3,), (3, 3))
    from scipy.spatial.transform import Rotation  # takes long to import

    value, order = table[key], {"quaternion_wxyz": "wxyz", "quaternion_xyzw": "xyzw", "qvec": "wxyz"}.get(key)
    if isinstance(value, Mapping) and value.keys() >= set("wxyz"):
        value, order = [value[c] for c in "wxyz"], "wxyz"
    if order is None:
        raise CalibrationError(
            f"{where}: the order of {key} is not stated; name it quaternion_wxyz or quaternion_xyzw, as it is."
        )
    q = numbers(where, {key: value}, (key,), (4,))
    if not 0.9 < np.linalg.norm(q) < 1.1:
        raise CalibrationError(f"{where}: {key} {q.tolist()} is no unit quaternion; correct this entry.")
    return np.asarray(Rotation.from_quat(q, scalar_first=order == "wxyz").as_matrix(), dtype=np.float64)


def _matrix(where: str, table: Table) -> Array:
    """Get the intrinsic matrix (3, 3) of a table."""
    k = numbers_if_any(where, table, _MATRIX, (3, 3), (4, 4), (4,))
    if k is None:
        return decomposed(numbers(where, table, _PROJECTION, (3, 4)), where)[0]
    if k.shape == (4,):
        return np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1.0]])
    return k[:3, :3]


def _lens(where: str, table: Table) -> Array | None:
    """Get the lens coefficients of a table in OpenCV's order; None where it has none."""
    lens = numbers_if_any(where, table, _LENS)
    if lens is not None or not any(k in table for k in _SINGLE[:2]):
        return lens
    keys = ("k1", "k2", "k3", "k4") if _fisheye(where, table) else _SINGLE
    values = np.array([numbers(where, {"v": table.get(k, 0.0)}, ("v",), (1,))[0] for k in keys])
    return values if len(keys) == 4 or values[5:].any() else values[:5]


def _fisheye(where: str, table: Table) -> bool:
    """Test whether the lens coefficients are of OpenCV's fisheye model; CalibrationError for other models."""
    words = {k: str(table[k]).lower().strip() for k in _MODEL if table.get(k) is not None}
    for key, word in words.items():
        if word not in _FISHEYE | _BROWN | _NEUTRAL or (key == "fisheye" and not isinstance(table[key], bool)):
            allowed = "true or false" if key == "fisheye" else "OpenCV's (plumb_bob, rational_polynomial) or fisheye"
            raise CalibrationError(f"{where}: {key} must be {allowed}, got {table[key]!r}; correct this entry.")
    said = {word in _FISHEYE for word in words.values() if word not in _NEUTRAL}
    if len(said) > 1:
        raise CalibrationError(f"{where}: {' and '.join(words)} contradict each other; correct one of them.")
    return True in said


def _size(where: str, table: Table) -> Array | None:
    """Get width and height of the pictures; None where they are not stated."""
    value = next((table[k] for k in _SIZE if k in table), None)
    if isinstance(value, Mapping):
        table, value = value, None
    if value is not None:
        return numbers(where, {"size": value}, ("size",), (2,))
    sides = [numbers_if_any(where, table, keys, (1,)) for keys in (_WIDTH, _HEIGHT)]
    return None if sides[0] is None or sides[1] is None else np.concatenate([sides[0], sides[1]])

"""Common parts of all readers of calibrations: conversion of numbers to checked cameras, missing picture sizes and
units.

Pose2Sim and Caliscope write metres; anipose and FreeMoCap write the unit of the calibration board, usually millimetres.
Where the file does not state the unit, the size decides: cameras whose typical distance from each other (for a single
camera: from the world's origin) exceeds 50 are in millimetres.
Why: rigs wider than 50 m and rigs narrower than 50 mm are both implausible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, se3, so3_exp

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
    shape = None if array is None else _fitting(array, shapes)
    if array is None or shape is None:
        got = f"shape {array.shape}" if array is not None and array.ndim else repr(table[key])[:40]
        allowed = " or ".join(" x ".join(map(str, s)) for s in shapes) or "a list"
        raise CalibrationError(f"{where}: {key} must be numbers of shape {allowed}, got {got}; correct this entry.")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{where}: {key} contains NaN or infinity; correct this entry, or calibrate again.")
    return array.reshape(shape)


def _fitting(array: Array, shapes: tuple[tuple[int, ...], ...]) -> tuple[int, ...] | None:
    """Choose the shape that an array has or can be given.

    shapes: accepted shapes; none for a row of any length.
    Returns: None where no shape fits.
    """
    for s in shapes or ((array.size,),):
        if array.size == math.prod(s) and (array.shape == s or 1 in (array.ndim, len(s))):
            return s
    return None


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
    if found := [fault for fault, there in faults.items() if there]:
        raise CalibrationError(f"{where}: {found[0]}.")
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

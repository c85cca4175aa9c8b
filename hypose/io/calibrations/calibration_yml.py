"""Calibrations in OpenCV's YAML or XML: EasyMocap's pair intri.yml and extri.yml, and single cameras."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array, so3_exp, so3_log
from hypose.io.calibrations.calibration_toml import (
    MAX_FILE_BYTES,
    checked_camera,
    guess_unit,
    natural_key,
    rescaled,
    rig_of,
)
from hypose.io.calibrations.opencv_storage import parse_storage
from hypose.io.file_names import text_of
from hypose.io.files import read_bytes, text_lines, write_text

_MAX_BYTES = 5_000_000
_K = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "CameraMatrix", "K")
_LENS = ("distortion_coefficients", "dist_coeffs", "Distortion_Coefficients", "DistortionCoeffs", "D", "dist")
_ROTATION = ("rotation_vectors", "rotation_matrix", "rvec", "R", "rotation")
_TRANSLATION = ("translation_vectors", "tvec", "T", "translation")
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")


def read_yml(path: str | Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of EasyMocap's files (their folder, or either of them) or of one camera in OpenCV's own layout."""
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    pair = _pair(folder)
    if pair is not None and (path.is_dir() or path in pair):
        cameras, notes = _easymocap(*pair)
    elif path.is_dir():
        raise CalibrationError(f"{path} holds no intri.yml and extri.yml; give a calibration file.")
    else:
        cameras, notes = _single(path)
    if unit == "auto":
        unit, more = guess_unit(path, cameras)
        notes += more
    factor = {"m": 1.0, "cm": 0.01, "mm": 0.001}[unit]
    return rig_of(path, [rescaled(c, factor) for c in cameras]), tuple(notes)


def storages(folder: Path) -> list[Path]:
    """The files of OpenCV's storage in a folder, one per camera, in natural order."""
    files = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in (".xml", ".yml", ".yaml")]
    found = []
    for p in files:
        with contextlib.suppress(InputError):  # of what cannot be read
            start = read_bytes(p, "a calibration", MAX_FILE_BYTES)[:4096]
            if b"opencv_storage" in start or b"opencv-matrix" in start:
                found.append(p)
    return sorted(found, key=lambda p: natural_key(p.name))


def read_storages(folder: Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of a folder with one file of OpenCV's storage per camera, called like the files."""
    cameras, notes = [], []
    for path in storages(folder)[:200]:
        one, said = _single(path)
        cameras += one
        notes += said
    if unit == "auto":
        unit, more = guess_unit(folder, cameras)
        notes += more
    factor = {"m": 1.0, "cm": 0.01, "mm": 0.001}[unit]
    return rig_of(folder, [rescaled(c, factor) for c in cameras]), tuple(notes)


def _pair(folder: Path) -> tuple[Path, Path] | None:
    for first, second in (("intri.yml", "extri.yml"), ("Intrinsic.yml", "Extrinsic.yml")):
        if (folder / first).is_file() and (folder / second).is_file():
            return folder / first, folder / second
    return None


class _Storage:
    """The values of a file, with sentences for errors."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._values = parse_storage("\n".join(text_lines(path, "a calibration file", _MAX_BYTES)))
        except ValueError as error:
            raise CalibrationError(
                f"{path} is not a file of OpenCV's storage (YAML or XML): {error}; calibrate again."
            ) from None

    def names(self) -> list[str]:
        """The cameras' names; EasyMocap writes numbers as well."""
        found = self._values.get("names")
        found = [found] if isinstance(found, str | float) else found
        return [n if isinstance(n, str) else f"{n:g}" for n in found] if isinstance(found, list) else []

    def matrix(self, keys: tuple[str, ...], counts: tuple[int, ...]) -> Array | None:
        """The first matrix or list found under the keys, flat."""
        for key in keys:
            value = self._values.get(key)
            if value is None:
                continue
            numbers = isinstance(value, list) and all(isinstance(v, float) for v in value)
            flat = np.array(value, dtype=np.float64) if numbers or isinstance(value, np.ndarray) else np.zeros(0)
            if flat.size not in counts or not np.isfinite(flat).all():
                raise CalibrationError(
                    f"{self.path}: {key} must be {' or '.join(map(str, counts))} finite numbers; calibrate again."
                )
            return flat
        return None

    def number(self, keys: tuple[str, ...]) -> float | None:
        """The first number found under the keys."""
        return next((v for key in keys if isinstance(v := self._values.get(key), float)), None)


_LENS_COUNTS = (4, 5, 8, 12, 14)


def _easymocap(intrinsics: Path, extrinsics: Path) -> tuple[list, list[str]]:
    lenses, poses = _Storage(intrinsics), _Storage(extrinsics)
    names = lenses.names()
    if not names:
        raise CalibrationError(f"{intrinsics} names no cameras (names: ...); give EasyMocap's intri.yml and extri.yml.")
    cameras, notes, guessed = [], [], []
    for name in sorted(names, key=natural_key):
        where = f"{intrinsics.parent}, camera {name}"
        # Pose2Sim numbers the entries and lists other names
        labels = (name, str(names.index(name) + 1))
        k = lenses.matrix(tuple(f"K_{n}" for n in labels), (9,))
        lens = lenses.matrix(tuple(f"dist_{n}" for n in labels), _LENS_COUNTS)
        turn = poses.matrix(tuple(f"Rot_{n}" for n in labels), (9,))
        vector = poses.matrix(tuple(f"R_{n}" for n in labels), (3, 9))
        place = poses.matrix(tuple(f"T_{n}" for n in labels), (3,))
        if k is None or place is None or (turn is None and vector is None):
            missing = "K" if k is None else "T" if place is None else "R"
            raise CalibrationError(f"{where}: {missing}_{name} is missing; calibrate this camera again.")
        w = lenses.number(tuple(f"W_{n}" for n in labels))
        h = lenses.number(tuple(f"H_{n}" for n in labels))
        if w is None or h is None:
            w, h = round(2 * k[2]), round(2 * k[5])
            guessed.append(name)
        if turn is None:
            assert vector is not None
            turn = so3_exp(vector) if vector.size == 3 else vector
        lens = np.zeros(5) if lens is None else lens
        cameras.append(checked_camera(where, name, k.reshape(3, 3), lens, turn.reshape(3, 3), place, np.array([w, h])))
    if guessed:
        notes.append(
            f"{intrinsics.name} does not say how large the images of {', '.join(guessed)} are; twice the principal "
            f"point is assumed. If that is wrong, add W_{guessed[0]} and H_{guessed[0]} to the file, and so for each."
        )
    return cameras, notes


def _single(path: Path) -> tuple[list, list[str]]:
    file = _Storage(path)
    k = file.matrix(_K, (9,))
    if k is None:
        raise CalibrationError(f"{path} holds no camera matrix; give a calibration file of OpenCV or EasyMocap.")
    lens = file.matrix(_LENS, _LENS_COUNTS)
    turn, place = file.matrix(_ROTATION, (3, 9)), file.matrix(_TRANSLATION, (3,))
    notes = []
    if turn is None or place is None:
        turn, place = np.zeros(3), np.zeros(3)
        notes.append(f"{path.name} says nothing about where the camera stands; it is put at the origin.")
    w, h = file.number(_WIDTH), file.number(_HEIGHT)
    if w is None or h is None:
        w, h = round(2 * k[2]), round(2 * k[5])
        notes.append(
            f"{path.name} does not say how large its images are; {w} x {h} px, twice the principal point, is assumed. "
            "If that is wrong, add image_width and image_height to the file."
        )
    told_by_folder = path.stem.lower() in ("config", "intrinsics", "calibration")
    name = text_of(path.absolute().parent.name if told_by_folder else path.stem)
    rotation = so3_exp(turn) if turn.size == 3 else turn.reshape(3, 3)
    lens = np.zeros(5) if lens is None else lens
    camera = checked_camera(str(path), name, k.reshape(3, 3), lens, rotation, place, np.array([w, h]))
    return [camera], notes


def write_yml(rig: CameraRig, folder: str | Path) -> list[Path]:
    """EasyMocap's intri.yml and extri.yml in a folder, metres."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for camera in rig:
        if camera.fisheye or len(camera.distortion) > 5:
            what = "fisheye lens" if camera.fisheye else "lens of more than 5 coefficients"
            raise CalibrationError(
                f"Camera {camera.name} has a {what}, which EasyMocap's files cannot hold; write .toml."
            )
        if not re.fullmatch(r"[A-Za-z0-9_-]+", camera.name):
            raise CalibrationError(
                f"The camera name {camera.name!r} cannot stand in EasyMocap's files; use letters, digits, - and _."
            )
    names = "names:\n" + "".join(f'  - "{c.name}"\n' for c in rig)
    first, second = ["%YAML:1.0\n---\n", names], ["%YAML:1.0\n---\n", names]
    for c in rig:
        lens = np.zeros((1, 5))
        lens[0, : len(c.distortion)] = c.distortion
        first += [_matrix(f"K_{c.name}", c.K), _matrix(f"dist_{c.name}", lens)]
        first += [f"H_{c.name}: {c.size[1]}\n", f"W_{c.name}: {c.size[0]}\n"]
        pose = c.camera_from_world
        second += [
            _matrix(f"R_{c.name}", so3_log(pose[:3, :3])[:, None]),
            _matrix(f"Rot_{c.name}", pose[:3, :3]),
            _matrix(f"T_{c.name}", pose[:3, 3:]),
        ]
    write_text(folder / "intri.yml", "".join(first))
    write_text(folder / "extri.yml", "".join(second))
    return [folder / "intri.yml", folder / "extri.yml"]


def _matrix(key: str, value: Array) -> str:
    rows, columns = value.shape
    numbers = ", ".join(_real(v) for v in value.ravel())
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def _real(value: float) -> str:
    text = repr(float(value))
    return text if "." in text or "e" in text or "n" in text else f"{text}."

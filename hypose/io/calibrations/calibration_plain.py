"""Calibrations as plain numbers: BioCV's files, and 3 x 4 projection matrices in text.

BioCV: one file per camera (no ending, or .calib): width, height, K in three lines, a line, [R | t] in three or four
lines (camera_from_world, mm), and in the last line the distortion k1 k2 p1 p2 k3. Projection matrices: lines of four
numbers, three for each camera, or twelve numbers in one line; a line of one word before them names the camera. Source:
the BioCV dataset (University of Bath), as Pose2Sim converts it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array
from hypose.io.calibrations.calibration_json import decomposed, twice_the_centre
from hypose.io.calibrations.calibration_toml import UNITS, checked_camera, guess_unit, natural_key, rescaled, rig_of
from hypose.io.file_names import text_of
from hypose.io.files import text_lines

_MAX_BYTES = 1_000_000
_KIND = "a calibration of plain numbers"


def plain_files(folder: Path) -> list[Path]:
    """The files of a folder that look like BioCV's, in natural order."""
    files = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in ("", ".calib")]
    found = [p for p in files if not p.name.startswith(".") and p.stat().st_size < _MAX_BYTES and _is_biocv(p)]
    return sorted(found, key=lambda p: natural_key(p.name))


def read_plain(path: Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of a folder of BioCV's files, one of them, or a text file of projection matrices; metres."""
    if path.is_dir():
        cameras = [_biocv(p) for p in plain_files(path)]
    elif _is_biocv(path):
        cameras = [_biocv(path)]
    else:
        return _projections(path, unit)
    factor = UNITS["mm" if unit == "auto" else unit]
    return rig_of(path, [rescaled(c, factor) for c in cameras]), ()


def _rows(path: Path) -> list[list[float]]:
    """Lines as numbers; lines with anything else are empty."""
    rows = []
    for line in text_lines(path, _KIND, _MAX_BYTES)[:10_000]:
        try:
            rows.append([float(c) for c in line.replace(",", " ").split()])
        except ValueError:
            rows.append([])
    return rows


def _is_biocv(path: Path) -> bool:
    try:
        rows = _rows(path)
    except (OSError, ValueError):
        return False
    return len(rows) > 9 and [len(r) for r in rows[:5]] == [1, 1, 3, 3, 3] and [len(r) for r in rows[6:9]] == [4] * 3


def _biocv(path: Path) -> Camera:
    rows = _rows(path)
    name = text_of(path.stem if path.suffix.lower() == ".calib" else path.name)
    pose = np.array(rows[6:9])
    lens = next((r for r in reversed(rows) if r), [])
    lens = lens if len(lens) in (4, 5, 8) and rows.index(lens) > 8 else [0.0] * 5
    size = np.array([rows[0][0], rows[1][0]])
    return checked_camera(str(path), name, np.array(rows[2:5]), np.array(lens), pose[:, :3], pose[:, 3], size)


def _projections(path: Path, unit: str) -> tuple[CameraRig, tuple[str, ...]]:
    found: dict[str, list[float]] = {}
    name: str | None = None
    for line in text_lines(path, _KIND, _MAX_BYTES):
        cells = line.replace(",", " ").split()
        try:
            values = [float(c) for c in cells]
        except ValueError:
            name = text_of(cells[0].rstrip(":")) if len(cells) == 1 and not line.startswith("#") else name
            continue
        if not values:
            continue
        if name is None or len(found.get(name, ())) == 12:
            name = f"cam_{len(found)}"
        found.setdefault(name, []).extend(values)
        if len(values) not in (4, 12) or len(found[name]) > 12:
            raise CalibrationError(
                f"{path}: a line has {len(values)} numbers; projection matrices need three lines of four numbers for "
                "each camera, or twelve in one."
            )
    if not found or any(len(v) != 12 for v in found.values()):
        raise CalibrationError(
            f"{path} is no calibration: it needs three lines of four numbers for each camera (projection matrices), or "
            "is BioCV's (width, height, K, [R | t], distortion)."
        )
    cameras = [_of_projection(path, n, np.reshape(v, (3, 4))) for n, v in found.items()]
    notes = [
        f"{path.name} does not say how large the images are; twice the principal point "
        f"({cameras[0].size[0]} x {cameras[0].size[1]} px for {cameras[0].name}) is assumed, and no distortion."
    ]
    if unit == "auto":
        unit, more = guess_unit(path, cameras)
        notes += more
    return rig_of(path, [rescaled(c, UNITS[unit]) for c in cameras]), tuple(notes)


def _of_projection(path: Path, name: str, matrix: Array) -> Camera:
    where = f"{path}, camera {name}"
    if not np.isfinite(matrix).all():
        raise CalibrationError(f"{where}: the matrix holds NaN or infinity; calibrate it again.")
    k, rotation, translation = decomposed(matrix, where)
    return checked_camera(where, name, k, np.zeros(5), rotation, translation, twice_the_centre(k))

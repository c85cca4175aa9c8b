"""Calibrations as text: the TOML family, JSON, OpenCV's storage and plain numbers.

TOML (hypose, Pose2Sim, anipose, FreeMoCap, Caliscope), one table per camera; Caliscope nests them under [cameras]:

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

JSON (CMU Panoptic's layout and its many relatives): a camera is a table with K (or intrinsics) and R, t (or rvec, tvec,
or RT, extrinsics of 3 x 4 or 4 x 4), which are camera_from_world, distCoef (OpenCV's order) and resolution; or with P,
a projection matrix without distortion. The cameras are a list, or a table by name, at the top or under "cameras".
Panoptic Studio's lengths are centimetres, and it names panel and node of every camera.

OpenCV's storage (YAML or XML): EasyMocap's pair intri.yml and extri.yml, and single cameras.

Plain numbers: BioCV's files and 3 x 4 projection matrices. BioCV: one file per camera (no ending, or .calib): width,
height, K in three lines, a line, [R | t] in three or four lines (camera_from_world, mm), and in the last line the
distortion k1 k2 p1 p2 k3. Projection matrices: lines of four numbers, three for each camera, or twelve numbers in one
line; a line of one word before them names the camera. Source: the BioCV dataset (University of Bath), as Pose2Sim
converts it.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array, so3_log
from hypose.io.calibrations.calibration_camera import (
    MAX_FILE_BYTES,
    UNITS,
    RigFile,
    decomposed,
    numbers,
    numbers_if_any,
    plain_lenses,
)
from hypose.io.file_names import natural_key, text_of
from hypose.io.files import open_file, read_json, read_toml, text_lines, toml_key, toml_lines, write_text

Found = tuple[CameraRig, tuple[str, ...]]
"""The rig of a calibration, world in metres, and sentences on what was assumed."""
_KIND = "a calibration"
_ROTATIONS = ((3,), (3, 3))


# ---- TOML ----------------------------------------------------------------------------------------------------------

_NOT_CAMERAS = {"metadata", "capture_volume", "charuco", "checkerboard", "board"}
# Spellings met in files of the family; the first one is what we write.
_TOML_SIZE = ("size", "image_size", "resolution")
_TOML_K = ("matrix", "K", "camera_matrix", "intrinsic_matrix")
_TOML_LENS = ("distortions", "distortion", "dist", "dist_coeffs", "distortion_coefficients")
_TOML_R, _TOML_T = ("rotation", "R", "rvec"), ("translation", "T", "t", "tvec")


def read_calibration_toml(path: Path, unit: str) -> Found:
    """Rig of a file of the TOML family; a CalibrationError names file and camera."""
    document = read_toml(path, _KIND)
    tables: dict[str, Any] = {k: v for k, v in document.items() if k.lower() not in _NOT_CAMERAS}
    nested = document.get("cameras")
    if isinstance(nested, Mapping):  # Caliscope: [cameras.0]
        tables = {f"cam_{k}" if str(k).isdecimal() else str(k): v for k, v in nested.items()}
    rig = RigFile(
        path,
        "each needs a table with size, matrix, distortions, rotation and translation; name a calibration file of "
        "Pose2Sim, anipose, FreeMoCap or Caliscope",
    )
    for key, table in tables.items():
        if not isinstance(table, Mapping) or not any(k in table for k in _TOML_K + _TOML_R):
            continue
        if table.get("ignore") is True and not (any(map(table.get, _TOML_R)) and any(map(table.get, _TOML_T))):
            rig.notes.append(f"{path.name}: camera {key} is marked ignore and has no pose; it is left out.")
            continue
        name = table.get("name")
        name = str(name) if isinstance(name, str | int) and str(name) else key
        where, fisheye = rig.where(name), table.get("fisheye", False)
        if not isinstance(fisheye, bool):
            raise CalibrationError(f"{where}: fisheye must be true or false, got {fisheye!r}; correct this entry.")
        rig.add(
            name,
            numbers(where, table, _TOML_K, (3, 3)),
            numbers_if_any(where, table, _TOML_LENS),
            numbers(where, table, _TOML_R, *_ROTATIONS),
            numbers(where, table, _TOML_T, (3,)),
            numbers(where, table, _TOML_SIZE, (2,)),
            fisheye,
        )
    return rig.rig(_unit_of(document.get("metadata"), unit))


def _unit_of(table: Any, unit: str) -> str:
    """The unit that a file states, unless another was given."""
    stated = table.get("unit", table.get("units")) if isinstance(table, Mapping) else None
    return stated if unit == "auto" and stated in UNITS else unit


def write_calibration(rig: CameraRig, path: str | Path, unit: str = "m") -> None:
    """Write the rig as a TOML file that hypose, Pose2Sim and anipose read; unit (m or mm): of its translations."""
    lines = []
    for camera in rig:
        pose = camera.camera_from_world
        table = {
            "name": camera.name,
            "size": [int(s) for s in camera.size],
            "matrix": camera.K,
            "distortions": np.ravel(camera.distortion),
            "rotation": so3_log(pose[:3, :3]),
            "translation": pose[:3, 3] * (1000 if unit == "mm" else 1),
            "fisheye": camera.fisheye,
        }
        lines += [f"[{toml_key(camera.name)}]", *toml_lines(table), ""]
    lines += ["[metadata]", *toml_lines({"adjusted": False, "error": 0.0, "unit": unit}), ""]
    write_text(path, "\n".join(lines))


def write_calibration_toml(rig: CameraRig, path: Path) -> list[Path]:
    """Write the file of the TOML family that the name tells; the files written."""
    name = path.name.lower()
    if name == "camera_array.toml":
        _write_caliscope(rig, path)
    else:
        write_calibration(rig, path, "mm" if "anipose" in name or "freemocap" in name else "m")
    return [path]


def _write_caliscope(rig: CameraRig, path: Path) -> None:
    """Caliscope's camera_array.toml: tables by number, the rotation as a matrix, metres."""
    lines = []
    for i, (camera, lens) in enumerate(zip(rig, plain_lenses(rig, "Caliscope's file"), strict=True)):
        table = {
            "cam_id": i,
            "name": camera.name,
            "rotation_count": 0,
            "error": 0.0,
            "exposure": 0,
            "grid_count": 0,
            "ignore": False,
            "size": [int(s) for s in camera.size],
            "matrix": camera.K,
            "distortions": lens,
            "translation": camera.camera_from_world[:3, 3],
            "rotation": camera.camera_from_world[:3, :3],
        }
        lines += [f"[cameras.{i}]", *toml_lines(table), ""]
    write_text(path, "\n".join(lines))


# ---- JSON ----------------------------------------------------------------------------------------------------------

_K = ("K", "matrix", "intrinsic", "intrinsics", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "mtx", "k")
_LENS = ("distCoef", "dist", "distortion", "distortions", "dist_coeffs", "distCoeffs", "distortion_coefficients", "D")
_SIZE = ("resolution", "size", "image_size", "imgSize", "img_size", "imageSize")
_ROTATION = ("R", "rotation", "rvec", "rotation_matrix", "r")
_TRANSLATION = ("t", "T", "translation", "tvec", "translation_vector")
_POSE = ("RT", "Rt", "extrinsic", "extrinsics", "camera_from_world", "world_to_camera", "w2c", "extrinsic_matrix")
_PROJECTION = ("P", "projection", "projection_matrix", "proj")


def read_calibration_json(path: Path, unit: str) -> Found:
    """Rig of a JSON file; a CalibrationError names file and camera."""
    document = read_json(path, _KIND, MAX_FILE_BYTES)
    tables = _tables(document)
    needs = "each needs K, R and t (or a 3 x 4 matrix P); export the calibration again"
    rig = RigFile(path, needs, "add resolution to each camera of the file")
    for name, table in tables.items():
        where = rig.where(name)
        k = numbers_if_any(where, table, _K, (3, 3))
        if k is None:
            k, rotation, translation = decomposed(numbers(where, table, _PROJECTION, (3, 4)), where)
        elif (pose := numbers_if_any(where, table, _POSE, (3, 4), (4, 4))) is not None:
            rotation, translation = pose[:3, :3], pose[:3, 3]
        else:
            rotation = numbers(where, table, _ROTATION, *_ROTATIONS)
            translation = numbers(where, table, _TRANSLATION, (3,))
        size = next((table[key] for key in _SIZE if key in table), table)
        if isinstance(size, Mapping):
            size = [size["width"], size["height"]] if {"width", "height"} <= size.keys() else None
        size = numbers_if_any(where, {"size": size}, ("size",), (2,))
        rig.add(name, k, numbers_if_any(where, table, _LENS), rotation, translation, size)
    unit = _unit_of(document, unit)
    if unit == "auto" and tables and all("panel" in t and "node" in t for t in tables.values()):
        unit = "cm"
        rig.notes.append(f"{path.name}: translations are taken as centimetres, as CMU Panoptic's are.")
    return rig.rig(unit)


def _tables(document: Any) -> dict[str, Mapping[str, Any]]:
    """The cameras' tables by name."""
    inside = document.get("cameras", document) if isinstance(document, Mapping) else document
    if isinstance(inside, list):
        inside = {f"cam_{i}": v for i, v in enumerate(inside)}
    found = inside if isinstance(inside, Mapping) else {}
    wanted = {*_K, *_PROJECTION}
    tables = {str(k): v for k, v in found.items() if isinstance(v, Mapping) and wanted & v.keys()}
    names = {k: v.get("name", v.get("camera", k)) for k, v in tables.items()}
    distinct = all(isinstance(n, str) and n for n in names.values()) and len(set(names.values())) == len(names)
    return {names[k] if distinct else k: v for k, v in tables.items()}


# ---- OpenCV's storage ----------------------------------------------------------------------------------------------
# Read here and not by OpenCV, whose parser can be made to corrupt the memory of the process by a damaged file (found by
# fuzzing with OpenCV 5.0). Only what calibrations hold is understood: scalars, flat lists, `!!opencv-matrix`, and the
# `!!opencv-nd-matrix` that OpenCV 5 makes of one-dimensional arrays; nested maps are passed over.

Value = float | str | list[float | str] | Array
_KEY = re.compile(r"([A-Za-z_][\w.-]*)\s*:(?:\s+(.*)|)$")
_MOST_NUMBERS = 100_000
_CV_K = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "CameraMatrix", "K")
_CV_LENS = ("distortion_coefficients", "dist_coeffs", "Distortion_Coefficients", "DistortionCoeffs", "D", "dist")
_CV_ROTATION = ("rotation_vectors", "rotation_matrix", "rvec", "R", "rotation")
_CV_TRANSLATION = ("translation_vectors", "tvec", "T", "translation")
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
_PAIRS = (("intri.yml", "extri.yml"), ("Intrinsic.yml", "Extrinsic.yml"))


def easymocap_pair(folder: Path) -> tuple[Path, Path] | None:
    """EasyMocap's two files in a folder; None when they are not there."""
    pairs = ((folder / first, folder / second) for first, second in _PAIRS)
    return next((pair for pair in pairs if all(p.is_file() for p in pair)), None)


def read_storage(path: Path, unit: str) -> Found:
    """Rig of EasyMocap's files (their folder, or either of them), or of single cameras in OpenCV's own layout (a file,
    or a folder with one file per camera, called like the files)."""
    pair = easymocap_pair(path if path.is_dir() else path.parent)
    if pair is not None and (path.is_dir() or path in pair):
        return _read_easymocap(*pair, unit)
    rig = RigFile(path, "a file of OpenCV has a camera matrix", "add image_width and image_height to the file")
    files = storage_files(path)[:200] if path.is_dir() else [path]
    for file in files:
        table = _storage(file)
        if not any(key in table for key in _CV_K):
            raise CalibrationError(f"{file} holds no camera matrix; give a calibration file of OpenCV or EasyMocap.")
        where = str(file)
        rotation = numbers_if_any(where, table, _CV_ROTATION, *_ROTATIONS)
        translation = numbers_if_any(where, table, _CV_TRANSLATION, (3,))
        if rotation is None or translation is None:
            rotation, translation = np.zeros(3), np.zeros(3)
            rig.notes.append(f"{file.name} says nothing about where the camera stands; it is put at the origin.")
        named_by_folder = file.stem.lower() in ("config", "intrinsics", "calibration")
        name = text_of(file.absolute().parent.name if named_by_folder else file.stem)
        lens = numbers_if_any(where, table, _CV_LENS)
        k, size = numbers(where, table, _CV_K, (3, 3)), _size(where, table, _WIDTH, _HEIGHT)
        rig.add(name, k, lens, rotation, translation, size)
    return rig.rig(unit)


def _read_easymocap(intrinsics: Path, extrinsics: Path, unit: str) -> Found:
    lenses, poses = _storage(intrinsics), _storage(extrinsics)
    found = lenses.get("names")  # EasyMocap writes numbers as well
    names = [
        n if isinstance(n, str) else f"{n:g}" for n in (found if isinstance(found, list) else [found] * bool(found))
    ]
    needs = f"{intrinsics.name} names none (names: ...); give EasyMocap's intri.yml and extri.yml"
    rig = RigFile(intrinsics.parent, needs, f"add W_ and H_ with each camera's name to {intrinsics.name}")
    for name in sorted(names, key=natural_key):
        where, labels = rig.where(name), (name, str(names.index(name) + 1))  # Pose2Sim numbers the entries
        rig.add(
            name,
            numbers(where, lenses, _keys(labels, "K"), (3, 3)),
            numbers_if_any(where, lenses, _keys(labels, "dist")),
            numbers(where, poses, _keys(labels, "Rot", "R"), *_ROTATIONS),
            numbers(where, poses, _keys(labels, "T"), (3,)),
            _size(where, lenses, _keys(labels, "W"), _keys(labels, "H")),
        )
    return rig.rig(unit)


def _keys(labels: tuple[str, str], *entries: str) -> tuple[str, ...]:
    return tuple(f"{entry}_{label}" for entry in entries for label in labels)


def _size(where: str, table: Mapping[str, Any], width: tuple[str, ...], height: tuple[str, ...]) -> Array | None:
    sides = [numbers_if_any(where, table, keys, (1,)) for keys in (width, height)]
    return None if sides[0] is None or sides[1] is None else np.concatenate([sides[0], sides[1]])


def storage_files(folder: Path) -> list[Path]:
    """The files of OpenCV's storage in a folder, one per camera, in natural order."""
    files = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in (".xml", ".yml", ".yaml")]
    return sorted((p for p in files if is_storage(p)), key=lambda p: natural_key(p.name))


def is_storage(path: Path) -> bool:
    """Whether a file begins as OpenCV's storage does."""
    try:
        with open_file(path, _KIND, MAX_FILE_BYTES) as stream:
            start = stream.read(4096)
    except (InputError, OSError):
        return False
    return b"opencv_storage" in start or b"opencv-matrix" in start


def _storage(path: Path) -> dict[str, Value]:
    try:
        return parse_storage("\n".join(text_lines(path, _KIND, MAX_FILE_BYTES)))
    except ValueError as error:
        raise CalibrationError(
            f"{path} is not a file of OpenCV's storage (YAML or XML): {error}; calibrate again."
        ) from None


def parse_storage(text: str) -> dict[str, Value]:
    """The values of the top level by their keys; a matrix comes flat. ValueError with a reason for anything else."""
    out = _parse_xml(text) if text.lstrip().startswith("<") else _parse_yaml(text)
    if not out:
        raise ValueError("it holds no values")
    return out


def _parse_yaml(text: str) -> dict[str, Value]:
    out: dict[str, Value] = {}
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%", "---"))]
    blocks: list[list[str]] = []
    for line in lines:
        if not line[0].isspace() and not line.startswith(("-", "]", "}")):
            blocks.append([line.rstrip()])
        elif not blocks:
            raise ValueError("it does not begin with a key")
        else:
            blocks[-1].append(line.strip())
    for first, *rest in blocks:
        if first == "...":
            break
        match = _KEY.match(first)
        if match is None and first.startswith(("{", "[", '"')):
            raise ValueError("it is no YAML of OpenCV")
        value = None if match is None else _yaml_value((match[2] or "").strip(), rest)
        if match is not None and value is not None:
            out[match[1]] = value
    return out


def _yaml_value(first: str, rest: list[str]) -> Value | None:
    whole = " ".join([first, *rest]).strip()
    if first.startswith(("!!opencv-matrix", "!!opencv-nd-matrix")):
        found = dict(re.findall(r"\b(rows|cols|sizes|data):\s*(\[[^\]]*\]|\S+)", whole))
        return _matrix(lambda key: found.get(key, "").strip("[] "))
    if whole.count("[") != whole.count("]"):
        raise ValueError("a list does not end")
    if whole.startswith("["):
        return [_scalar(item) for item in _items(whole.strip("[] "))]
    if whole.startswith("-") and not first:
        return [_scalar(line[1:].strip()) for line in rest if line.startswith("-")]
    return None if whole.startswith("{") or rest else _scalar(first)


def _parse_xml(text: str) -> dict[str, Value]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # OpenCV writes none; entities can make a file huge
        raise ValueError("it has a DOCTYPE")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise ValueError(f"it is no XML ({error})") from None
    if root.tag != "opencv_storage":
        raise ValueError("it is no XML of OpenCV")
    out: dict[str, Value] = {}
    for element in root:
        if element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
            out[element.tag] = _matrix(lambda key, element=element: (element.findtext(key) or "").strip())
        elif len(element) == 0:
            values = [_scalar(item) for item in _items((element.text or "").strip())]
            out[element.tag] = values[0] if len(values) == 1 else values
    return out


def _matrix(get: Callable[[str], str]) -> Array:
    """Flat, of its texts rows and cols, or sizes, and data; empty when the numbers are not as many as these say, or no
    numbers."""
    sizes = _items(get("sizes"))[:8] or [get("rows"), get("cols")]
    count = math.prod(int(s) if re.fullmatch(r"\d{1,5}", s, re.ASCII) else 0 for s in sizes)
    values = [_scalar(item) for item in _items(get("data"))]
    fits = len(values) == count and all(isinstance(v, float) for v in values)
    return np.array(values if fits else [], dtype=np.float64)


def _items(text: str) -> list[str]:
    items = text.replace(",", " ").split() if '"' not in text else re.findall(r'"([^"]*)"|([^\s,"]+)', text)
    if len(items) > _MOST_NUMBERS:
        raise ValueError(f"a list has more than {_MOST_NUMBERS} values")
    return [item if isinstance(item, str) else f'"{item[0]}"' if item[0] else item[1] for item in items]


def _scalar(text: str) -> float | str:
    """A number, or a text without its quotes. OpenCV writes 1. and .5, .Nan and -.Inf."""
    if text[:1] in ('"', "'"):
        return text.strip("\"'")
    if text.lower().lstrip("+-") in (".nan", ".inf"):
        return float(text.replace(".", ""))
    plain = re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text, re.IGNORECASE | re.ASCII)
    return float(text) if plain and len(text) < 64 else text


def write_easymocap(rig: CameraRig, path: Path) -> list[Path]:
    """EasyMocap's intri.yml and extri.yml in the folder of the given name, metres; the files written."""
    names = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{c.name}"\n' for c in rig)
    intrinsics, extrinsics = [names], [names]
    for c, lens in zip(rig, plain_lenses(rig, "EasyMocap's files"), strict=True):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", c.name):
            raise CalibrationError(
                f"The camera name {c.name!r} cannot stand in EasyMocap's files; use letters, digits, - and _."
            )
        pose = c.camera_from_world
        intrinsics += [_yaml_matrix(f"K_{c.name}", c.K), _yaml_matrix(f"dist_{c.name}", lens[None])]
        intrinsics += [f"H_{c.name}: {c.size[1]}\n", f"W_{c.name}: {c.size[0]}\n"]
        extrinsics += [
            _yaml_matrix(f"R_{c.name}", so3_log(pose[:3, :3])[:, None]),
            _yaml_matrix(f"Rot_{c.name}", pose[:3, :3]),
            _yaml_matrix(f"T_{c.name}", pose[:3, 3:]),
        ]
    out = [path.parent / name for name in _PAIRS[0]]
    for file, parts in zip(out, (intrinsics, extrinsics), strict=True):
        write_text(file, "".join(parts))
    return out


def _yaml_matrix(key: str, value: Array) -> str:
    rows, columns = value.shape
    texts = [repr(float(v)) for v in value.ravel()]
    data = ", ".join(t if "." in t or "e" in t or "n" in t else f"{t}." for t in texts)
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"


# ---- plain numbers -------------------------------------------------------------------------------------------------

_MAX_PLAIN_BYTES = 1_000_000
_MOST_LINES = 10_000


def plain_files(folder: Path) -> list[Path]:
    """The files of a folder that look like BioCV's, in natural order."""
    files = [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in ("", ".calib")]
    found = [p for p in files if not p.name.startswith(".") and p.stat().st_size < _MAX_PLAIN_BYTES]
    return sorted((p for p in found if _is_biocv(p)), key=lambda p: natural_key(p.name))


def read_plain(path: Path, unit: str) -> Found:
    """Rig of a folder of BioCV's files, one of them, or a text file of projection matrices."""
    needs = (
        "it needs three lines of four numbers for each camera (projection matrices), or is BioCV's (width, height, K, "
        "[R | t], distortion)"
    )
    rig = RigFile(path, needs, "write K, R, t and resolution as JSON instead")
    files = plain_files(path) if path.is_dir() else [path]
    if path.is_dir() or _is_biocv(path):
        for file in files:
            rows = _rows(file)
            pose, size = np.array(rows[6:9]), np.array([rows[0][0], rows[1][0]])
            lens = next((r for r in reversed(rows) if r), [])
            lens = np.array(lens) if len(lens) in (4, 5, 8) and rows.index(lens) > 8 else None
            name = text_of(file.stem if file.suffix.lower() == ".calib" else file.name)
            rig.add(name, np.array(rows[2:5]), lens, pose[:, :3], pose[:, 3], size)
        return rig.rig("mm" if unit == "auto" else unit)
    for name, values in _projections(path).items():
        if len(values) != 12:
            raise CalibrationError(f"{path} is no calibration: {needs}.")
        where = rig.where(name)
        k, rotation, translation = decomposed(numbers(where, {"P": values}, ("P",), (3, 4)), where)
        rig.add(name, k, None, rotation, translation, None)
    return rig.rig(unit)


def _rows(path: Path) -> list[list[float]]:
    """Lines as numbers; lines with anything else are empty."""
    rows = []
    for line in text_lines(path, _KIND, _MAX_PLAIN_BYTES)[:_MOST_LINES]:
        try:
            rows.append([float(c) for c in line.replace(",", " ").split()])
        except ValueError:
            rows.append([])
    return rows


def _is_biocv(path: Path) -> bool:
    try:
        rows = _rows(path)
    except InputError:
        return False
    return len(rows) > 9 and [len(r) for r in rows[:5]] == [1, 1, 3, 3, 3] and [len(r) for r in rows[6:9]] == [4] * 3


def _projections(path: Path) -> dict[str, list[float]]:
    """The numbers by the cameras' names."""
    found: dict[str, list[float]] = {}
    name: str | None = None
    for line, values in zip(text_lines(path, _KIND, _MAX_PLAIN_BYTES), _rows(path), strict=False):
        cells = line.replace(",", " ").split()
        if not values:
            name = text_of(cells[0].rstrip(":")) if len(cells) == 1 and not line.startswith("#") else name
            continue
        if name is None or len(found.get(name, ())) == 12:
            name = f"cam_{len(found)}"
        found.setdefault(name, []).extend(values)
        if len(values) not in (4, 12) or len(found[name]) > 12:
            raise CalibrationError(
                f"{path}: a line has {len(values)} numbers; projection matrices need three lines of four numbers for "
                "each camera, or twelve in one."
            )
    return found

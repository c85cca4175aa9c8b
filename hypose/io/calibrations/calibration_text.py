"""Calibrations as text: TOML, JSON, YAML, OpenCV's XML and plain numbers.

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

JSON (CMU Panoptic, XRMoCap and relatives), YAML (OpenCV, Kalibr, ROS, MC-Calib) and OpenCV's XML: the same tables in
other spellings, see `camera_tables`; a list, or a table by name, at the top or under "cameras". Panoptic Studio writes
centimetres, and names panel and node of every camera. EasyMocap has a pair intri.yml and extri.yml.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array, so3_log
from hypose.io.calibrations.camera_tables import (
    MAX_FILE_BYTES,
    RigFile,
    add_cameras,
    as_numbers,
    strange_keys,
    tables_of,
    unit_of,
)
from hypose.io.file_names import natural_key, text_of
from hypose.io.files import open_file, read_bytes, read_json, read_toml, toml_key, toml_lines, write_text
from hypose.io.formats import Source

_KIND = "a calibration"
_MOST_FILES = 200


# ---- tables: TOML, JSON, YAML, XML ---------------------------------------------------------------------------------

_PAIRS = (("intri.yml", "extri.yml"), ("Intrinsic.yml", "Extrinsic.yml"))


def read_tables(source: Source, rig: RigFile) -> None:
    """Add the cameras of a TOML, JSON, YAML or XML document with one table per camera to a rig.

    The source is a file with all cameras, or a folder with one XML or YAML file per camera. A camera file without a
    camera name gets the name of the file (of its folder, if the file name is a common one).

    Raises: CalibrationError where a value is missing or wrong; it names the file, the camera and the key.
    """
    files = lens_files(source)
    documents = [parse_document(file) for file in files]
    tables = {k: v for f, d in zip(files, documents, strict=True) for k, v in tables_of(d, _file_name(f)).items()}
    rig.unit = unit_of(documents[0], rig.unit, str(rig.path))
    if rig.unit == "auto" and tables and all("panel" in t and "node" in t for t in tables.values()):
        rig.unit = "cm"
        rig.notes.append(f"{rig.path.name}: translations are taken as centimetres, as CMU Panoptic's are.")
    add_cameras(rig, tables)
    if strange := strange_keys(documents[0], tables):
        rig.notes.append(f"{rig.path.name}: {', '.join(strange[:6])} is not understood and passed over.")
    if source.path.is_dir() and (others := [p.name for p in source.files(".xml", ".yml", ".yaml") if p not in files]):
        rig.notes.append(f"{rig.path.name}: {', '.join(others)} is no camera's calibration and is left out.")


def _file_name(path: Path) -> str:
    """Derive the name of a single camera from its file, or from its folder where the file has a common name."""
    common = path.stem.lower() in ("config", "intrinsics", "calibration", "camera_info")
    return text_of(path.absolute().parent.name if common else path.stem)


def parse_document(path: Path) -> Any:
    """Parse a file by its ending; matrices become lists or arrays, XML of other programs than OpenCV its root element.

    Raises: CalibrationError where it is damaged.
    """
    ending = path.suffix.lower()
    if ending == ".toml":
        return read_toml(path, _KIND)
    if ending == ".json":
        return read_json(path, _KIND, MAX_FILE_BYTES)
    data = read_bytes(path, _KIND, MAX_FILE_BYTES)
    marked = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    text = data.decode("utf-16" if marked else "utf-16-le" if b"\0" in data[:64] else "utf-8-sig", "replace")
    try:
        return parse_xml(text) if text.lstrip().startswith("<") else parse_yaml(text)
    except ValueError as error:
        raise CalibrationError(f"{path} is no calibration: {error}; export it again.") from None


def lens_files(source: Source) -> list[Path]:
    """Find the files of single cameras (OpenCV, ROS) in a folder, at most 200 in natural order; a file is itself."""
    files = source.files(".xml", ".yml", ".yaml")
    return [p for p in files if is_storage(p)][:_MOST_FILES] if source.path.is_dir() else files


def is_storage(path: Path) -> bool:
    """Test whether a file begins as OpenCV's storage or ROS's camera_info does."""
    try:
        with open_file(path, _KIND, MAX_FILE_BYTES) as stream:
            start = stream.read(4096)
    except (InputError, OSError):
        return False
    return any(word in start for word in (b"opencv_storage", b"opencv-matrix", b"camera_matrix:"))


def easymocap_pair(path: Path) -> tuple[Path, Path] | None:
    """Find EasyMocap's two files in a folder, or the pair of one of them; None where they are not there."""
    folder = path if path.is_dir() else path.parent
    pairs = ((folder / first, folder / second) for first, second in _PAIRS)
    return next((p for p in pairs if p[0].is_file() and p[1].is_file() and path in (folder, *p)), None)


def read_easymocap(source: Source, rig: RigFile) -> None:
    """Add the cameras of EasyMocap's pair of files (intri.yml and extri.yml) to a rig."""
    pair = easymocap_pair(source.path)
    assert pair is not None  # its format was recognised by it
    rig.path = pair[0].parent
    both = parse_document(pair[0]) | parse_document(pair[1])
    found = both.get("names")  # EasyMocap writes numbers as well
    names = [
        n if isinstance(n, str) else f"{n:g}" for n in (found if isinstance(found, list) else [found] * bool(found))
    ]
    entries = {"K": "matrix", "dist": "distortions", "R": "rvec", "Rot": "rotation", "T": "translation"}
    entries |= {"W": "image_width", "H": "image_height"}
    tables = dict[str, dict[str, Any]]()
    for name in sorted(names, key=natural_key):
        labels = (str(names.index(name) + 1), name)  # Pose2Sim numbers the entries
        known = ((f"{entry}_{label}", key) for label in labels for entry, key in entries.items())
        tables[name] = {key: both[entry] for entry, key in known if entry in both}
    if tables and not any("translation" in table for table in tables.values()):
        raise CalibrationError(f"{pair[1]} holds none of the poses T_NAME, R_NAME; give EasyMocap's {pair[1].name}.")
    add_cameras(rig, tables)


def write_calibration(rig: CameraRig, path: str | Path) -> None:
    """Write a rig as a TOML file in metres that hypose, Pose2Sim and anipose read.

    Raises: InputError where the name of the file does not end in .toml.
    """
    check_toml(path)
    lines = []
    for camera in rig:
        pose = camera.camera_from_world
        table = {
            "name": camera.name,
            "size": [int(s) for s in camera.size],
            "matrix": camera.K,
            "distortions": np.ravel(camera.distortion),
            "rotation": so3_log(pose[:3, :3]),
            "translation": pose[:3, 3],
            "fisheye": camera.fisheye,
        }
        lines += [f"[{toml_key(camera.name)}]", *toml_lines(table), ""]
    lines += ["[metadata]", *toml_lines({"adjusted": False, "error": 0.0, "unit": "m"}), ""]
    write_text(path, "\n".join(lines))


def check_toml(path: str | Path) -> None:
    """Check that the name of a calibration to be written ends in .toml; InputError otherwise."""
    if Path(path).suffix.lower() != ".toml":
        raise InputError(f"{path} cannot be written: name the calibration .toml.")


# ---- YAML and XML --------------------------------------------------------------------------------------------------
# OpenCV's own reader is not used: a damaged file can make it corrupt the memory of the process (found by fuzzing with
# OpenCV 5.0).


_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SafeLoader):
    """Loader for plain YAML with OpenCV's tags and numbers (1., .5, 1e-05, .Nan)."""


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda loader, node: loader.construct_mapping(node, deep=True))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$|[-+]?\.(nan|Nan|NaN|inf|Inf)$"),
    list("-+.0123456789"),
)


def parse_yaml(text: str) -> dict[str, Any]:
    """Parse a YAML document; matrices become arrays.

    Raises: ValueError where it is not valid, has references or holds no values.
    """
    lines = [line for line in text.splitlines() if not line.startswith("%")]
    if any(re.search(r"(^|[\s\[,])[&*]\w", line.split(" #")[0]) for line in lines if '"' not in line):
        raise ValueError("it has references, which can make a file huge")
    try:
        document = yaml.load("\n".join(lines), _Loader)  # noqa: S506 - a safe loader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"it is no YAML ({' '.join(str(error).split())})") from None
    if not isinstance(document, dict) or not document:
        raise ValueError("it holds no values")
    return _with_arrays(document)


def _with_arrays(value: Any) -> Any:
    """Convert tables of rows, cols (or sizes) and data to arrays; empty where the number of data is wrong."""
    if not isinstance(value, dict):
        return value
    if "data" in value and ({"rows", "cols"} <= value.keys() or "sizes" in value):
        return _matrix([str(s) for s in value.get("sizes") or (value.get("rows"), value.get("cols"))], value["data"])
    return {k: _with_arrays(v) for k, v in value.items()}


def parse_xml(text: str) -> Any:
    """Parse XML; of OpenCV's storage the values, with matrices as arrays, of others the root element.

    Raises: ValueError where it is not valid.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # none of the programs writes one; entities can make a file huge
        raise ValueError("it has a DOCTYPE")
    try:
        # the declaration names an encoding that the text no longer has
        root = ElementTree.fromstring(text[text.index("<", text.find("?>") + 1) :] if "?>" in text else text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise ValueError(f"it is not valid XML ({error})") from None
    if root.tag != "opencv_storage":
        return root
    out: dict[str, Any] = {}
    for element in root:
        if element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
            sizes = (element.findtext("sizes") or "").split() or [element.findtext(k) or "" for k in ("rows", "cols")]
            out[element.tag] = _matrix(sizes, (element.findtext("data") or "").split())
        elif len(element) == 0:
            values = [scalar(item) for item in re.findall(r'"[^"]*"|[^\s"]+', element.text or "")]
            out[element.tag] = values[0] if len(values) == 1 else values
    return out


def _matrix(sizes: list[str], data: Any) -> Array:
    """Shape the numbers of a matrix.

    sizes: texts of its numbers of rows and columns.
    data: list of numbers or of their texts.
    Returns: an empty array where the number of data does not agree with the sizes, or they are not numbers.
    """
    shape = [int(s) if re.fullmatch(r"\s*\d{1,5}\s*", s, re.ASCII) else 0 for s in sizes[:8]]
    values = [scalar(item) if isinstance(item, str) else item for item in (data if isinstance(data, list) else [data])]
    array = as_numbers(values)
    return np.empty(0) if array is None or array.size != math.prod(shape) else array.reshape(shape)


def scalar(text: str) -> float | str:
    """Parse a number as OpenCV writes it (1., .5, .Nan, -.Inf), or a text without its quotes."""
    if text.startswith('"'):
        return text.strip('"')
    if text.lower().lstrip("+-") in (".nan", ".inf"):
        return float(text.replace(".", ""))
    plain = re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text, re.IGNORECASE | re.ASCII)
    return float(text) if plain and len(text) < 64 else text

"""Calibration files of all known programs: the table of their formats, and the readers. Only TOML is written.

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

import io
import math
import pickle
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import yaml

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array, so3_log
from hypose.io.calibrations.camera_tables import (
    MAX_FILE_BYTES,
    UNITS,
    RigFile,
    add_cameras,
    as_numbers,
    numbers,
    strange_keys,
    tables_of,
    unit_of,
)
from hypose.io.files import (
    natural_key,
    open_file,
    read_bytes,
    read_json,
    read_toml,
    text_of,
    toml_text,
    write_text,
)
from hypose.io.formats import Format, FormatTable, Source

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
    tables: dict[str, Any] = {}
    for camera in rig:
        pose = camera.camera_from_world
        tables[camera.name] = {
            "name": camera.name,
            "size": [int(s) for s in camera.size],
            "matrix": camera.K,
            "distortions": np.ravel(camera.distortion),
            "rotation": so3_log(pose[:3, :3]),
            "translation": pose[:3, 3],
            "fisheye": camera.fisheye,
        }
    write_text(path, toml_text({**tables, "metadata": {"adjusted": False, "error": 0.0, "unit": "m"}}))


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


# ---- systems -------------------------------------------------------------------------------------------------------
# Calibrations of motion capture systems and apps: Qualisys, Vicon, OptiTrack's Motive (XML), OpenCap (pickles).
#
# Motive (.mcal, XML in UTF-16): each camera has ImagerPixelWidth and -Height, IntrinsicStandardCameraModel (focal
# lengths and centre in px, k1 k2 k3 and tangential terms, as OpenCV's) and Extrinsic: the camera's position in metres
# and OrientMatrix0..8, row by row the axes of a camera that looks along -z with y up. The world has y up and is
# rotated so that z points up.
#
# OpenCap (cameraIntrinsicsExtrinsics.pickle) is read safely. A pickle may call any function, so opening a foreign one
# could run any program. Here the few names that arrays need are replaced by functions of this module, and a file with
# any other name is refused.


# Rotation from a camera that looks along -z with y up to one with z forward and y down.
_FLIP = np.diag([1.0, -1.0, -1.0])
# Motive's (x, y, z) with y up -> (x, -z, y) with z up
_WORLD_FROM_MOTIVE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def _attributes(
    where: str, parent: Element, tag: str, *names: str, count: int = 1, default: float | None = None
) -> Array:
    """Get the numbers of attributes of an XML element.

    tag: name of the element in `parent`; "." for `parent` itself.
    count: how many numbers each attribute has.
    default: value of an absent attribute; None where it must be present.
    Raises: CalibrationError where an attribute is missing or not a number.
    """
    element = parent.find(tag)
    texts = {} if element is None else element.attrib
    table = {} if default is None else dict.fromkeys(names, [default])
    table |= {n: [scalar(v) for v in texts[n].split()][:count] for n in names if n in texts}
    at = f"{where}, <{parent.tag if tag == '.' else tag}>"
    return np.concatenate([numbers(at, table, (n,), (count,)) for n in names])


def _video_cameras(
    rig: RigFile, elements: list[Element], is_video: Callable[[Element], bool], key: str
) -> Iterator[tuple[str, str, Element]]:
    """Select the video cameras of a file, and note how many others are left out.

    elements: XML elements of all cameras.
    is_video: test whether an element is marked as a video camera; where none is, all are taken.
    key: attribute with the camera's serial number, by which they are sorted.
    Returns: an iterator over name, start of error messages and element of each camera.
    """
    video = [e for e in elements if is_video(e)] or elements
    if len(video) < len(elements):
        left = len(elements) - len(video)
        rig.notes.append(f"{rig.path.name}: {len(video)} video cameras; the {left} others are left out.")
    for i, element in enumerate(sorted(video, key=lambda e: natural_key(e.get(key, "")))):
        name = element.get(key) or element.get("USERID") or f"cam_{i + 1}"
        yield name, rig.where(name), element


def read_qualisys(source: Source, rig: RigFile) -> None:
    """Add the cameras of a calibration of Qualisys Track Manager (XML) to a rig.

    Intrinsics are in 1/64 px, the translation is the camera's position in mm, the rotation is world_from_camera stored
    by columns, of a camera that looks along -z with y up (rotated by pi about x into OpenCV's).

    Why: Pose2Sim divides the distortion coefficients by 64 as well. They belong to normalised coordinates, and without
        the division they agree with a chessboard calibration of the same cameras, so they are not divided here.
    """

    def is_video(element: Element) -> bool:
        return any(m in element.get("model", "").lower() for m in ("video", "hybrid", "none"))

    rig.unit = "m"
    for name, where, element in _video_cameras(rig, source.document.findall("cameras/camera"), is_video, "serial"):
        if element.get("viewrotation", "0") not in ("0", ""):
            rig.notes.append(
                f"{rig.path.name}: camera {name} is marked as turned by {element.get('viewrotation')} degrees; "
                "its images must not be turned in the video files."
            )
        left, top, right, bottom = _attributes(where, element, "fov_video", "left", "top", "right", "bottom")
        optics = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        fu, fv, cu, cv = _attributes(where, element, "intrinsic", *optics) / 64
        terms = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
        lens = _attributes(where, element, "intrinsic", *terms)
        third = _attributes(where, element, "intrinsic", "radialDistortion3", default=0.0)
        axes = _attributes(where, element, "transform", *(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))
        place = _attributes(where, element, "transform", "x", "y", "z") / 1000
        k = np.array([[fu, 0, cu - left], [0, fv, cv - top], [0, 0, 1.0]])
        turn = _FLIP @ axes.reshape(3, 3)
        size = np.array([right - left + 1, bottom - top + 1])
        rig.add(name, k, np.concatenate([lens, third]), turn, -turn @ place, size)


# With r in pixels, k r^2 and k r^4 are this small for any lens; with r in focal lengths they never are.
_PIXEL_UNITS = 1e-5


def read_vicon(source: Source, rig: RigFile) -> None:
    """Add the cameras of a Vicon calibration (XML) to a rig.

    FOCAL_LENGTH and PRINCIPAL_POINT are in px, ORIENTATION is the quaternion (x, y, z, w) of camera_from_world,
    POSITION is that of the camera in mm, VICON_RADIAL2 is "name cx cy k1 k2 k3", VICON_RADIAL is "k1 k2".

    The radial coefficients are used as OpenCV's, as in Pose2Sim and OpenCap. Coefficients so small that they can only
    belong to radii in pixels are converted from Vicon's own model, u = c + (1 + k1 r^2 + k2 r^4)(d - c), which gives
    undistorted positions u from distorted positions d.
    """
    from scipy.spatial.transform import Rotation  # takes long to import

    def is_video(element: Element) -> bool:
        return any(m in (element.get("TYPE", "") + element.get("DISPLAY_TYPE", "")).lower() for m in ("video", "vue"))

    rig.unit = "m"
    for name, where, element in _video_cameras(rig, source.document.findall("Camera"), is_video, "DEVICEID"):
        frame = element.find("KeyFrames/KeyFrame")
        if frame is None:
            rig.notes.append(f"{rig.path.name}: camera {name} was not calibrated and is left out.")
            continue
        size = _attributes(where, element, ".", "SENSOR_SIZE", count=2)
        aspect = _attributes(where, element, ".", "PIXEL_ASPECT_RATIO", default=1.0)[0]
        focal = _attributes(where, frame, ".", "FOCAL_LENGTH")[0]
        centre = _attributes(where, frame, ".", "PRINCIPAL_POINT", count=2)
        q = _attributes(where, frame, ".", "ORIENTATION", count=4)
        place = _attributes(where, frame, ".", "POSITION", count=3) / 1000
        if not 0.1 < aspect < 10 or not 0.9 < np.linalg.norm(q) < 1.1:
            raise CalibrationError(
                f"{where}: PIXEL_ASPECT_RATIO {aspect:g} or ORIENTATION {q.tolist()} is implausible; export it again."
            )
        k = np.array([[focal, 0, centre[0]], [0, focal / aspect, centre[1]], [0, 0, 1.0]])
        raw = frame.get("VICON_RADIAL2")
        words = raw.split()[3:6] if raw is not None else frame.get("VICON_RADIAL", "").split()[:3]
        lens = numbers(where, {"VICON_RADIAL": [*map(scalar, words), 0.0, 0.0, 0.0][:3]}, ("VICON_RADIAL",), (3,))
        if 0 < np.abs(lens).max() < _PIXEL_UNITS:
            # OpenCV's k1 k2 k3 fitted to Vicon's undistortion in pixels, by least squares over the picture
            d = np.linspace(0, float(np.hypot(*size)) / 2, 200)[1:]
            u = d * (1 + lens[0] * d**2 + lens[1] * d**4 + lens[2] * d**6) / focal
            lens = np.linalg.lstsq(np.stack([u**3, u**5, u**7], 1), d / focal - u, rcond=None)[0]
            rig.notes.append(
                f"{rig.path.name}: the lens of {name} is given in pixels and was converted to OpenCV's model."
            )
        turn = np.asarray(Rotation.from_quat(q).as_matrix(), dtype=np.float64)
        rig.add(name, k, np.array([lens[0], lens[1], 0.0, 0.0, lens[2]]), turn, -turn @ place, size)


def read_motive(source: Source, rig: RigFile) -> None:
    """Add the cameras of a calibration of OptiTrack Motive (XML) to a rig; the module describes the format."""
    left, rig.unit = [], "m"
    for i, element in enumerate(sorted(source.document.iter("Camera"), key=lambda e: natural_key(e.get("Serial", "")))):
        name = element.get("Serial") or f"cam_{i + 1}"
        where, model = rig.where(name), "IntrinsicStandardCameraModel"
        if element.find(model) is None or element.find("Extrinsic") is None:
            left.append(name)
            continue
        size = _attributes(where, element, "Attributes", "ImagerPixelWidth", "ImagerPixelHeight")
        optics = ("HorizontalFocalLength", "VerticalFocalLength", "LensCenterX", "LensCenterY")
        fx, fy, cx, cy = _attributes(where, element, model, *optics)
        lens = _attributes(where, element, model, "k1", "k2", "TangentialX", "TangentialY", "k3")
        place = _WORLD_FROM_MOTIVE @ _attributes(where, element, "Extrinsic", "X", "Y", "Z")
        axes = _attributes(where, element, "Extrinsic", *(f"OrientMatrix{i}" for i in range(9))).reshape(3, 3)
        turn = _FLIP @ axes @ _WORLD_FROM_MOTIVE.T
        rig.add(name, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), lens, turn, -turn @ place, size)
    rig.notes.append("Motive's world is turned so that z points up.")
    if left:
        rig.notes.append(f"{rig.path.name}: {', '.join(left)} has no standard camera model or place and is left out.")


# ---- OpenCap -------------------------------------------------------------------------------------------------------

_MAX_BYTES = 1_000_000
# OpenCap's world is the board's: it stands upright with y down; turned so that z points up, as Pose2Sim does.
_UP_FROM_BOARD = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])


class _Kind:
    """The number format of a pickled array.

    code: numpy's code of the type, such as "f8".
    order: byte order, "<" or ">".
    """

    def __init__(self, code: Any, *_: Any) -> None:
        self.code, self.order = code, "<"

    def __setstate__(self, state: Any) -> None:
        self.order = ">" if state[1] == ">" else "<"

    def numbers(self, raw: Any) -> Array:
        """Convert bytes (in protocol 0: text) to numbers; ValueError for other types than numbers."""
        if self.code not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
            raise ValueError("an array in it holds something else than numbers")
        raw = raw.encode("latin-1") if isinstance(raw, str) else bytes(raw)
        return np.frombuffer(raw, self.order + self.code).astype(np.float64)


class _Array:
    """A pickled array that is being read."""

    value: Array | None = None

    def __init__(self, *_: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, by_columns, raw = state
        self.value = kind.numbers(raw).reshape(shape, order="F" if by_columns else "C")


# Names in pickles of arrays, and their replacements here, because numpy's own functions crash on invalid states.
_OF_ARRAYS = {
    "_codecs.encode": lambda text, _: text.encode("latin-1"),  # how protocol 2 writes bytes
    "numpy.dtype": _Kind,
    "numpy.ndarray": None,
    "numpy.core.multiarray._reconstruct": _Array,
    "numpy.core.multiarray.scalar": lambda kind, raw: float(kind.numbers(raw)[0]),
    "numpy.core.numeric._frombuffer": lambda raw, kind, shape, order: kind.numbers(raw).reshape(
        shape, order="F" if order == "F" else "C"
    ),  # protocol 5
}


class _ArraysOnly(pickle.Unpickler):
    """Unpickler for numbers, text, tuples, lists, dictionaries and arrays; ValueError for any other name in the
    file.
    """

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}".replace("numpy._core", "numpy.core")
        if full not in _OF_ARRAYS:
            raise ValueError(f"it asks for {full}, which plain numbers and arrays do not need")
        return _OF_ARRAYS[full]


def read_plain_pickle(data: bytes) -> Any:
    """Read a pickle of numbers, text, tuples, lists, dictionaries and arrays, without importing anything that it names.

    Raises: ValueError where it holds anything else or is damaged.
    """
    try:
        return _plain(_ArraysOnly(io.BytesIO(data)).load())
    except ValueError:
        raise
    except Exception as error:  # invalid instructions may raise any exception
        raise ValueError(f"it is damaged ({error})") from None


def _plain(value: Any) -> Any:
    """Replace the arrays that were read in nested lists, tuples and dictionaries by numpy's arrays."""
    if isinstance(value, _Array):
        return _plain(value.value)
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return type(value)(_plain(v) for v in value) if isinstance(value, list | tuple) else value


def opencap_files(path: Path) -> list[Path]:
    """List the pickles in a folder and its subfolders, in natural order; for a file, that file alone."""
    return sorted(path.rglob("*.pickle"), key=lambda p: natural_key(str(p))) if path.is_dir() else [path]


def read_opencap(source: Source, rig: RigFile) -> None:
    """Add the cameras of an OpenCap pickle, or of a folder of such pickles, to a rig; the world has z up.

    A folder may have the layout Videos/Cam0/cameraIntrinsicsExtrinsics.pickle.

    Raises: CalibrationError where a file is not valid.
    """
    files = opencap_files(source.path)
    if len(files) > 100:
        raise CalibrationError(f"{rig.path} holds {len(files)} .pickle files; give the folder of the cameras' alone.")
    rig.unit = "m"
    rig.notes.append("OpenCap's world is turned so that z points up.")
    for file in files:
        name = text_of(file.parent.name if file.stem.lower() == "cameraintrinsicsextrinsics" else file.stem)
        where = f"{file}, camera {name}"
        try:
            content = read_plain_pickle(read_bytes(file, "an OpenCap camera file", _MAX_BYTES))
            if not isinstance(content, dict):
                raise ValueError("it holds no dictionary")
        except ValueError as error:
            raise CalibrationError(f"{file} is not an OpenCap camera file: {error}.") from None
        rig.add(
            name,
            numbers(where, content, ("intrinsicMat",), (3, 3)),
            numbers(where, content, ("distortion",)),
            numbers(where, content, ("rotation",), (3, 3)) @ _UP_FROM_BOARD.T,
            numbers(where, content, ("translation",), (3,)) / 1000,
            numbers(where, content, ("imageSize",), (2,))[::-1],
        )


# ---- formats -------------------------------------------------------------------------------------------------------
def _is_xml_with(source: Source, *places: str) -> bool:
    root = source.document
    return isinstance(root, Element) and any(root.find(place) is not None for place in places)


CALIBRATIONS = FormatTable(
    "a calibration",
    "give a calibration that a program has exported, or run hypose calibrate",
    (
        Format(
            "hypose, Pose2Sim, anipose, FreeMoCap, Caliscope",
            (".toml",),
            read_tables,
            write=write_calibration,
            precision=1e-9,
        ),
        Format(
            "EasyMocap",
            (".yml", ".yaml", "/"),
            read_easymocap,
            lambda source: easymocap_pair(source.path),
        ),
        Format("OpenCV, Kalibr, ROS, MC-Calib", (".yml", ".yaml"), read_tables),
        Format("OpenCV, ROS (one file per camera)", ("/",), read_tables, lens_files),
        Format("OpenCV", (".xml",), read_tables, lambda source: isinstance(source.document, dict)),
        Format(
            "OpenCap",
            (".pickle", ".pkl", "/"),
            read_opencap,
            lambda source: opencap_files(source.path),
        ),
        Format(
            "CMU Panoptic, XRMoCap, 3 x 4 projections",
            (".json",),
            read_tables,
            lambda source: tables_of(source.document, source.path.stem),
        ),
        Format(
            "Qualisys",
            (".qca.txt", ".qca", ".xml"),
            read_qualisys,
            lambda source: _is_xml_with(source, "cameras/camera"),
        ),
        Format(
            "Vicon",
            (".xcp", ".xml"),
            read_vicon,
            lambda source: _is_xml_with(source, "Camera[@DEVICEID]", "Camera/KeyFrames"),
        ),
        Format("OptiTrack Motive", (".mcal", ".xml"), read_motive, lambda source: _is_xml_with(source, ".//Camera")),
    ),
    parse_document,
)
"""Calibrations: readers of a source that add cameras to a `RigFile`; the writer of a rig to a path."""


def read_any(path: str | Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Read a calibration file or folder of any known program.

    unit: unit of the file's translations: "m", "cm", "mm", or "auto" to determine it (see `calibration_camera`);
        ignored where the format defines it.
    Returns: the rig, in the order of cameras in the file, world in metres, and notes about assumptions.
    Raises: CalibrationError that names the file, the camera and the cause.
    """
    if unit != "auto" and unit not in UNITS:
        raise CalibrationError(f"The calibration unit {unit!r} is not known; use auto, m, cm or mm.")
    rig = RigFile(Path(path), unit)
    try:
        CALIBRATIONS.read(path, rig)
        return rig.rig()
    except InputError as error:
        raise CalibrationError(str(error)) from None


def find_calibration(folder: Path) -> Path | None:
    """Find the calibration file in a folder: calibration.toml, else the only .toml with cameras, else .qca.txt.

    Where there are several, the last in natural order is used; None where there is none.
    """
    if (folder / "calibration.toml").is_file():
        return folder / "calibration.toml"
    candidates = [p for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
    tomls = [p for p in candidates if p.suffix.lower() == ".toml" and p.name.lower() != "config.toml"]
    tomls = [p for p in tomls if "calib" in p.name.lower() or "camera" in p.name.lower()] or tomls
    found = tomls or [p for p in candidates if p.name.lower().endswith(".qca.txt")]
    return max(found, key=lambda p: natural_key(p.name), default=None)

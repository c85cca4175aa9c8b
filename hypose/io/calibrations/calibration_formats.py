"""Calibration files of all known programs: the table of their formats, and reading. Only TOML is written."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array
from hypose.io.calibrations.calibration_text import (
    easymocap_pair,
    lens_files,
    parse_document,
    read_easymocap,
    read_tables,
    scalar,
    write_calibration,
)
from hypose.io.calibrations.camera_tables import UNITS, RigFile, numbers, tables_of
from hypose.io.file_names import natural_key, text_of
from hypose.io.files import read_bytes
from hypose.io.formats import Format, FormatTable, Source

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
        radial = _attributes(where, element, "intrinsic", "radialDistortion1", "radialDistortion2")
        tangential = _attributes(where, element, "intrinsic", "tangentalDistortion1", "tangentalDistortion2")
        third = _attributes(where, element, "intrinsic", "radialDistortion3", default=0.0)
        axes = _attributes(where, element, "transform", *(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))
        place = _attributes(where, element, "transform", "x", "y", "z") / 1000
        k = np.array([[fu, 0, cu - left], [0, fv, cv - top], [0, 0, 1.0]])
        turn = _FLIP @ axes.reshape(3, 3)
        size = np.array([right - left + 1, bottom - top + 1])
        rig.add(name, k, np.concatenate([radial, tangential, third]), turn, -turn @ place, size)


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

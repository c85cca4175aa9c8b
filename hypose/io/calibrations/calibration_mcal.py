"""OptiTrack's calibration: Motive's .mcal, XML in UTF-16.

Per camera ImagerPixelWidth and -Height, IntrinsicStandardCameraModel (focal lengths and centre in px, k1 k2 k3 and
tangential terms, as OpenCV's) and Extrinsic: the camera's place in metres and OrientMatrix0..8, row by row the axes of
a camera that looks along -z with y up. The world has y up and is turned so that z points up.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array
from hypose.io.calibrations.calibration_toml import MAX_FILE_BYTES, checked_camera, natural_key, rig_of
from hypose.io.files import read_bytes

# Motive's (x, y, z) with y up -> (x, -z, y) with z up
_WORLD_FROM_MOTIVE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_STANDARD = ("k1", "k2", "TangentialX", "TangentialY", "k3")


def read_mcal(path: Path) -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of Motive's file, metres, z up; a CalibrationError names the camera and what is wrong."""
    data = read_bytes(path, "a calibration of Motive", MAX_FILE_BYTES)
    wide = data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:64]
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-16-le" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        raise CalibrationError(f"{path} is not a text file; export the calibration from Motive again.") from None
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CalibrationError(f"{path} is not a calibration of Motive (it has a DOCTYPE); export it again.")
    try:
        # the declaration names an encoding that the text no longer has
        root = ElementTree.fromstring(text[text.index("<", text.find("?>") + 1) :] if "?>" in text else text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} is not valid XML: {error}; export the calibration again.") from None
    cameras, left = [], []
    for element in sorted(root.iter("Camera"), key=lambda e: natural_key(e.get("Serial", ""))):
        name = element.get("Serial") or f"cam_{len(cameras) + 1}"
        where = f"{path}, camera {name}"
        lens = element.find("IntrinsicStandardCameraModel")
        if lens is None or element.find("Extrinsic") is None:
            left.append(name)
            continue
        size = _numbers(where, element.find("Attributes"), ("ImagerPixelWidth", "ImagerPixelHeight"))
        fx, fy, cx, cy = _numbers(
            where, lens, ("HorizontalFocalLength", "VerticalFocalLength", "LensCenterX", "LensCenterY")
        )
        place = _WORLD_FROM_MOTIVE @ _numbers(where, element.find("Extrinsic"), ("X", "Y", "Z"))
        axes = _numbers(where, element.find("Extrinsic"), tuple(f"OrientMatrix{i}" for i in range(9))).reshape(3, 3)
        rotation = np.diag([1.0, -1.0, -1.0]) @ axes @ _WORLD_FROM_MOTIVE.T
        k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        cameras.append(
            checked_camera(where, name, k, _numbers(where, lens, _STANDARD), rotation, -rotation @ place, size)
        )
    if not cameras:
        raise CalibrationError(f"{path} holds no calibrated cameras; calibrate in Motive and export the .mcal.")
    notes = ["Motive's world is turned so that z points up."]
    if left:
        notes.append(f"{path.name}: {', '.join(left)} has no standard camera model or place and is left out.")
    return rig_of(path, cameras), tuple(notes)


def _numbers(where: str, element: ElementTree.Element | None, names: tuple[str, ...]) -> Array:
    values = []
    for name in names:
        try:
            values.append(float(element.get(name, "nan")) if element is not None else float("nan"))
        except ValueError:
            values.append(float("nan"))
        if not np.isfinite(values[-1]):
            raise CalibrationError(f"{where}: {name} is missing or no number; export the calibration again.")
    return np.array(values)

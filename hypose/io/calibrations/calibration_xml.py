"""Calibrations in XML: Qualisys Track Manager's .qca.txt and Vicon's .xcp."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array
from hypose.io.calibrations.calibration_toml import checked_camera, natural_key, read_text, rig_of


def read_xml(path: str | Path) -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of a Qualisys or Vicon file, told apart by what is in it."""
    path = Path(path)
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # none of these programs writes one; entities can make a file huge
        raise CalibrationError(f"{path} is not a Qualisys or Vicon calibration (it has a DOCTYPE); export it again.")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} is not valid XML: {error}; export the calibration again.") from None
    if root.findall("cameras/camera"):
        return _read_qca(path, root)
    if root.findall("Camera"):
        return _read_xcp(path, root)
    raise CalibrationError(f"{path} holds no cameras; export the calibration of the video cameras from QTM or Vicon.")


# ---- Qualisys ----------------------------------------------------------------------------------------------


def _read_qca(path: Path, root: ElementTree.Element) -> tuple[CameraRig, tuple[str, ...]]:
    """Qualisys Track Manager's XML. Intrinsics are in 1/64 px, the translation is the camera's position in
    mm, the rotation world_from_camera stored by columns, of a camera that looks along -z with y up (turned by
    pi about x into OpenCV's).

    Deviation: Pose2Sim divides the distortion coefficients by 64, too. They belong to normalised coordinates,
    and undivided they agree with a chessboard calibration of the same cameras, so they are taken as they are.
    """
    elements = root.findall("cameras/camera")
    video = [e for e in elements if any(m in e.get("model", "").lower() for m in ("video", "hybrid", "none"))]
    notes = []
    if video and len(video) < len(elements):
        notes.append(f"{path.name}: {len(video)} video cameras; the {len(elements) - len(video)} others are left out.")
    cameras = []
    for element in sorted(video or elements, key=lambda e: natural_key(e.get("serial", ""))):
        name = element.get("serial") or f"cam_{len(cameras) + 1}"
        where = f"{path}, camera {name}"
        if element.get("viewrotation", "0") not in ("0", ""):
            notes.append(
                f"{path.name}: camera {name} is marked as turned by {element.get('viewrotation')} degrees; "
                "its images must not be turned in the video files."
            )
        view = _attributes(where, element, "fov_video", ("left", "top", "right", "bottom"))
        optics = _attributes(
            where, element, "intrinsic", ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        )
        lens = _attributes(
            where,
            element,
            "intrinsic",
            ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2"),
        )
        third = _attributes(where, element, "intrinsic", ("radialDistortion3",), 0.0)
        axes = [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
        pose = _attributes(where, element, "transform", (*axes, "x", "y", "z"))
        fu, fv, cu, cv = optics / 64
        k = np.array([[fu, 0, cu - view[0]], [0, fv, cv - view[1]], [0, 0, 1.0]])
        turn = np.diag([1.0, -1.0, -1.0]) @ pose[:9].reshape(3, 3)
        size = np.array([view[2] - view[0] + 1, view[3] - view[1] + 1])
        cameras.append(
            checked_camera(where, name, k, np.concatenate([lens, third]), turn, -turn @ pose[9:] / 1000, size)
        )
    return rig_of(path, cameras), tuple(notes)


# ---- Vicon ---------------------------------------------------------------------------------------------------------

# With r in pixels, k r^2 and k r^4 are this small for any lens; with r in focal lengths they never are.
_PIXEL_UNITS = 1e-5


def _read_xcp(path: Path, root: ElementTree.Element) -> tuple[CameraRig, tuple[str, ...]]:
    """Vicon's XML: FOCAL_LENGTH and PRINCIPAL_POINT in px, ORIENTATION the quaternion (x, y, z, w) of
    camera_from_world, POSITION of the camera in mm, VICON_RADIAL2 "name cx cy k1 k2 k3" or VICON_RADIAL "k1 k2".

    The radial coefficients are taken as OpenCV's, as Pose2Sim and OpenCap do; so small that they can only belong to
    radii in pixels, they are taken as Vicon's own model, which multiplies distorted positions to straighten them:
    u = c + (1 + k1 r^2 + k2 r^4)(d - c); OpenCV's coefficients that undo it best inside the picture are found."""
    elements = root.findall("Camera")
    video = [e for e in elements if "video" in (e.get("TYPE", "") + e.get("DISPLAY_TYPE", "")).lower()]
    video = video or [e for e in elements if "vue" in e.get("DISPLAY_TYPE", "").lower()]
    notes = []
    if video and len(video) < len(elements):
        notes.append(f"{path.name}: {len(video)} video cameras; the {len(elements) - len(video)} others are left out.")
    cameras = []
    for element in sorted(video or elements, key=lambda e: natural_key(e.get("DEVICEID", ""))):
        name = element.get("USERID") if element.get("DEVICEID") is None else element.get("DEVICEID")
        name = name or f"cam_{len(cameras) + 1}"
        where = f"{path}, camera {name}"
        frames = element.findall("KeyFrames/KeyFrame")
        if not frames:
            notes.append(f"{path.name}: camera {name} was not calibrated and is left out.")
            continue
        frame = frames[0]
        size = _list(where, element, "SENSOR_SIZE", 2)
        aspect = _list(where, element, "PIXEL_ASPECT_RATIO", 1)[0] if element.get("PIXEL_ASPECT_RATIO") else 1.0
        focal = _list(where, frame, "FOCAL_LENGTH", 1)[0]
        centre = _list(where, frame, "PRINCIPAL_POINT", 2)
        q = _list(where, frame, "ORIENTATION", 4)
        place = _list(where, frame, "POSITION", 3) / 1000
        if not 0.1 < aspect < 10 or not 0.9 < np.linalg.norm(q) < 1.1:
            raise CalibrationError(
                f"{where}: PIXEL_ASPECT_RATIO {aspect:g} or ORIENTATION {q.tolist()} is implausible; export it again."
            )
        k = np.array([[focal, 0, centre[0]], [0, focal / aspect, centre[1]], [0, 0, 1.0]])
        lens = _radial(where, frame)
        if np.abs(lens).max() > 0 and np.abs(lens).max() < _PIXEL_UNITS:
            lens = _straightened(lens, focal, float(np.hypot(*size)) / 2)
            notes.append(f"{path.name}: the lens of {name} is given in pixels and was converted to OpenCV's model.")
        rotation = _rotation(q / np.linalg.norm(q))
        distortion = np.array([lens[0], lens[1], 0.0, 0.0, lens[2]])
        cameras.append(checked_camera(where, name, k, distortion, rotation, -rotation @ place, size))
    if not cameras:
        raise CalibrationError(f"{path} holds no calibrated camera; calibrate the video cameras in Vicon and export.")
    return rig_of(path, cameras), tuple(notes)


def _list(where: str, element: ElementTree.Element, name: str, count: int) -> Array:
    raw = element.get(name)
    try:
        values = np.array([float(v) for v in (raw or "").split()][:count])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise CalibrationError(
            f"{where}: {name} is {'missing' if raw is None else repr(raw)}, {count} numbers are needed; export the "
            "calibration again."
        )
    return values


def _radial(where: str, frame: ElementTree.Element) -> Array:
    """(3,) radial coefficients."""
    raw, first = frame.get("VICON_RADIAL2"), 3
    if raw is None:
        raw, first = frame.get("VICON_RADIAL") or "", 0
    try:
        values = [float(v) for v in raw.split()[first : first + 3]]
    except ValueError:
        values = [math.nan]
    if not np.isfinite(values).all():
        raise CalibrationError(f"{where}: the radial distortion {raw!r} is not understood; export it again.")
    return np.array([*values, 0.0, 0.0, 0.0][:3])


def _straightened(coefficients: Array, focal: float, radius: float) -> Array:
    """OpenCV's k1 k2 k3 for straightening in pixels: least squares over the picture."""
    d = np.linspace(0, radius, 200)[1:]
    u = d * (1 + coefficients[0] * d**2 + coefficients[1] * d**4 + coefficients[2] * d**6) / focal
    powers = np.stack([u**3, u**5, u**7], 1)
    return np.linalg.lstsq(powers, d / focal - u, rcond=None)[0]


def _rotation(q: Array) -> Array:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _attributes(
    where: str, camera: ElementTree.Element, tag: str, names: tuple[str, ...], default: float | None = None
) -> Array:
    element = camera.find(tag)
    values = []
    for name in names:
        raw = None if element is None else element.get(name)
        if raw is None and default is not None:
            values.append(default)
            continue
        try:
            value = float(raw) if raw is not None else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise CalibrationError(
                f"{where}: <{tag} {name}> is {'missing' if raw is None else repr(raw)}, a number is needed; "
                "export the calibration again."
            )
        values.append(value)
    return np.array(values)

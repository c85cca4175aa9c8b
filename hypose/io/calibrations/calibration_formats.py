"""Calibration files of all known programs: the table of their formats, and reading. Only TOML is written."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.io.calibrations.calibration_camera import UNITS, RigFile
from hypose.io.calibrations.calibration_systems import (
    opencap_files,
    read_motive,
    read_opencap,
    read_qualisys,
    read_vicon,
)
from hypose.io.calibrations.calibration_text import (
    easymocap_pair,
    lens_files,
    parse_document,
    read_easymocap,
    read_tables,
    write_calibration,
)
from hypose.io.calibrations.camera_tables import tables_of
from hypose.io.file_names import natural_key
from hypose.io.formats import Format, FormatTable, Source


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

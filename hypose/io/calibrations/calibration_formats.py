"""Calibration files of all known programs: the choice of the format for reading and writing.

`FORMATS` lists the formats. A file is read by the first one whose endings and test `holds` fit. The file's name
determines the format that is written: camera_array.toml is Caliscope's (nested tables); a .toml with anipose or
freemocap in its name is theirs (millimetres); any other .toml is in metres; .yml gives EasyMocap's intri.yml and
extri.yml, and .pickle gives OpenCap's (one file per camera), in the folder of the given name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.io.calibrations.calibration_camera import UNITS
from hypose.io.calibrations.calibration_systems import opencap_files, read_opencap, read_system_xml, write_opencap
from hypose.io.calibrations.calibration_text import (
    Found,
    is_storage,
    plain_files,
    read_plain,
    read_tables,
    tables_folder,
    write_calibration_toml,
    write_easymocap,
)
from hypose.io.file_names import natural_key


@dataclass(frozen=True)
class Format:
    """A format of calibration files.

    programs: names of the programs that use it.
    endings: endings of the files' names.
    read: function of path and unit that gives the rig, its world in metres, and notes. The unit is that of the file's
        translations ("auto": determined by the reader), ignored where the format defines it.
    folder: test whether a folder is of this format.
    holds: test whether a file with one of the endings is of this format.
    write: function of rig and path that gives the written files; None where the format is only read.
    """

    programs: str
    endings: tuple[str, ...]
    read: Callable[[Path, str], Found]
    folder: Callable[[Path], object] = lambda _: False
    holds: Callable[[Path], bool] = lambda _: True
    write: Callable[[CameraRig, Path], list[Path]] | None = None


FORMATS = (
    Format(
        "hypose, Pose2Sim, anipose, FreeMoCap, Caliscope",
        (".toml",),
        read_tables,
        write=write_calibration_toml,
    ),
    Format(
        "EasyMocap, OpenCV, Kalibr, ROS, MC-Calib", (".yml", ".yaml"), read_tables, tables_folder, write=write_easymocap
    ),
    Format("OpenCap", (".pickle", ".pkl"), read_opencap, opencap_files, write=write_opencap),
    Format("CMU Panoptic, XRMoCap, 3 x 4 projections", (".json",), read_tables),
    Format("Qualisys, Vicon, OptiTrack Motive", (".qca.txt", ".qca", ".xcp", ".mcal"), read_system_xml),
    Format("BioCV, 3 x 4 projections", (".txt", ".calib", ""), read_plain, plain_files),
    Format("OpenCV", (".xml",), read_tables, holds=is_storage),
    Format("Qualisys, Vicon", (".xml",), read_system_xml),
)
_READ = (
    ".toml, .yml, .yaml, .xml, .json, .qca.txt, .xcp, .mcal, .txt, .calib, .pickle, or a folder with intri.yml and "
    "extri.yml, .pickle, .calib or OpenCV's .xml files"
)


def read_any(path: str | Path, unit: str = "auto") -> Found:
    """Read a calibration file or folder of any known program.

    unit: unit of the file's translations: "m", "cm", "mm", or "auto" to determine it (see `calibration_camera`).
    Returns: the rig, in the order of cameras in the file, world in metres, and notes about assumptions.
    Raises: CalibrationError that names the file, the camera and the cause.
    """
    path = Path(path)
    if unit != "auto" and unit not in UNITS:
        raise CalibrationError(f"The calibration unit {unit!r} is not known; use auto, m, cm or mm.")
    if not path.exists():
        raise CalibrationError(f"The calibration file {path} does not exist; check the path, or run hypose calibrate.")
    try:
        if path.is_dir():
            found = next((f for f in FORMATS if f.folder(path)), None)
        else:
            found = next((f for f in FORMATS if _has_ending(path, f) and f.holds(path)), None)
        if found is not None:
            return found.read(path, unit)
    except CalibrationError:
        raise
    except InputError as error:
        raise CalibrationError(str(error)) from None
    if path.is_dir():
        raise CalibrationError(f"The folder {path} holds no calibration; give a file or folder: {_READ}.")
    raise CalibrationError(f"{path}: calibrations are read from {_READ}; name the file by one of these endings.")


def _has_ending(path: Path, kind: Format) -> bool:
    name = path.name.lower()
    return any(name.endswith(e) if e else "." not in name for e in kind.endings)


def _writer(path: Path) -> Callable[[CameraRig, Path], list[Path]]:
    write = next((f.write for f in FORMATS if f.write is not None and _has_ending(path, f)), None)
    if write is None or path.suffix.lower() == ".pkl":
        raise InputError(f"{path} cannot be written: name the calibration .toml, .yml or .pickle.")
    return write


def check_format(path: Path) -> None:
    """Check that the ending of a file's name gives a format that can be written; InputError otherwise."""
    _writer(path)


def write_any(rig: CameraRig, path: str | Path) -> list[Path]:
    """Write a rig in the format that the file's name gives, and return the written files.

    Files of EasyMocap and OpenCap are written to the folder of the given name.
    """
    return _writer(Path(path))(rig, Path(path))


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

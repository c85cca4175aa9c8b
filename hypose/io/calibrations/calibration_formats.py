"""Calibration files of other programs: how each is recognized, read and written.

`FORMATS` lists them: the first whose endings a file's name has, and whose `holds` accepts it, reads it. The name tells
all that is written: camera_array.toml is Caliscope's (nested tables), a .toml with anipose or freemocap in its name
theirs (millimetres), any other .toml in metres; .yml EasyMocap's intri.yml and extri.yml, .pickle OpenCap's (one file
per camera), in the folder of the given name."""

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
    """Calibrations of some programs.

    endings: of the files' names. read(path, unit): the rig, world in metres, and notes; unit of the file's translations
    (auto: made out), ignored where the format knows it. folder: whether a folder is one of these. holds: whether a file
    with these endings is. write(rig, path): the files written; None when none are.
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
    """Rig of a calibration of any known program, in the file's camera order, world in metres, and sentences on what was
    assumed.

    unit: 'auto' (see `calibration_camera`), 'm', 'cm' or 'mm', the unit of the file's translations. A
    CalibrationError names the file, the camera and the cause.
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
    """An InputError when the file's ending tells no format that is written."""
    _writer(path)


def write_any(rig: CameraRig, path: str | Path) -> list[Path]:
    """Write the rig in the format that the file's name tells; the files written. EasyMocap's and OpenCap's files go to
    the folder of the given name."""
    return _writer(Path(path))(rig, Path(path))


def find_calibration(folder: Path) -> Path | None:
    """The calibration file in a folder: calibration.toml, else the only .toml that holds cameras, else .qca.txt.

    With several, the last in natural order of their names; None when there is none.
    """
    if (folder / "calibration.toml").is_file():
        return folder / "calibration.toml"
    candidates = [p for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
    tomls = [p for p in candidates if p.suffix.lower() == ".toml" and p.name.lower() != "config.toml"]
    tomls = [p for p in tomls if "calib" in p.name.lower() or "camera" in p.name.lower()] or tomls
    found = tomls or [p for p in candidates if p.name.lower().endswith(".qca.txt")]
    return max(found, key=lambda p: natural_key(p.name), default=None)

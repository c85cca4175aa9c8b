"""Calibration files of other programs: which is which by the ending of its name, what is read and what is written.

| name | program | read | written |
| --- | --- | --- | --- |
| .toml | hypose, Pose2Sim, anipose, FreeMoCap, Caliscope | yes | metres |
| camera_array.toml | Caliscope | yes | its nested tables |
| a name with anipose or freemocap in it, .toml | anipose, FreeMoCap | yes | millimetres |
| .yml, .yaml, or a folder with intri.yml and extri.yml | EasyMocap; OpenCV (one camera) | yes | intri.yml, extri.yml |
| a folder of OpenCV's .xml or .yml, one per camera | OpenCV | yes | - |
| .qca.txt | Qualisys | yes | - |
| .xcp | Vicon | yes | - |
| .mcal | OptiTrack Motive | yes | - |
| .json | CMU Panoptic (K, R, t), 3 x 4 projections | yes | - |
| .txt | 3 x 4 projections | yes | - |
| .calib, no ending, or a folder of them | BioCV | yes | - |
| .pickle, or a folder of them | OpenCap | yes, safely | one file per camera |
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.io.calibrations.calibration_json import read_json
from hypose.io.calibrations.calibration_mcal import read_mcal
from hypose.io.calibrations.calibration_opencap import read_opencap, write_opencap
from hypose.io.calibrations.calibration_plain import plain_files, read_plain
from hypose.io.calibrations.calibration_toml import (
    MAX_FILE_BYTES,
    UNITS,
    read_text,
    read_toml,
    toml_value,
    write_calibration,
)
from hypose.io.calibrations.calibration_xml import read_xml
from hypose.io.calibrations.calibration_yml import read_storages, read_yml, storages, write_yml
from hypose.io.files import read_bytes, write_text

_READ = (
    ".toml, .yml, .yaml, .xml, .json, .qca.txt, .xcp, .mcal, .txt, .calib, .pickle, or a folder with intri.yml and "
    "extri.yml, .pickle, .calib or OpenCV's .xml files"
)
_WRITTEN = ".toml, .yml or .pickle"


def read_any(path: str | Path, unit: str = "auto") -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of a calibration of any known program, in the file's camera order, world in metres, and sentences on what was
    assumed.

    unit: 'auto' (see `calibration_toml`), 'm', 'cm' or 'mm', the unit of the file's translations. A
    CalibrationError names the file, the camera and what is wrong.
    """
    path = Path(path)
    name = path.name.lower()
    if unit != "auto" and unit not in UNITS:
        raise CalibrationError(f"The calibration unit {unit!r} is not known; use auto, m, cm or mm.")
    if path.is_dir():
        if any((path / n).is_file() for n in ("intri.yml", "Intrinsic.yml")):
            return read_yml(path, unit)
        if next(path.rglob("*.pickle"), None) is not None:
            return read_opencap(path)
        if plain_files(path):
            return read_plain(path, unit)
        if storages(path):
            return read_storages(path, unit)
        raise CalibrationError(f"The folder {path} holds no calibration; give a file or folder: {_READ}.")
    if name.endswith(".toml"):
        return read_toml(path, read_text(path), unit)
    if not path.is_file():
        raise CalibrationError(f"The calibration file {path} does not exist; check the path, or run hypose calibrate.")
    if name.endswith((".qca.txt", ".qca", ".xcp")):
        return read_xml(path)
    if name.endswith(".xml"):
        start = read_bytes(path, "a calibration", MAX_FILE_BYTES)[:4096]
        return read_yml(path, unit) if b"opencv_storage" in start else read_xml(path)
    if name.endswith((".yml", ".yaml")):
        return read_yml(path, unit)
    if name.endswith((".pickle", ".pkl")):
        return read_opencap(path)
    if name.endswith(".json"):
        return read_json(path, unit)
    if name.endswith(".mcal"):
        return read_mcal(path)
    if name.endswith((".txt", ".calib")) or "." not in name:
        return read_plain(path, unit)
    raise CalibrationError(f"{path}: calibrations are read from {_READ}; name the file by one of these endings.")


def check_format(path: Path) -> None:
    """An InputError when the file's ending tells no format."""
    if not path.name.lower().endswith((".toml", ".yml", ".yaml", ".pickle")):
        raise InputError(f"{path} cannot be written: name the calibration {_WRITTEN}.")


def write_any(rig: CameraRig, path: str | Path) -> list[Path]:
    """Write the rig in the format that the file's name tells; the files written. EasyMocap's and OpenCap's files go to
    the folder of the given name."""
    path = Path(path)
    check_format(path)
    name = path.name.lower()
    if name.endswith((".yml", ".yaml")):
        return write_yml(rig, path.parent)
    if name.endswith(".pickle"):
        return write_opencap(rig, path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)
    if name == "camera_array.toml":
        _write_caliscope(rig, path)
    elif "anipose" in name or "freemocap" in name:
        cameras = []
        for camera in rig:
            pose = camera.camera_from_world.copy()
            pose[:3, 3] *= 1000
            cameras.append(replace(camera, camera_from_world=pose))
        write_calibration(CameraRig(tuple(cameras)), path, unit="mm")
    else:
        write_calibration(rig, path)
    return [path]


def _write_caliscope(rig: CameraRig, path: Path) -> None:
    """Caliscope's camera_array.toml: tables by number, the rotation as a matrix, metres."""
    lines = []
    for i, camera in enumerate(rig):
        if camera.fisheye:
            raise CalibrationError(f"Camera {camera.name} is a fisheye, which Caliscope's file cannot hold here.")
        lens = np.zeros(5)
        lens[: min(5, len(camera.distortion))] = camera.distortion[:5]
        lines += [
            f"[cameras.{i}]",
            f"cam_id = {i}",
            f"name = {toml_value(camera.name)}",
            "rotation_count = 0",
            "error = 0.0",
            "exposure = 0",
            "grid_count = 0",
            "ignore = false",
            f"size = {toml_value([int(s) for s in camera.size])}",
            f"matrix = {toml_value(camera.K)}",
            f"distortions = {toml_value(lens)}",
            f"translation = {toml_value(camera.camera_from_world[:3, 3])}",
            f"rotation = {toml_value(camera.camera_from_world[:3, :3])}",
            "",
        ]
    write_text(path, "\n".join(lines))

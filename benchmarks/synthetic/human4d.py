"""HUMAN4D: a run measured by Vicon, as seen from four real depth cameras (tofis/human4d_dataset, MIT)."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.geometry import Array, se3, se3_inverse, transform

# (camera, frames) whose positions contradict the other views by more than 10 mm
_BAD = {2: set(range(236, 278)), 1: {266, 269, 279}, 3: {266, 269, 272, 278, 279}}


@dataclass(frozen=True)
class Human4d:
    """joints (T, 33, 3) m in the first camera's frame; camera_from_first (4, 4, 4): the four cameras, OpenCV axes;
    intrinsics (4, 3, 3) px."""

    joints: Array
    camera_from_first: Array
    intrinsics: Array


def read_human4d(folder: Path) -> Human4d:
    """The run of the folder human4d_run; an InputError names a file that cannot be used."""
    try:
        with importlib.import_module("h5py").File(folder / "running_annot.h5") as data:
            arrays = {name: np.asarray(data[name]) for name in ("pose/3d", "camera", "frame")}
            lenses = np.array([data[f"intrinsics/M72{name}"] for name in "ehij"], dtype=np.float64)
        text = json.loads((folder / "extrinsics_from_procrustes.json").read_text())["cam1_to_camk"]
    except (OSError, KeyError, ValueError) as e:
        raise InputError(f"{folder} is not the HUMAN4D run ({e}); give the folder with running_annot.h5.") from e
    extrinsics = se3([v["R"] for v in text.values()], np.array([v["t"] for v in text.values()], dtype=np.float64) / 1e3)
    camera, frame = arrays["camera"], arrays["frame"].astype(np.int64).ravel()
    names = sorted(set(camera.ravel().tolist()))
    pose = arrays["pose/3d"].astype(np.float64) / 1e3
    first_from_camera = se3_inverse(extrinsics)
    seen: dict[int, list[Array]] = {}
    for i, (name, at) in enumerate(zip(camera.ravel().tolist(), frame.tolist(), strict=True)):
        k = names.index(name)
        if at not in _BAD.get(k, ()) and np.isfinite(pose[i]).all() and np.abs(pose[i]).max() > 1e-3:
            seen.setdefault(at, []).append(transform(first_from_camera[k], pose[i]))
    return Human4d(np.array([np.median(seen[at], axis=0) for at in sorted(seen)]), extrinsics, lenses)

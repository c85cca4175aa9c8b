"""Calibration of cameras from measured points of the scene that were clicked in each camera's picture."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hypose.calibration.bundle import LensPrior, Observations, bundle_adjust, trial_lenses
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError, refuse
from hypose.geometry import Array, se3
from hypose.io.calibrations.camera_tables import UNITS, numbers
from hypose.io.files import read_toml

_LEAST_KNOWN, _LEAST_UNKNOWN = 4, 6  # points for a camera with a known and with an unknown lens
_CLICK_PX = 1.0
# few points cannot separate lens and pose: little distortion is assumed, and square pixels
_PRIOR = LensPrior(centre=0.02, aspect=0.003, radial=0.1, tangential=0.001, k3=0.02)


@dataclass(frozen=True)
class ScenePoints:
    """Measured points of a scene and their positions in the pictures.

    points: (3,) by name, world z up, m.
    clicks: (2,) px by camera and point.
    sizes: width and height of the pictures by camera, px, where given.
    """

    points: Mapping[str, Array]
    clicks: Mapping[str, Mapping[str, Array]]
    sizes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class PointCalibration:
    """The result of a calibration from measured points.

    rig: calibrated cameras.
    errors: px by camera and point.
    rms_px: root mean square per coordinate, px.
    position_sd: (C,) standard deviation of the position for clicks of 1 px, m.
    notes, warnings: sentences for the user.
    """

    rig: CameraRig
    errors: Mapping[str, Mapping[str, float]]
    rms_px: float
    position_sd: Array
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def read_scene_points(path: str | Path) -> ScenePoints:
    """Read measured points and their clicks from a TOML file of this form:

        unit = "m"                      # of the points: m, cm or mm
        [points]
        corner_a = [0.0, 0.0, 0.0]      # x, y, z; z up
        [clicks.cam01]
        size = [1920, 1080]             # width, height of the picture; not needed with a calibration file
        corner_a = [512.3, 830.0]       # px, the middle of the first pixel is 0, 0

    Raises: InputError where a key or value is wrong.
    """
    path = Path(path)
    document = read_toml(path, "a TOML file of scene points")
    unknown = set(document) - {"unit", "points", "clicks"}
    unit, tables = document.get("unit", "m"), document.get("clicks")
    faults = {
        f"{', '.join(sorted(unknown))} is unknown; known are unit, [points], [clicks.CAMERA]": unknown,
        f"unit must be m, cm or mm, got {unit!r}; correct it": unit not in UNITS,
        "no clicks; add a table [clicks.CAMERA] per camera with POINT = [x, y]": (
            not isinstance(tables, dict) or not tables
        ),
    }
    refuse(f"{path}: ", faults)
    points = {n: UNITS[unit] * v for n, v in _vectors(path, "points", document.get("points"), 3).items()}
    clicks, sizes = {}, {}
    for camera, table in dict(tables).items():
        entries = dict(table) if isinstance(table, dict) else {}
        size = entries.pop("size", None)
        if size is not None:
            given = numbers(f"{path}, camera {camera}", {"size": size}, ("size",), (2,))
            if (given < 1).any() or (given % 1).any():
                raise InputError(f"{path}, camera {camera}: size must be [width, height] in px, got {size!r}.")
            sizes[camera] = (int(given[0]), int(given[1]))
        clicks[camera] = _vectors(path, f"clicks.{camera}", entries, 2)
        stray = [n for n in clicks[camera] if n not in points]
        if stray:
            raise InputError(
                f"{path}, camera {camera}: the point {stray[0]} has no place in [points], which has "
                f"{', '.join(points)}; correct the name."
            )
    return ScenePoints(points, clicks, sizes)


def _vectors(path: Path, table: str, entries: Any, length: int) -> dict[str, Array]:
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: the table [{table}] is missing or empty; list NAME = [..] with {length} numbers.")
    return {str(name): numbers(f"{path}, [{table}]", entries, (name,), (length,)) for name in entries}


def calibrate_from_points(scene: ScenePoints, lenses: CameraRig | None = None) -> PointCalibration:
    """Calibrate cameras in the world of measured points.

    scene: the points and their positions in the pictures.
    lenses: K and distortion by camera name, kept. Without them a camera needs six points that are not in one plane, and
        its lens is assumed to have square pixels and little distortion.
    Raises: CalibrationError where there are too few points, they lie in a line or plane, or no pose explains the
        clicks.
    """
    names = list(scene.points)
    world = np.stack([scene.points[n] for n in names])
    cameras, errors, sds, notes, warnings = [], {}, [], [], []
    for name, clicks in scene.clicks.items():
        index, pixels = np.array([names.index(n) for n in clicks]), np.stack(list(clicks.values()))
        lens = None if lenses is None else lenses.select([name])[0]
        found = bundle_adjust(
            [_start(name, world[index], pixels, lens, scene.sizes.get(name))],
            np.eye(4)[None],
            world,
            Observations(np.zeros_like(index), np.zeros_like(index), index, pixels),
            free_intrinsics=lens is None,
            fixed_frames=np.array([True]),
            prior=_PRIOR,
            noise_px=_CLICK_PX,
            robust_px=3.0,
        )
        camera = found.cameras[0]
        distance = np.linalg.norm(found.residuals, axis=1)
        errors[name] = dict(zip(clicks, distance.tolist(), strict=True))
        worst = max(clicks, key=errors[name].__getitem__)
        if distance.max() > max(5.0, 4 * float(np.median(distance))):
            warnings.append(
                f"{name}: the point {worst} lies {distance.max():.0f} px from where it should be (median "
                f"{np.median(distance):.1f} px); check its click and its measured place."
            )
        if lens is None:
            share = float(found.focal_sd[0]) / camera.K[0, 0]
            notes.append(f"{name}: focal length {camera.K[0, 0]:.0f} px, uncertain by {100 * share:.1f} %.")
        cameras.append(camera)
        sds.append(float(found.position_sd[0]))
    rms = float(np.sqrt(np.mean([px**2 for e in errors.values() for px in e.values()]) / 2))
    return PointCalibration(CameraRig(tuple(cameras)), errors, rms, np.array(sds), tuple(notes), tuple(warnings))


def _start(name: str, world: Array, pixels: Array, lens: Camera | None, size: tuple[int, int] | None) -> Camera:
    """Find a camera that explains the clicks roughly; 24 focal lengths are tried where the lens is unknown.

    name: name of the camera.
    world: (N, 3) m, measured points.
    pixels: (N, 2) px, their clicks.
    lens: the known lens; None where unknown.
    size: width and height of the picture, px; None where unknown.
    Raises: CalibrationError where there are too few points, they lie in a line or plane, the size is missing, or no
        pose explains the clicks.
    """
    least, how = (_LEAST_UNKNOWN, "without") if lens is None else (_LEAST_KNOWN, "with")
    spread = np.append(np.linalg.svd(world - world.mean(0), compute_uv=False), [0.0, 0.0])
    line, plane = spread[1] < 1e-3 * spread[0], lens is None and spread[2] < 0.02 * spread[0]
    faults = {
        f"{len(world)} points are clicked, at least {least} are needed {how} a known lens; click more, or give "
        "--intrinsics": len(world) < least,
        f"all its points lie in one {'line' if line else 'plane'}; measure some outside it"
        f"{', or give its lens with --intrinsics' if lens is None else ''}": line or plane,
        f"the size of its picture is not known; add size = [width, height] to [clicks.{name}], or give its lens with "
        "--intrinsics": lens is None and size is None,
    }
    refuse(f"Camera {name}: ", faults, CalibrationError)
    lenses = [replace(lens, name=name)] if lens else trial_lenses(name, size or (0, 0), np.geomspace(0.4, 6, 24))
    found = [one for camera in lenses for one in _posed(camera, world, pixels)]
    if not found:
        raise CalibrationError(
            f"Camera {name}: no place of the camera explains its clicks; check that each point's name, measured place "
            "and click belong together."
        )
    return min(found, key=lambda f: f[0])[1]


def _posed(camera: Camera, world: Array, pixels: Array) -> list[tuple[float, Camera]]:
    """Find camera poses with all points and with each point left out.

    world: (N, 3) m.
    pixels: (N, 2) px, distorted.
    Returns: the median error, px, and the camera at each pose.
    Why: one wrong click distorts the whole pose.
    """
    undistorted = camera.undistort_points(pixels)
    found, count = list[tuple[float, Camera]](), len(world)
    for left_out in (None, *(range(count) if count > _LEAST_KNOWN else ())):
        use = np.arange(count) != left_out
        with contextlib.suppress(cv2.error):
            ok, rvec, tvec = cv2.solvePnP(world[use], undistorted[use], camera.K, None, flags=cv2.SOLVEPNP_SQPNP)
            trial = replace(camera, camera_from_world=se3(cv2.Rodrigues(rvec)[0], tvec.ravel())) if ok else camera
            error = float(np.median(np.linalg.norm(trial.project(world) - pixels, axis=1)))
            found += [(error, trial)] if ok and np.isfinite(error) else []
    return found

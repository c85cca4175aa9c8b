"""A camera's lens from pictures of a board: Zhang's closed form and OpenCV's refinement to start with, then the joint
refinement of `bundle` with its weak prior, without the pictures that do not fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from hypose.calibration.boards import Board, BoardDetection
from hypose.calibration.bundle import Observations, Refined, bundle_adjust
from hypose.calibration.views import positions
from hypose.cameras.camera import Camera
from hypose.errors import CalibrationError
from hypose.geometry import Array, se3

MAX_VIEWS = 40
_MIN_VIEWS = 4
_DISTINCT = 0.03  # of the picture's width: boards nearer to each other than this say the same
FOCAL_SD = 0.03
"""A focal length known worse than this share of it is not known."""


@dataclass(frozen=True)
class CalibratedLens:
    """camera: the lens with pose = identity; frames: the board pictures that were used; rms_px per coordinate;
    focal_sd px; given: taken from a file, not calibrated."""

    camera: Camera
    frames: tuple[int, ...]
    rms_px: float
    focal_sd: float
    given: bool = False


def calibrate_lens(
    name: str,
    sightings: Mapping[int, BoardDetection],
    board: Board,
    size: tuple[int, int],
    *,
    fisheye: bool = False,
    strict: bool = True,
) -> CalibratedLens:
    """K and distortion (k1 k2 p1 p2 k3, or four fisheye coefficients) from boards seen by frame number.

    A CalibrationError says what is missing when the pictures do not determine the focal length; with strict = False an
    uncertain one is returned, since boards that other cameras saw as well may settle it.
    """
    chosen = spread_out(sightings, size, MAX_VIEWS)
    different = len(spread_out(sightings, size, MAX_VIEWS, _DISTINCT))
    if different < _MIN_VIEWS:
        raise CalibrationError(
            f"Camera {name}: the board was seen in {len(sightings)} pictures, in {different} different positions; its "
            f"lens needs at least {_MIN_VIEWS}, better 15: film the board tilted, near and far, in all corners of the "
            "picture, or give a calibration file with --intrinsics."
        )
    start = (
        _first_fisheye(name, chosen, sightings, board, size)
        if fisheye
        else _first(name, chosen, sightings, board, size)
    )
    result: Refined | None = None
    for attempt in range(3):
        poses = [board_poses(start, sightings[f], board.points)[0] for f in chosen]
        # bad start poses (a board nearly edge-on) would only be dropped later
        good = [k for k, (pose, _) in enumerate(poses) if pose[2, 3] > 0]
        chosen, poses = [chosen[k] for k in good], [poses[k] for k in good]
        if len(chosen) < 3:
            break
        observations = collect_observations({0: {f: sightings[f] for f in chosen}}, chosen)
        result = bundle_adjust([start], np.stack([p for p, _ in poses]), board.points, observations)
        start = result.cameras[0]
        error = np.sqrt(
            np.bincount(observations.frame, (result.residuals**2).sum(1)) / (2 * np.bincount(observations.frame))
        )
        limit = max(3 * float(np.median(error)), 0.5)
        if (error <= limit).all() or attempt == 2:
            break
        chosen = [f for f, e in zip(chosen, error, strict=True) if e <= limit]
    if result is None or len(chosen) < 3:
        raise CalibrationError(
            f"Camera {name}: the boards found in its pictures contradict each other; check the pattern size and that "
            "the board is flat and stiff."
        )
    sd = float(result.focal_sd[0])
    if strict and not sd < FOCAL_SD * start.K[0, 0]:
        raise CalibrationError(
            f"Camera {name}: {len(sightings)} pictures of the board leave its focal length uncertain by "
            f"{100 * sd / start.K[0, 0]:.0f} %; film the board tilted by 30 to 45 degrees in several directions, or "
            "give a calibration file with --intrinsics."
        )
    return CalibratedLens(start, tuple(chosen), result.rms_px, sd)


def spread_out(
    sightings: Mapping[int, BoardDetection], size: tuple[int, int], count: int, apart: float = 0.0
) -> list[int]:
    """At most `count` frames whose boards lie as differently as possible (farthest-point sampling), no two nearer than
    `apart` (share of the picture's width); in order of time."""
    frames = list(sightings)
    if not frames:
        return []
    where = positions(sightings, size) * [1, 1, 3, 0.1]  # a board's size matters as well
    most = int(np.argmax([len(s.ids) for s in sightings.values()]))
    picked, distance = [most], np.linalg.norm(where - where[most], axis=1)
    while len(picked) < min(count, len(frames)):
        far = int(distance.argmax())
        if distance[far] <= apart:
            break
        picked.append(far)
        distance = np.minimum(distance, np.linalg.norm(where - where[far], axis=1))
    return sorted(frames[i] for i in picked)


def collect_observations(sightings: Mapping[int, Mapping[int, BoardDetection]], frames: Sequence[int]) -> Observations:
    """The corners of cameras (by index) in the given frames, as arrays; the frame's index is its place in `frames`."""
    place = {f: k for k, f in enumerate(frames)}
    parts = [
        (np.full(len(s.ids), c), np.full(len(s.ids), place[f]), s.ids, s.pixels)
        for c, seen in sightings.items()
        for f, s in seen.items()
        if f in place
    ]
    if not parts:
        empty = np.zeros(0, np.int64)
        return Observations(empty, empty, empty, np.zeros((0, 2)))
    c, f, i, p = (np.concatenate(v) for v in zip(*parts, strict=True))
    return Observations(c, f, i, p)


def board_poses(camera: Camera, sighting: BoardDetection, points: Array) -> list[tuple[Array, float]]:
    """camera_from_board (4, 4) and rms error (px) of the two poses under which a plane looks nearly the same, the
    better first (Collins & Bartoli 2014, "Infinitesimal plane-based pose estimation")."""
    flat = np.linalg.inv(camera.K)
    u = camera.undistort_points(sighting.pixels)
    normal = np.concatenate([u, np.ones((len(u), 1))], 1) @ flat.T
    seen = points[sighting.ids]
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            seen, normal[:, :2].copy(), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return [(se3(np.eye(3), [0, 0, -1.0]), float("inf"))]
    out = []
    for r, t in zip(rotations, translations, strict=True):
        pose = se3(cv2.Rodrigues(r)[0], np.ravel(t))
        error = replace(camera, camera_from_world=pose).project(seen) - sighting.pixels
        rms = float(np.sqrt(np.mean(error**2)))
        out.append((pose, rms if np.isfinite(rms) else float("inf")))
    return sorted(out, key=lambda p: p[1])


def _first(
    name: str, frames: Sequence[int], sightings: Mapping[int, BoardDetection], board: Board, size: tuple[int, int]
) -> Camera:
    objects = [board.points[sightings[f].ids].astype(np.float32) for f in frames]
    images = [sightings[f].pixels.astype(np.float32) for f in frames]
    k = np.asarray(cv2.initCameraMatrix2D(objects, images, size, 1.0), dtype=np.float64)
    f = float(k[0, 0])
    if not 0.2 * max(size) < f < 20 * max(size):
        f = 1.0 * max(size)
    k = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        _, found, lens = cv2.calibrateCamera(objects, images, size, k.copy(), np.zeros(5), flags=flags)[:3]
        found, lens = np.asarray(found, np.float64), np.ravel(lens)[:5].astype(np.float64)
        middle = np.abs(found[:2, 2] - k[:2, 2]).max()
        if 0.2 * max(size) < found[0, 0] < 20 * max(size) and middle < 0.3 * max(size) and np.abs(lens).max() < 3:
            return Camera(name, found, lens, np.eye(4), size)
    except cv2.error:
        pass
    return Camera(name, k, np.zeros(5), np.eye(4), size)


def _first_fisheye(
    name: str, frames: Sequence[int], sightings: Mapping[int, BoardDetection], board: Board, size: tuple[int, int]
) -> Camera:
    """Of focal lengths between those of 60 and 220 degrees of view the one whose poses fit best (the equidistant model
    r = f angle is near enough to start from; OpenCV's own start fails on boards near the edge)."""
    best = (float("inf"), 0.0)
    for view in np.deg2rad(np.geomspace(60, 220, 12)):
        f = max(size) / view
        camera = _fisheye(name, f, size)
        errors = [board_poses(camera, sightings[i], board.points)[0][1] for i in frames]
        best = min(best, (float(np.median(errors)), f))
    return _fisheye(name, best[1] or max(size) / 2.0, size)


def _fisheye(name: str, f: float, size: tuple[int, int]) -> Camera:
    k = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1]])
    return Camera(name, k, np.zeros(4), np.eye(4), size, True)

"""Lenses of cameras from pictures of a board, and the joint refinement of cameras and boards.

A lens starts without distortion, with the focal length of which board poses fit best. Lenses and rigs are refined by
`bundle` with its weak prior, without the pictures that do not fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from hypose.calibration.boards import Board, BoardDetection, IntArray
from hypose.calibration.bundle import NOISE_PX, Observations, bundle_adjust, trial_lenses
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, far_apart, se3, transform

MAX_VIEWS = 40
_MIN_VIEWS = 4
_DISTINCT = 0.03  # of the picture's width: boards nearer to each other than this give the same information
FOCAL_SD = 0.03
"""Relative standard deviation above which a focal length counts as undetermined."""


@dataclass(frozen=True)
class CalibratedLens:
    """The lens of one camera.

    camera: the lens; its pose is the identity.
    rms_px: root mean square error per coordinate, px.
    given: it was read from a file, not calibrated.
    """

    camera: Camera
    rms_px: float
    given: bool = False


def calibrate_lens(
    name: str,
    sightings: Mapping[int, BoardDetection],
    board: Board,
    size: tuple[int, int],
    *,
    fisheye: bool = False,
) -> CalibratedLens:
    """Calibrate K and distortion (k1 k2 p1 p2 k3, or four fisheye coefficients) of one camera from its board pictures.

    name: name of the camera.
    sightings: detected boards by frame number.
    size: width and height of the pictures, px.
    Returns: the lens, also where its focal length stays uncertain, because boards that other cameras saw as well may
        determine it.
    Raises: CalibrationError where pictures are missing or contradict each other.
    """
    chosen = spread_out(sightings, size, MAX_VIEWS)
    different = len(spread_out(sightings, size, MAX_VIEWS, _DISTINCT))
    if different < _MIN_VIEWS:
        raise CalibrationError(
            f"Camera {name}: the board was seen in {len(sightings)} pictures, in {different} different positions; its "
            f"lens needs at least {_MIN_VIEWS}, better 15: film the board tilted, near and far, in all corners of the "
            "picture, or give a calibration file with --intrinsics."
        )
    seen = {f: sightings[f] for f in chosen}
    # fisheye lenses see 60 to 220 degrees by the equidistant model r = f angle, which is near enough for a start
    lenses = trial_lenses(name, size, np.geomspace(0.26, 0.95, 12) if fisheye else np.geomspace(0.3, 8, 24), fisheye)
    few = list(seen.values())[:: max(1, len(seen) // 12)]
    start = lenses[
        int(np.argmin([np.median([board_poses(lens, s, board.points)[0][1] for s in few]) for lens in lenses]))
    ]
    poses = {f: board_poses(start, s, board.points)[0][0] for f, s in seen.items()}
    # bad start poses (a board nearly edge-on) would only be dropped later
    good = {f: p for f, p in poses.items() if p[2, 3] > 0}
    fit = refine_boards([start], {0: seen}, good, board, [True]) if len(good) > 2 else None
    if fit is None or len(fit.errors) < 3:
        raise CalibrationError(
            f"Camera {name}: the boards found in its pictures contradict each other; check the pattern size and that "
            "the board is flat and stiff."
        )
    return CalibratedLens(fit.rig[0], fit.rms_px)


def spread_out(
    sightings: Mapping[int, BoardDetection], size: tuple[int, int], count: int, apart: float = 0.0
) -> list[int]:
    """Choose frames whose boards lie as differently as possible (farthest-point sampling).

    sightings: detected boards by frame number.
    size: width and height of the pictures, px.
    count: largest number of frames.
    apart: smallest difference between two boards, as a share of the picture's width.
    Returns: frame numbers in increasing order.
    """
    frames = list(sightings)
    if not frames:
        return []
    spreads = [s.pixels.std(0) / size[0] for s in sightings.values()]
    # place, size and slant of each board; the size matters most
    where = np.array(
        [
            [*(s.pixels.mean(0) / size[0]), 3 * np.hypot(*spread), 0.1 * np.arctan2(*spread)]
            for s, spread in zip(sightings.values(), spreads, strict=True)
        ]
    )
    most = int(np.argmax([len(s.ids) for s in sightings.values()]))
    return sorted(frames[i] for i in far_apart(where, most, count, apart))


def collect_observations(sightings: Mapping[int, Mapping[int, BoardDetection]], frames: Sequence[int]) -> Observations:
    """Collect the corners of some frames of all cameras as arrays.

    sightings: detected boards by camera index and frame number.
    frames: frame numbers; their positions in this list are the frame indices in the result.
    """
    place = {f: k for k, f in enumerate(frames)}
    none = np.zeros(0, np.int64)
    parts = [
        (np.full(len(s.ids), c), np.full(len(s.ids), place[f]), s.ids, s.pixels)
        for c, seen in sorted(sightings.items())
        for f, s in sorted(seen.items(), key=lambda item: place.get(item[0], -1))
        if f in place
    ]
    return Observations(*map(np.concatenate, zip((none, none, none, np.zeros((0, 2))), *parts, strict=True)))


def board_poses(camera: Camera, sighting: BoardDetection, points: Array) -> list[tuple[Array, float]]:
    """Compute the two poses of a board that explain its picture (Collins and Bartoli 2014, infinitesimal plane-based
    pose).

    sighting: the detected board.
    points: (N, 3) corners of the board, m.
    Returns: camera_from_board (4, 4) and rms error, px, of each pose, the better one first.
    """
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


# ---- joint refinement ----------------------------------------------------------------------------------------------


_ROUNDS = 8


@dataclass(frozen=True)
class RigCalibration:
    """The result of `calibrate_rig`.

    rig: cameras in the frame of the first camera; `place_on_floor` changes it.
    boards: world_from_board (4, 4) by frame.
    sightings: the used detections by camera index and frame, numbered alike in all cameras.
    errors: rms per coordinate by (camera, frame), px.
    rms_px: rms over all, px.
    camera_rms: (C,) rms of each camera, px.
    focal_sd: (C,) standard deviation of the focal length, px.
    position_sd: (C,) standard deviation of the position, m.
    dropped: (camera, frame) of detections that do not fit and were left out.
    notes: sentences for the user.
    """

    rig: CameraRig
    boards: Mapping[int, Array]
    sightings: Mapping[int, Mapping[int, BoardDetection]]
    errors: Mapping[tuple[int, int], float]
    rms_px: float
    camera_rms: Array
    focal_sd: Array
    position_sd: Array
    dropped: tuple[tuple[int, int], ...]
    notes: tuple[str, ...] = ()


def refine_boards(
    cameras: Sequence[Camera],
    seen: Mapping[int, Mapping[int, BoardDetection]],
    boards: Mapping[int, Array],
    board: Board,
    free_lenses: Sequence[bool],
    notes: tuple[str, ...] = (),
) -> RigCalibration:
    """Refine cameras, lenses and boards jointly; boards that contradict the others are left out in between.

    cameras: start cameras in one world.
    seen: detected boards by camera index and frame, numbered alike; frames below 0 are for one camera's lens only.
    boards: world_from_board (4, 4) by frame, of the frames that are used.
    free_lenses: (C,) lenses that are refined.
    notes: sentences so far.
    """
    frames, named = list(boards), seen
    behind = {
        (c, f)
        for c, camera in enumerate(cameras)
        for f, pose in boards.items()
        if (transform(camera.camera_from_world @ pose, board.points)[:, 2] <= 0.01).any()
    }
    seen = {c: {f: s for f, s in v.items() if f in boards and (c, f) not in behind} for c, v in seen.items()}
    poses = [board_poses(cameras[c], s, board.points)[0] for c, v in seen.items() for f, s in v.items() if f >= 0]
    alone = float(np.median([error for _, error in poses]))
    dropped: list[tuple[int, int]] = []
    moving: dict[tuple[int, int], float] = {}
    attempt = -1
    while True:
        attempt += 1
        obs = collect_observations(seen, frames)
        place = zip(obs.camera.tolist(), obs.group.tolist(), strict=True)
        noise = np.hypot(NOISE_PX, np.array([moving.get((c, frames[f]), 0.0) for c, f in place]))
        start = np.stack([boards[f] for f in frames])
        result = bundle_adjust(
            cameras,
            start,
            board.points,
            obs,
            free_intrinsics=np.array(free_lenses),
            noise_px=noise,
            robust_px=2.0 if attempt else 5.0,
        )
        cameras, boards = result.cameras, dict(zip(frames, result.frames, strict=True))
        error, _ = _by_view(obs, result.residuals * (NOISE_PX / noise)[:, None], len(cameras), len(frames))
        usual = float(np.nanmedian(error))
        # the worst first: what they bend must not count against the others
        bad = np.nan_to_num(error) > max(4 * usual, 0.8, float(np.nanmax(error)) / 3)
        gone = [(int(c), frames[f]) for c, f in np.argwhere(bad)]
        rest = {c: {f: s for f, s in v.items() if (c, f) not in gone} for c, v in seen.items()}
        if attempt == _ROUNDS - 1:
            break
        if gone and all(rest.values()):
            seen, dropped = rest, dropped + gone
        elif attempt and (moving or not gone):
            break
        # each camera by itself fits its boards, together they do not: the instants differ
        if moving or usual > max(1.5 * alone, NOISE_PX):
            # pictures taken for the lens (below 0) have no common time
            filmed = {c: {f: s for f, s in v.items() if f >= 0} for c, v in seen.items()}
            moving = motion_noise(cameras, {f: p for f, p in boards.items() if f >= 0}, filmed, board)
    error, count = _by_view(obs, result.residuals, len(cameras), len(frames))
    errors = {(int(c), frames[k]): float(error[c, k]) for c, k in np.argwhere(count > 0) if frames[k] >= 0}
    if moving:
        notes = (
            *notes,
            f"Each camera by itself fits its boards to {alone:.2f} px, all together to {result.rms_px:.2f} px: the "
            "pictures were not taken at quite the same instant, so boards that move count less; hold the board still "
            "for a moment in many places, and see hypose sync.",
        )
    return RigCalibration(
        CameraRig(tuple(cameras)),
        {f: boards[f] for f in frames if any(k == f for _, k in errors)},
        {c: {f: s for f, s in v.items() if (c, f) in errors} for c, v in named.items()},
        errors,
        result.rms_px,
        np.sqrt(np.nansum(error**2 * count, 1) / np.maximum(count.sum(1), 1)),
        result.focal_sd,
        result.position_sd,
        tuple(d for d in dropped if d[1] >= 0),
        notes,
    )


def _by_view(obs: Observations, residuals: Array, c: int, f: int) -> tuple[Array, IntArray]:
    """Summarise residuals by camera and frame.

    obs: M observations.
    residuals: (M, 2) px.
    c, f: numbers of cameras and of frames.
    Returns: rms per coordinate (C, F), px, NaN where a camera saw no board; numbers of corners (C, F).
    """
    at = obs.camera * f + obs.group
    count = np.bincount(at, minlength=c * f).reshape(c, f).astype(np.int64)
    total = np.bincount(at, (residuals**2).sum(1), c * f).reshape(c, f)
    with np.errstate(invalid="ignore"):
        return np.where(count > 0, np.sqrt(total / (2 * np.maximum(count, 1))), np.nan), count


# ---- board timing --------------------------------------------------------------------------------------------------
# Pictures that were not taken at exactly the same instant: the uncertainty of a moving board's corners.
#
# Webcams and phones without a trigger expose within a part of a frame of each other, differently in every frame, so
# a corner is uncertain by the distance it moves in that time. Boards held still then decide, as they should.
#
# Tried and dropped: leaving the fastest boards out (fewer boards, 1.7 instead of 0.4 degrees from an independent
# calibration of four webcams). A time offset per picture as a further unknown: it explains the misfit (0.85 to 0.35 px
# there) but the boards that were held still fit worse afterwards, so it explains away what the poses should explain.


OFFSET_SD = 0.1
"""Standard deviation of a picture's instant, frames."""
_REACH = 2  # frames: a neighbour farther away gives no velocity


def motion_noise(
    cameras: Sequence[Camera],
    boards: Mapping[int, Array],
    sightings: Mapping[int, Mapping[int, BoardDetection]],
    board: Board,
) -> dict[tuple[int, int], float]:
    """Estimate the uncertainty of corners because a board moves while cameras expose at slightly different instants.

    boards: world_from_board (4, 4) by frame, as fitted so far.
    sightings: detected boards by camera index and frame.
    Returns: standard deviation by (camera, frame), px. Boards without a neighbour in time get the median of the others.
    """
    out: dict[tuple[int, int], float] = {}
    unknown = []
    for f in sorted({f for seen in sightings.values() for f in seen}):
        who = [c for c, seen in sightings.items() if f in seen]
        near = [g for g in (*range(f - _REACH, f), *range(f + 1, f + _REACH + 1)) if g in boards]
        before, after = max((g for g in near if g < f), default=f), min((g for g in near if g > f), default=f)
        if f not in boards or before == after:
            unknown += [(c, f) for c in who]
            continue
        low, high = transform(boards[before], board.points), transform(boards[after], board.points)
        for c in who:
            moved = (cameras[c].project(high) - cameras[c].project(low)) / (after - before)
            speed = float(np.sqrt(np.nanmean(moved**2))) if np.isfinite(moved).any() else 0.0
            out[c, f] = OFFSET_SD * speed
    return out | dict.fromkeys(unknown, (float(np.median(list(out.values()))) if out else 0.0))

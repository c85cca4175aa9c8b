"""Calibration of a rig from boards: relative poses of pairs of cameras, joined along the best tree, then refined
jointly.

Relative poses come from boards that two cameras saw at the same time. The joint refinement includes lenses and board
poses. A chessboard that looks the same when rotated by 180 degrees may be numbered oppositely in two cameras. Once the
board moves, the relative pose that explains all common frames shows the right numbering; for a still board the floor
around it does (`from_boards.floor_likelihood`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hypose.calibration.boards import Board, BoardDetection, IntArray
from hypose.calibration.bundle import (
    NOISE_PX,
    CalibratedLens,
    Observations,
    Refined,
    board_poses,
    bundle_adjust,
    collect_observations,
    spread_out,
)
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, se3_inverse, so3_log, transform

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
    usual = float(np.median(list(out.values()))) if out else 0.0
    return out | dict.fromkeys(unknown, usual)


PoseComparison = Callable[[int, int, Array, Array], float]
"""Function of camera c, camera d, d_from_c and another d_from_c that gives how many times more likely the first pose
is."""

_MAX_FRAMES = 120
_ROUNDS = 8
_APART = np.deg2rad(8.0)  # relative poses that differ by more are different answers
_CAP = 0.02  # of the picture's width: errors of a frame count up to this when relative poses are compared
_DECIDED = 1.3
_AGREE = 0.3  # share of the common boards that must agree with a relative pose


@dataclass(frozen=True)
class Link:
    """The relative pose of two cameras c and d.

    d_from_c: (4, 4).
    shared: number of frames with a common board.
    agreeing: number of these that agree with the pose.
    error: median over the frames, px.
    other: a different pose that explains the boards as well; None where there is none.
    """

    c: int
    d: int
    d_from_c: Array
    shared: int
    agreeing: int
    error: float
    other: Array | None = None


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


def calibrate_rig(
    lenses: Sequence[CalibratedLens],
    sightings: Sequence[Mapping[int, BoardDetection]],
    board: Board,
    choose: PoseComparison | None = None,
    lens_sightings: Sequence[Mapping[int, BoardDetection]] | None = None,
) -> RigCalibration:
    """Calibrate the poses of all cameras from boards seen at the same time.

    lenses: lens of each camera.
    sightings: detected boards per camera, by frame of the common time.
    choose: chooses between two relative poses of a symmetric board that did not move.
    lens_sightings: further boards, each for its own camera's lens only.
    Raises: CalibrationError where cameras have no common board with the others; it names them.
    """
    cameras = [n.camera for n in lenses]
    poses = [
        {f: board_poses(c, s, board.points) for f, s in seen.items()}
        for c, seen in zip(cameras, sightings, strict=True)
    ]
    links, notes = [], []
    for c, d in combinations(range(len(cameras)), 2):
        link = _link(c, d, cameras, sightings, poses, board)
        if link is not None:
            links.append(link)
    tree = _tree(links, cameras, sightings, choose, notes)
    placed = _placed(tree, cameras)
    named, boards = _numbered(placed, sightings, poses, board)
    frames = _choose_frames(named, boards, cameras)
    extra: dict[int, dict[int, BoardDetection]] = {}
    number = -1
    for c, seen in enumerate(lens_sightings or ()):
        for f in () if lenses[c].given else spread_out(seen, cameras[c].size, 30):
            extra.setdefault(c, {})[number] = seen[f]
            number -= 1
    return _refined(placed, named, boards, frames, extra, lenses, board, tuple(notes))


# ---- relative poses ------------------------------------------------------------------------------------------------


def _link(
    c: int,
    d: int,
    cameras: Sequence[Camera],
    sightings: Sequence[Mapping[int, BoardDetection]],
    poses: Sequence[Mapping[int, list[tuple[Array, float]]]],
    board: Board,
) -> Link | None:
    """Find the relative pose of two cameras with which most common frames agree, and the next best different one.

    c, d: indices of the cameras.
    sightings: detected boards per camera, by frame.
    poses: the two poses (4, 4) with their errors, px, of each board, per camera, by frame.
    Returns: the link; None where no frame has a usable board in both.
    """
    shared = [f for f in sightings[c] if f in sightings[d]]
    shared = [f for f in shared if poses[c][f][0][1] < 5 and poses[d][f][0][1] < 5]
    if not shared:
        return None
    shared = spread_out({f: sightings[c][f] for f in shared}, cameras[c].size, 30)
    turns = [_turn_motion(board, t) for t in board.turns]
    candidates = []
    for f in shared:
        for pc, ec in poses[c][f]:
            for pd, ed in poses[d][f]:
                # the second pose of a plane counts only where it fits nearly as well
                if ec < 3 * poses[c][f][0][1] + 0.2 and ed < 3 * poses[d][f][0][1] + 0.2:
                    candidates += [pd @ turn @ se3_inverse(pc) for turn in turns]
    cap = _CAP * cameras[d].size[0]
    errors = np.stack([_disagreement(h, c, d, cameras, shared, sightings, poses, board) for h in candidates])
    score = np.minimum(errors, cap).mean(1)
    order = np.argsort(score)
    best = candidates[order[0]]
    agreeing = int((errors[order[0]] < cap).sum())
    other = None
    for k in order[1:] if agreeing >= _AGREE * len(shared) else ():
        if np.linalg.norm(so3_log(candidates[k][:3, :3] @ best[:3, :3].T)) > _APART:
            if score[k] < 2 * score[order[0]] + 0.25:
                other = candidates[k]
            break
    return Link(c, d, best, len(shared), agreeing, float(np.median(errors[order[0]])), other)


def _turn_motion(board: Board, turn: np.ndarray) -> Array:
    """Compute the rigid motion of the board's frame that renumbers its corners: point turn[i] = motion(point i)."""
    a, b = board.points, board.points[turn]
    out = np.eye(4)
    step = a[1] - a[0]
    moved = b[1] - b[0]
    angle = np.arctan2(moved[1], moved[0]) - np.arctan2(step[1], step[0])
    out[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    out[:3, 3] = b[0] - out[:3, :3] @ a[0]
    return out


def _disagreement(
    d_from_c: Array,
    c: int,
    d: int,
    cameras: Sequence[Camera],
    shared: Sequence[int],
    sightings: Sequence[Mapping[int, BoardDetection]],
    poses: Sequence[Mapping[int, list[tuple[Array, float]]]],
    board: Board,
) -> Array:
    """Compute the error in camera d of the boards seen by camera c, for the best of their poses and numberings.

    d_from_c: (4, 4) relative pose.
    c, d: indices of the cameras.
    shared: F frames with a board in both.
    sightings: detected boards per camera, by frame.
    poses: the two poses (4, 4) with their errors, px, of each board, per camera, by frame.
    Returns: (F,) rms, px; infinite where a board would lie behind the camera.
    """
    out = np.empty(len(shared))
    for k, f in enumerate(shared):
        s = sightings[d][f]
        best = np.inf
        for pose, error in poses[c][f]:
            if error > 3 * poses[c][f][0][1] + 0.2:
                continue
            uv = replace(cameras[d], camera_from_world=d_from_c @ pose).project(board.points)
            for turn in board.turns:
                e = uv[turn[s.ids]] - s.pixels
                best = min(best, float(np.sqrt(np.mean(e**2))) if np.isfinite(e).all() else np.inf)
        out[k] = best
    return out


def _tree(
    links: Sequence[Link],
    cameras: Sequence[Camera],
    sightings: Sequence[Mapping[int, BoardDetection]],
    choose: PoseComparison | None,
    notes: list[str],
) -> list[Link]:
    """Choose links that join all cameras: unambiguous ones first, and those on which most frames agree first.

    links: relative poses of pairs of cameras.
    sightings: detected boards per camera, by frame, for the message.
    choose: compares two relative poses by the pictures; None where that is not possible.
    notes: list to which sentences on decisions are added.
    Raises: CalibrationError where cameras cannot be joined, or an ambiguity cannot be decided.
    """
    names = [c.name for c in cameras]
    group = list(range(len(cameras)))
    out: list[Link] = []

    def join(link: Link) -> None:
        old, new = group[link.d], group[link.c]
        group[:] = [new if g == old else g for g in group]
        out.append(link)

    sure = [k for k in links if k.other is None and k.agreeing >= max(1, _AGREE * k.shared)]
    for link in sorted(sure, key=lambda k: (-min(k.agreeing, 10), k.error)):
        if group[link.c] != group[link.d]:
            join(link)
    # the others: decided by the floor around the board, the clearest first
    unsure = [k for k in links if k.other is not None]
    weighed = []
    for link in unsure:
        if group[link.c] == group[link.d]:
            continue
        assert link.other is not None
        ratio = 1.0 if choose is None else choose(link.c, link.d, link.d_from_c, link.other)
        if ratio < 1:
            link = replace(link, d_from_c=link.other, other=link.d_from_c)
            ratio = 1 / max(ratio, 1e-9)
        weighed.append((ratio, link))
    for ratio, link in sorted(weighed, key=lambda w: -w[0]):
        if group[link.c] == group[link.d]:
            continue
        if ratio < _DECIDED:
            raise CalibrationError(
                "The board looks the same turned by 180 degrees and did not move, so it is open which way round camera "
                f"{names[link.d]} sees it compared with {names[link.c]}, and the floor around it does not show it; "
                "move the board to a second place, use a board with one even and one odd number of corners, or a "
                "ChArUco board."
            )
        notes.append(
            f"Which way round {names[link.d]} sees the board, which looks the same turned by 180 degrees, was decided "
            f"by the floor around it ({ratio:.1f} times better than the other way); look at the contact sheet."
        )
        join(link)
    if len(set(group)) > 1:
        parts = [[i for i in range(len(names)) if group[i] == g] for g in dict.fromkeys(group)]
        said = " | ".join(", ".join(f"{names[i]} ({_span(sightings[i])})" for i in part) for part in parts)
        disagreeing = [k for k in links if group[k.c] != group[k.d]]
        why = "they saw no board at the same time"
        if disagreeing:
            k = max(disagreeing, key=lambda k: k.shared)
            why = (
                f"{names[k.c]} and {names[k.d]} saw the board together in {k.shared} pictures but these contradict "
                "each other: the videos are probably not synchronous (give --lag CAMERA=FRAMES, or hypose sync), or "
                "the board is printed on both sides (cover the back)"
            )
        raise CalibrationError(
            f"The cameras cannot be joined: {said}; {why}. Film the board where cameras of both parts see it."
        )
    return out


def _span(seen: Mapping[int, BoardDetection]) -> str:
    return f"{len(seen)} boards, frames {min(seen)} to {max(seen)}" if seen else "no board"


def _placed(tree: Sequence[Link], cameras: Sequence[Camera]) -> list[Camera]:
    """Set the cameras' poses in the first camera's frame, along the tree of links."""
    poses: dict[int, Array] = {0: np.eye(4)}
    while len(poses) < len(cameras):
        before = len(poses)
        for k in tree:
            if k.c in poses and k.d not in poses:
                poses[k.d] = k.d_from_c @ poses[k.c]
            elif k.d in poses and k.c not in poses:
                poses[k.c] = se3_inverse(k.d_from_c) @ poses[k.d]
        assert len(poses) > before
    return [replace(c, camera_from_world=poses[i]) for i, c in enumerate(cameras)]


_Sightings = dict[int, dict[int, BoardDetection]]
"""Detections by camera and frame."""


def _numbered(
    cameras: Sequence[Camera],
    sightings: Sequence[Mapping[int, BoardDetection]],
    poses: Sequence[Mapping[int, list[tuple[Array, float]]]],
    board: Board,
) -> tuple[_Sightings, dict[int, Array]]:
    """Choose per frame the board pose of one camera with which the others agree best, and each camera's numbering for
    it.

    cameras: cameras in one world.
    sightings: detected boards per camera, by frame.
    poses: the two poses (4, 4) with their errors, px, of each board, per camera, by frame.
    Returns: the detections, numbered alike, and world_from_board (4, 4) by frame.
    """
    boards: dict[int, Array] = {}
    out: _Sightings = {c: {} for c in range(len(cameras))}
    for f in sorted({f for seen in sightings for f in seen}):
        who = [c for c in range(len(cameras)) if f in sightings[c]]
        best: tuple[float, Array, list[int]] | None = None
        for c in who:
            for pose, error in poses[c][f]:
                if not np.isfinite(error):
                    continue
                world = se3_inverse(cameras[c].camera_from_world) @ pose
                points = transform(world, board.points)
                total, chosen = 0.0, []
                for d in who:
                    s = sightings[d][f]
                    uv = cameras[d].project(points)
                    e = [float(np.nan_to_num(np.mean((uv[t[s.ids]] - s.pixels) ** 2), nan=1e6)) for t in board.turns]
                    chosen.append(int(np.argmin(e)))
                    total += min(min(e), (_CAP * cameras[d].size[0]) ** 2)
                if best is None or total < best[0]:
                    best = (total, world, chosen)
        if best is None:
            continue
        boards[f] = best[1]
        for d, t in zip(who, best[2], strict=True):
            out[d][f] = sightings[d][f].turned(board.turns[t])
    return out, boards


def _choose_frames(seen: _Sightings, boards: Mapping[int, Array], cameras: Sequence[Camera]) -> list[int]:
    """Choose frames for the joint refinement: for each pair of cameras those that differ most, then others for the
    lenses.

    seen: detected boards by camera index and frame.
    boards: world_from_board (4, 4) by frame.
    Returns: at most _MAX_FRAMES frame numbers, increasing.
    """
    if len(boards) <= _MAX_FRAMES:
        return sorted(boards)
    pairs = [(c, d) for c, d in combinations(range(len(cameras)), 2) if set(seen[c]) & set(seen[d])]
    picked: set[int] = set()
    for c, d in pairs:
        both = {f: s for f, s in seen[c].items() if f in seen[d]}
        picked |= set(spread_out(both, cameras[c].size, max(4, _MAX_FRAMES // (2 * len(pairs)))))
    for c, camera in enumerate(cameras):
        left = {f: s for f, s in seen[c].items() if f not in picked}
        picked |= set(spread_out(left, camera.size, max(2, (_MAX_FRAMES - len(picked)) // (len(cameras) - c))))
    return sorted(picked)


# ---- joint refinement ----------------------------------------------------------------------------------------------


def _refined(
    cameras: Sequence[Camera],
    named: _Sightings,
    boards: dict[int, Array],
    frames: Sequence[int],
    extra: Mapping[int, Mapping[int, BoardDetection]],
    lenses: Sequence[CalibratedLens],
    board: Board,
    notes: tuple[str, ...],
) -> RigCalibration:
    """Refine cameras, lenses and boards jointly; boards that contradict the others are left out in between.

    cameras: start cameras in one world.
    named: detected boards by camera index and frame, numbered alike.
    boards: world_from_board (4, 4) by frame; poses of `extra` are added.
    frames: frames that are used.
    extra: boards for one camera's lens only, by camera index and negative frame number.
    lenses: lens of each camera; given ones stay.
    notes: sentences so far.
    """
    all_frames = [*frames, *(f for seen in extra.values() for f in seen)]
    for c, seen in extra.items():
        for f, s in seen.items():
            boards[f] = se3_inverse(cameras[c].camera_from_world) @ board_poses(cameras[c], s, board.points)[0][0]
    seen = {c: {**named[c], **extra.get(c, {})} for c in range(len(cameras))}
    seen = {
        c: {f: s for f, s in v.items() if f in boards and _in_front(cameras[c], boards[f], board)}
        for c, v in seen.items()
    }
    alone = [board_poses(cameras[c], s, board.points)[0][1] for c in seen for f, s in seen[c].items() if f in frames]
    free = np.array([not n.given for n in lenses])
    dropped: list[tuple[int, int]] = []
    moving: dict[tuple[int, int], float] = {}
    result: Refined | None = None
    obs = collect_observations(seen, all_frames)
    start_shape = (len(cameras), len(all_frames))
    for attempt in range(_ROUNDS):
        start = np.stack([boards[f] for f in all_frames])
        motion = np.array(
            [moving.get((int(c), all_frames[f]), 0.0) for c, f in zip(obs.camera, obs.frame, strict=True)]
        )
        result = bundle_adjust(
            cameras,
            start,
            board.points,
            obs,
            free_intrinsics=free,
            noise_px=np.hypot(NOISE_PX, motion),
            robust_px=2.0 if attempt else 5.0,
        )
        cameras = result.cameras
        boards = dict(zip(all_frames, result.frames, strict=True))
        if attempt == _ROUNDS - 1:
            break
        error, _ = _by_view(obs, result.residuals / (np.hypot(NOISE_PX, motion) / NOISE_PX)[:, None], *start_shape)
        limit = max(4 * float(np.nanmedian(error)), 0.8)
        bad = np.nan_to_num(error) > limit
        # the worst first: what they bend must not count against the others
        bad &= np.nan_to_num(error) >= np.nanmax(error) / 3
        gone = [(int(c), all_frames[f]) for c, f in np.argwhere(bad)]
        rest = {c: {f: s for f, s in v.items() if (c, f) not in gone} for c, v in seen.items()}
        if gone and all(rest.values()):
            seen, dropped = rest, dropped + gone
            obs = collect_observations(seen, all_frames)
        elif attempt and (moving or not gone):
            break
        # each camera by itself fits its boards, together they do not: the instants differ
        if moving or float(np.nanmedian(error)) > max(1.5 * float(np.median(alone)), NOISE_PX):
            # pictures taken for the lens (below 0) have no common time
            together = {f: p for f, p in boards.items() if f >= 0}
            filmed = {c: {f: s for f, s in v.items() if f >= 0} for c, v in seen.items()}
            moving = motion_noise(cameras, together, filmed, board)
    assert result is not None
    error, count = _by_view(obs, result.residuals, *start_shape)
    per_camera = np.sqrt(np.nansum(error**2 * count, 1) / np.maximum(count.sum(1), 1))
    errors = {
        (c, f): float(error[c, k])
        for k, f in enumerate(all_frames)
        if f >= 0
        for c in range(len(cameras))
        if count[c, k]
    }
    used = {c: {f: s for f, s in named[c].items() if (c, f) in errors} for c in range(len(cameras))}
    if moving:
        notes = (
            *notes,
            f"Each camera by itself fits its boards to {np.median(alone):.2f} px, all together to "
            f"{result.rms_px:.2f} px: the pictures were not taken at quite the same instant, so boards that move count "
            "less; hold the board still for a moment in many places, and see hypose sync.",
        )
    return RigCalibration(
        CameraRig(tuple(result.cameras)),
        {f: result.frames[k] for k, f in enumerate(all_frames) if f >= 0 and count[:, k].any()},
        used,
        errors,
        result.rms_px,
        per_camera,
        result.focal_sd,
        result.position_sd,
        tuple(d for d in dropped if d[1] >= 0),
        notes,
    )


def _in_front(camera: Camera, world_from_board: Array, board: Board) -> bool:
    """Test whether the whole board lies in front of the camera."""
    return bool((transform(camera.camera_from_world @ world_from_board, board.points)[:, 2] > 0.01).all())


def _by_view(obs: Observations, residuals: Array, c: int, f: int) -> tuple[Array, IntArray]:
    """Summarise residuals by camera and frame.

    obs: M observations.
    residuals: (M, 2) px.
    c, f: numbers of cameras and of frames.
    Returns: rms per coordinate (C, F), px, NaN where a camera saw no board; numbers of corners (C, F).
    """
    at = obs.camera * f + obs.frame
    count = np.bincount(at, minlength=c * f).reshape(c, f).astype(np.int64)
    total = np.bincount(at, (residuals**2).sum(1), c * f).reshape(c, f)
    with np.errstate(invalid="ignore"):
        return np.where(count > 0, np.sqrt(total / (2 * np.maximum(count, 1))), np.nan), count

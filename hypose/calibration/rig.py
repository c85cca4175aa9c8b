"""Calibration of a rig from boards: relative poses of pairs of cameras, joined along the best tree, then refined
jointly.

Relative poses come from boards that two cameras saw at the same time. The joint refinement includes lenses and board
poses. A chessboard that looks the same when rotated by 180 degrees may be numbered oppositely in two cameras. Once the
board moves, the relative pose that explains all common frames shows the right numbering; for a still board the floor
around it does (`from_boards.floor_likelihood`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hypose.calibration.board_fit import CalibratedLens, RigCalibration, board_poses, refine_boards, spread_out
from hypose.calibration.boards import Board, BoardDetection
from hypose.cameras.camera import Camera
from hypose.errors import CalibrationError
from hypose.geometry import Array, procrustes, se3_inverse, so3_log, transform

PoseComparison = Callable[[int, int, Array, Array], float]
"""Function of camera c, camera d, d_from_c and another d_from_c that gives how many times more likely the first pose
is."""

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
    pairs, notes = combinations(range(len(cameras)), 2), list[str]()
    links = [link for c, d in pairs if (link := _link(c, d, cameras, sightings, poses, board)) is not None]
    placed = _placed(_tree(links, cameras, sightings, choose, notes), cameras)
    named, boards = _numbered(placed, sightings, poses, board)
    free = [not n.given for n in lenses]
    for c, seen in enumerate(lens_sightings or ()):
        for f in spread_out(seen, cameras[c].size, 30) if free[c] else ():
            number = min(-1, *boards) - 1
            pose = board_poses(placed[c], seen[f], board.points)[0][0]
            named[c][number], boards[number] = seen[f], se3_inverse(placed[c].camera_from_world) @ pose
    return refine_boards(placed, named, boards, board, free, tuple(notes))


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
    turns = [procrustes(board.points, board.points[t])[0] for t in board.turns]
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
    out = np.full(len(shared), np.inf)
    for k, f in enumerate(shared):
        for pose in (pose for pose, error in poses[c][f] if error <= 3 * poses[c][f][0][1] + 0.2):
            camera = replace(cameras[d], camera_from_world=d_from_c @ pose)
            out[k] = min(out[k], _misfits(camera, board.points, sightings[d][f], board).min())
    return out


def _misfits(camera: Camera, corners: Array, sighting: BoardDetection, board: Board) -> Array:
    """Compute the error of a detection for each numbering of the board, rms, px; infinite behind the camera.

    corners: (N, 3) m, of the board in the world.
    """
    uv = camera.project(corners)
    rms = [np.sqrt(np.mean((uv[turn[sighting.ids]] - sighting.pixels) ** 2)) for turn in board.turns]
    return np.nan_to_num(rms, nan=np.inf)


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

    def join(links: Iterable[tuple[float, Link]]) -> None:
        """Add the links that join two groups; each comes with how many times better it is than another pose."""
        for ratio, link in links:
            if group[link.c] == group[link.d]:
                continue
            if ratio < _DECIDED:
                raise CalibrationError(
                    "The board looks the same turned by 180 degrees and did not move, so it is open which way round "
                    f"camera {names[link.d]} sees it compared with {names[link.c]}, and the floor around it does not "
                    "show it; move the board to a second place, use a board with one even and one odd number of "
                    "corners, or a ChArUco board."
                )
            if link.other is not None:
                notes.append(
                    f"Which way round {names[link.d]} sees the board, which looks the same turned by 180 degrees, was "
                    f"decided by the floor around it ({ratio:.1f} times better than the other way); look at the "
                    "contact sheet."
                )
            group[:] = [group[link.c] if g == group[link.d] else g for g in group]
            out.append(link)

    sure = [k for k in links if k.other is None and k.agreeing >= max(1, _AGREE * k.shared)]
    join((np.inf, link) for link in sorted(sure, key=lambda k: (-min(k.agreeing, 10), k.error)))
    # the others: decided by the floor around the board, the clearest first
    weighed = []
    for link in links:
        if link.other is not None and group[link.c] != group[link.d]:
            ratio = 1.0 if choose is None else choose(link.c, link.d, link.d_from_c, link.other)
            turned = replace(link, d_from_c=link.other, other=link.d_from_c)
            weighed.append((ratio, link) if ratio >= 1 else (1 / max(ratio, 1e-9), turned))
    join(sorted(weighed, key=lambda w: -w[0]))
    if len(set(group)) > 1:
        parts = [[i for i in range(len(names)) if group[i] == g] for g in dict.fromkeys(group)]
        seen = [f"{len(s)} boards, frames {min(s)} to {max(s)}" if s else "no board" for s in sightings]
        said = " | ".join(", ".join(f"{names[i]} ({seen[i]})" for i in part) for part in parts)
        why = "they saw no board at the same time"
        for k in sorted([k for k in links if group[k.c] != group[k.d]], key=lambda k: -k.shared)[:1]:
            why = (
                f"{names[k.c]} and {names[k.d]} saw the board together in {k.shared} pictures but these contradict "
                "each other: the videos are probably not synchronous (give --lag CAMERA=FRAMES, or hypose sync), or "
                "the board is printed on both sides (cover the back)"
            )
        raise CalibrationError(
            f"The cameras cannot be joined: {said}; {why}. Film the board where cameras of both parts see it."
        )
    return out


def _placed(tree: Sequence[Link], cameras: Sequence[Camera]) -> list[Camera]:
    """Set the cameras' poses in the first camera's frame, along the tree of links."""
    poses: dict[int, Array] = {0: np.eye(4)}
    for _ in tree:
        for k in tree:
            if k.c in poses and k.d not in poses:
                poses[k.d] = k.d_from_c @ poses[k.c]
            elif k.d in poses and k.c not in poses:
                poses[k.c] = se3_inverse(k.d_from_c) @ poses[k.d]
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
    caps = np.array([_CAP * camera.size[0] for camera in cameras])
    for f in sorted({f for seen in sightings for f in seen}):
        who = [c for c in range(len(cameras)) if f in sightings[c]]
        found = []
        for c, pose in ((k, pose) for k in who for pose, error in poses[k][f] if np.isfinite(error)):
            world = se3_inverse(cameras[c].camera_from_world) @ pose
            corners = transform(world, board.points)
            errors = np.stack([_misfits(cameras[d], corners, sightings[d][f], board) for d in who])
            total = (np.minimum(errors.min(1), caps[who]) ** 2).sum()
            found.append((total, world, np.argmin(errors, axis=1)))
        if found:
            _, boards[f], turns = min(found, key=lambda f: f[0])
            for d, t in zip(who, turns, strict=True):
                out[d][f] = sightings[d][f].turned(board.turns[t])
    return out, boards

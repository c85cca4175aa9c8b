"""The world of a calibrated rig: z up, the floor at z = 0, from a board that lay on the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hypose.calibration.boards import Board
from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, rotation_between, se3, se3_inverse, so3_log, transform

_FLAT = np.deg2rad(30.0)  # a board tilted by more against the cameras' common up does not lie on the floor
_STILL_M, _STILL_RAD = 0.01, np.deg2rad(1.0)
_STILL_FRAMES = 3


def floor_frame(
    rig: CameraRig, boards: Mapping[int, Array], board: Board, wanted: int | None, still: bool
) -> tuple[int | None, str]:
    """The frame in which the board lies on the floor, None if there is none, and a sentence about it.

    wanted: the user's choice, the nearest frame with a board is taken; still: the board never moved. Otherwise the
    first frame of the longest time in which the board stays where it is, flat against the cameras' common up.
    """
    if not boards:
        return None, ""
    frames = sorted(boards)
    if wanted is not None:
        near = min(frames, key=lambda f: abs(f - wanted))
        if abs(near - wanted) > 50:
            raise CalibrationError(
                f"No board was found near frame {wanted} (the nearest is frame {near}); give --floor a frame in which "
                "the board lies on the floor and is seen."
            )
        return near, f"The floor is where the board lies in frame {near}."
    if still or len(frames) == 1:
        return frames[0], "The floor is where the board lies."
    up = _common_up(rig)
    middle = board.points.mean(0)
    best: list[int] = []
    run: list[int] = []
    for f in frames:
        flat = float(-boards[f][:3, 2] @ up) > np.cos(_FLAT)
        if run and flat:
            motion = se3_inverse(boards[run[0]]) @ boards[f]
            moved = np.linalg.norm(transform(boards[run[0]], middle[None]) - transform(boards[f], middle[None]))
            if moved > _STILL_M or np.linalg.norm(so3_log(motion[:3, :3])) > _STILL_RAD:
                run = []
        run = [*run, f] if flat else []
        if len(run) > len(best):
            best = list(run)
    if len(best) >= _STILL_FRAMES:
        return best[len(best) // 2], (
            f"The floor is where the board lies still in frames {best[0]} to {best[-1]}; if it lay on something else, "
            "give --floor FRAME."
        )
    return None, (
        "No frame shows the board lying still, so the floor is not known: up is the mean of the cameras' upward "
        "directions, and z = 0 is where the board was lowest; lay the board on the floor for a moment and give --floor "
        "FRAME."
    )


def place_on_floor(
    rig: CameraRig, boards: Mapping[int, Array], board: Board, frame: int | None
) -> tuple[CameraRig, dict[int, Array]]:
    """Rig and boards in a world with z up. With a floor frame the origin is the board's first corner and x its first
    row; otherwise the origin lies under the middle of all boards and x points as the first camera's right."""
    if frame is not None:
        world_from_old = np.diag([1.0, -1.0, -1.0, 1.0]) @ se3_inverse(boards[frame])
    else:
        up = _common_up(rig)
        turn = rotation_between(up, [0, 0, 1.0])
        right = turn @ rig[0].camera_from_world[0, :3]
        angle = -np.arctan2(right[1], right[0])
        spin = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        turn = spin @ turn
        corners = np.concatenate([transform(b, board.points) for b in boards.values()]) @ turn.T
        origin = np.array([*corners[:, :2].mean(0), corners[:, 2].min()])
        world_from_old = se3(turn, -origin)
    return move_world(rig, world_from_old), {f: world_from_old @ b for f, b in boards.items()}


def move_world(rig: CameraRig, new_from_old: Array) -> CameraRig:
    """The same rig described in another world (4, 4)."""
    back = se3_inverse(new_from_old)
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ back) for c in rig))


def _common_up(rig: CameraRig) -> Array:
    """(3,) mean of the cameras' upward directions, without the part along their views that tilting adds: the direction
    most perpendicular to all cameras' x axes, since cameras are tilted but seldom rolled."""
    right = np.stack([c.camera_from_world[0, :3] for c in rig])
    mean = -np.stack([c.camera_from_world[1, :3] for c in rig]).mean(0)
    _, s, vt = np.linalg.svd(right)
    up = vt[-1]
    if len(rig) < 2 or s[1] < 0.2 * s[0]:  # x axes all alike leave it open
        up = mean
    up = up / np.linalg.norm(up)
    return up if up @ mean >= 0 else -up

"""overlay.mp4 of a track with one camera: the picture with the body and all modes, and these seen from the side.

In the camera's own picture the modes nearly coincide; from the side it shows how far they are apart in depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import (
    Image,
    as_shown,
    bones,
    draw_body,
    draw_skeleton,
    layout,
    open_images,
    write_text,
)
from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.cameras.camera import Camera
from hypose.geometry import Array
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter

_BAR = 26
_REACH_M = 2.4
"""What the side view shows, m from edge to edge."""
_FAINT = 0.45
"""How visible the modes are beside the best one."""


def write_modes_overlay(
    path: str | Path,
    recording: Recording,
    motion: Motion,
    modes: Modes,
    body: Body,
    *,
    stills: Sequence[int] = (),
    video: bool = True,
    progress: ProgressCall = ignore,
) -> dict[int, Image]:
    """Draw the motion and its modes over the one camera's pictures; returns the pictures of the rows in `stills`. With
    video=False only those are drawn and no file is written."""
    assert motion.poses is not None
    view, camera = recording.views[0], recording.rig[0]
    rows = range(len(motion)) if video else sorted(set(stills))
    kept: dict[int, Image] = {}
    with ExitStack() as stack:
        (images,) = open_images(recording)
        stack.callback(images.close)
        size = layout([images.size]).tiles[0].size
        seen = as_shown(view, camera, size)
        whole = ((size[0] + size[1]) // 2 * 2, (size[1] + _BAR) // 2 * 2)
        writer = stack.enter_context(VideoWriter(path, motion.frame_rate, whole)) if video else None
        for done, i in enumerate(rows):
            progress("overlay", done, len(rows))
            picture = np.full((whole[1], whole[0], 3), 24, np.uint8)
            recorded = images.read(recording.frames[i])
            if recorded is not None:
                shown = np.asarray(cv2.resize(recorded, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
                draw_body(shown, seen, body.skin(motion.poses[i], body.fine), body.fine)
                faint = shown.copy()
                for k in range(int(modes.alive[i]) - 1, -1, -1):
                    draw_skeleton(faint, seen, body, modes.joints[i, k])
                shown = np.asarray(cv2.addWeighted(faint, _FAINT, shown, 1 - _FAINT, 0), dtype=np.uint8)
                draw_skeleton(shown, seen, body, motion.joints[i])
                picture[_BAR : _BAR + size[1], : size[0]] = shown[: whole[1] - _BAR]
            picture[_BAR : _BAR + size[1], size[0] : size[0] + size[1]] = side_view(
                camera, body, motion.joints[i], modes.joints[i, : modes.alive[i]], size[1]
            )
            write_text(picture, _title(recording, motion, modes, i), 8, 18)
            if motion.lost[i]:
                write_text(picture, "LOST", 8, _BAR + 22, (60, 60, 255))
            if writer is not None:
                writer.write(picture)
            if i in stills:
                kept[i] = picture
        progress("overlay", len(rows), len(rows))
    return kept


def _title(recording: Recording, motion: Motion, modes: Modes, row: int) -> str:
    alive, share = int(modes.alive[row]), float(modes.weights[row, 0])
    depth = 1e3 * float(np.nanmedian(modes.depth_sd[row]))
    return (
        f"frame {recording.frames[row]}   {motion.times[row]:.2f} s   {alive} modes, best {share:.0%}   "
        f"depth +-{depth:.0f} mm"
    )


def side_view(camera: Camera, body: Body, joints: Array, modes: Array, side: int) -> Image:
    """(side, side, 3): a pose's joints (J, 3) m and all modes' (K, J, 3) of a frame seen from the camera's right, the
    camera to the left, each as it stands relative to the pose's pelvis; the pose is drawn last and in full colour."""
    picture = np.full((side, side, 3), 245, np.uint8)
    drawn = [*modes[::-1], joints]
    for k, points in enumerate(drawn):
        uv, best = _from_the_side(camera, points - joints[0], side), k == len(drawn) - 1
        layer = picture if best else picture.copy()
        for a, b, colour in bones(body):
            if np.isfinite(uv[[a, b]]).all():
                first, last = (tuple(int(x) for x in p) for p in np.rint(uv[[a, b]]))
                cv2.line(layer, first, last, colour if colour != (235, 235, 235) else (90, 90, 90), 2, cv2.LINE_AA)
        if not best:
            picture = np.asarray(cv2.addWeighted(layer, _FAINT, picture, 1 - _FAINT, 0), dtype=np.uint8)
    write_text(picture, "from the side: camera <- -> away", 8, side - 10)
    metre = side / _REACH_M
    cv2.line(picture, (12, side - 34), (12 + round(0.5 * metre), side - 34), (60, 60, 60), 2)
    write_text(picture, "0.5 m", 14 + round(0.5 * metre), side - 29)
    return picture


def _from_the_side(camera: Camera, points: Array, side: int) -> Array:
    """(J, 2) px of points (J, 3) m relative to the middle: away from the camera to the right, world up upwards."""
    forward = camera.camera_from_world[2, :3] * [1.0, 1.0, 0.0]
    length = np.linalg.norm(forward)
    forward = forward / length if length > 1e-6 else camera.camera_from_world[1, :3]
    scale = side / _REACH_M
    return np.column_stack([side / 2 + scale * (points @ forward), side / 2 - scale * points[:, 2]])

"""overlay.mp4: what was filmed and what was found in one picture, frame by frame; and pictures of it for the report."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import (
    ALARM,
    Canvas,
    Drawing,
    Image,
    as_shown,
    bones,
    draw_body,
    draw_close_ups,
    draw_skeleton,
    jpeg,
    layout,
    open_images,
    write_text,
)
from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter
from hypose.pipeline.track_loop import FrameSource
from hypose.pipeline.tracked_people import OnePerson

_AHEAD = 2  # frames that are drawn and not yet written
_COLOURS = ((200, 190, 60), (70, 160, 240), (110, 200, 90), (220, 110, 200), (90, 210, 220), (230, 130, 80))
_BAR = 26
_REACH_M = 2.4  # what the side view shows, from edge to edge
_FAINT = 0.45  # how visible the modes are next to the best one
_SMALL = 480  # px, width of the small pictures


@dataclass(frozen=True)
class PictureRows:
    """The rows of which pictures are wanted. video: the film of all rows; stills: close-ups of some; small: the
    recorded pictures of some, for the report's viewer."""

    video: bool = True
    stills: Sequence[int] = ()
    small: Sequence[int] = ()


@dataclass(frozen=True)
class Shown:
    """Pictures by row. stills: close-ups; small: the recorded pictures of every view as JPEG, b"" where there is
    none."""

    stills: dict[int, Image]
    small: dict[int, list[bytes]]


Draw = Callable[[int, Sequence[Image | None], Canvas | None], Image]
"""(row, recorded pictures of all views, canvas) -> the picture of the film, or without a canvas the still, of a row"""


def _film(
    path: str | Path,
    recording: Recording,
    numbers: Sequence[int],
    rate: float,
    draw: Draw,
    wanted: PictureRows,
    progress: ProgressCall,
    size: tuple[int, int] | None = None,
) -> Shown:
    """Read the recorded pictures once, and draw what is wanted of them. numbers: of the frames, by row; size:
    (width, height) px of the film, by default that of the canvas."""
    rows = range(len(numbers)) if wanted.video else sorted({*wanted.stills, *wanted.small})
    shown = Shown({}, {})
    with ExitStack() as stack:
        images = [stack.enter_context(closing(one)) for one in open_images(recording)]
        plan = layout([v.size for v in images])
        video = VideoWriter(path, rate, size or plan.size) if wanted.video else None
        writer = stack.enter_context(video) if video is not None else None
        canvases = [Canvas(recording, plan) for _ in range(_AHEAD + 1)]
        writing = stack.enter_context(ThreadPoolExecutor(1))
        written: deque[Future[None]] = deque()
        for done, row in enumerate(rows):
            progress("overlay", done, len(rows))
            if len(written) > _AHEAD:
                written.popleft().result()
            canvas = canvases[done % len(canvases)]
            pictures = canvas.read(images, numbers[row])
            if row in wanted.small:
                shown.small[row] = [b"" if p is None else jpeg(p, _SMALL) for p in pictures]
            if row in wanted.stills:
                shown.stills[row] = draw(row, pictures, None)
            if writer is not None:  # the next frames are read and drawn while this one is written
                written.append(writing.submit(writer.write, draw(row, pictures, canvas)))
        for one in written:
            one.result()
        progress("overlay", len(rows), len(rows))
    return shown


def still_rows(motion: Motion, count: int = 4) -> list[int]:
    """Rows worth looking at: evenly spread, and the one that fits worst."""
    rows = set(np.linspace(0, len(motion) - 1, min(count, len(motion))).astype(int).tolist())
    if np.isfinite(motion.cost).any():
        rows.add(int(np.nanargmax(motion.cost)))
    return sorted(rows)


# ---- one person ------------------------------------------------------------------------------------------------------


def write_overlay(
    path: str | Path,
    recording: Recording,
    source: FrameSource,
    motion: Motion,
    body: Body | None,
    wanted: PictureRows,
    progress: ProgressCall = ignore,
) -> Shown:
    """Draw a motion over its recording. source: gives the silhouettes; row i of the motion belongs to frame i of the
    source, and to recording.frames[i]. An InputError when something is to be drawn and there are no poses."""
    numbers = recording.frames[: len(motion)]

    def draw(row: int, pictures: Sequence[Image | None], canvas: Canvas | None) -> Image:
        if motion.poses is None or body is None:
            raise InputError("The motion holds joint positions only, and the overlay needs poses; track again.")
        what = _drawing(source, motion, motion.poses[row], body, row, numbers[row])
        return draw_close_ups(pictures, recording, body, what) if canvas is None else canvas.draw(pictures, body, what)

    rate = motion.frame_rate if len(motion) > 1 else 25.0
    return _film(path, recording, numbers, rate, draw, wanted, progress)


def _drawing(source: FrameSource, motion: Motion, pose: Array, body: Body, row: int, number: int) -> Drawing:
    lost, extrapolated = bool(motion.lost[row]), bool(motion.extrapolated[row])
    iou = 1 - float(motion.cost[row])
    parts = [f"frame {number}", f"{motion.times[row]:.2f} s"]
    parts += [f"IoU {iou:.2f}"] if np.isfinite(iou) else []
    parts += ["LOST"] if lost else []
    parts += ["extrapolated (no evidence)"] if extrapolated else []
    finite = bool(np.isfinite(pose).all())
    return Drawing(
        vertices=body.skin(pose, body.fine) if finite else None,
        joints=motion.joints[row] if finite else None,
        silhouettes=source.frame(row).silhouettes,
        title="   ".join(parts),
        alarm=lost or extrapolated,
    )


# ---- several people --------------------------------------------------------------------------------------------------


def colour_of(number: int) -> tuple[int, int, int]:
    """BGR of a person by their number."""
    return _COLOURS[number % len(_COLOURS)]


def write_people_overlay(
    path: Path, recording: Recording, source: FrameSource, people: Sequence[OnePerson], progress: ProgressCall = ignore
) -> None:
    """Draw all people over their recording, each in a colour of their own."""
    motion = people[0].result.motion
    numbers = recording.frames[: len(motion)]

    def draw(row: int, pictures: Sequence[Image | None], canvas: Canvas | None) -> Image:
        assert canvas is not None  # stills are in each person's own report
        return canvas.draw(pictures, None, _drawing_of_people(source, people, row, numbers[row]))

    _film(path, recording, numbers, motion.frame_rate, draw, PictureRows(), progress)


def _drawing_of_people(source: FrameSource, people: Sequence[OnePerson], row: int, number: int) -> Drawing:
    others, parts, alarm = [], [f"frame {number}"], False
    for k, p in enumerate(people):
        m, body = p.result.motion, p.result.body
        if not p.present[row] or m.poses is None or not np.isfinite(m.poses[row]).all():
            parts.append(f"{p.name} is not there")
            continue
        lost = bool(m.lost[row] or m.extrapolated[row])
        alarm |= lost
        parts.append(f"{p.name} LOST" if lost else p.name)
        others.append((body, body.skin(m.poses[row], body.fine), ALARM if lost else colour_of(k)))
    silhouettes = source.frame(row).silhouettes
    return Drawing(None, None, silhouettes, "   ".join(parts), alarm, tuple(others))


# ---- one camera ------------------------------------------------------------------------------------------------------


def write_modes_overlay(
    path: str | Path,
    recording: Recording,
    motion: Motion,
    modes: Modes,
    body: Body,
    wanted: PictureRows,
    progress: ProgressCall = ignore,
) -> Shown:
    """Draw a motion and its modes over the pictures of the one camera, and next to these from the side: in the camera's
    own picture the modes nearly coincide, from the side it shows how far they are apart in depth."""
    view, camera, numbers = recording.views[0], recording.rig[0], recording.frames[: len(motion)]
    with closing(open_images(recording)[0]) as opened:
        size = layout([opened.size]).tiles[0].size
    seen = as_shown(view, camera, size)
    both = ((size[0] + size[1]) // 2 * 2, (size[1] + _BAR) // 2 * 2)

    def draw(row: int, pictures: Sequence[Image | None], canvas: Canvas | None) -> Image:
        assert motion.poses is not None
        picture, recorded = np.full((both[1], both[0], 3), 24, np.uint8), pictures[0]
        if recorded is not None:
            shown = np.asarray(cv2.resize(recorded, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            draw_body(shown, seen, body.skin(motion.poses[row], body.fine), body.fine)
            faint = shown.copy()
            for k in range(int(modes.alive[row]) - 1, -1, -1):
                draw_skeleton(faint, seen, body, modes.joints[row, k])
            shown = np.asarray(cv2.addWeighted(faint, _FAINT, shown, 1 - _FAINT, 0), dtype=np.uint8)
            draw_skeleton(shown, seen, body, motion.joints[row])
            picture[_BAR : _BAR + size[1], : size[0]] = shown[: both[1] - _BAR]
        picture[_BAR : _BAR + size[1], size[0] : size[0] + size[1]] = _side_view(
            camera, body, motion.joints[row], modes.joints[row, : modes.alive[row]], size[1]
        )
        alive, share = int(modes.alive[row]), float(modes.weights[row, 0])
        title = f"frame {numbers[row]}   {motion.times[row]:.2f} s   {alive} modes, best {share:.0%}   "
        write_text(picture, f"{title}depth +-{1e3 * float(np.nanmedian(modes.depth_sd[row])):.0f} mm", 8, 18)
        if motion.lost[row]:
            write_text(picture, "LOST", 8, _BAR + 22, (60, 60, 255))
        return picture

    return _film(path, recording, numbers, motion.frame_rate, draw, wanted, progress, both)


def _side_view(camera: Camera, body: Body, joints: Array, modes: Array, side: int) -> Image:
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

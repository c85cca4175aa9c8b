"""Draw results over the recorded pictures: overlay.mp4 frame by frame, and pictures for the report."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import (
    ALARM,
    Canvas,
    Drawing,
    draw_close_ups,
    jpeg,
    open_images,
)
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.geometry import Array, Image
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter
from hypose.pipeline.run import TrackResult
from hypose.pipeline.track_loop import FrameSource

_AHEAD = 2  # frames that are drawn and not yet written
_COLOURS = ((200, 190, 60), (70, 160, 240), (110, 200, 90), (220, 110, 200), (90, 210, 220), (230, 130, 80))
_SMALL = 480  # px, width of the small pictures


@dataclass(frozen=True)
class PictureRows:
    """Rows of a motion of which pictures are wanted.

    video: a video of all rows.
    stills: rows whose close-ups are wanted.
    small: rows whose recorded pictures are wanted, for the report's viewer.
    """

    video: bool = True
    stills: Sequence[int] = ()
    small: Sequence[int] = ()


@dataclass(frozen=True)
class OverlayRows:
    """Pictures by row of the motion.

    stills: close-ups.
    small: the recorded picture of every view as JPEG, b"" where there is none.
    """

    stills: dict[int, Image] = field(default_factory=dict)
    small: dict[int, list[bytes]] = field(default_factory=dict)


Draw = Callable[[int, Sequence[Image | None], Canvas | None], Image]
"""Function (row, recorded pictures of all views, canvas) that draws the picture of the video; without a canvas, the
close-up.
"""


def _film(
    path: str | Path,
    recording: Recording,
    numbers: Sequence[int],
    rate: float,
    draw: Draw,
    wanted: PictureRows,
    progress: ProgressCall,
) -> OverlayRows:
    """Read the recorded pictures once, write the video of all rows and draw the wanted stills.

    path: of the video; not used without a video.
    numbers: number of the frame in each row.
    rate: of the video, Hz.
    draw: draws one row.
    wanted: rows of the video, stills and small pictures.
    Returns: stills and small pictures by row.
    """
    rows = range(len(numbers)) if wanted.video else sorted({*wanted.stills, *wanted.small})
    shown = OverlayRows()
    with ExitStack() as stack:
        images = stack.enter_context(open_images(recording))
        canvases = [Canvas(recording, images) for _ in range(_AHEAD + 1)]
        writer = stack.enter_context(VideoWriter(path, rate, canvases[0].size)) if wanted.video else None
        writing = stack.enter_context(ThreadPoolExecutor(1))
        written: deque[Future[None]] = deque()
        for done, row in enumerate(rows):
            progress("overlay", done, len(rows))
            if len(written) > _AHEAD:
                written.popleft().result()
            canvas = canvases[done % len(canvases)]
            pictures = [view.read(numbers[row]) for view in images]
            if row in wanted.small:
                shown.small[row] = [b"" if p is None else jpeg(p, _SMALL) for p in pictures]
            if row in wanted.stills:
                shown.stills[row] = draw(row, pictures, None)
            if writer is not None:  # the next frames are read and drawn while this one is being written
                written.append(writing.submit(writer.write, draw(row, pictures, canvas)))
        for one in written:
            one.result()
        progress("overlay", len(rows), len(rows))
    return shown


def still_rows(motion: Motion, count: int = 4) -> list[int]:
    """Select rows of a motion to show.

    count: number of rows, evenly spread; the row with the worst fit is added.
    """
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
) -> OverlayRows:
    """Draw a motion over its recording.

    path: of the video; not used without a video.
    source: gives the silhouettes; row i of the motion is frame i of the source, and recording.frames[i].
    wanted: rows that are drawn.
    Returns: stills and small pictures by row.
    Raises: InputError where something is drawn and the motion has no poses.
    """
    numbers = recording.frames[: len(motion)]

    def draw(row: int, pictures: Sequence[Image | None], canvas: Canvas | None) -> Image:
        if motion.poses is None or body is None:
            raise InputError("The motion holds joint positions only, and the overlay needs poses; track again.")
        what = _drawing(source, motion, motion.poses[row], body, row, numbers[row])
        return draw_close_ups(pictures, recording, body, what) if canvas is None else canvas.draw(pictures, body, what)

    return _film(path, recording, numbers, motion.frame_rate if len(motion) > 1 else 25.0, draw, wanted, progress)


def _drawing(source: FrameSource, motion: Motion, pose: Array, body: Body, row: int, number: int) -> Drawing:
    """Prepare the drawing of one row: body, skeleton, masks and a title; the body only where the pose is finite.

    pose: (D,) of the row.
    number: of the frame.
    """
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
    """Return the colour (BGR) of a person by their number."""
    return _COLOURS[number % len(_COLOURS)]


def write_people_overlay(
    path: Path,
    recording: Recording,
    source: FrameSource,
    people: Sequence[TrackResult],
    progress: ProgressCall = ignore,
) -> None:
    """Draw the video of all people over their recording, each in a colour of their own.

    path: of the video.
    source: gives the silhouettes, of all people together.
    """
    motion = people[0].motion
    numbers = recording.frames[: len(motion)]

    def draw(row: int, pictures: Sequence[Image | None], canvas: Canvas | None) -> Image:
        assert canvas is not None  # stills are in each person's own report
        return canvas.draw(pictures, None, _drawing_of_people(source, people, row, numbers[row]))

    _film(path, recording, numbers, motion.frame_rate, draw, PictureRows(), progress)


def _drawing_of_people(source: FrameSource, people: Sequence[TrackResult], row: int, number: int) -> Drawing:
    others, parts, alarm = [], [f"frame {number}"], False
    for k, p in enumerate(people):
        m, body = p.motion, p.body
        if not p.there[row] or m.poses is None or not np.isfinite(m.poses[row]).all():
            parts.append(f"{p.name} is not there")
            continue
        lost = bool(m.lost[row] or m.extrapolated[row])
        alarm |= lost
        parts.append(f"{p.name} LOST" if lost else p.name)
        others.append((body, body.skin(m.poses[row], body.fine), ALARM if lost else colour_of(k)))
    return Drawing(None, None, source.frame(row).silhouettes, "   ".join(parts), alarm, tuple(others))

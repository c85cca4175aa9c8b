"""Draw results over the recorded pictures: overlay.mp4 frame by frame, and pictures for the report."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import (
    ALARM,
    BODY,
    Canvas,
    Drawing,
    DrawnBody,
    draw_close_ups,
    jpeg,
    open_images,
)
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.geometry import Image
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter
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


@dataclass(frozen=True)
class Shown:
    """Person to draw over a recording.

    name: shown in the title bar; "" for a single person.
    motion: row i of all motions is the same frame.
    body: None where the motion has no poses: nothing of it is drawn.
    present: (T,) rows in which the person is there; None: all.
    """

    name: str
    motion: Motion
    body: Body | None
    present: NDArray[np.bool_] | None = None


def still_rows(motion: Motion, count: int = 4) -> list[int]:
    """Select rows of a motion to show.

    count: number of rows, evenly spread; the row with the worst fit is added.
    """
    rows = set(np.linspace(0, len(motion) - 1, min(count, len(motion))).astype(int).tolist())
    if np.isfinite(motion.cost).any():
        rows.add(int(np.nanargmax(motion.cost)))
    return sorted(rows)


def colour_of(number: int) -> tuple[int, int, int]:
    """Return the colour (BGR) of a person by their number."""
    return _COLOURS[number % len(_COLOURS)]


def write_overlay(
    path: str | Path,
    recording: Recording,
    source: FrameSource,
    people: Sequence[Shown],
    wanted: PictureRows,
    progress: ProgressCall = ignore,
) -> OverlayRows:
    """Draw people over their recording, several of them each in a colour of their own. The recorded pictures are read
    once.

    path: of the video; not used without a video.
    source: gives the silhouettes; row i of the motions is frame i of the source, and recording.frames[i].
    wanted: rows that are drawn.
    Returns: stills and small pictures by row.
    """
    motion = people[0].motion
    numbers = recording.frames[: len(motion)]
    rows = range(len(numbers)) if wanted.video else sorted({*wanted.stills, *wanted.small})
    shown = OverlayRows()
    with ExitStack() as stack:
        images = stack.enter_context(open_images(recording))
        canvases = [Canvas(recording, images) for _ in range(_AHEAD + 1)]
        rate = motion.frame_rate if len(motion) > 1 else 25.0
        writer = stack.enter_context(VideoWriter(path, rate, canvases[0].size)) if wanted.video else None
        writing = stack.enter_context(ThreadPoolExecutor(1))
        written: deque[Future[None]] = deque()
        for done, row in enumerate(rows):
            progress("overlay", done, len(rows))
            if len(written) > _AHEAD:
                written.popleft().result()
            pictures = [view.read(numbers[row]) for view in images]
            if row in wanted.small:
                shown.small[row] = [b"" if p is None else jpeg(p, _SMALL) for p in pictures]
            if row in wanted.stills:
                what = _drawing(source, people, row, numbers[row])
                shown.stills[row] = draw_close_ups(pictures, recording, what)
            if writer is not None:  # the next frames are read and drawn while this one is being written
                picture = canvases[done % len(canvases)].draw(pictures, _drawing(source, people, row, numbers[row]))
                written.append(writing.submit(writer.write, picture))
        for one in written:
            one.result()
        progress("overlay", len(rows), len(rows))
    return shown


def _drawing(source: FrameSource, people: Sequence[Shown], row: int, number: int) -> Drawing:
    """Prepare the drawing of one row: masks, the bodies of the people whose pose is known, and a title that says how
    each fits.

    number: of the frame.
    """
    drawn, alarm = list[DrawnBody](), False
    parts = [f"frame {number}", f"{people[0].motion.times[row]:.2f} s"]
    for k, p in enumerate(people):
        m = p.motion
        if p.present is not None and not p.present[row]:
            parts.append(f"{p.name} is not there")
            continue
        lost, extrapolated, iou = bool(m.lost[row]), bool(m.extrapolated[row]), 1 - float(m.cost[row])
        said = [p.name, f"IoU {iou:.2f}" if np.isfinite(iou) else "", "LOST" if lost else ""]
        said.append("extrapolated (no evidence)" if extrapolated else "")
        parts += filter(None, said)
        alarm |= lost or extrapolated
        if p.body is not None and m.poses is not None and np.isfinite(m.poses[row]).all():
            colour = ALARM if lost or extrapolated else BODY if len(people) == 1 else colour_of(k)
            drawn.append(DrawnBody(p.body, p.body.skin(m.poses[row], p.body.fine), m.joints[row], colour))
    return Drawing(source.frame(row).silhouettes, "   ".join(parts), tuple(drawn), alarm)

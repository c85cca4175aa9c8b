"""overlay.mp4: what was filmed and what was found in one picture, frame by frame; and stills of it for the report."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import Canvas, Drawing, Image, draw_close_ups, layout, open_images
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter
from hypose.pipeline.track_loop import FrameSource

_AHEAD = 2  # frames that are drawn and not yet written


def write_overlay(
    path: str | Path,
    recording: Recording,
    source: FrameSource,
    motion: Motion,
    body: Body,
    *,
    frames: range | None = None,
    stills: Sequence[int] = (),
    video: bool = True,
    progress: ProgressCall = ignore,
) -> dict[int, Image]:
    """Draw the motion over the recording.

    source: gives the silhouettes; motion row i belongs to frame frames[i] of the recording (default: recording.frames)
    and to frame i of the source. Returns close-ups of the rows in `stills`; with video=False only those are drawn and
    no file is written.
    """
    numbers = frames if frames is not None else recording.frames
    rows = range(min(len(motion), len(numbers))) if video else sorted(set(stills))
    if motion.poses is None:
        raise InputError("The motion holds joint positions only, and the overlay needs poses; track again.")
    kept: dict[int, Image] = {}
    with ExitStack() as stack:
        images = open_images(recording)
        for one in images:
            stack.callback(one.close)
        plan = layout([v.size for v in images])
        writer = None
        if video:
            writer = stack.enter_context(VideoWriter(path, motion.frame_rate if len(motion) > 1 else 25.0, plan.size))
        canvases = [Canvas(recording, plan) for _ in range(_AHEAD + 1)]
        writing = stack.enter_context(ThreadPoolExecutor(1))
        written: deque[Future[None]] = deque()
        for done, i in enumerate(rows):
            progress("overlay", done, len(rows))
            if len(written) > _AHEAD:
                written.popleft().result()
            what, canvas = _drawing(source, motion, body, i, numbers[i]), canvases[done % len(canvases)]
            pictures = canvas.read(images, numbers[i])
            if i in stills:
                kept[i] = draw_close_ups(pictures, recording, body, what)
            if writer is not None:  # the next frames are read and drawn while this one is written
                written.append(writing.submit(writer.write, canvas.draw(pictures, body, what)))
        for one in written:
            one.result()
        progress("overlay", len(rows), len(rows))
    return kept


def still_rows(motion: Motion, count: int = 4) -> list[int]:
    """Rows worth looking at: evenly spread, and the one that fits worst."""
    rows = set(np.linspace(0, len(motion) - 1, min(count, len(motion))).astype(int).tolist())
    if np.isfinite(motion.cost).any():
        rows.add(int(np.nanargmax(motion.cost)))
    return sorted(rows)


def _drawing(source: FrameSource, motion: Motion, body: Body, row: int, number: int) -> Drawing:
    assert motion.poses is not None
    pose = motion.poses[row]
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

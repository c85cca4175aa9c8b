"""overlay.mp4 with several people, each in a colour of their own."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.reports.result_pictures import ALARM, Canvas, Drawing, Image, draw_close_ups, layout, open_images
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import VideoWriter
from hypose.pipeline.track_loop import FrameSource
from hypose.pipeline.tracked_people import OnePerson

_COLOURS = ((200, 190, 60), (70, 160, 240), (110, 200, 90), (220, 110, 200), (90, 210, 220), (230, 130, 80))


def colour_of(number: int) -> tuple[int, int, int]:
    """BGR of a person by their number."""
    return _COLOURS[number % len(_COLOURS)]


def write_people_overlay(
    path: Path,
    recording: Recording,
    source: FrameSource,
    people: Sequence[OnePerson],
    *,
    stills: Sequence[int] = (),
    video: bool = True,
    progress: ProgressCall = ignore,
) -> dict[int, Image]:
    """Draw everybody over the recording; returns close-ups of the first person's rows in `stills`. With video=False
    only those are drawn and no file is written."""
    first = people[0].result
    rows = range(len(first.motion)) if video else sorted(set(stills))
    kept: dict[int, Image] = {}
    with ExitStack() as stack:
        images = open_images(recording)
        for one in images:
            stack.callback(one.close)
        plan = layout([v.size for v in images])
        canvas = Canvas(recording, plan)
        writer = stack.enter_context(VideoWriter(path, first.motion.frame_rate, plan.size)) if video else None
        for done, i in enumerate(rows):
            progress("overlay", done, len(rows))
            what = _drawing(source, people, i, recording.frames[i])
            pictures = canvas.read(images, recording.frames[i])
            if i in stills:
                poses = first.motion.poses
                assert poses is not None
                own = replace(what, vertices=first.body.skin(poses[i], first.body.fine), joints=first.motion.joints[i])
                kept[i] = draw_close_ups(pictures, recording, first.body, own)
            if writer is not None:
                writer.write(canvas.draw(pictures, None, what))
        progress("overlay", len(rows), len(rows))
    return kept


def _drawing(source: FrameSource, people: Sequence[OnePerson], row: int, number: int) -> Drawing:
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

"""`hypose correct`: a result tracked again from a corrected frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.commands_track import set_threads, split_names
from hypose.app.commands.console import Stages, say
from hypose.app.commands.options import MOST_FRAMES, Threads, number
from hypose.errors import InputError


def correct(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track.")],
    clicks: Annotated[Path, typer.Argument(help="The corrected pose: starts/NAME.json, saved in hypose view.")],
    until: Annotated[
        int | None, number("Track again up to this frame of the recording. [default: to the end]", 1, MOST_FRAMES)
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Results folder. [default: RESULTS-corrected]")] = None,
    formats: Annotated[str, typer.Option(help="Motion files to write.")] = "trc,c3d,bvh,glb,csv,mot",
    threads: Threads = None,
) -> None:
    """Track a result again from a frame whose pose was corrected; the frames before stay as they are."""
    set_threads(threads)
    from hypose.app.jobs.correct import correct as track_again
    from hypose.app.jobs.correct import read_correction
    from hypose.app.reports.summary import require_found
    from hypose.app.studio.view_result import find_recording
    from hypose.io.files import claimed
    from hypose.io.motions.results import ResultsFolder

    recording = find_recording(results)
    if recording is None:
        raise InputError(f"{results} lies in no recording; give the results folder inside the recording's folder.")
    folder = ResultsFolder(out or results.with_name(f"{results.name}-corrected"))
    correction = read_correction(clicks)
    with claimed(folder.path), Stages() as progress:
        names = tuple(split_names(formats))
        motion = track_again(
            recording, ResultsFolder(results), correction, folder, until=until, formats=names, progress=progress
        )
    say(f"Frames {correction.frame} and after tracked again, {int(motion.lost.sum())} of {len(motion)} frames lost.")
    say(f"Results: {folder.path}")
    require_found(motion, recording.name, folder.path)

"""`hypose export` and `hypose report`: work on results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.commands_track import set_threads, split_names
from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.kept_verdicts import tell_untrusted
from hypose.app.commands.options import Threads
from hypose.errors import InputError


def export(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track, or its motion.npz.")],
    formats: Annotated[str, typer.Option(help="Motion files to write; also osim, rrd.")] = "trc,c3d,bvh,glb,csv,mot",
    out: Annotated[Path | None, typer.Option(help="Folder to write to. [default: the results folder]")] = None,
) -> None:
    """Write motion files (TRC, C3D, BVH, GLB, CSV, MOT; OpenSim, Rerun) from a tracked motion."""
    from hypose.io.claims import claimed
    from hypose.io.motions.bodies import load_result_body
    from hypose.io.motions.export import export_motion

    motion, body = load_result_body(results)
    tell_untrusted(results)
    target = out or (results if results.is_dir() else results.parent)
    names = split_names(formats)
    with claimed(target), Stages() as progress:
        progress("export", 0, 1)
        written = export_motion(motion, body, target, names)
        progress("export", 1, 1)
    for path in written:
        say(str(path))


def report(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track or hypose fuse, or its motion.npz.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write. [default: report.html in the results folder]")
    ] = None,
    threads: Threads = None,
) -> None:
    """Write the report of a result again: one file that opens from disk and loads nothing."""
    set_threads(threads)
    from hypose.app.reports.report import write_report
    from hypose.app.studio.view_result import find_recording, load_view
    from hypose.io.files import check_writable

    folder = results if results.is_dir() else results.parent
    target = out or folder / "report.html"
    if target.is_dir():
        raise InputError(f"{target} is a folder; name the file to write, for example {target / 'report.html'}.")
    recording = find_recording(folder) if results.exists() else None
    if results.exists():
        check_writable(target.parent)
    shown = load_view(results, recording)
    with Stages() as progress:
        progress("report", 0, 1)
        written = write_report(target, shown, recording)
        progress("report", 1, 1)
    for text in shown.notes:
        note(f"note: {text}")
    say(f"Report: {written}")

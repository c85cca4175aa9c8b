"""`hypose compare`: how far a result agrees with markers, another program, or another result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.kept_verdicts import tell_untrusted
from hypose.app.commands.options import number
from hypose.errors import InputError


def compare(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="RESULT OTHER [RESULT OTHER ...]: a results folder, then what to compare it with: .c3d, .trc, .mot, "
            ".sto or another result."
        ),
    ],
    joint: Annotated[
        list[str] | None,
        typer.Option(help="JOINT=MARKER+MARKER: the joint is the middle of these markers (may be repeated)."),
    ] = None,
    subject: Annotated[
        str | None, typer.Option(help="Whose points, where a file names several people's SUBJECT:POINT.")
    ] = None,
    offset: Annotated[
        float | None,
        number("Seconds to add to the other's times. [default: found]", -100_000, 100_000, unit="seconds"),
    ] = None,
    no_align: Annotated[
        bool, typer.Option("--no-align", help="Both have the same world: do not move the other onto the result.")
    ] = False,
    all_frames: Annotated[
        bool, typer.Option("--all-frames", help="Also frames in which the person was lost or only predicted.")
    ] = False,
    max_mm: Annotated[
        float | None,
        number("Exit with 1 if the RMSE of the joints, offsets aside, is larger.", 0, 10_000, unit="millimetres"),
    ] = None,
    max_degrees: Annotated[
        float | None, number("Exit with 1 if an angle's RMSE, its offset aside, is larger.", 0, 360, unit="degrees")
    ] = None,
    min_coverage: Annotated[
        float | None, number("Exit with 1 if a smaller share lies in the 90 % regions (0.8, for example).", 0, 1)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for compare.csv and compare.html. [default: the first results folder]")
    ] = None,
) -> None:
    """Compare results with markers or other motions: errors per joint and angle, one table, one page."""
    from hypose.app.jobs import compare_job
    from hypose.io.files import check_writable
    from hypose.pipeline.comparison import CompareOptions

    if len(files) % 2:
        raise InputError("Give pairs: a result, what to compare it with, and so on; one of the files has no partner.")
    pairs = list(zip(files[::2], files[1::2], strict=True))
    folder = out or (files[0] if files[0].is_dir() else files[0].parent)
    joints = compare_job.parse_joints(joint or [])
    compare_job.load_result(files[0])
    check_writable(folder)
    options = CompareOptions(offset, not no_align, all_frames)
    with Stages() as progress:
        compared = []
        for done, pair in enumerate(pairs):
            progress("compare", done, len(pairs))
            compared += compare_job.compare_files([pair], options, joints, subject)
        progress("compare", len(pairs), len(pairs))
    failed = compare_job.exceeded(compared, compare_job.Limits(max_mm, max_degrees, min_coverage))
    compare_job.write_csv(folder / "compare.csv", compared)
    compare_job.write_page(folder / "compare.html", compared, failed)
    for file in dict.fromkeys(files):
        tell_untrusted(file)
    for c in compared:
        for text in c.found.notes:
            note(f"note: {text}")
        if c.found.joints:
            median, p95, rmse = c.found.left_mm
            share = compare_job.mean_coverage(c.found)
            inside = f", {100 * share:.0f} % inside our 90 % regions" if share == share else ""
            say(
                f"{c.other}: {len(c.found.joints)} joints, offsets aside: median {median:.1f} mm, 95 % within "
                f"{p95:.1f} mm, RMSE {rmse:.1f} mm{inside}"
            )
        if c.found.angles:
            degrees = [a.rmse_left for a in c.found.angles if a.unit == "deg" and a.n]
            span = f"{min(degrees):.1f} to {max(degrees):.1f} degrees" if degrees else "-"
            say(f"{c.other}: {len(degrees)} angles, offsets aside: RMSE {span}")
    say(f"Table: {folder / 'compare.csv'}")
    say(f"Page:  {folder / 'compare.html'}")
    for text in failed:
        say(text, "yellow")
    if failed:
        raise typer.Exit(1)

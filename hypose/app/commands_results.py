"""`hypose export`, `hypose report` and `hypose bench`: work on results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hypose.app.commands_track import set_threads, split_names
from hypose.app.console import Stages, note, say
from hypose.app.options import Threads, number
from hypose.errors import InputError


def export(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track, or its motion.npz.")],
    formats: Annotated[str, typer.Option(help="Motion files to write.")] = "trc,c3d,bvh,glb,csv,mot",
    out: Annotated[Path | None, typer.Option(help="Folder to write to. [default: the results folder]")] = None,
) -> None:
    """Write motion files (TRC, C3D, BVH, GLB, CSV, MOT) from a tracked motion."""
    from hypose.io.bodies import load_body
    from hypose.io.claims import claimed
    from hypose.io.export import export_motion
    from hypose.io.results import ResultsFolder, load_motion

    if not results.exists():
        raise InputError(f"{results} does not exist; give the results folder that hypose track wrote.")
    folder = ResultsFolder(results if results.is_dir() else results.parent)
    motion = load_motion(folder.motion if results.is_dir() else results)
    body = load_body(folder.file("body.npz"))
    if body.skeleton.joint_names != motion.skeleton.joint_names:
        raise InputError(
            f"{folder.path}: body.npz and the motion belong to different bodies; track the recording again."
        )
    names = split_names(formats)
    with claimed(out or folder.path), Stages() as progress:
        progress("export", 0, 1)
        written = export_motion(motion, body, out or folder.path, names)
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
    from hypose.app.report import from_result, write_report
    from hypose.app.view_result import find_recording, load_view
    from hypose.io.results import check_writable

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
        written = write_report(target, from_result(shown, recording))
        progress("report", 1, 1)
    for text in shown.notes:
        note(f"note: {text}")
    say(f"Report: {written}")


def bench(
    name: Annotated[str, typer.Argument(help="Name of the benchmark; a wrong one lists them.")] = "",
    quick: Annotated[bool, typer.Option("--quick", help="At most a minute on two cores; small, and says so.")] = False,
    seeds: Annotated[int, number("Repetitions; 0 = the benchmark's own number.", 0, 100_000)] = 0,
    first_seed: Annotated[
        int | None,
        number("First seed, where a benchmark has several. [default: the benchmark's own]", 0, 10**9),
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Folder with the real recordings, for real-* benchmarks.")] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the figures to this file (.png, .svg or .pdf).")] = None,
    parts: Annotated[
        Path | None,
        typer.Option(help="Keep the figures of each part here, and go on from those kept (gesture tables)."),
    ] = None,
    threads: Threads = None,
) -> None:
    """Measure accuracy and speed."""
    set_threads(threads)
    from hypose.evaluation.bench_list import run_benchmark
    from hypose.io.results import atomic_path, check_writable, to_json

    if plot is not None:
        from hypose.app.bench_plot import check_plot_path

        check_plot_path(plot)
    for file, option in ((json, "--json"), (plot, "--plot")):
        if file is not None:
            check_writable(file.parent, option)
    with Stages() as progress:
        report = run_benchmark(
            name, quick=quick, seeds=seeds, data=data, progress=progress, first_seed=first_seed, parts=parts
        )
    _show(report)
    if json is not None:
        with atomic_path(json) as temporary:
            temporary.write_text(to_json(report), encoding="utf-8", newline="\n")
        say(f"Written: {json}")
    if plot is not None:
        from hypose.app.bench_plot import plot_report

        plot_report(report, plot)
        say(f"Drawn: {plot}")


def _show(report: dict[str, Any]) -> None:
    from rich.table import Table

    from hypose.app.console import out

    table = Table(title=f"{report.get('name', '')}: {report.get('seconds', 0):.0f} s", title_justify="left")
    for column in ("metric", "case", "value", "sd", "n", "baseline", "ratio"):
        table.add_column(column, justify="left" if column in ("metric", "case", "baseline") else "right")
    for row in report.get("results", []):
        baseline = f"{row['baseline']} {_number(row.get('baseline_value'))}" if row.get("baseline") else ""
        table.add_row(
            str(row["metric"]),
            str(row["case"]),
            f"{_number(row['value'])} {row.get('unit') or ''}".strip(),
            _number(row.get("sd")),
            _number(row.get("n")),
            baseline,
            _number(row.get("ratio")),
        )
    console = out()
    if not console.is_terminal:
        console.width = 160  # a pipe has no width; wrapped tables are hard to read
    console.print(table)


def _number(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)

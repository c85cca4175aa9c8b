"""Measure accuracy and speed: `./run bench NAME --case CASE`, or `python -m benchmarks NAME --case CASE`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from click.exceptions import Exit

from hypose.app.cli import make_command, run_cli
from hypose.app.commands.console import Stages, print_table, say
from hypose.options import Option, Threads


def bench(
    name: Annotated[str, Option("Name of the benchmark; a wrong one lists them.", argument=True)] = "",
    case: Annotated[str, Option("Case of the benchmark; a wrong one lists them.")] = "",
    quick: Annotated[bool, Option("At most a minute on two cores; small, and says so.")] = False,
    seeds: Annotated[int, Option("Repetitions; 0 = the benchmark's own number.", 0, 100_000)] = 0,
    first_seed: Annotated[
        int | None,
        Option("First seed, where a benchmark has several. [default: the benchmark's own]", 0, 10**9),
    ] = None,
    data: Annotated[Path | None, Option("Folder with the real recordings, for real-* benchmarks.")] = None,
    json: Annotated[Path | None, Option("Write the figures to this file.")] = None,
    parts: Annotated[
        Path | None,
        Option("Keep the figures of each part of a long table here, and go on from those kept."),
    ] = None,
    keep: Annotated[bool, Option("Keep the figures (benchmarks/results; golden.json).")] = False,
    other: Annotated[bool, Option("The second set of golden clips, of other seeds.")] = False,
    threads: Threads = None,
) -> None:
    """Measure accuracy and speed."""
    from benchmarks.bench_list import run_benchmark
    from hypose.io.files import atomic_path, check_writable
    from hypose.io.motions.results import to_json

    if json is not None:
        check_writable(json.parent, "--json")
    if keep and name != "golden":
        from benchmarks.pages import check_keep

        check_keep(quick)
    with Stages() as progress:
        given = {"seeds": seeds, "first_seed": first_seed, "data": data, "parts": parts, "other": other}
        report = run_benchmark(name, case, quick=quick, progress=progress, **given)
    _show(report)
    if json is not None:
        with atomic_path(json) as temporary:
            temporary.write_text(to_json(report), encoding="utf-8", newline="\n")
        say(f"Written: {json}")
    if name == "golden":
        from benchmarks.golden import conclude

        status, lines = conclude(report, keep)
        for line in lines:
            say(line)
        raise Exit(status)
    if keep:
        from benchmarks.pages import RESULTS

        path = RESULTS / f"{report['name']}.json"
        with atomic_path(path) as temporary:
            temporary.write_text(to_json(report), encoding="utf-8", newline="\n")
        say(f"Written: {path}. make docs writes the pages.")


def _show(report: dict[str, Any]) -> None:
    rows = [
        (
            str(row["metric"]),
            str(row["case"]),
            f"{_number(row['value'])} {row.get('unit') or ''}".strip(),
            _number(row.get("sd")),
            _number(row.get("n")),
            f"{row['baseline']} {_number(row.get('baseline_value'))}" if row.get("baseline") else "",
            _number(row.get("ratio")),
        )
        for row in report.get("results", [])
    ]
    columns = ("metric", "case", "value", "sd", "n", "baseline", "ratio")
    print_table(f"{report.get('name', '')}: {report.get('seconds', 0):.0f} s", columns, rows)


def _number(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    run_cli(command=make_command("benchmarks", bench), name="benchmarks")

"""`hypose batch`: many recordings, each with its options, on the cores of a computer or the nodes of a lab."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from click.exceptions import Exit

from hypose.app.commands.commands_track import split_names, stopping
from hypose.app.commands.console import Stages, print_note, say
from hypose.errors import InputError
from hypose.options import Option

_GO_ON = "Stopped. Go on with the same command."


def batch(
    recordings: Annotated[
        tuple[Path, ...],
        Option("A table (CSV) of recordings and options, see docs/batch.md; or folders of recordings.", argument=True),
    ],
    workers: Annotated[
        int | None, Option("Processes of this computer. [default: the number of cores]", 1, 1024)
    ] = None,
    threads: Annotated[int | None, Option("Threads of each worker. [default: the cores shared]", 1, 256)] = None,
    scheduler: Annotated[str | None, Option("Address of a running Dask scheduler, tcp://HOST:8786, instead.")] = None,
    out: Annotated[
        Path | None, Option("Results folder. [default: TABLE-results beside the table, else batch-results]")
    ] = None,
    formats: Annotated[str, Option("Motion files to write.")] = "trc,csv",
    overlay: Annotated[bool, Option("Write overlay.mp4 as well.")] = False,
    dry_run: Annotated[bool, Option("Say what would be done, and do nothing.")] = False,
) -> None:
    """Track many recordings, each with options of its own; finished tasks are skipped, begun ones are resumed."""
    if scheduler is not None and (workers is not None or threads is not None):
        raise InputError("A running scheduler has its own workers; leave --workers and --threads out.")
    from hypose.app.batch import finished_metrics, ordered_tasks, require_dask, run_batch, wanted, write_table
    from hypose.io.files import claimed
    from hypose.io.motions.export import known_formats

    if not dry_run:
        require_dask("distributed")  # before all files are read
    names = split_names(formats)
    known_formats(names)
    drafts = [replace(task, formats=names, overlay=overlay) for task in wanted(recordings)]
    results = out or recordings[0].parent / f"{recordings[0].stem}-results"
    if out is None and recordings[0].suffix.lower() != ".csv":
        results = Path("batch-results")
    with stopping(_GO_ON), Stages() as progress:
        tasks, refused = ordered_tasks(drafts, results, progress)
        rows = refused
        if dry_run:
            done = sum(finished_metrics(t) is not None for t in tasks)
            say(f"{len(tasks)} tasks: {done} finished, {len(tasks) - done} to do, {len(refused)} refused")
        else:
            with claimed(results):
                count = workers or os.cpu_count() or 1
                done = run_batch(tasks, results, progress, workers=count, threads=threads, scheduler=scheduler)
                rows = [*done, *refused]
                write_table(rows, results)
    for row in rows:
        if row["state"] == "failed":
            print_note(f"{row['recording']}, {row['name']}: {row['message']}")
    if dry_run:
        raise Exit(1 if refused else 0)  # as the batch itself would end
    states = [row["state"] for row in rows]
    before = sum(row.get("before", False) for row in rows)
    parts = [f"{states.count('done')} of {len(rows)} done ({before} were before)"]
    parts += [f"{states.count(s)} {s}" for s in ("failed", "stopped") if s in states]
    say(", ".join(parts))
    say(f"Table: {results / 'results.csv'}")
    if "stopped" in states:
        say(_GO_ON)
        raise Exit(130)
    if "failed" in states:
        raise Exit(1)

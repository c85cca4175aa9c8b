"""`hypose batch`: many recordings times many sets of parameters, on the cores of a computer or the nodes of a lab."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import number
from hypose.errors import InputError


def batch(
    sweep: Annotated[
        Path,
        typer.Argument(
            help="TOML file: recordings, sets of settings; see docs/batch.md. Or the folder of a recording."
        ),
    ],
    workers: Annotated[
        int | None,
        number("Processes of this computer, or jobs with --slurm. [default: the number of cores]", 1, 1024),
    ] = None,
    threads: Annotated[int | None, number("Threads of each worker. [default: the cores shared]", 1, 256)] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a running Dask scheduler, tcp://HOST:8786, instead.")
    ] = None,
    slurm: Annotated[
        bool, typer.Option("--slurm", help="Workers as SLURM jobs, as [slurm] of the sweep says (extra slurm).")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Results folder. [default: the sweep's]")] = None,
    chunk: Annotated[
        float | None,
        number(
            "Split recordings that are longer into chunks of so many seconds. [default: the sweep's]",
            10,
            1_000_000,
            unit="seconds",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")] = False,
) -> None:
    """Track many recordings with many sets of parameters; what is finished is skipped, what was begun goes on."""
    _check(workers, threads, scheduler, slurm)
    from hypose.app.sweeps.batch_worker import finished
    from hypose.app.sweeps.cluster import Place, require_dask, run_batch
    from hypose.app.sweeps.sweep import is_recording, plan, read_sweep, sweep_of
    from hypose.io.files import claimed

    if not dry_run:
        require_dask(slurm)  # before all files are read
    wanted = sweep_of(sweep) if is_recording(sweep) else read_sweep(sweep)
    if chunk is not None:
        wanted = replace(wanted, chunk_s=chunk)
    if out is not None:
        wanted = replace(wanted, results=out)
    count = workers or os.cpu_count() or 1
    place = Place(count, threads, scheduler, wanted.slurm if slurm else None, wanted.retries)
    previous = signal.signal(signal.SIGTERM, _interrupt)
    try:
        with Stages() as progress:
            tasks, refused = plan(wanted, progress)
            if dry_run:
                done = sum(finished(t) is not None for t in tasks)
                say(f"{len(tasks)} tasks: {done} finished, {len(tasks) - done} to do, {len(refused)} refused")
                for one in refused:
                    say(f"{one.recording}, {one.set_name}: {one.reason}")
                if refused:  # as the batch itself would end
                    raise typer.Exit(1)
                return
            with claimed(wanted.results):
                figures = run_batch(tasks, place, wanted.results, progress, lambda link: note(f"Dashboard: {link}"))
    except KeyboardInterrupt:
        say("Stopped. Go on with the same command.")
        raise typer.Exit(130) from None
    finally:
        signal.signal(signal.SIGTERM, previous)
    from hypose.app.sweeps.batch_table import rows_of, write_table

    rows = rows_of(tasks, refused, figures, wanted.results)
    table, page = write_table(rows, wanted.results)
    states = [str(r["state"]) for r in rows]
    for row in rows:
        if row["state"] == "failed":
            note(f"{row['recording']}, {row['set']}: {row['message']}")
    skipped = sum(r["state"] == "done" and r["attempts"] == 0 for r in rows)
    parts = [f"{states.count('done')} of {len(rows)} done ({skipped} were before)"]
    parts += [f"{states.count(s)} {s}" for s in ("failed", "stopped") if s in states]
    say(", ".join(parts))
    say(f"Table: {table}")
    say(f"Page:  {page}")
    if "stopped" in states:
        say("Stopped. Go on with the same command.")
        raise typer.Exit(130)
    if "failed" in states:
        raise typer.Exit(1)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _check(workers: int | None, threads: int | None, scheduler: str | None, slurm: bool) -> None:
    if scheduler is not None and slurm:
        raise InputError("--scheduler and --slurm exclude each other; give one of them.")
    if scheduler is not None and (workers is not None or threads is not None):
        raise InputError("A running scheduler has its own workers; leave --workers and --threads out.")

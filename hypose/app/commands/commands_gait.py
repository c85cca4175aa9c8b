"""`hypose gait`: foot strikes, steps and their figures of a tracked motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.console import say
from hypose.app.commands.kept_verdicts import tell_untrusted


def gait(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track, or its motion.npz.")],
    out: Annotated[Path | None, typer.Option(help="Folder to write to. [default: the results folder]")] = None,
) -> None:
    """Write strikes, steps, cadence and speed (CSV, C3D with events), and joint angles over the gait cycle."""
    from hypose.app.reports.gait_plot import write_gait
    from hypose.io.claims import claimed
    from hypose.io.motions.bodies import load_result_body
    from hypose.pipeline.gait_events import gait_of

    motion, body = load_result_body(results)
    source = results if results.is_dir() else results.parent
    tell_untrusted(results)
    found = gait_of(motion, body)
    with claimed(out or source):
        written = write_gait(out or source, motion, found)
    strikes = sum(e.kind == "strike" for e in found.events)
    say(f"{strikes} foot strikes, {len(found.events) - strikes} times a foot left the ground, {len(found.steps)} steps")
    for f in found.figures:
        say(f"{f.name.replace('_', ' ')}: {f.mean:.3f} {f.unit} ({f.low:.3f} to {f.high:.3f} with 90 %), n = {f.n}")
    if not found.steps:
        say("Nobody walks two steps in this motion, as far as the feet show.")
    for path in written:
        say(str(path))

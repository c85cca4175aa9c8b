"""The command line: `hypose COMMAND`. Every error that a user can cause ends in one sentence and exit code 2.

The commands' work is imported when a command runs, so that `hypose --help` answers at once.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import typer

from hypose.app import (
    commands_batch,
    commands_calibrate,
    commands_check,
    commands_cite,
    commands_data,
    commands_fuse,
    commands_gesture,
    commands_results,
    commands_studio,
    commands_subject,
    commands_sync,
    commands_track,
)
from hypose.errors import HyposeError

app = typer.Typer(
    name="hypose",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Human motion from ordinary cameras: calibrated videos in; joint positions, angles and their uncertainty out.",
)

app.command("demo")(commands_track.demo)
app.command("calibrate")(commands_calibrate.calibrate)
app.command("check")(commands_check.check)
app.command("sync")(commands_sync.sync)
app.command("silhouettes")(commands_data.silhouettes)
app.command("track")(commands_track.track)
app.command("subject")(commands_subject.subject)
app.command("fuse")(commands_fuse.fuse)
app.add_typer(commands_gesture.app, name="gesture")
app.command("batch")(commands_batch.batch)
app.command("view")(commands_studio.view)
app.command("export")(commands_results.export)
app.command("report")(commands_results.report)
app.command("synth")(commands_data.synth)
app.command("cite")(commands_cite.cite)
app.command("bench")(commands_results.bench)


def _version(wanted: bool) -> None:
    if wanted:
        from hypose import __version__

        typer.echo(f"hypose {__version__}")
        raise typer.Exit


@app.callback()
def _global(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show where an error came from (also: HYPOSE_DEBUG=1).")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script; arguments default to those of the process. Exits the process."""
    # threads that make the next frame hold the interpreter for less than a tenth of a frame's time
    sys.setswitchinterval(5e-4)
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given or os.environ.get("HYPOSE_DEBUG", "") not in ("", "0")
    # accepted in any place: who needs it is in a hurry
    given = [a for a in given if a != "--debug"]
    try:
        app(given, prog_name="hypose", obj=given)
    except HyposeError as error:
        _fail(str(error), debug)
        sys.exit(2)
    except Exception as error:  # a bug: still no traceback unless asked for
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        if isinstance(error, MemoryError):
            reason = "the memory is full; close other programs, or track fewer frames at a time with --frames"
        else:
            reason = (
                f"this should not have happened ({reason}); please report it with the output of the same command "
                "and --debug"
            )
        _fail(reason + ".", debug)
        sys.exit(1)


def _fail(sentence: str, debug: bool) -> None:
    from hypose.app import console

    if debug:
        traceback.print_exc()
    console.error(sentence)


if __name__ == "__main__":
    main()

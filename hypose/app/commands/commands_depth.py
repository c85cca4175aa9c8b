"""`hypose depth-import`: a recording folder from what depth cameras recorded."""

from __future__ import annotations

import contextlib
import shlex
from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import Seed, number


def depth_import(
    sources: Annotated[
        list[Path],
        typer.Argument(help="One per camera: Azure Kinect .mkv, RealSense .bag, Record3D .r3d, or a folder of maps."),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write the recording to.")],
    empty: Annotated[
        list[Path] | None, typer.Option(help="The empty room, one per camera in the same order (may be repeated).")
    ] = None,
    frame_rate: Annotated[
        float | None, number("Frames per second of folders of maps, which do not tell it. [default: 30]", 1, 1000)
    ] = None,
    millimetres: Annotated[
        float, number("Millimetres that one step of a value stands for, of folders of maps.", 0, 100, above=True)
    ] = 1.0,
    seed: Seed = 0,
) -> None:
    """Make a recording of depth cameras to track: maps, lenses, floor; several are brought together by the person."""
    from hypose.errors import InputError
    from hypose.io.files import claimed
    from hypose.pipeline.import_depth import FolderUnits, import_depth

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not empty; give a new folder.")
    new = not out.exists()
    units = FolderUnits(frame_rate, millimetres)
    try:
        with claimed(out, "--out"), Stages() as progress:
            path, notes = import_depth(sources, out, empty=empty or (), units=units, seed=seed, progress=progress)
    except KeyboardInterrupt:
        say(f"Stopped; nothing is kept in {out}. Start again with the same command.")
        raise typer.Exit(130) from None
    finally:
        if new:
            with contextlib.suppress(OSError):  # the recording is in it
                out.rmdir()
    for text in notes:
        note(f"note: {text}")
    say(f"{path}: {len(sources)} depth cameras; track it with: hypose track {shlex.quote(str(out))}")

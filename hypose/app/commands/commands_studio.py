"""`hypose view`: the studio, a page on this computer for results, clicked joints, gestures and new recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import print_note, say
from hypose.app.commands.options import Threads, number
from hypose.errors import InputError

_NETWORK = "Network"


def view(
    what: Annotated[
        Path, typer.Argument(help="Results folder, recording, or a folder that holds such.", show_default="this folder")
    ] = Path(),
    port: Annotated[int, number("Port to listen on; 0 takes any free one.", 0, 65535, rich_help_panel=_NETWORK)] = 8765,
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; others than this computer need the token.", rich_help_panel=_NETWORK),
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        typer.Option(
            help="What pages must show. [default: none on this computer, else made]", rich_help_panel=_NETWORK
        ),
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open the page.")] = False,
    threads: Threads = None,
) -> None:
    """Open the studio: results in 3D with their pictures, corrections by clicks, gestures, new recordings."""
    set_threads(threads)
    from hypose.app.studio.server import NOT_BUILT, STATIC_FOLDER, StudioOptions, run_server

    if not what.exists():
        raise InputError(f"{what} does not exist; give a results folder, a recording, or a folder that holds such.")
    if not (STATIC_FOLDER / "index.html").is_file():
        raise InputError(NOT_BUILT)
    root, shown = _place(what)

    def ready(address: str) -> None:
        page = address + (f"#/{shown}" if shown else "")
        say(f"Studio: {page}")
        print_note(f"Shows {root}. Stop with Ctrl-C.")
        if not no_browser:
            import webbrowser

            webbrowser.open(page)

    run_server(StudioOptions(root, host, port, token), ready)


def _place(what: Path) -> tuple[Path, str]:
    """The folder to serve, and the screen that shows `what` in it."""
    from hypose.app.studio.catalog import Catalog, is_recording, recording_above

    folder = (what if what.is_dir() else what.parent).resolve()
    if (folder / "motion.npz").is_file():
        root = recording_above(folder) or folder
        return root, f"view/{Catalog(root).id_of('result', folder)}"
    if is_recording(folder):
        catalog = Catalog(folder)
        results = catalog.items("result")
        if results:  # the last one of several, which are listed behind it
            return folder, f"view/{results[0].id}"
        return folder, f"setup/{catalog.id_of('recording', folder)}"
    return folder, ""

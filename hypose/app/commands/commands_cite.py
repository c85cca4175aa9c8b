"""`hypose cite`: what to cite with a result."""

from __future__ import annotations

from typing import Annotated

import typer

from hypose.app.commands.console import say


def cite(
    method: Annotated[
        str, typer.Argument(help="A results folder, or a recipe or method by name; a wrong one lists them.")
    ] = "default",
    bibtex: Annotated[bool, typer.Option("--bibtex", help="As BibTeX.")] = False,
) -> None:
    """Print the papers behind the method that gave a result."""
    from hypose.app.jobs.cite import listed, papers_of

    say(listed(papers_of(method), bibtex))

"""The documentation names commands and options that exist, and all commands."""

import re
from pathlib import Path

import pytest
import typer

from hypose.app import cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "examples").rglob("*.*"))]


def commands(command, name=""):
    """(name, its options) of a command and all below it."""
    yield name, {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help", "--debug"}
    for child, one in getattr(command, "commands", {}).items():
        yield from commands(one, f"{name} {child}".strip())


OPTIONS = dict(commands(typer.main.get_command(cli.app)))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_in_the_documentation_exist(page):
    unknown = []
    for name, child, rest in re.findall(r"hypose ([a-z-]+)(?: ([a-z]+))?([^`|#\n]*)", page.read_text("utf-8")):
        own = OPTIONS.get(f"{name} {child}", OPTIONS.get(name))
        if own is not None:
            unknown += [f"hypose {name} {o}" for o in re.findall(r"(?<![\w-])--[a-z][\w-]*", rest) if o not in own]
    assert not unknown


def test_every_command_is_in_the_table_of_the_documentation():
    table = re.findall(r"^\| `hypose ([a-z-]+)", (ROOT / "docs" / "index.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(table) == sorted(n for n in OPTIONS if n and " " not in n)

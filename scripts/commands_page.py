"""Make the site's page of commands from the options that they declare; nothing of it is kept in docs/."""

from __future__ import annotations

import inspect
import re

import click

from hypose.app.cli import CLI_COMMANDS, app

_HEAD = """# Commands

`hypose COMMAND --help` prints the same. Exit codes: 0 done; 1 `check` has warnings, `compare` is beyond a limit, a part
of a `batch` failed (or a bug, which is then reported); 2 unusable input, or no person found; 3 the result is not to be
trusted; 130 stopped by Ctrl-C. An error is one sentence; `--debug` shows where it came from.

`./run bench NAME` measures accuracy or speed; a wrong name lists the [benchmarks](benchmarks.md)."""


def commands_page() -> str:
    """Return the page as Markdown: a table of all commands, then the options of each."""
    parts, rows = [], ["| command | |", "| --- | --- |"]
    for heading, several in CLI_COMMANDS.items():
        parts.append(f"## {heading}")
        for name, (_, line) in several.items():
            rows.append(f"| [`hypose {name}`](#hypose-{name}) | {_plain(line)} |")
            parts += _entries(f"hypose {name}", app.get_command(None, name), "###")
    return "\n\n".join([_HEAD, "\n".join(rows), *parts]) + "\n"


def _entries(name: str, command: click.Command | None, level: str) -> list[str]:
    assert command is not None, name
    if isinstance(command, click.Group):
        out = [f"{level} {name}", _plain(command.help or "")]
        for sub in command.list_commands(None):  # pyright: ignore[reportArgumentType]
            out += _entries(f"{name} {sub}", command.get_command(None, sub), f"{level}#")  # pyright: ignore[reportArgumentType]
        return out
    context = click.Context(command, info_name=name)
    usage = " ".join(p.make_metavar(context) for p in command.params if isinstance(p, click.Argument))
    out = [
        f"{level} {name}",
        f"```\n{name} {usage}\n```".replace(" \n", "\n"),
        _plain(inspect.cleandoc(command.help or "")),
    ]
    records = [r for p in command.params if isinstance(p, click.Option) and (r := p.get_help_record(context))]
    if records:
        rows = [f"| `{flags.replace('|', ' or ')}` | {_plain(' '.join(text.split()))} |" for flags, text in records]
        out.append("\n".join(["| option | |", "| --- | --- |", *rows]))
    return out


def _plain(text: str) -> str:
    """Help is plain text: what Markdown would take for marks is kept."""
    return re.sub(r"([*_|])", r"\\\1", text.replace("<", "&lt;"))

"""The command line: `hypose COMMAND`. Every error that a user can cause ends in one sentence and exit code 2.

Commands are made of the options that they declare (hypose.options). A command is imported when it is asked for, and its
work when it runs, so that `hypose --help` answers at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import importlib
import inspect
import io
import logging
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from hypose.app import options
from hypose.errors import HyposeError, visible
from hypose.options import RESEARCH, THREAD_VARIABLES, Declared, declared

CommandTable = Mapping[str, Mapping[str, tuple[Any, str]]]
"""Heading -> name of a command -> (where it is, its line in the help). Where: module:function below hypose.app, or
below hypose.app.commands; or the table of a command that has commands of its own. What function `track` takes is
declared by the class TrackCommand of hypose.app.options; without such a class by the function itself."""
GESTURE_COMMANDS: CommandTable = {
    "Commands": {
        "train": ("jobs.gesture_job:gesture_train", "Teach a gesture, live or from recorded sessions."),
        "run": ("jobs.gesture_job:gesture_run", "Watch for gestures: events as JSON lines, OSC, WebSocket."),
        "eval": ("jobs.gesture_job:gesture_evaluate", "Judge a model on a recorded session."),
    }
}
CLI_COMMANDS: CommandTable = {
    "Begin here": {
        "calibrate": (
            "commands_calibrate:calibrate",
            "Lenses and places of cameras, from boards or measured points.",
        ),
        "check": (
            "jobs.checking:check",
            "Do the views agree? What is wrong, and --refine cures it.",
        ),
        "sync": ("commands_sync:sync", "How many frames each view is late; cure it with --out."),
        "track": (
            "jobs.person_job:track_command",
            "Track the person: motion files, overlay video, report.",
        ),
        "view": ("commands_live:view", "The studio in the browser: look at results, correct, set up."),
        "export": ("commands_results:export", "Write TRC, C3D, BVH, GLB, CSV, MOT of a tracked motion."),
    },
    "Recordings": {
        "init": ("commands_recordings:init", "Write the recording.toml of a folder with videos."),
        "demo": ("commands_recordings:demo", "Make a synthetic recording, track it, compare with the truth."),
        "synth": ("commands_recordings:synth", "Make a synthetic recording with known truth."),
        "depth-import": ("commands_recordings:depth_import", "A recording from what depth cameras recorded."),
        "silhouettes": ("commands_recordings:silhouettes", "Write the masks of the person, and a contact sheet."),
        "keypoints": ("commands_recordings:keypoints", "Detect 2D key points and masks of people in the videos."),
        "subject": (
            "jobs.person_job:measure_subject",
            "Measure a person: lengths, girths, a body for track.",
        ),
        "batch": ("commands_recordings:batch", "Many recordings, many settings, all cores or a cluster."),
    },
    "Results": {
        "report": ("commands_results:report", "Write the report of a result again."),
        "correct": ("jobs.correct:correct", "Track a result again from a frame corrected in the studio."),
        "explain": ("commands_results:explain", "Which pass moved a joint of a frame, and why."),
        "gait": ("commands_results:gait", "Foot strikes, steps, cadence and speed of a tracked motion."),
        "compare": (
            "jobs.compare_job:compare",
            "How far a result agrees with markers or another motion.",
        ),
        "cite": ("commands_results:cite", "Print the papers behind the method that gave a result."),
    },
    "Live and depth sensors": {
        "live": ("commands_live:live", "Cameras in, poses out, while it happens."),
        "fuse": ("jobs.fuse_job:fuse", "One skeleton per person from several depth sensors."),
        "gesture": (
            GESTURE_COMMANDS,
            "Learn still gestures in minutes, and watch for them.",
        ),
        "warm-up": ("commands_recordings:warm_up_command", "Compile now what the first run would compile."),
    },
}
_ABOUT = "Human motion from ordinary cameras: calibrated videos in; joint positions, angles and their uncertainty out."
_PLACEHOLDERS = {int: "N", float: "X", Path: "PATH"}
_CONTEXT = {"max_content_width": 120}


class _Group(click.Group):
    """Group of commands in a table, each imported when it is first used."""

    def __init__(self, name: str, table: CommandTable, about: str, params: Sequence[click.Parameter] = ()) -> None:
        super().__init__(name, help=about, params=[*params], no_args_is_help=True, context_settings=_CONTEXT)
        self._table = table

    def list_commands(self, ctx: click.Context | None) -> list[str]:
        return [name for commands in self._table.values() for name in commands]

    def get_command(self, ctx: click.Context | None, name: str, /) -> click.Command | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        if name not in self.commands:
            found = next((commands[name] for commands in self._table.values() if name in commands), None)
            if found is None:
                return None
            where, line = found
            if isinstance(where, Mapping):
                return self.commands.setdefault(name, _Group(name, where, line))
            module, _, member = where.partition(":")
            module = f"hypose.app.{'' if '.' in module else 'commands.'}{module}"

            def load() -> Any:  # noqa: ANN401
                return getattr(importlib.import_module(module), member)

            declares = getattr(options, f"{name.capitalize()}Command", None)
            self.commands[name] = make_command(name, declares or load(), load if declares else None)
        return self.commands[name]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for heading, commands in self._table.items():
            with formatter.section(heading):
                formatter.write_dl([(name, line) for name, (_, line) in commands.items()])


class _Command(click.Command):
    """Command whose help shows its options under headings.

    declares: dataclass or function that declares the options.
    """

    declares: Callable[..., Any]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections: dict[str, list[tuple[str, str]]] = {"Options": []}
        for param in self.get_params(ctx):
            if not isinstance(param, click.Argument) and (record := param.get_help_record(ctx)):
                sections.setdefault(getattr(param, "group", "") or "Options", []).append(record)
        for heading, records in sorted(sections.items(), key=lambda s: s[0] == RESEARCH):  # last
            with formatter.section(heading):
                formatter.write_dl(records)


def make_command(name: str, declares: Callable[..., Any], load: Callable[[], Any] | None = None) -> click.Command:
    """Make a command with the options that a function or dataclass declares (`hypose.options.declared`).

    name: name of the command.
    declares: called with the values of the options: a function does the work, a dataclass keeps the values.
    load: imports and returns the function that does the work and takes the instance of the dataclass; None where
        `declares` does it.
    """

    def run(**given: Any) -> None:  # noqa: ANN401
        set_threads(given.get("threads"))
        made = declares(**given)
        if load is not None:
            load()(made)

    out = _Command(name, callback=run, help=inspect.getdoc(declares), context_settings=_CONTEXT)
    out.params, out.declares = [_parameter(option) for option in declared(declares)], declares
    return out


def set_threads(count: int | None) -> None:
    """Limit the threads of all libraries; call it before numpy and OpenCV are imported. count: None changes nothing."""
    if count is not None:
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(count)))
        import cv2

        cv2.setNumThreads(count)


def _parameter(d: Declared) -> click.Parameter:
    """Convert a declared option to an option or argument of click."""
    required = d.default is dataclasses.MISSING
    about: dict[str, Any] = {} if required else {"default": d.default}
    about |= {"type": click.Path(path_type=Path) if d.kind is Path else d.kind, "help": d.option.help}
    about["metavar"] = d.option.value or None
    if d.option.choices and d.option.value:
        about["help"] += f" One of {', '.join(d.option.choices)}."
    if d.option.argument:
        if d.name == "recording":
            about |= {"callback": _keep_options, "is_eager": True}
        return click.Argument([d.name], nargs=-1 if d.many else 1, required=required, **about)
    flags = d.flag
    if d.kind is bool:
        about.update(is_flag=True, flag_value=not d.default)
        if d.default is None:
            flags, about["flag_value"] = f"{d.flag}/--no-{d.name}", None
    else:
        choices = f"{{{','.join(d.option.choices)}}}" if d.option.choices else ""
        about.update(required=required, multiple=d.many, show_default=d.default not in (None, "", ()))
        about["metavar"] = d.option.value or choices or _PLACEHOLDERS.get(d.kind, "TEXT")
    out = click.Option([flags, d.name], callback=lambda ctx, param, value: d.check(value), **about)
    out.group = d.option.group  # pyright: ignore[reportAttributeAccessIssue] (for the help)
    return out


def _keep_options(ctx: click.Context, param: click.Parameter, recording: Path) -> Path:
    """Take the defaults of `hypose track` from the recording, before its other options are read."""
    if ctx.command.name == "track":
        ctx.default_map = options.recorded_options(recording)
    return recording


def _version(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if wanted:
        from hypose import __version__

        click.echo(f"hypose {__version__}")
        ctx.exit()


app = _Group(
    "hypose",
    CLI_COMMANDS,
    _ABOUT,
    [
        click.Option(["--version"], is_flag=True, callback=_version, is_eager=True, help="Print the version and exit."),
        click.Option(["--debug"], is_flag=True, help="Log what is done, and where an error came from."),
    ],
)


def run_cli(arguments: Sequence[str] | None = None, command: click.Command = app, name: str = "hypose") -> None:
    """Run a command line, and exit the process with its code.

    Exit codes: 0 for success, 1 for findings and for bugs, 2 for errors that the user can correct, 130 after Ctrl-C;
        others are those of the commands.
    arguments: default: those of the process.
    command: group of commands, `hypose` by default.
    name: name of the program, for the help.
    """
    for stream in (sys.stdout, sys.stderr):  # what the terminal has no letters for is no reason to fail
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # threads that make the next frame hold the interpreter for less than a tenth of a frame's time
    sys.setswitchinterval(5e-4)
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given or os.environ.get("HYPOSE_DEBUG", "") not in ("", "0")
    if debug:
        logging.basicConfig(format="%(relativeCreated)7d ms %(name)s: %(message)s")
        logging.getLogger("hypose").setLevel(logging.DEBUG)
    # accepted in any place: who needs it is in a hurry
    given = [a for a in given if a != "--debug"]
    # a flag takes no value
    given = [b for a in given for b in (("--refine", "--far") if a == "--refine=far" else (a,))]
    try:
        try:
            command(given, prog_name=name, obj=given)
        finally:
            sys.stdout.flush()  # a full disk shows here, while it can be reported
    except HyposeError as error:
        _fail(str(error), debug)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:  # still no traceback unless asked for
        sentence = _foreseen(error)
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        report = "please report it with the output of the same command and --debug"
        _fail(sentence or f"this should not have happened ({reason}); {report}.", debug)
        sys.exit(2 if sentence else 1)


def _foreseen(error: Exception) -> str:
    """Make the sentence for an error of the system; "" for any other, which is a bug of hypose.

    error: any exception that is no HyposeError.
    """
    if isinstance(error, MemoryError):
        return "the memory is full; close other programs, or track fewer frames at a time with --frames."
    if not isinstance(error, OSError) or error.errno is None:
        return ""
    from hypose.io.files import FULL, cannot_write

    if error.errno == errno.ENAMETOOLONG:
        return f"{str(error.filename)[:60]}... is too long for the name of a file; give another path."
    reason = (error.strerror or type(error).__name__).lower()
    if error.filename is None and error.errno in (*FULL, errno.EFBIG, errno.EBADF):
        with contextlib.suppress(OSError):  # what still waits to be printed would fail again at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return f"The output cannot be written ({reason}); free some space, or send it elsewhere, and run it again."
    what = "The system" if error.filename is None else os.fsdecode(error.filename)
    if error.errno in (*FULL, errno.EFBIG, errno.EROFS):
        return cannot_write(Path(what), error)
    return f"{what}: {reason}; look whether it is there and you may read and write it, and run the same command again."


def _fail(sentence: str, debug: bool) -> None:
    if debug:
        traceback.print_exc()
    try:
        from hypose.app.commands import console

        console.error(sentence)
    except (ImportError, OSError, MemoryError):  # no memory is left for the colours of the terminal
        sys.stderr.write(f"error: {visible(sentence)}\n")

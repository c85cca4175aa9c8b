"""Print results, notes and progress on the command line: stages with frames/s and time left, tables, sentences. Control
characters in names become visible escapes, so that names cannot control the terminal.

Results go to stdout, progress and errors to stderr, so that `hypose ... > file` keeps the results only.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, TextIO, TypeVar

from click.exceptions import Exit

from hypose.errors import visible

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

TITLES = {
    "prepare": "Prepare",
    "compile": "Compile (once per machine)",
    "background": "Background",
    "masks": "Silhouettes",
    "detect": "Key points",
    "look": "First look",
    "subject": "Subject",
    "track": "Track",
    "sides": "Left and right",
    "both ways": "Arms both ways",
    "smooth": "Smooth",
    "export": "Export",
    "overlay": "Overlay video",
    "report": "Report",
    "render": "Render",
    "check": "Check",
    "doctor": "Examine the calibration",
    "refine": "Refine the calibration",
    "sync": "Synchronise",
    "offsets": "Look how late the views are",
    "start": "Find the cameras",
    "board": "Look for the board",
    "solve": "Solve",
    "plan": "Look at the recordings",
    "read": "Read the recordings",
}
"""Title of each stage for the user."""
_COUNTED_IN_FRAMES = frozenset({"track", "overlay", "masks", "render", "detect", "each sensor alone"})
_PLAIN_SECONDS = 10.0  # without a terminal a line at most this often
_JSON_SECONDS = 0.2
JSON_PROGRESS = "HYPOSE_JSON_PROGRESS"
"""With this environment variable set, progress is printed as lines of JSON on stderr, for a program that started this
one.
"""


def _console(file: TextIO) -> Console:
    """Make the console of a stream; a new one each time, so that a redirected stream is used."""
    from rich.console import Console

    return Console(file=file, highlight=False, soft_wrap=True)


def say(text: str = "", style: str | None = None) -> None:
    """Print one line of results; style: a style of the package rich, for example "green", or None."""
    _console(sys.stdout).print(visible(text), style=style, markup=False)


def counted(count: int, what: str) -> str:
    """Format a number with its noun in the singular or plural: "1 frame", "2 frames"."""
    return f"{count} {what}{'s' * (count != 1)}"


def print_note(text: str) -> None:
    """Print one line on stderr, apart from the results."""
    _console(sys.stderr).print(visible(text), style="dim", markup=False)


def print_notes(notes: Iterable[str]) -> None:
    """Print notes for the user, each on a line of stderr."""
    for text in notes:
        print_note(f"note: {text}")


def error(text: str) -> None:
    """Print the sentence that ends a failed command."""
    from rich.text import Text

    _console(sys.stderr).print(Text.assemble(("error: ", "bold red"), visible(text)))


def _bars(console: Console) -> Progress:
    """Make progress bars, one per stage; stages that count frames show frames per second."""
    from rich import progress
    from rich.text import Text

    class Speed(progress.ProgressColumn):
        def render(self, task: progress.Task) -> Text:
            speed = task.finished_speed or task.speed
            if not speed or task.fields.get("unit") != "frames":
                return Text("")
            return Text(f"{speed:.1f} frames/s" if speed < 100 else f"{speed:.0f} frames/s")

    return progress.Progress(
        progress.TextColumn("{task.description:<26}"),
        progress.BarColumn(bar_width=30),
        progress.MofNCompleteColumn(),
        Speed(),
        progress.TimeRemainingColumn(compact=True, elapsed_when_finished=True),
        console=console,
    )


def print_table(title: str, columns: Iterable[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table; at full width where the output is no terminal.

    columns: headings.
    rows: texts, as many as headings.
    """
    from rich.table import Table

    table, console = Table(title=visible(title), title_justify="left"), _console(sys.stdout)
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*map(visible, row))
    if not console.is_terminal:
        console.width = 160
    console.print(table)


class Stages:
    """Progress of the stages of one command; call it with (stage, done, total).

    In a terminal: one bar per stage with frames/s and time left. Elsewhere (a log, a pipe): a line at the start and end
    of each stage and every 10 s. With JSON_PROGRESS set: a line of JSON five times a second.
    seconds: time per stage, s.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._console, self._quiet = _console(sys.stderr), quiet
        self.seconds: dict[str, float] = {}
        self._began: dict[str, float] = {}
        self._tasks: dict[str, TaskID] = {}
        self._said: dict[str, float] = {}
        self._json = bool(os.environ.get(JSON_PROGRESS))
        shown = self._console.is_terminal and not quiet and not self._json
        self._bars: Progress | None = _bars(self._console) if shown else None

    def __enter__(self) -> Stages:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` steps of a stage are done."""
        now, first, last = time.monotonic(), stage not in self._began, done >= total
        elapsed = self.seconds[stage] = now - self._began.setdefault(stage, now)
        title, unit = TITLES.get(stage, stage.capitalize()), "frames" if stage in _COUNTED_IN_FRAMES else ""
        if self._bars is not None:
            if first:
                self._tasks[stage] = self._bars.add_task(title, total=total, unit=unit)
            self._bars.update(self._tasks[stage], completed=done, total=total)
            return
        due = now - self._said.get(stage, -math.inf) >= (_JSON_SECONDS if self._json else _PLAIN_SECONDS)
        if self._quiet or not (done == 0 or last or due):
            return
        self._said[stage] = now
        if self._json:
            shown = {"name": stage, "title": title, "done": done, "total": total, "seconds": round(elapsed, 2)}
            print(json.dumps({"stage": shown | {"unit": unit}}), file=sys.stderr, flush=True)
            return
        rate = f", {done / elapsed:.1f} per s" if elapsed > 0.5 and done else ""
        left = f", {(total - done) * elapsed / done:.0f} s left" if rate and not last else f", {elapsed:.1f} s"
        self._console.print(f"{title}: {done}/{total}{rate}{left if done else ''}", markup=False)


_Item = TypeVar("_Item")
ProgressCall = Callable[[str, int, int], None]
"""Function progress(stage, done, total)."""


def each(progress: ProgressCall, stage: str, items: Sequence[_Item]) -> Iterator[_Item]:
    """Yield the items of a stage, and report each as one step.

    progress: function (stage, done, total).
    stage: name of the stage.
    """
    for done, item in enumerate(items):
        progress(stage, done, len(items))
        yield item
    progress(stage, len(items), len(items))


def ignore(stage: str, done: int, total: int) -> None:
    """Do nothing: progress function for callers that want no progress shown."""


@contextlib.contextmanager
def ended_by_signals(ended: threading.Event) -> Iterator[None]:
    """Set an event at Ctrl-C, SIGTERM and a closed terminal inside the context, instead of interrupting the program.

    ended: event that is set.
    Why: the program finishes its work in order. Under nohup a closed terminal changes nothing.
    """
    hung_up = getattr(signal, "SIGHUP", None)
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hung_up is not None and signal.getsignal(hung_up) != signal.SIG_IGN:  # under nohup it continues
        numbers.append(hung_up)
    before = {n: signal.signal(n, lambda number, frame: ended.set()) for n in numbers}
    try:
        yield
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)


@contextlib.contextmanager
def stopping(text: str | Callable[[], str] = "") -> Iterator[None]:
    """End the command with exit code 130 at Ctrl-C and SIGTERM, inside the context.

    text: sentence that is printed then, or a function that makes it.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        if text:
            say(text if isinstance(text, str) else text())
        raise Exit(130) from None
    finally:
        signal.signal(signal.SIGTERM, previous)

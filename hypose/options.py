"""Options, each declared once: a field of a dataclass or a parameter of a command, annotated with an `Option`.

Command line, tables of recordings and the studio's forms are made of these declarations.

    @dataclass(frozen=True)
    class Options:
        height: Annotated[float | None, Option("The person's height in metres.", 0.4, 2.8, unit="metres")] = None
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import typing
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from hypose.errors import InputError

HEIGHT = (0.4, 2.8)
"""m: of a person whom the trackers know."""
MOST_FRAMES = 10**9
LARGEST_SEED = 2**63 - 1
OUTPUT, RUN, RESEARCH = "Output", "Run", "Research"
"""Headings of options: files to write, how to run, comparison of methods."""
THREAD_VARIABLES = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that limit the threads of numba and of the libraries behind numpy."""
_TRUTH = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


@dataclass(frozen=True)
class Option:
    """Description of one option: its purpose and its possible values.

    help: one sentence.
    least, most: range of a number, both included.
    above: `least` itself is not possible.
    unit: unit of a number, for the error.
    choices: possible texts; empty: any.
    group: heading in the help.
    flag: name on the command line, where it differs from the name of the field.
    value: placeholder for the value in the help.
    argument: it is given by its place on the command line, without a name.
    """

    help: str
    least: float | None = None
    most: float = float("inf")
    above: bool = False
    unit: str = ""
    choices: tuple[str, ...] = ()
    group: str = ""
    flag: str = ""
    value: str = ""
    argument: bool = False

    @property
    def allowed(self) -> str:
        """Possible values in words, for an error: "give 1 to 60 metres"."""
        if self.choices:
            return f"choose {', '.join(self.choices[:-1])} or {self.choices[-1]}"
        if self.most in (MOST_FRAMES, LARGEST_SEED):  # which only keep numbers from overflowing later
            return f"give {self.least} or more"
        numbers = f"more than {self.least} and at most {self.most}" if self.above else f"{self.least} to {self.most}"
        return f"give {numbers}{self.unit and ' ' + self.unit}"

    def allows(self, value: Any) -> bool:  # noqa: ANN401 (of whatever kind the option is)
        """Test whether a value (not None) is in the range, in which NaN never is, or is one of the choices."""
        if self.least is None:
            return not self.choices or value in self.choices
        return self.least <= value <= self.most and not (self.above and value == self.least)


@dataclass(frozen=True)
class Declared:
    """Declared option with the name and type of its field or parameter.

    name: name of the field or parameter.
    kind: bool, int, float, str or Path.
    many: the value is a tuple of `kind`.
    default: `dataclasses.MISSING` where a value must be given.
    option: its description.
    """

    name: str
    kind: type
    many: bool
    default: Any
    option: Option

    @property
    def flag(self) -> str:
        """The option as it is written on the command line: --name, or --no-name for one that is on by default."""
        return self.option.flag or f"--{'no-' * (self.default is True)}{self.name.replace('_', '-')}"

    def check(self, value: Any, name: str | None = None) -> Any:  # noqa: ANN401
        """Check a value.

        name: name of the option in the error; default: its flag.
        Returns: the same value; None and tuples are not checked.
        Raises: InputError where the value is not possible.
        """
        if value is None or self.many or self.option.allows(value):
            return value
        shown = f"{value:g}" if isinstance(value, float) else str(value)
        raise InputError(f"{name or self.flag} {shown} is not possible; {self.option.allowed}.")

    def parse(self, text: str) -> Any:  # noqa: ANN401
        """Convert a text to the value that it stands for.

        Raises: InputError where the text is of another kind, or as for `check`.
        """
        try:
            value = _TRUTH[text.lower()] if self.kind is bool else self.kind(text)
        except (ValueError, KeyError):
            raise InputError(f"{self.name} cannot be {text!r}; see docs/batch.md.") from None
        return self.check(value, self.name)


@functools.cache
def declared(of: Callable[..., Any]) -> tuple[Declared, ...]:
    """List the options that a dataclass or function declares, in their order; its other parameters are left out."""
    parameters, out = inspect.signature(of).parameters, []
    for name, hint in typing.get_type_hints(of, include_extras=True).items():
        if typing.get_origin(hint) is Annotated and isinstance(hint.__metadata__[0], Option):
            plain, default = hint.__origin__, parameters[name].default
            kind = (typing.get_args(plain) or (plain,))[0]
            default = dataclasses.MISSING if default is inspect.Parameter.empty else default
            out.append(Declared(name, kind, typing.get_origin(plain) is tuple, default, hint.__metadata__[0]))
    return tuple(out)


def named_values(
    flag: str, texts: Iterable[str], form: str, names: Container[str] | None = None, value: str = ".+"
) -> dict[str, str]:
    """Split the texts NAME=VALUE of an option that may be repeated.

    flag: name of the option, for the error.
    form: what to write instead, for the error.
    names: allowed names; None: all.
    value: regular expression that a value must match.
    Returns: values by name.
    Raises: InputError where a text has another form, or a name is unknown or given twice.
    """
    out: dict[str, str] = {}
    for text in texts:
        name, _, given = text.partition("=")
        if not name or name in out or (names is not None and name not in names) or not re.fullmatch(value, given):
            raise InputError(f"{flag} {text} is not possible; give {form}, each once.")
        out[name] = given
    return out


RecordingPath = Annotated[
    Path, Option("Folder with recording.toml, that file, or a Pose2Sim project.", argument=True, value="RECORDING")
]
CalibrationFile = Annotated[Path | None, Option("Use this calibration file instead of the recording's.")]
FrameSpan = Annotated[
    str | None,
    Option("first:stop, counted from 0. [default: recording.toml's, else all]", value="A:B"),
]
Threads = Annotated[
    int | None, Option("Processor threads; the result does not depend on it. [default: all]", 1, 256, group=RUN)
]
Seed = Annotated[
    int, Option("Of every random draw; the same seed gives the same result.", 0, LARGEST_SEED, group=RESEARCH)
]
Seconds = Annotated[float, Option("Length of the recording.", 0, 3600, above=True, unit="seconds")]
Resume = Annotated[bool, Option("Go on where an interrupted run stopped.", group=RUN)]
Yes = Annotated[bool, Option("Fetch the detector's models, once, without asking.", group=RUN)]
Formats = Annotated[str, Option("Motion files to write.", value="LIST", group=OUTPUT)]
ListenHost = Annotated[str, Option("Address to listen on; others than this computer need the token.", group="Network")]
OscAddress = Annotated[str | None, Option("Where to send OSC to.", value="HOST:PORT", group=OUTPUT)]
TrackedPath = Annotated[
    Path, Option("Results folder of hypose track, or its motion.npz.", argument=True, value="RESULTS")
]
MotionPath = Annotated[
    Path, Option("Results folder of hypose track or hypose fuse, or its motion.npz.", argument=True, value="RESULTS")
]
OutFolder = Annotated[Path | None, Option("Folder to write to. [default: the results folder]")]

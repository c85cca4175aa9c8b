"""What a page asks of a gesture session: how it begins, and what is changed while it runs; checked here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from hypose.errors import InputError
from hypose.gestures.session import COMMANDS, Command, SessionSettings

PHASES = ("do_gesture", "positive", "release", "negative")


@dataclass(frozen=True)
class Start:
    """mode: train or run. gesture, resume (id of a model), settings: of a training. models: ids of a run. source: a
    value of the state's sources; fast: recordings and the simulated person are not slowed down to their pace."""

    mode: str
    source: str
    gesture: str = ""
    resume: str | None = None
    settings: SessionSettings = SessionSettings()
    models: tuple[str, ...] = ()
    seed: int = 0
    fast: bool = False


@dataclass
class Controls:
    """What a page changes while a session runs. box: where the gesture is asked for (px), None = the middle; threshold:
    cm^2, None = the automatic one; hold_s: how long a gesture must be held; map: the detection map is wanted."""

    box: tuple[float, float] | None = None
    threshold: float | None = None
    hold_s: float = 0.15
    map: bool = False


def read_start(message: Mapping[str, Any]) -> Start:
    """The start that a page asks for; an InputError says what cannot be."""
    mode, source, seed = message.get("mode"), message.get("source"), message.get("seed", 0)
    if mode not in ("train", "run"):
        raise InputError(f"There is no mode {mode!r}; choose train or run.")
    if not isinstance(source, str) or not source:
        raise InputError("There is no source; choose the simulated person, a recorded session or a camera.")
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**32:
        raise InputError(f"The seed is {seed!r}; give a whole number from 0 on.")
    fast = message.get("fast", False) is True
    if mode == "run":
        models = message.get("models")
        if not isinstance(models, list) or not 1 <= len(models) <= 16 or not all(isinstance(m, str) for m in models):
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        return Start("run", source, models=tuple(models), seed=seed, fast=fast)
    gesture, resume = message.get("gesture"), message.get("resume")
    if not isinstance(gesture, str) or not gesture.strip():
        raise InputError("The gesture has no name; type one, for example tee.")
    if resume is not None and not isinstance(resume, str):
        raise InputError("The gesture to go on with is not known; choose it from the list.")
    return Start("train", source, gesture.strip(), resume, _settings(message), seed=seed, fast=fast)


def _settings(message: Mapping[str, Any]) -> SessionSettings:
    seconds, rounds = message.get("seconds") or {}, message.get("rounds", 10)
    if not isinstance(seconds, dict) or not isinstance(rounds, int) or isinstance(rounds, bool):
        raise InputError("Rounds must be a whole number, and every phase a number of seconds.")
    given = {f"{name}_s": number(seconds[name], f"the seconds of {name}") for name in PHASES if name in seconds}
    return SessionSettings(rounds=rounds, **given)


def read_command(message: Mapping[str, Any]) -> Command:
    """The command of a message; an InputError lists the commands."""
    command = message.get("command")
    if command not in COMMANDS:
        raise InputError(f"There is no command {command!r}; the commands are {', '.join(COMMANDS)}.")
    return cast(Command, command)


def change(controls: Controls, message: Mapping[str, Any], size: tuple[int, int]) -> bool:
    """Take a change of box, threshold, hold or map; False when the message is none of these."""
    kind = message.get("t")
    if kind == "box":
        x, y = number(message.get("x"), "the box's x"), number(message.get("y"), "the box's y")
        controls.box = (min(max(x, 0.0), size[0] - 1.0), min(max(y, 0.0), size[1] - 1.0))
    elif kind == "threshold":
        value = message.get("value")
        if value is not None and number(value, "the threshold") <= 0:
            raise InputError("The threshold must be above 0 cm².")
        controls.threshold = None if value is None else float(value)
    elif kind == "hold":
        seconds = number(message.get("seconds"), "the time to hold")
        if not 0 <= seconds <= 10:
            raise InputError("A gesture can be held for 0 to 10 s before it counts.")
        controls.hold_s = seconds
    elif kind == "map":
        controls.map = message.get("on") is True
    else:
        return False
    return True


def number(value: Any, what: str) -> float:
    """A finite number; an InputError names what it is for."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"There is no number for {what} in {str(value)[:40]!r}.")
    return float(value)

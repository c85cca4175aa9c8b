"""What a page asks of a gesture session: how it begins, and what is changed while it runs; checked here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from hypose.app.studio.asked import choice, number, text, whole
from hypose.errors import InputError
from hypose.gestures.model import check_gesture_name
from hypose.gestures.session import COMMANDS, Command, SessionSettings

MOST_GESTURES = 8
"""Gestures that are taught one after the other."""
PHASES = ("do_gesture", "positive", "release", "negative")


@dataclass(frozen=True)
class Start:
    """mode: train or run. gesture, resume (id of a model), settings: of a training. then: gestures that are taught
    after it; taught: ids of the models before; all are tried in the end. models: ids of a run. source: a value of the
    state's sources; fast: recordings and the simulated person are not slowed down to their pace."""

    mode: str
    source: str
    gesture: str = ""
    resume: str | None = None
    settings: SessionSettings = SessionSettings()
    models: tuple[str, ...] = ()
    then: tuple[str, ...] = ()
    taught: tuple[str, ...] = ()
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
    mode = choice(message.get("mode"), "mode", ("train", "run"))
    source = text(message.get("source"), "source", 80, "choose the simulated person, a recorded session or a camera")
    seed = whole(message.get("seed", 0), "the seed", 0, 2**32 - 1)
    fast = message.get("fast", False) is True
    if mode == "run":
        models = message.get("models")
        if not isinstance(models, list) or not 1 <= len(models) <= 16 or not all(isinstance(m, str) for m in models):
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        return Start("run", source, models=tuple(models), seed=seed, fast=fast)
    gesture = text(message.get("gesture"), "name of the gesture", 64, "type one, for example tee")
    resume = message.get("resume")
    if resume is not None and not isinstance(resume, str):
        raise InputError("The gesture to go on with is not known; choose it from the list.")
    then = _then(message.get("then"), gesture.strip())
    return Start("train", source, gesture.strip(), resume, _settings(message), then=then, seed=seed, fast=fast)


def _then(value: Any, first: str) -> tuple[str, ...]:
    """The gestures that are taught after the first one."""
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MOST_GESTURES - 1:
        raise InputError(
            f"At most {MOST_GESTURES} gestures are taught in one session; teach the others in another one."
        )
    names = [text(v, "name of a gesture", 64, "type one, for example ok").strip() for v in value]
    for name in names:
        check_gesture_name(name)
    if len({first, *names}) <= len(names):
        raise InputError("A gesture is named twice; name each of them once.")
    return tuple(names)


def _settings(message: Mapping[str, Any]) -> SessionSettings:
    seconds, rounds = message.get("seconds") or {}, whole(message.get("rounds", 10), "the number of rounds", 1, 1000)
    if not isinstance(seconds, dict):
        raise InputError("Every phase must be given a number of seconds.")
    given = {f"{name}_s": number(seconds[name], f"the seconds of {name}", 0, 600) for name in PHASES if name in seconds}
    return SessionSettings(rounds=rounds, **given)


def read_command(message: Mapping[str, Any]) -> Command:
    """The command of a message; an InputError lists the commands."""
    return cast(Command, choice(message.get("command"), "command", COMMANDS))


def change(controls: Controls, message: Mapping[str, Any], size: tuple[int, int]) -> bool:
    """Take a change of box, threshold, hold or map; False when the message is none of these."""
    kind = message.get("t")
    if kind == "box":
        x, y = (number(message.get(k), f"the box's {k}", -1e9, 1e9) for k in ("x", "y"))
        controls.box = (min(max(x, 0.0), size[0] - 1.0), min(max(y, 0.0), size[1] - 1.0))
    elif kind == "threshold":
        value = message.get("value")
        controls.threshold = None if value is None else number(value, "the threshold (cm²)", 1e-3, 1e6)
    elif kind == "hold":
        controls.hold_s = number(message.get("seconds"), "the time to hold (s)", 0, 10)
    elif kind == "map":
        controls.map = message.get("on") is True
    else:
        return False
    return True

"""Check a page's requests to a gesture session: its start, its source of pictures, and changes while it runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from hypose.app.live.gesture_sources import GestureSource, Taken, open_source
from hypose.app.studio.http import digits, request_choice, request_number, text, whole
from hypose.errors import InputError
from hypose.gestures.model import check_gesture_name
from hypose.gestures.trainer import COMMANDS, Command, SessionSettings

MOST_GESTURES = 8
"""Most gestures that are taught one after the other."""
STUDIO_PHASES = ("do_gesture", "positive", "release", "negative")


@dataclass(frozen=True)
class SessionRequest:
    """Checked request to start a gesture session.

    mode: "train" or "run".
    source: one of the sources of the state.
    gesture: name, for training.
    resume: id of a model to train further.
    settings: of the training.
    models: ids of the models to run.
    then: gestures that are taught next.
    taught: ids of the models taught before; all are tried at the end.
    seed: of random numbers.
    fast: recordings and the simulated person are not slowed down to real time.
    """

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
    """Settings that a page changes while a session runs.

    box: (x, y) px where the gesture is asked for; None: the middle.
    threshold: cm^2; None: automatic.
    hold_s: time for which a gesture must be held, s.
    map: the map of votes is wanted.
    """

    box: tuple[float, float] | None = None
    threshold: float | None = None
    hold_s: float = 0.15
    map: bool = False


@dataclass(frozen=True)
class GestureFeed:
    """Source of pictures for a session.

    title: for the page.
    live: pictures of a camera arrive by themselves; others are shown at the pace of their times.
    knows: the box of a picture is the true place of the gesture, and None means that it is not shown.
    """

    source: GestureSource
    title: str
    live: bool = False
    knows: bool = True


def read_start(message: Mapping[str, Any]) -> SessionRequest:
    """Check the start message of a page.

    Raises: InputError names the faulty value.
    """
    mode = request_choice(message.get("mode"), "mode", ("train", "run"))
    source = text(message.get("source"), "source", 80, "choose the simulated person, a recorded session or a camera")
    seed = whole(message.get("seed", 0), "the seed", 0, 2**32 - 1)
    fast = message.get("fast", False) is True
    if mode == "run":
        models = message.get("models")
        if not isinstance(models, list) or not 1 <= len(models) <= 16 or not all(isinstance(m, str) for m in models):
            raise InputError("Choose 1 to 16 gestures to watch for; teach one first if there is none.")
        return SessionRequest("run", source, models=tuple(models), seed=seed, fast=fast)
    gesture, resume = text(message.get("gesture"), "name of the gesture", 64, "type one, for example tee").strip(), None
    if message.get("resume") is not None:
        resume = text(message["resume"], "gesture to go on with", 64, "choose it from the list")
    then = message.get("then") or []
    if not isinstance(then, list) or len(then) > MOST_GESTURES - 1:
        raise InputError(f"At most {MOST_GESTURES} gestures are taught in one session; teach the others in another.")
    names = [text(v, "name of a gesture", 64, "type one, for example ok").strip() for v in then]
    for name in names:
        check_gesture_name(name)
    if len({gesture, *names}) <= len(names):
        raise InputError("A gesture is named twice; name each of them once.")
    seconds, rounds = message.get("seconds") or {}, whole(message.get("rounds", 10), "the number of rounds", 1, 1000)
    if not isinstance(seconds, dict):
        raise InputError("Every phase must be given a number of seconds.")
    given = {
        f"{name}_s": request_number(seconds[name], f"the seconds of {name}", 0, 600)
        for name in STUDIO_PHASES
        if name in seconds
    }
    settings = SessionSettings(rounds=rounds, **given)
    return SessionRequest("train", source, gesture, resume, settings, then=tuple(names), seed=seed, fast=fast)


def read_command(message: Mapping[str, Any]) -> Command:
    """Return the command of a message.

    Raises: InputError lists the commands.
    """
    return cast(Command, request_choice(message.get("command"), "command", COMMANDS))


def change(controls: Controls, message: Mapping[str, Any], size: tuple[int, int]) -> bool:
    """Apply a change of box, threshold, hold or map; return False where the message is none of these."""
    kind = message.get("t")
    if kind == "box":
        x, y = (request_number(message.get(k), f"the box's {k}", -1e9, 1e9) for k in ("x", "y"))
        controls.box = (min(max(x, 0.0), size[0] - 1.0), min(max(y, 0.0), size[1] - 1.0))
    elif kind == "threshold":
        value = message.get("value")
        controls.threshold = None if value is None else request_number(value, "the threshold (cm²)", 1e-3, 1e6)
    elif kind == "hold":
        controls.hold_s = request_number(message.get("seconds"), "the time to hold (s)", 0, 10)
    elif kind == "map":
        controls.map = message.get("on") is True
    return kind in ("box", "threshold", "hold", "map")


def open_feed(start: SessionRequest, gesture: str, session: Callable[[str], Path]) -> GestureFeed:
    """Open the source of a start: simulated:N, session:ID or realsense. Why no others: a page must not open paths.

    session: gives the folder of a session's id.
    Raises: InputError for other sources.
    """
    kind, _, rest = start.source.partition(":")
    if kind == "simulated":
        person = digits(rest or "0", "the simulated person's number")
        return GestureFeed(open_source(f"simulated:{person}", gesture, start.seed), f"Simulated person {person + 1}")
    if kind == "session":
        path = session(rest)
        return GestureFeed(_from_zero(open_source(str(path), gesture)), f"Recorded session {path.name}")
    if start.source == "realsense":
        return GestureFeed(_from_zero(open_source("realsense")), "RealSense camera", live=True, knows=False)
    raise InputError(f"There is no source {start.source[:40]!r}; choose one of the list.")


def _from_zero(source: GestureSource) -> GestureSource:
    """Wrap a source so that its times start at 0."""
    first: list[float] = []

    def take(phase: str) -> Taken | None:
        taken = source.take(phase)
        if taken is None:
            return None
        first.append(taken.time)
        return replace(taken, time=taken.time - first[0])

    return replace(source, take=take)


def shut(feed: GestureFeed) -> None:
    """Close the source and ignore its errors, so that an unplugged camera does not lose a session."""
    with contextlib.suppress(OSError, RuntimeError):
        feed.source.close()

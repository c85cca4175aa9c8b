"""Where a session's pictures come from, and when: the simulated person, a recorded session, a depth camera."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from hypose.app.live.gesture_sources import Source, Taken, open_source
from hypose.app.studio.asked import digits
from hypose.errors import InputError


@dataclass(frozen=True)
class Feed:
    """live: a camera, whose pictures come when they come; others are shown at the pace of their times. knows: the box
    of a picture says where the gesture really is, and None that it is not seen."""

    source: Source
    title: str
    live: bool = False
    knows: bool = True


def open_feed(value: str, gesture: str, seed: int, session: Callable[[str], Path]) -> Feed:
    """The feed of a source's value in the protocol: simulated:N, session:ID or realsense. InputError for any other:
    a page opens no paths."""
    kind, _, rest = value.partition(":")
    if kind == "simulated":
        number = digits(rest or "0", "the simulated person's number")
        source = open_source(f"simulated:{number}", gesture, seed)
        return Feed(source, f"Simulated person {number + 1}")
    if kind == "session":
        path = session(rest)
        source = _from_zero(open_source(str(path), gesture))
        return Feed(source, f"Recorded session {path.name}")
    if value == "realsense":
        return Feed(_from_zero(open_source("realsense")), "RealSense camera", live=True, knows=False)
    raise InputError(f"There is no source {value[:40]!r}; choose one of the list.")


def _from_zero(source: Source) -> Source:
    """The source with its times counted from its first picture on."""
    first: list[float] = []

    def take(phase: str) -> Taken | None:
        taken = source.take(phase)
        if taken is None:
            return None
        if not first:
            first.append(taken.time)
        return replace(taken, time=taken.time - first[0])

    return replace(source, take=take)


def shut(feed: Feed) -> None:
    """Let go of the source; a camera that has been unplugged is no reason to lose a session."""
    with contextlib.suppress(OSError, RuntimeError):
        feed.source.close()

"""Where a session's pictures come from, and when: the simulated person, a recorded session, a depth camera."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hypose.app.live.gesture_sources import Source, Taken, open_source
from hypose.app.studio.asked import digits
from hypose.errors import InputError

PERSON_RATE = 15.0
"""Hz of the simulated person."""
_TEST_S = 2.0
"""The simulated person does the gesture every other so many seconds while it is not told what to do."""


@dataclass(frozen=True)
class Feed:
    """live: a camera, whose pictures come when they come; others are shown at the pace of their times. knows: the box
    of a picture says where the gesture really is, and None that it is not seen. clear: whether the last picture shows
    it or clearly does not."""

    source: Source
    title: str
    live: bool = False
    knows: bool = True
    clear: Callable[[], bool] = lambda: False


def open_feed(value: str, gesture: str, seed: int, session: Callable[[str], Path]) -> Feed:
    """The feed of a source's value in the protocol: simulated:N, session:ID or realsense. InputError for any other:
    a page opens no paths."""
    kind, _, rest = value.partition(":")
    if kind == "simulated":
        return _person(rest or "0", gesture, seed)
    if kind == "session":
        path = session(rest)
        source = _from_zero(open_source(str(path), gesture))
        return Feed(source, f"Recorded session {path.name}")
    if value == "realsense":
        return Feed(_from_zero(open_source("realsense")), "RealSense camera", live=True, knows=False)
    raise InputError(f"There is no source {value[:40]!r}; choose one of the list.")


def _person(who: str, gesture: str, seed: int) -> Feed:
    from hypose.gestures.depth_pictures import KINECT
    from hypose.synthetic.gesture_live import live_person

    number = digits(who, "the simulated person's number")
    frames = live_person(number, gesture, np.random.default_rng([93, seed, number]), PERSON_RATE)
    count, clear = 0, False

    def take(phase: str) -> Taken | None:
        nonlocal count, clear
        asked = phase in ("do_gesture", "positive")
        if phase in ("test", "free"):
            asked = int(count / PERSON_RATE / _TEST_S) % 2 == 1
        frame = frames.send(asked) if count else next(frames)
        count, clear = count + 1, frame.clear
        return Taken((count - 1) / PERSON_RATE, frame.depth, frame.point)

    source = Source(f"simulated:{number}", KINECT, (640, 480), take)
    return Feed(source, f"Simulated person {number + 1}", clear=lambda: clear)


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

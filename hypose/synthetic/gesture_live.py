"""A simulated person who moves as it is asked to: smooth ways between poses, seen by the simulated sensor.

What a session with a screen shows where there is no camera. Unlike the independent pictures of `gesture_sessions`,
neighbouring frames are alike, as they are of a real person.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from hypose.compute import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT
from hypose.synthetic.gesture_people import Puppet, load_people
from hypose.synthetic.gesture_poses import GESTURES, Keyframe, annotated, apply, gesture, movement
from hypose.synthetic.gesture_scenes import (
    PICTURE_SIZE,
    Setting,
    handedness,
    make_gesture_room,
    make_view,
    render,
    stand_at,
)

_OTHERS = 0.3
"""Share of ways that lead to another gesture while none is asked for."""
_HIDDEN = 0.06
"""m: something nearer than the annotated point by more hides it."""
_REACH, _VARY, _MOVE = (0.55, 0.8), (0.4, 0.7), (0.5, 1.2)
"""s: how long the way into the gesture takes, from one variation of it to the next, and any other way."""


@dataclass(frozen=True)
class SimulatedFrame:
    """depth (480, 640) uint16 mm; point: the pixel of the gesture, None while it is not done or not seen; clear: the
    gesture is done and seen, or not done at all: not on the way to or from it, and not hidden."""

    depth: DepthImage
    point: tuple[float, float] | None
    clear: bool


def live_person(number: int, name: str, rng: np.random.Generator, rate: float) -> Generator[SimulatedFrame, bool, None]:
    """Endless frames at a rate (Hz) of person `number` in a furnished room before a fixed camera.

    `send(True)` after the first frame asks for the gesture, `send(False)` for anything else. InputError when there is
    no such person or gesture."""
    people = load_people()
    if not 0 <= number < len(people):
        raise InputError(f"There is no simulated person {number}; they have the numbers 0 to {len(people) - 1}.")
    if name not in GESTURES:
        raise InputError(f"The simulated person cannot do {name!r}; the gestures are {', '.join(GESTURES)}.")
    return _frames(number, Puppet(people[number]), name, rng, rate)


def _frames(
    number: int, puppet: Puppet, name: str, rng: np.random.Generator, rate: float
) -> Generator[SimulatedFrame, bool, None]:
    setting = Setting.new(make_gesture_room(rng, "furnished"), make_view(rng, rng.uniform(1.5, 2.3)))
    leading = handedness(number)
    others = [g for g in GESTURES if g != name]
    start = goal = movement(puppet, rng)
    shows = asked = False  # the goal is the gesture; the gesture is wanted
    arrived = leaving = False  # the way leads from one variation of the gesture to the next; out of the gesture
    share, seconds = 1.0, 1.0
    while True:
        if asked != shows or share >= 1:
            start = start.towards(goal, _eased(share))
            leaving = shows and not asked
            arrived = shows and asked and share >= 1
            goal = _goal(puppet, name if asked else None, others, leading, rng)
            seconds = float(rng.uniform(*(_MOVE if not asked else _VARY if arrived else _REACH)))
            share, shows = 0.0, asked
        share = min(1.0, share + 1 / (rate * seconds))
        apply(puppet, start.towards(goal, _eased(share)))
        doing = shows and (arrived or share >= 1)
        frame = _seen(puppet, setting, name if doing else None, leading, rng)
        asked = bool((yield frame if doing or not (shows or leaving) else replace(frame, clear=False)))


def _eased(share: float) -> float:
    return share * share * (3 - 2 * share)


def _goal(puppet: Puppet, name: str | None, others: list[str], leading: str, rng: np.random.Generator) -> Keyframe:
    if name is None and rng.random() >= _OTHERS:
        return movement(puppet, rng)
    return gesture(puppet, name or str(rng.choice(others)), rng, leading)[0]


def _seen(puppet: Puppet, setting: Setting, name: str | None, leading: str, rng: np.random.Generator) -> SimulatedFrame:
    view = setting.view
    depth, inverse = render([(puppet.person, stand_at(puppet))], setting.behind, view, rng)
    if name is None:
        return SimulatedFrame(depth, None, True)
    p = view.points(annotated(puppet, name, leading) - [0, 0, puppet.person.ground])
    x, y = float(p[0] / p[2] * KINECT.fx + KINECT.cx), float(p[1] / p[2] * KINECT.fy + KINECT.cy)
    if not (25 < x < PICTURE_SIZE[0] - 25 and 25 < y < PICTURE_SIZE[1] - 25):
        return SimulatedFrame(depth, None, False)
    window = inverse[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4]
    hidden = np.abs(1 / np.maximum(window, 1e-3) - p[2]).min() > _HIDDEN
    return SimulatedFrame(depth, None if hidden else (x, y), not hidden)

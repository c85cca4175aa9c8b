"""Sets of simulated depth pictures for the gesture benchmarks: who, where, what, and which share shows the gesture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.depth_gestures.gesture_pictures import CLUTTERED, TRAINING, UNSEEN, GestureFrame, Stage, picture
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.online import Example, Learner
from hypose.synthetic.gesture_people import GESTURES
from hypose.synthetic.gesture_scenes import Setting, make_gesture_room, make_view

TRAINED = tuple(range(12))
"""People in training pictures; three of them left-handed."""
TESTED = tuple(range(12, 18))
"""People in test pictures; one of them left-handed."""
SHARE = 0.25
"""Of the test pictures of a gesture show it; the others are half other gestures, half movement, and a quarter of the
movement is of kinds that no training picture shows."""


@dataclass(frozen=True)
class Size:
    """Pictures of one seed: training (per gesture, of movement) and test (per gesture)."""

    train_each: int
    train_movement: int
    test_each: int


FULL, QUICK = Size(80, 400, 24), Size(16, 64, 8)
SEEDS = 3
"""Of every table, unless another number is asked for."""


Tick = Callable[[int, int], None]


def training_set(
    size: Size,
    rng: np.random.Generator,
    stage: Stage = TRAINING,
    gestures: Sequence[str] = GESTURES,
    tick: Tick | None = None,
) -> list[GestureFrame]:
    """Pictures of the trained people: every gesture and movement, in a random order."""
    kinds = [g for g in gestures for _ in range(size.train_each)] + ["movement"] * size.train_movement
    return _shoot(kinds, TRAINED, stage, rng, tick)


def test_set(
    size: Size,
    rng: np.random.Generator,
    stage: Stage = CLUTTERED,
    gestures: Sequence[str] = GESTURES,
    tick: Tick | None = None,
) -> list[GestureFrame]:
    """Pictures of the tested people, enough for `for_gesture`."""
    others = round(size.test_each * (1 / SHARE - 1))
    movement = others - others // 2
    strange = [UNSEEN[k % len(UNSEEN)] for k in range(movement // 4)]
    kinds = [g for g in gestures for _ in range(size.test_each)] + strange + ["movement"] * (movement - len(strange))
    return _shoot(kinds, TESTED, stage, rng, tick)


def for_gesture(frames: Sequence[GestureFrame], gesture: int) -> list[GestureFrame]:
    """The test of one gesture: all its pictures, all movement, and as many of other gestures as SHARE asks for."""
    shown = [f for f in frames if f.gesture == gesture]
    movement = [f for f in frames if f.gesture == 0]
    other = [f for f in frames if f.gesture not in (0, gesture)]
    wanted = max(0, round(len(shown) * (1 / SHARE - 1)) - len(movement))
    step = max(1, len(other) // max(wanted, 1))
    return shown + movement + other[::step][:wanted]


def two_fixed_rooms(rng: np.random.Generator, distance: float = 1.8) -> Stage:
    """Training as in the thesis: two empty rooms, each with its own fixed camera, nobody else."""
    settings = tuple(Setting(make_gesture_room(rng, "empty"), make_view(rng, distance)) for _ in range(2))
    return Stage(("empty",), 0.0, settings=settings)


def examples(frames: Iterable[GestureFrame], gesture: int) -> list[Example]:
    """The frames as one against all: every other gesture is background."""
    return [Example(f.depth, KINECT, 1, f.x, f.y) if f.gesture == gesture else Example(f.depth, KINECT) for f in frames]


def thinned(frames: Sequence[Example], share: float, rng: np.random.Generator) -> list[Example]:
    """All positive examples and a random share of the negative ones."""
    return [e for e in frames if e.gesture or rng.random() < share]


def _shoot(
    kinds: Sequence[str], people: Sequence[int], stage: Stage, rng: np.random.Generator, tick: Tick | None
) -> list[GestureFrame]:
    out = []
    for k, i in enumerate(rng.permutation(len(kinds)).tolist()):
        who = people[k % len(people)]
        out.append(picture(who, str(kinds[i]), stage, rng, [p for p in people if p != who]))
        if tick is not None:
            tick(k + 1, len(kinds))
    return out


def teach(learner: Learner, examples: Sequence[Example], *, shuffle: bool = False) -> None:
    """Show all examples once, in their order or in one drawn from the learner's random numbers."""
    order = learner.rng.permutation(len(examples)) if shuffle else np.arange(len(examples))
    for k in order.tolist():
        e = examples[k]
        if e.gesture:
            learner.show(e.depth, e.lens, e.x, e.y)
        else:
            learner.reject(e.depth, e.lens)

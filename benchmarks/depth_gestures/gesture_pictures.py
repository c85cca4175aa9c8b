"""Independent simulated depth pictures of people doing gestures, and of poses that no training picture shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.geometry import Array, transform
from hypose.gestures.depth_pictures import KINECT
from hypose.synthetic.gesture_people import (
    GESTURES,
    ArmGoal,
    Doer,
    GesturePerson,
    Keyframe,
    Puppet,
    apply,
    gesture,
    load_people,
    movement,
)
from hypose.synthetic.gesture_scenes import (
    PICTURE_SIZE,
    GestureRoom,
    Setting,
    handedness,
    make_gesture_room,
    make_view,
    render,
    stand_at,
)

UNSEEN = ("folded_arms", "hands_on_hips", "phone", "three_fingers", "bottle")
"""Kinds of negative that occur in tests only, never in training."""


@dataclass(frozen=True)
class GestureFrame:
    """depth (480, 640) uint16 mm; gesture: 1 to 6, 0 = none; x, y px and position (3,) m in the camera's frame of the
    annotated point (NaN when there is none); person: number; kind: what is shown."""

    depth: DepthImage
    gesture: int
    x: float
    y: float
    position: Array
    person: int
    kind: str


@dataclass(frozen=True)
class Stage:
    """Where pictures are taken: level of the room, share of pictures with a second person; distance range (m) of the
    camera; settings: fixed rooms with their cameras to choose from instead of a new one for each picture."""

    levels: tuple[str, ...] = ("empty", "furnished")
    second: float = 0.12
    distance: tuple[float, float] = (1.2, 3.0)
    settings: tuple[Setting, ...] = ()

    def choose(self, rng: np.random.Generator) -> Setting:
        """A room and a camera."""
        if self.settings:
            return self.settings[int(rng.integers(len(self.settings)))]
        return Setting(
            make_gesture_room(rng, str(rng.choice(self.levels))), make_view(rng, rng.uniform(*self.distance))
        )


TRAINING, CLUTTERED = Stage(), Stage(("cluttered",), 0.7)


def picture(person: int, kind: str, stage: Stage, rng: np.random.Generator, others: Sequence[int] = ()) -> GestureFrame:
    """One picture of a person doing a gesture, "movement" or an unseen negative; others: who may be the second person.

    A gesture is always visible: where clutter hides it or the picture cuts it, room and pose are drawn again."""
    everyone = load_people()
    puppet = Puppet(everyone[person])
    while True:
        setting = stage.choose(rng)
        view = setting.view
        point = None
        if kind in GESTURES:
            _, point = gesture(puppet, kind, rng, handedness(person))
            point = point - [0, 0, puppet.person.ground]
        elif kind in UNSEEN:
            apply(puppet, unseen(puppet, kind, rng, handedness(person)))
        else:
            apply(puppet, movement(puppet, rng))
        shown = [(puppet.person, stand_at(puppet))]
        if others and rng.random() < stage.second:
            shown.append(bystander(everyone[others[int(rng.integers(len(others)))]], setting.room, rng))
        x = y = np.nan
        position = np.full(3, np.nan)
        if point is not None:
            position = transform(view, point[None])[0]
            x = float(position[0] / position[2] * KINECT.fx + KINECT.cx)
            y = float(position[1] / position[2] * KINECT.fy + KINECT.cy)
            if not (25 < x < PICTURE_SIZE[0] - 25 and 25 < y < PICTURE_SIZE[1] - 25):
                continue
        depth, inverse = render(shown, setting.behind, view, rng)
        if point is not None:
            window = slice(int(y) - 3, int(y) + 4), slice(int(x) - 3, int(x) + 4)
            if np.abs(1 / np.maximum(inverse[window], 1e-3) - position[2]).min() > 0.06:
                continue
            if 1 / np.maximum(setting.behind[window], 1e-3).max() < position[2] + 0.03:  # furniture before the hand
                continue
        number = GESTURES.index(kind) + 1 if kind in GESTURES else 0
        return GestureFrame(depth, number, x, y, position, person, kind)


def bystander(person: GesturePerson, room: GestureRoom, rng: np.random.Generator) -> tuple[GesturePerson, Array]:
    """A second person who moves beside or behind the first."""
    puppet = Puppet(person)
    apply(puppet, movement(puppet, rng))
    at = (float(rng.choice([-1, 1]) * rng.uniform(0.25, 1.1)), float(rng.uniform(0.3, max(0.5, room.wall))))
    return person, stand_at(puppet, rng.uniform(-3, 3), at)


def unseen(puppet: Puppet, kind: str, rng: np.random.Generator, leading: str = "right") -> Keyframe:
    """One of the UNSEEN kinds of negative."""
    do = Doer(puppet, rng, leading, 1.0)
    lead_x = -1.0 if leading == "right" else 1.0
    if kind == "folded_arms":
        arms = []
        for side, x, z in ((do.lead, 1, 0.0), (do.other, -1, -0.05)):
            wrist = do.middle + do.way(0.12 * x, -0.24, -0.22 + z, 0.02)
            arms.append(
                ArmGoal(
                    wrist,
                    do.way(x, -0.1, 0.1, 0.1),
                    do.way(0, 1, 0, 0.1),
                    do.elbow(-x, 0, -0.6),
                    do.shape(side, "relaxed"),
                )
            )
        return do.keyframe(*arms)
    if kind == "hands_on_hips":
        arms = []
        for side, x in ((do.lead, -1), (do.other, 1)):
            wrist = puppet.at("pelvis") + do.way(0.17 * x, -0.06, 0.12, 0.02)
            arms.append(
                ArmGoal(
                    wrist,
                    do.way(-x, -0.5, -0.4, 0.1),
                    do.way(0, 0.4, -1, 0.1),
                    do.elbow(x, 0.3, 0),
                    do.shape(side, "relaxed"),
                )
            )
        return do.keyframe(*arms)
    if kind == "phone":
        ear = puppet.at("head") + do.way(lead_x * do.mirror[0] * 0.11, -0.02, 0.03, 0.01)
        goal = ArmGoal(
            ear + do.way(0, -0.03, -0.09),
            do.way(0.1, 0.1, 1, 0.1),
            do.way(1, 0, 0, 0.1),
            do.elbow(-0.7, -0.2, -1),
            do.shape(do.lead, "grip"),
        )
        return do.keyframe(goal)
    if kind not in UNSEEN:
        raise InputError(f"There is no movement {kind!r}; the kinds are {', '.join(UNSEEN)}.")
    wrist = do.lead_shoulder + do.way(-0.06, -0.34, 0.0, 0.05)
    f, n = (do.way(0, -0.1, 1, 0.1), do.way(0, -1, 0, 0.1))
    hand = do.shape(do.lead, "three" if kind == "three_fingers" else "grip")
    if kind == "bottle":
        f, n = do.way(0.6, -0.7, 0.2, 0.15), do.way(0.7, 0.6, 0, 0.15)
    return do.keyframe(ArmGoal(wrist, f, n, do.elbow(-0.6, 0.3, -1), hand))

"""Depth pictures of people who show gestures in rooms, as a structured-light sensor would deliver them, with the truth.

World: the person stands at the origin and faces -y, z up, floor at z = 0, metres. Cameras look along +y.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.compute import depth_sensor
from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.geometry import Array, se3, transform
from hypose.gestures.depth_pictures import KINECT
from hypose.synthetic.gesture_people import (
    GESTURES,
    GesturePerson,
    Puppet,
    annotated,
    apply,
    gesture,
    load_people,
    movement,
    rotation_about,
)
from hypose.synthetic.scenes import box_mesh, joined_meshes

PICTURE_SIZE = (640, 480)
_PINHOLE = (KINECT.fx, KINECT.fy, KINECT.cx, KINECT.cy)


def _floor() -> tuple[Array, NDArray[np.int32]]:
    """Make the floor, 8 x 8 m, in tiles: those that reach behind the camera are omitted when it is drawn."""
    x, y = np.meshgrid(np.arange(-4, 5.0), 0.8 * np.arange(-5, 6), indexing="ij")
    i, j = (g.ravel() for g in np.mgrid[:8, :10])
    a = i * 11 + j
    faces = np.concatenate([np.stack([a, a + 11, a + 12], 1), np.stack([a, a + 12, a + 1], 1)])
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1), faces.astype(np.int32)


_FLOOR = _floor()


@dataclass(frozen=True)
class GestureRoom:
    """Mesh of a room.

    vertices: (V, 3) m in the world.
    faces: (F, 3).
    wall: distance of the back wall behind the person, m.
    """

    vertices: Array
    faces: NDArray[np.int32]
    wall: float


def make_gesture_room(rng: np.random.Generator, level: str) -> GestureRoom:
    """Make a random room.

    rng: random numbers.
    level: "empty" (floor and a wall far behind), "furnished", or "cluttered" close to the person.
    """
    parts: list[tuple[Array, NDArray[np.int32]]] = []

    def box(centre: Sequence[float], size: Sequence[float], yaw: float) -> None:
        vertices, faces = box_mesh((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
        parts.append((vertices * size @ rotation_about([0, 0, 1], yaw).T + centre, faces))

    wall = rng.uniform(1.6, 2.6) if level == "empty" else rng.uniform(0.5, 2.5)
    box([0, wall + 0.1, 1.5], [14, 0.2, 5], rng.uniform(-0.25, 0.25))
    parts.append(_FLOOR)
    count = {"empty": 0, "furnished": rng.integers(3, 6), "cluttered": rng.integers(8, 15)}[level]
    for _ in range(int(count)):
        if rng.random() < 0.6:
            size = [rng.uniform(0.1, 1.2), rng.uniform(0.1, 0.8), rng.uniform(0.1, 2)]
        else:
            size = [rng.uniform(0.02, 0.12), rng.uniform(0.02, 0.12), rng.uniform(0.5, 2)]
        y = rng.uniform(-0.6, wall)
        x = rng.choice([-1, 1]) * rng.uniform(0.55, 1.8) if y < 0.45 else rng.uniform(-1.8, 1.8)
        z = size[2] / 2 if rng.random() < 0.6 else rng.uniform(0.3, 2)
        box([x, y, z], size, rng.uniform(-1.5, 1.5))
    return GestureRoom(*joined_meshes(parts), float(wall))


def make_view(rng: np.random.Generator, distance: float) -> Array:
    """Make the place of a random camera `distance` m in front of the person, 1.0 to 1.6 m high, up to 20 degrees to the
    side.

    Returns: camera_from_world (4, 4), m.
    """
    height, yaw = rng.uniform(1.0, 1.6), np.deg2rad(rng.uniform(-20, 20))
    tilt = np.arctan2(height - 1.25, distance) + rng.normal(0, 0.03)
    position = np.array([np.sin(yaw) * distance, -np.cos(yaw) * distance, height])
    forward = rotation_about([0, 0, 1], yaw + rng.normal(0, 0.06)) @ np.array([0.0, 1, 0])
    right = np.cross(forward, [0, 0, 1])
    forward = rotation_about(right, -tilt) @ forward
    rotation = np.stack([right, np.cross(forward, right), forward])
    return se3(rotation, -rotation @ position)


def render(
    people: Sequence[tuple[GesturePerson, Array]],
    behind: NDArray[np.float32],
    view: Array,
    rng: np.random.Generator,
) -> tuple[DepthImage, NDArray[np.float32]]:
    """Render people in front of a backdrop with a simulated depth sensor.

    people: (person, vertices in the world) of each.
    behind: (480, 640) inverse depth of the empty room, 1/m (`Setting.behind`).
    view: camera_from_world (4, 4), m.
    Returns: depth (480, 640) uint16 mm as sensed, and the exact inverse depth (480, 640) 1/m.
    """
    inverse = behind.copy()
    for person, vertices in people:
        depth_sensor.draw(transform(view, vertices), person.faces, _PINHOLE, inverse)
    return depth_sensor.sense(inverse, KINECT.fx, rng), inverse


def stand_at(puppet: Puppet, yaw: float = 0.0, at: Sequence[float] = (0, 0)) -> Array:
    """Return the vertices (V, 3) m of a posed person who stands on the floor at a place, turned by yaw (rad)."""
    return puppet.skin() @ rotation_about([0, 0, 1], yaw).T + [at[0], at[1], -puppet.person.ground]


def handedness(person: int) -> str:
    """Return the leading side of a person: every fourth one is left-handed."""
    return "left" if person % 4 == 3 else "right"


@dataclass(frozen=True)
class Setting:
    """Room seen by a camera.

    room: the room.
    view: camera_from_world (4, 4), m.
    """

    room: GestureRoom
    view: Array

    @cached_property
    def behind(self) -> NDArray[np.float32]:
        """Picture (480, 640) of the inverse depth of the empty room, 1/m."""
        inverse = np.zeros((PICTURE_SIZE[1], PICTURE_SIZE[0]), np.float32)
        depth_sensor.draw(transform(self.view, self.room.vertices), self.room.faces, _PINHOLE, inverse)
        return inverse


# ---- a simulated depth camera that films gestures --------------------------------------------------------------------
# A simulated person who shows a gesture on demand: smooth movements between poses, seen by the simulated sensor.
#
# A session with a screen shows it where there is no camera. Neighbouring frames are similar, as those of a real person.


# Share of movements that are another gesture while the gesture is not asked for.
_OTHERS = 0.3
# m; a surface nearer than the annotated point by more hides it.
_HIDDEN = 0.06
# s, least and largest duration of the movement into the gesture, between two variations of it, and of any other
# movement.
_REACH, _VARY, _MOVE = (0.55, 0.8), (0.4, 0.7), (0.5, 1.2)


@dataclass(frozen=True)
class SimulatedFrame:
    """Frame of the simulated depth camera.

    depth: (480, 640) uint16 mm.
    point: pixel of the gesture; None while it is not shown or not visible.
    clear: whether the gesture is shown and visible, or not shown at all; False on the way to and from it, and where it
        is hidden.
    """

    depth: DepthImage
    point: tuple[float, float] | None
    clear: bool


def live_person(number: int, name: str, rng: np.random.Generator, rate: float) -> Generator[SimulatedFrame, bool, None]:
    """Yield endless frames of a simulated person in a furnished room before a fixed camera.

    number: number of the person.
    name: name of the gesture.
    rate: Hz.

    After the first frame, the caller sends True to the generator where the person is to show the gesture, and False
    where the person is to do anything else.
    Raises: InputError for an unknown person or gesture.
    """
    people = load_people()
    if not 0 <= number < len(people):
        raise InputError(f"There is no simulated person {number}; they have the numbers 0 to {len(people) - 1}.")
    if name not in GESTURES:
        raise InputError(f"The simulated person cannot do {name!r}; the gestures are {', '.join(GESTURES)}.")
    return _frames(number, Puppet(people[number]), name, rng, rate)


def _frames(
    number: int, puppet: Puppet, name: str, rng: np.random.Generator, rate: float
) -> Generator[SimulatedFrame, bool, None]:
    """Yield the frames of `live_person`.

    number: number of the person, which decides the leading hand.
    puppet: the person, who is posed.
    name: name of the gesture.
    rng: random numbers.
    rate: Hz.
    """
    setting = Setting(make_gesture_room(rng, "furnished"), make_view(rng, rng.uniform(1.5, 2.3)))
    leading = handedness(number)
    others = [g for g in GESTURES if g != name]
    start = goal = movement(puppet, rng)
    shows = asked = False  # the goal is the gesture; the gesture is asked for
    arrived = leaving = False  # moving from one variation of the gesture to the next; moving out of the gesture
    share, seconds = 1.0, 1.0
    while True:
        if asked != shows or share >= 1:
            start = start.towards(goal, share * share * (3 - 2 * share))
            leaving = shows and not asked
            arrived = shows and asked and share >= 1
            if asked or rng.random() < _OTHERS:
                goal = gesture(puppet, name if asked else str(rng.choice(others)), rng, leading)[0]
            else:
                goal = movement(puppet, rng)
            seconds = float(rng.uniform(*(_MOVE if not asked else _VARY if arrived else _REACH)))
            share, shows = 0.0, asked
        share = min(1.0, share + 1 / (rate * seconds))
        apply(puppet, start.towards(goal, share * share * (3 - 2 * share)))  # it starts and ends slowly
        doing = shows and (arrived or share >= 1)
        frame = _seen(puppet, setting, name if doing else None, leading, rng)
        asked = bool((yield frame if doing or not (shows or leaving) else replace(frame, clear=False)))


def _seen(puppet: Puppet, setting: Setting, name: str | None, leading: str, rng: np.random.Generator) -> SimulatedFrame:
    """Render the simulated person as posed.

    puppet: the person.
    setting: room and camera.
    name: gesture that is shown; None: none.
    leading: side of the leading hand.
    rng: random numbers of the sensor.
    Returns: the frame; without a point where the gesture is hidden or less than 25 px from the border.
    """
    view = setting.view
    depth, inverse = render([(puppet.person, stand_at(puppet))], setting.behind, view, rng)
    if name is None:
        return SimulatedFrame(depth, None, True)
    p = transform(view, annotated(puppet, name, leading)[None] - [0, 0, puppet.person.ground])[0]
    x, y = float(p[0] / p[2] * KINECT.fx + KINECT.cx), float(p[1] / p[2] * KINECT.fy + KINECT.cy)
    if not (25 < x < PICTURE_SIZE[0] - 25 and 25 < y < PICTURE_SIZE[1] - 25):
        return SimulatedFrame(depth, None, False)
    window = inverse[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4]
    hidden = np.abs(1 / np.maximum(window, 1e-3) - p[2]).min() > _HIDDEN
    return SimulatedFrame(depth, None if hidden else (x, y), not hidden)

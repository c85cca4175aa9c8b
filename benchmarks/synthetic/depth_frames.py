"""Frames of simulated depth scenes, seen as recordings of depth cameras are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.evidence.depth_background import (
    STILL_FRAMES,
    DepthBackground,
    behind_things,
    learn_background,
    person_before,
    person_on_floor,
    unlike_people,
)
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import DepthMap
from hypose.synthetic.depth_scenes import DepthScene


def empty_rooms(scene: DepthScene, frames: int = 20) -> list[DepthBackground]:
    """What is learnt of the empty room, sensor by sensor."""
    return [learn_background([scene.empty_map(c, k) for k in range(frames)]) for c in range(len(scene.rig))]


def depth_frames(scene: DepthScene, people: bool = False, empty: bool = True) -> Iterator[Frame]:
    """Frames with depth and the silhouettes that come with it, as they are of recordings. people: with everybody in
    them; empty: the empty room was recorded."""
    views = range(len(scene.rig))
    rooms = empty_rooms(scene) if empty else []
    few = np.unique(np.linspace(0, len(scene) - 1, min(STILL_FRAMES, len(scene))).round().astype(int))
    things = [unlike_people([scene.depth_map(c, t) for t in few], scene.rig[c]) for c in views if not empty]
    for t in range(len(scene)):
        maps = [scene.depth_map(c, t) for c in views]
        at = float(scene.times[t])
        yield (
            seen_before(rooms, maps, scene.rig, at, t, people)
            if empty
            else seen_on_floor(things, maps, scene.rig, at, t, people)
        )


def seen_before(
    rooms: Sequence[DepthBackground],
    maps: Sequence[DepthMap],
    rig: CameraRig,
    at: float,
    index: int,
    people: bool = False,
) -> Frame:
    """The frame of maps (h, w) m at a time (s), whose rooms are known, as it is for recordings; people: with everybody
    in it."""
    known = zip(maps, rooms, rig, strict=True)
    masks = [person_before(m, room, c.K[0, 0], people) for m, room, c in known]
    silhouettes = make_silhouettes(masks, rig)
    depth = Depth(np.stack(maps), silhouettes.masks, rig, silhouettes.usable.copy())
    return Frame(at, index, silhouettes if people else behind_things(silhouettes, depth, rooms), depth=depth)


def seen_on_floor(
    things: Sequence[DepthMap], maps: Sequence[DepthMap], rig: CameraRig, at: float, index: int, people: bool = False
) -> Frame:
    """The same where the empty room was not recorded; things (h, w) m: what stands still and is nobody
    (`unlike_people`)."""
    masks = [person_on_floor(m, c, t, people) for m, c, t in zip(maps, rig, things, strict=True)]
    silhouettes = make_silhouettes(masks, rig)
    return Frame(at, index, silhouettes, depth=Depth(np.stack(maps), silhouettes.masks, rig, silhouettes.usable.copy()))

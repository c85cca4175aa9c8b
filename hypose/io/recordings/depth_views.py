"""The depth maps of one view of a recording, by frame number, undistorted and at working size, and who is in them."""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.evidence.depth_background import (
    STILL_FRAMES,
    DepthBackground,
    DepthMap,
    learn_background,
    people_before,
    people_on_floor,
    person_before,
    person_on_floor,
    unlike_people,
    with_still_things,
)
from hypose.io.recordings.recording_views import View
from hypose.io.sensors.depth import read_depth_png
from hypose.io.videos.video import frame_size, list_images

_KEPT = 8
_ROOM_FRAMES = 30
"""maps of the empty room that are looked at, at most"""


class DepthPreparer:
    """Stored depth maps of a camera as those of the pinhole `small`; shift: px of the calibrated size added to image
    positions."""

    def __init__(self, camera: Camera, small: Camera, shift: tuple[float, float]) -> None:
        self._small = small
        self._maps = camera.undistort_maps(small.size, small.size)
        # a fisheye lens bends rays without coefficients, too
        self._plain = not (camera.fisheye or np.any(camera.distortion)) and tuple(shift) == (0, 0)
        scale = small.size[0] / camera.size[0], small.size[1] / camera.size[1]
        self._shift = shift[0] * scale[0], shift[1] * scale[1]

    def __call__(self, depth: DepthMap) -> DepthMap:
        """(h, w) m of the working size."""
        stored = depth.shape[1], depth.shape[0]
        if self._plain and stored == self._small.size:
            return depth
        # the nearest pixel: between two values lies nothing that was measured
        x, y = (m - np.float32(s) for m, s in zip(self._maps, self._shift, strict=True))
        sx, sy = stored[0] / self._small.size[0], stored[1] / self._small.size[1]
        x, y = (
            (x + np.float32(0.5)) * np.float32(sx) - np.float32(0.5),
            (y + np.float32(0.5)) * np.float32(sy) - np.float32(0.5),
        )
        return np.asarray(cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderValue=0), dtype=np.float32)


class DepthSource:
    """Depth maps of a view whose `depth` is a folder of 16-bit PNG in millimetres; `background`: one of the empty room.
    people: several are to be seen. Used by one thread at a time, but for maps that
    are kept."""

    def __init__(self, view: View, camera: Camera, small: Camera, people: bool = False) -> None:
        if view.depth is None:
            raise InputError(f"View {view.name} has no depth; give its folder of 16-bit PNG in millimetres.")
        self.view, self._small, self._people = view, small, people
        self._files = list_images(view.depth)
        self._prepared = DepthPreparer(camera, small, view.image_shift)
        self._stored: tuple[int, int] | None = None
        self._kept: OrderedDict[int, DepthMap] = OrderedDict()

    def map(self, frame: int) -> DepthMap:
        """(h, w) float32 m of a frame, 0 = hole; an InputError names what cannot be read."""
        found = self._kept.get(frame)
        if found is None:
            if not 0 <= frame < len(self._files):
                raise InputError(f"{self.view.depth} has the frames 0 to {len(self._files) - 1}, not {frame}.")
            found = self._kept[frame] = self._prepared(self._read(self._files[frame]))
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return found

    def person(self, frame: int) -> NDArray[np.uint8]:
        """(h, w) 0/1: who stands before the empty room, or on the floor where that is not known; everybody, if several
        are to be seen."""
        room, camera = self.furnished[0], self._small
        depth = self.map(frame)
        if room is None:
            return (people_on_floor if self._people else person_on_floor)(depth, camera, self._unlike_people)
        return people_before(depth, room) if self._people else person_before(depth, room, camera.K[0, 0])

    @cached_property
    def room(self) -> DepthBackground | None:
        """The empty room, None when there is no recording of it."""
        if self.view.background is None:
            return None
        files = list_images(self.view.background)
        chosen = np.unique(np.linspace(0, len(files) - 1, min(_ROOM_FRAMES, len(files))).round().astype(int))
        return learn_background([self._prepared(self._read(files[k])) for k in chosen])

    @cached_property
    def furnished(self) -> tuple[DepthBackground | None, float]:
        """The room with things that stand still in the recording and were not there when it was empty, and how much of
        them is seen, m^2; as it was where several people are to be seen, who may stand still."""
        room = self.room
        if room is None or self._people:
            return room, 0.0
        maps = [m for m in self._spread() if m.shape == room.depth.shape]
        return with_still_things(room, maps, self._small) if len(maps) > 4 else (room, 0.0)

    @cached_property
    def _unlike_people(self) -> DepthMap | None:
        """(h, w) m: what of the recording stands still and is not like a person; None when no map can be read."""
        maps = self._spread()
        return unlike_people(maps, self._small) if maps else None

    def _spread(self) -> list[DepthMap]:
        """Some maps, evenly over the recording."""
        count, maps = len(self._files), list[DepthMap]()
        for k in np.unique(np.linspace(0, count - 1, min(STILL_FRAMES, count)).round().astype(int)):
            with contextlib.suppress(InputError):  # a damaged map is named where its frame is asked for
                maps.append(self._prepared(self._read(self._files[k])))
        return maps

    def _read(self, file: Path) -> DepthMap:
        """A map as it is stored; an InputError when it has not the size of the view's first."""
        if self._stored is None:
            self._stored = frame_size(self._files[0])
        depth = read_depth_png(file)
        if depth.shape[::-1] != self._stored:
            raise InputError(
                f"{file} is {depth.shape[1]} x {depth.shape[0]} px, the first map of {self.view.depth} "
                f"{self._stored[0]} x {self._stored[1]} px; give maps of one mode of the camera, the empty room's as "
                "well."
            )
        return depth

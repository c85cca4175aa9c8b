"""Pictures, masks and depth maps of one view by frame number, undistorted and at working size."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import cached_property, lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute import packed_masks
from hypose.compute.glance import Glance, differing_box, stored_places
from hypose.compute.picture_to_mask import Box, make_lens, shrink_undistort
from hypose.compute.threads import default_threads
from hypose.errors import InputError
from hypose.evidence.depth_background import (
    STILL_FRAMES,
    DepthBackground,
    learn_background,
    people_before,
    people_on_floor,
    person_before,
    person_on_floor,
    unlike_people,
    with_still_things,
)
from hypose.evidence.silhouettes import (
    BitMask,
    Segmenter,
    as_mask,
    bounding_box,
)
from hypose.geometry import DepthMap, Image, Mask
from hypose.io.recordings.object_masks import SIDECAR, ObjectMasks, open_masks
from hypose.io.recordings.recording_views import ViewSettings, stored_numbers
from hypose.io.sensors.depth import read_depth_png
from hypose.io.videos.video import VideoReader, evenly_spread, frame_size, list_images, open_video, read_image

# ---- depth views ---------------------------------------------------------------------------------------------------
# The depth maps of one view of a recording, by frame number, undistorted and at working size, and the people in them.


_KEPT = 8
# Largest number of depth maps that describe the empty room.
_ROOM_FRAMES = 30


class DepthPreparer:
    """Conversion of stored depth maps to the maps of a pinhole camera at working size.

    camera: the calibrated camera.
    small: the pinhole camera of the working size.
    shift: (x, y) that is added to positions in the stored maps, px of the calibrated size.
    """

    def __init__(self, camera: Camera, small: Camera, shift: tuple[float, float]) -> None:
        self._places = lru_cache(maxsize=2)(partial(places_in_stored, camera, small.size, shift))

    def __call__(self, depth: DepthMap) -> DepthMap:
        """Convert a depth map to the working size (h, w), m, with the nearest stored pixel.

        Why: no depth was measured between two pixels.
        """
        places = self._places((depth.shape[1], depth.shape[0]))
        moved = cv2.remap(depth, places[..., 0], places[..., 1], cv2.INTER_NEAREST, borderValue=0)
        return np.asarray(moved, dtype=np.float32)


class DepthSource:
    """Depth maps of a view, stored as a folder of 16-bit PNG in millimetres, and the people in them.

    Only one thread may use it at a time, except for maps that are in memory.

    small: pinhole camera of the working size.
    people: find all people, not one.

    Attributes:
    map: function of the frame that reads its depth map (h, w), float32 m, 0 for a hole; it raises InputError where the
        frame does not exist or cannot be read.
    """

    def __init__(self, view: ViewSettings, camera: Camera, small: Camera, people: bool = False) -> None:
        self.view, self._small, self._people = view, small, people
        self._files = list_images(view.files["depth"])
        self._prepared = DepthPreparer(camera, small, view.image_shift)
        self.map = lru_cache(maxsize=_KEPT)(self._map)

    def _map(self, frame: int) -> DepthMap:
        if not 0 <= frame < len(self._files):
            raise InputError(f"{self.view.files['depth']} has the frames 0 to {len(self._files) - 1}, not {frame}.")
        return self._read(self._files[frame])

    def person(self, frame: int) -> NDArray[np.uint8]:
        """Segment the person in a frame as a mask (h, w) of 0 and 1.

        The person is in front of the empty room or, where that is not known, stands on the floor. With `people` the
        mask shows all people.
        """
        room, camera = self.furnished[0], self._small
        depth = self.map(frame)
        if room is None:
            return (people_on_floor if self._people else person_on_floor)(depth, camera, self._unlike_people)
        return people_before(depth, room) if self._people else person_before(depth, room, camera.K[0, 0])

    @cached_property
    def room(self) -> DepthBackground | None:
        """Background model of the empty room; None where it was not recorded."""
        if "background" not in self.view.files:
            return None
        files = list_images(self.view.files["background"])
        chosen = evenly_spread(0, len(files), _ROOM_FRAMES)
        return learn_background([self._read(files[k]) for k in chosen])

    @cached_property
    def furnished(self) -> tuple[DepthBackground | None, float]:
        """The empty room with the things that stand still in the recording and were added later.

        With several people nothing is added, because they may stand still.

        Returns: the background model, and the visible area of the added things, m^2.
        """
        room = self.room
        if room is None or self._people:
            return room, 0.0
        maps = [m for m in self._spread() if m.shape == room.depth.shape]
        return with_still_things(room, maps, self._small) if len(maps) > 4 else (room, 0.0)

    @cached_property
    def _unlike_people(self) -> DepthMap | None:
        """Depth map (h, w), m, of still things that are not like a person; None where no map can be read."""
        maps = self._spread()
        return unlike_people(maps, self._small) if maps else None

    def _spread(self) -> list[DepthMap]:
        """Read some maps, evenly spread over the recording."""
        maps = list[DepthMap]()
        for k in evenly_spread(0, len(self._files), STILL_FRAMES):
            with contextlib.suppress(InputError):  # a damaged map is reported when its frame is read
                maps.append(self._read(self._files[k]))
        return maps

    @cached_property
    def _size(self) -> tuple[int, int]:
        return frame_size(self._files[0])

    def _read(self, file: Path) -> DepthMap:
        """Read a stored map at working size; InputError where its size differs from the view's first map."""
        depth = read_depth_png(file)
        if depth.shape[::-1] != self._size:
            raise InputError(
                f"{file} is {depth.shape[1]} x {depth.shape[0]} px, the first map of {self.view.files['depth']} "
                f"{self._size[0]} x {self._size[1]} px; give maps of one mode of the camera, the empty room's as well."
            )
        return self._prepared(depth)


def places_in_stored(
    camera: Camera, size: tuple[int, int], shift: tuple[float, float], stored: tuple[int, int]
) -> NDArray[np.float32]:
    """Compute where the pixels of the undistorted picture lie in a stored picture.

    size: (width, height) size of the undistorted picture.
    camera: calibrated camera.
    shift: (x, y) that is added to positions in the stored picture, px of the calibrated size.
    stored: (width, height) size of the stored picture.
    Returns: (h, w, 2) px.
    """
    moved = np.array(shift) * stored / np.array(camera.size)
    return np.asarray(np.stack(camera.undistort_maps(size, stored), -1) - moved, dtype=np.float32)


class Preparer:
    """Conversion of stored pictures of any size to undistorted pictures of the working size.

    camera: the calibrated camera.
    small: the pinhole camera of the working size.
    shift: (x, y) that is added to positions in the stored pictures, px of the calibrated size.
    """

    def __init__(self, camera: Camera, small: Camera, shift: tuple[float, float]) -> None:
        self.size = small.size
        mx, my = camera.undistort_maps(self.size, self.size)
        scale = self.size[0] / camera.size[0], self.size[1] / camera.size[1]
        self._maps = mx - np.float32(shift[0] * scale[0]), my - np.float32(shift[1] * scale[1])
        self._memory = np.zeros((self.size[1], self.size[0], 3), np.uint8)
        self._lens = lru_cache(maxsize=4)(lambda stored: make_lens(stored, *self._maps))
        self._places = lru_cache(maxsize=4)(lambda stored: stored_places(stored, *self._maps))

    def __call__(self, image: Image) -> Image:
        """Undistort a stored picture."""
        image = self._enlarged(image)
        return shrink_undistort(image, self._lens(image.shape[1::-1]))

    def within(self, image: Image, box: Box | None) -> Image:
        """Undistort a stored picture within a box, into memory that the next call overwrites.

        box: y0, y1, x0, x1 in the undistorted picture, outside which the values are undefined; None for the whole
            picture.
        """
        image = self._enlarged(image)
        return shrink_undistort(image, self._lens(image.shape[1::-1]), box, self._memory)

    def differing_box(self, image: Image, glance: Glance) -> Box | None:
        """Find the box around all foreground in a stored picture.

        image: (h, w, 3) BGR as stored.
        glance: coarse test of pixels against the background.
        Returns: y0, y1, x0, x1 in the undistorted picture of working size; None where there is no foreground.
        """
        image = self._enlarged(image)
        return differing_box(image, self._places(image.shape[1::-1]), glance, self.size)

    def _enlarged(self, image: Image) -> Image:
        if image.shape[1] >= self.size[0] and image.shape[0] >= self.size[1]:
            return image
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def mask_in(image: Image, prepare: Preparer, segment: Segmenter, band: Mask | None = None) -> tuple[BitMask, Image]:
    """Segment the person in a stored picture.

    prepare: conversion to the working size.
    segment: segmentation against the background.
    band: region where the person can be; None for the whole picture.
    Returns: the mask, and the undistorted picture, which is valid within the mask until the next call with this
        Preparer.
    """
    box: Box | None = None
    if segment.glance is not None:  # then only the person's box is processed
        found = prepare.differing_box(image, segment.glance) if band is None else bounding_box(band)
        box = found or (0, 0, 0, 0)
    prepared = prepare.within(image, box)
    runs = segment.runs(prepared, band, box)
    if box is not None and runs.area:
        (y0, y1, x0, x1), (a0, a1, b0, b1) = box, runs.box
        if not (y0 <= a0 and a1 <= y1 and x0 <= b0 and b1 <= x1):  # closed or filled parts may reach beyond it
            prepared = prepare.within(image, None)
    return runs, prepared


class _MaskSource:
    """Given masks of a view: a video, a folder of images, masks of several objects, or a folder written by
    `write_masks`.

    path: the view's masks.
    prepare: conversion to the working size.
    size: width and height of the working size, px.

    Attributes:
    objects: masks of several objects; None where the masks do not separate objects.
    """

    def __init__(self, view: ViewSettings, path: Path, prepare: Preparer, size: tuple[int, int]) -> None:
        self.path, self._prepare, self._size = path, prepare, size
        self._stored = stored_numbers(view)
        made_here = (path / SIDECAR).is_file()
        self._reader = None if made_here else open_masks(path, view.first_mask)
        self._numbered = {int(p.stem): p for p in list_images(path) if p.stem.isdigit()} if made_here else {}
        self.objects = self._reader if isinstance(self._reader, ObjectMasks) else None
        self.person = lru_cache(maxsize=1)(self._person)

    def _person(self, frame: int) -> Mask:
        """Read the mask (h, w) of a frame, of 0 and 1, at working size.

        Raises: InputError where there is none.
        """
        if self._reader is None:
            if frame not in self._numbered:
                raise InputError(f"{self.path} holds no mask of frame {frame}.")
            mask = as_mask(read_image(self._numbered[frame]), str(self._numbered[frame])) * np.uint8(255)
            if mask.shape[1::-1] != self._size:  # already undistorted, at another working size
                mask = np.asarray(cv2.resize(mask, self._size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        else:
            frame = frame if self._stored is None else int(self._stored[frame])
            if self.objects is None:
                whole = as_mask(self._reader.read(frame), f"{self.path}, frame {frame},")
            else:
                whole = self.objects.union(frame, self.objects.chosen)
            mask = self._prepare(np.repeat(whole[..., None] * np.uint8(255), 3, 2))[..., 0]
        return (mask > 127).astype(np.uint8)

    def close(self) -> None:
        """Close the files."""
        if self._reader is not None:
            self._reader.close()


class ViewSource:
    """Pictures and masks of one view by frame number. Only one thread may use it at a time.

    small: pinhole camera of the working size.
    people: find all people in depth maps.
    parallel: number of videos that are decoded at the same time and share the cores.
    """

    def __init__(
        self, view: ViewSettings, camera: Camera, small: Camera, people: bool = False, parallel: int = 1
    ) -> None:
        self.view = view
        self._threads = max(1, default_threads() // parallel)
        self.prepare = Preparer(camera, small, view.image_shift)
        masks = view.files.get("masks")
        self._masks = _MaskSource(view, masks, self.prepare, small.size) if masks else None
        self.depth = DepthSource(view, camera, small, people) if "depth" in view.files else None
        self._given = self.depth or self._masks  # masks that need no segmentation of pictures
        self._reader: VideoReader | None = None
        self.segment: Segmenter | None = None
        self._broken: tuple[int, str] | None = None
        self._problems: dict[int, str] = {}  # why there is no mask, by frame
        self._shown: tuple[int, Image] | None = None
        self._memory: Image | None = None  # of the last picture of a video
        self.given: tuple[int, Image] | None = None
        """Number and stored picture of a frame that need not be read."""

    @property
    def furnished(self) -> tuple[DepthBackground | None, float]:
        """Background model of the room before a depth camera, with the things that stand still in the recording, and
        the visible area of these things, m^2; (None, 0) for other cameras.
        """
        return self.depth.furnished if self.depth else (None, 0.0)

    @property
    def objects(self) -> ObjectMasks | None:
        """Masks of several objects of this view; None where its masks do not separate objects."""
        return self._masks.objects if self._masks else None

    def image(self, frame: int) -> Image:
        """Read the undistorted picture (h, w, 3) BGR of a frame at working size.

        Raises: InputError where the view has no pictures or the frame cannot be read.
        """
        return self.prepare(self._stored(frame))

    def image_of_mask(self, frame: int) -> Image | None:
        """Get the undistorted picture (h, w, 3) BGR of a frame whose mask was made last.

        Returns: the picture, valid at least within the mask; None where the view has no picture or it is damaged.
        """
        if self._shown is not None and self._shown[0] == frame:
            return self._shown[1]
        try:
            return None if self.view.source is None else self.image(frame)
        except InputError:  # the mask does not need the picture
            return None

    def _stored(self, frame: int) -> Image:
        if self.given is not None and self.given[0] == frame:
            return self.given[1]
        if self._reader is None:
            if self.view.source is None:
                raise InputError(f"View {self.view.name} has neither video nor images, only masks.")
            self._reader = open_video(self.view.source, self._threads, self.view.rate)
        self._memory = self._reader.read(frame, self._memory)
        return self._memory

    def mask(
        self, frame: int, band: Mask | None = None, widened: Callable[[Mask], Mask | None] = lambda mask: None
    ) -> tuple[BitMask | None, str]:
        """Segment the person in a frame.

        band: region where the person can be; None for the whole picture.
        widened: function that gives a wider band for a mask that is too narrow, or None; the mask is then made again.
        Returns: the packed mask and "", or None and the reason.
        """
        if self._broken is not None and frame >= self._broken[0]:
            return None, f"{self.view.name}, frame {frame}: {self._broken[1]}"
        if self._given is None and self.segment is None:
            return None, f"{self.view.name}, frame {frame}: it has no pictures"
        try:
            runs = self._runs(frame, band)
            wide = None if band is None else widened(packed_masks.draw(runs))
            return runs if wide is None else self._runs(frame, wide), ""
        except InputError as problem:
            self._problems[frame] = str(problem)
            # a damaged video stays damaged: do not decode it from its start for every frame
            if self._given is None and not (self._reader and self._reader.is_sequence):
                self._broken = (frame, str(problem))
            return None, f"{self.view.name}, frame {frame}: {problem}"

    def _runs(self, frame: int, region: Mask | None) -> BitMask:
        """Make the mask of a frame within a region; InputError where the frame cannot be read."""
        if self._given:
            mask = self._given.person(frame)
            return packed_masks.pack(mask if region is None else mask & region)
        assert self.segment is not None  # `mask` has checked
        runs, prepared = mask_in(self._stored(frame), self.prepare, self.segment, region)
        self._shown = frame, prepared
        return runs

    @property
    def note(self) -> str:
        """Sentence about the frames that could not be read so far; empty where there are none."""
        problems = dict(self._problems)  # another thread may be reading
        if not problems:
            return ""
        first = min(problems)
        if self._broken is not None:
            return f"has no mask from frame {first} on: {problems[first]}"
        which = "frame" if len(problems) == 1 else f"{len(problems)} frames, the first of them"
        return f"has no mask in {which} {first}: {problems[first]}"

    def close(self) -> None:
        """Close the files."""
        for source in (self._reader, self._masks):
            if source is not None:
                source.close()
        self._reader = None

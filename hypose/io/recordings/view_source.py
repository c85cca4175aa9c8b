"""The pictures and masks of one view of a recording, by frame number, undistorted and at working size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute import (
    Box,
    Glance,
    Lens,
    default_threads,
    differing_box,
    make_lens,
    mask_runs,
    new_picture,
    shrink_undistort,
    stored_pixels,
)
from hypose.errors import InputError
from hypose.evidence.background import Image
from hypose.evidence.silhouettes import Mask, MaskRuns, Segmenter, as_mask, bounding_box
from hypose.io.recordings.depth_views import DepthSource
from hypose.io.recordings.object_masks import ObjectMasks, open_masks
from hypose.io.recordings.recording_views import SIDECAR, View
from hypose.io.videos.video import VideoReader, list_images, open_video, read_image


class Preparer:
    """Stored images (any size) of a camera -> undistorted images of the working-size camera `small`. shift: px of the
    calibrated size added to image positions."""

    def __init__(self, camera: Camera, small: Camera, shift: tuple[float, float]) -> None:
        self.size = small.size
        mx, my = camera.undistort_maps(self.size, self.size)
        scale = self.size[0] / camera.size[0], self.size[1] / camera.size[1]
        self._maps = mx - np.float32(shift[0] * scale[0]), my - np.float32(shift[1] * scale[1])
        self._lenses: dict[tuple[int, int], Lens] = {}
        self._memory = new_picture(self.size[1], self.size[0])
        self._pixels: dict[tuple[int, int], NDArray[np.int32]] = {}

    def __call__(self, image: Image) -> Image:
        """The undistorted image."""
        image = self._enlarged(image)
        return shrink_undistort(image, self._lens(image))

    def within(self, image: Image, box: Box | None) -> Image:
        """The same until the next call, which uses its memory; undefined outside the box (y0, y1, x0, x1), if any."""
        image = self._enlarged(image)
        return shrink_undistort(image, self._lens(image), box, self._memory)

    def _lens(self, image: Image) -> Lens:
        stored = (image.shape[1], image.shape[0])
        if stored not in self._lenses:
            self._lenses[stored] = make_lens(stored, *self._maps)
        return self._lenses[stored]

    def differing_box(self, image: Image, glance: Glance) -> Box | None:
        """The box of the working size that holds what is not the room; None when there is nothing."""
        image = self._enlarged(image)
        stored = (image.shape[1], image.shape[0])
        if stored not in self._pixels:
            self._pixels[stored] = stored_pixels(stored, *self._maps)
        return differing_box(image, self._pixels[stored], glance, self.size)

    def _enlarged(self, image: Image) -> Image:
        if image.shape[1] >= self.size[0] and image.shape[0] >= self.size[1]:
            return image
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def mask_in(image: Image, prepare: Preparer, segment: Segmenter, band: Mask | None = None) -> tuple[MaskRuns, Image]:
    """The mask of a stored image, and the undistorted image, known within it, until the next call with this Preparer;
    band: where the person can be."""
    box: Box | None = None
    if segment.glance is not None:  # then nothing outside the person's box is looked at
        found = prepare.differing_box(image, segment.glance) if band is None else bounding_box(band)
        box = found or (0, 0, 0, 0)
    prepared = prepare.within(image, box)
    runs = segment.runs(prepared, band, box)
    if box is not None and runs.area and not _holds(box, runs.box):  # what is closed or filled may reach beyond it
        prepared = prepare.within(image, None)
    return runs, prepared


def _holds(box: Box, other: Box) -> bool:
    return box[0] <= other[0] and other[1] <= box[1] and box[2] <= other[2] and other[3] <= box[3]


class _MaskSource:
    """Masks made elsewhere: a video, a folder of images in order, masks of several objects, or a folder written by
    write_masks. chosen: the objects that are the person, None: all; first: as for `open_masks`."""

    def __init__(self, path: Path, prepare: Preparer, size: tuple[int, int], first: int | None = None) -> None:
        self.path, self._prepare, self._size = path, prepare, size
        self._numbered: dict[int, Path] | None = None
        self._reader: VideoReader | None = None
        self.objects: ObjectMasks | None = None
        self.chosen: frozenset[str] | None = None
        if (path / SIDECAR).is_file():
            self._numbered = {int(p.stem): p for p in list_images(path) if p.stem.isdigit()}
        else:
            opened = open_masks(path, first)
            if isinstance(opened, ObjectMasks):
                self.objects = opened
            else:
                self._reader = opened

    def read(self, frame: int) -> Mask:
        if self._numbered is not None:
            if frame not in self._numbered:
                raise InputError(f"{self.path} holds no mask of frame {frame}.")
            mask = as_mask(read_image(self._numbered[frame]), str(self._numbered[frame])) * np.uint8(255)
            if mask.shape[1::-1] != self._size:  # already undistorted, at another working size
                mask = np.asarray(cv2.resize(mask, self._size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        elif self.objects is not None:
            whole = self.objects.union(frame, self.chosen) * np.uint8(255)
            mask = self._prepare(np.repeat(whole[..., None], 3, 2))[..., 0]
        else:
            assert self._reader is not None
            whole = as_mask(self._reader.read(frame), f"{self.path}, frame {frame},") * np.uint8(255)
            mask = self._prepare(np.repeat(whole[..., None], 3, 2))[..., 0]
        return (mask > 127).astype(np.uint8)

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()


class ViewSource:
    """Masks of one view by frame number; used by one thread at a time. people: of all in a depth camera's maps;
    beside: how many videos are decoded at once, which share the cores: more threads cost more in all."""

    def __init__(self, view: View, camera: Camera, small: Camera, people: bool = False, beside: int = 1) -> None:
        self.view = view
        self._threads = max(1, default_threads() // beside)
        self._prepare = Preparer(camera, small, view.image_shift)
        masks = view.masks
        self._masks = None if masks is None else _MaskSource(masks, self._prepare, small.size, view.first_mask)
        self.depth = None if view.depth is None else DepthSource(view, camera, small, people)
        self._reader: VideoReader | None = None
        self.segment: Segmenter | None = None
        self._broken: tuple[int, str] | None = None
        self._problems: dict[int, str] = {}  # why there is no mask, by frame
        self._shown: tuple[int, Image] | None = None

    @property
    def objects(self) -> ObjectMasks | None:
        """The view's masks where they tell objects apart."""
        return None if self._masks is None else self._masks.objects

    def choose(self, objects: frozenset[str]) -> None:
        """Take these objects of the masks for the person."""
        if self._masks is not None:
            self._masks.chosen = objects

    def image(self, frame: int) -> Image:
        """The undistorted working-size image."""
        return self._prepare(self._stored(frame))

    def image_of_mask(self, frame: int) -> Image | None:
        """The same, known within the mask that was made last, which is of this frame; None where there is none."""
        if self._shown is not None and self._shown[0] == frame:
            return self._shown[1]
        try:
            return None if self.view.source is None else self.image(frame)
        except InputError:  # the mask is from elsewhere, and does for the rest
            return None

    def _stored(self, frame: int) -> Image:
        if self._reader is None:
            if self.view.source is None:
                raise InputError(f"View {self.view.name} has neither video nor images, only masks.")
            self._reader = open_video(self.view.source, self._threads, in_place=True)
        return self._reader.read(frame)

    def mask(
        self, frame: int, band: Mask | None, widened: Callable[[Mask], Mask | None] | None = None
    ) -> tuple[MaskRuns | None, str]:
        """The mask, packed, or None and why there is none. widened: a wider band for a mask, with which it is made
        again, or None when it may stay."""
        if self._broken is not None and frame >= self._broken[0]:
            return None, f"{self.view.name}, frame {frame}: {self._broken[1]}"
        try:
            given = self.depth.person if self.depth is not None else None if self._masks is None else self._masks.read
            if given is not None:
                mask = given(frame)
                within = mask if band is None else mask & band
                wide = None if widened is None else widened(within)
                return mask_runs.runs_of(within if wide is None else mask & wide), ""
            if self.segment is None:
                return None, f"{self.view.name}, frame {frame}: it has no pictures"
            image = self._stored(frame)
            runs, prepared = mask_in(image, self._prepare, self.segment, band)
            wide = None if widened is None else widened(mask_runs.draw(runs))
            if wide is not None:
                runs, prepared = mask_in(image, self._prepare, self.segment, wide)
            self._shown = frame, prepared
            return runs, ""
        except InputError as problem:
            self._problems[frame] = str(problem)
            # a damaged video stays damaged: do not decode it from its start again and again
            files = self.depth is not None or (self._reader is not None and self._reader.is_sequence)
            if self._masks is None and not files:
                self._broken = (frame, str(problem))
            return None, f"{self.view.name}, frame {frame}: {problem}"

    @property
    def note(self) -> str:
        """What could not be read so far, "" when nothing."""
        problems = dict(self._problems)  # another thread may be reading
        if not problems:
            return ""
        first = min(problems)
        if self._broken is not None:
            return f"has no mask from frame {first} on: {problems[first]}"
        which = "frame" if len(problems) == 1 else f"{len(problems)} frames, the first of them"
        return f"has no mask in {which} {first}: {problems[first]}"

    def close(self) -> None:
        """Release the files."""
        for source in (self._reader, self._masks):
            if source is not None:
                source.close()
        self._reader = None

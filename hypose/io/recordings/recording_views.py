"""Views of a recording: the files of each camera, their size, length and frame rate, and whether the views agree.

The pictures, masks and depth maps of a view are read by frame number, undistorted and at working size.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
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
from hypose.errors import CalibrationError, InputError
from hypose.evidence.depth_background import (
    STILL_FRAMES,
    DepthBackground,
    learn_background,
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
from hypose.geometry import Array, DepthMap, Image, Mask
from hypose.io.recordings.object_masks import SIDECAR, ObjectMasks, open_masks
from hypose.io.sensors.depth import read_depth_png
from hypose.io.videos.video import (
    VideoReader,
    check_numbers,
    evenly_spread,
    frame_size,
    frame_times,
    list_images,
    open_video,
    read_image,
    stored_frames,
)

# Ratio of frame rates below which they count as equal: 29.97 and 30 frames/s differ by rounding in the container.
_ALIKE = 1.005


@dataclass(frozen=True)
class ViewSettings:
    """The files and settings of one camera's view.

    files: existing paths by kind of evidence: "video" (a file), "images" or "depth" (folders of images or depth maps),
        "masks" (video or folder), "background" (video, photo or folder that shows the empty room), "keypoints" (file or
        folder); without the kinds that the view does not have.
    image_shift: (x, y) to add to image coordinates, px of the calibrated size.
    accept_scaled: images of another shape were stretched, not cut.
    first_mask: number of the first frame's files, for masks of one folder per object; None for the view's lowest
        number.
    rate: frames/s at which the video is read by its time stamps; None to read it frame by frame.
    """

    name: str
    files: Mapping[str, Path] = field(default_factory=dict)
    image_shift: tuple[float, float] = (0.0, 0.0)
    accept_scaled: bool = False
    first_mask: int | None = None
    rate: float | None = None

    @property
    def source(self) -> Path | None:
        """The video, image folder or folder of depth maps; None where there are only masks or key points."""
        return next((self.files[kind] for kind in ("video", "images", "depth") if kind in self.files), None)

    @property
    def segmented(self) -> bool:
        """Whether masks are made from its video or images."""
        return self.has_pictures and not {"masks", "depth"} & self.files.keys()

    @property
    def has_pictures(self) -> bool:
        """Whether there is a video, images, depth maps or masks; else there are key points alone."""
        return bool({"video", "images", "depth", "masks"} & self.files.keys())

    def without(self, *kinds: str) -> ViewSettings:
        """Copy the view and leave out its files of some kinds."""
        return replace(self, files={kind: path for kind, path in self.files.items() if kind not in kinds})


_Clip = VideoReader | ObjectMasks
"""A video, folder of images or masks of a view, with its size, length and frame rate; no picture is read yet."""


def look(view: ViewSettings) -> list[_Clip]:
    """Open the files of a view (video or images, then masks)."""
    out: list[_Clip] = []
    for kind in [k for k in ("video", "images", "depth", "masks") if k in view.files]:
        path = view.files[kind]
        made_here = (path / SIDECAR).is_file()
        if made_here and view.source is not None:
            continue  # found by frame number; there may be masks of some frames only
        if path.is_dir() and not made_here:
            check_numbers(path)
        out.append(open_masks(path, view.first_mask) if kind == "masks" else open_video(path))
    return out


def look_together(views: Sequence[ViewSettings], notes: list[str]) -> tuple[list[ViewSettings], list[list[_Clip]]]:
    """Read the properties of all views' files, and number masks of one folder per object alike in all views.

    Where such files begin with different numbers, the lowest is the first frame of all views.

    notes: list to which a sentence about different numbers is added.
    Returns: the views, with `first_mask` set where needed, and the properties of their files.
    Why: a person who is not seen at the start has no masks there.
    """
    with ThreadPoolExecutor(len(views)) as pool:  # counting the frames that can be decoded takes time
        clips = list(pool.map(look, views))
    masks = {k: c for k, found in enumerate(clips) for c in found if isinstance(c, ObjectMasks)}
    numbered = {k: c.first for k, c in masks.items() if c.first is not None}
    begin, shortest = sorted(numbered.values()), min((masks[k].n_frames for k in numbered), default=0)
    if not 0 < (begin[-1] - begin[0] if begin else 0) < shortest:  # independent counters of cameras differ by more
        return list(views), clips
    same = [replace(v, first_mask=begin[0]) if k in numbered else v for k, v in enumerate(views)]
    late = ", ".join(f"{views[k].name} {first}" for k, first in numbered.items() if first != begin[0])
    notes.append(
        f"Files of masks begin with different numbers ({begin[0]}, but {late}): they are taken as the numbers of all "
        "views' frames."
    )
    return same, [look(v) if k in numbered else clips[k] for k, v in enumerate(same)]


def open_pictures(view: ViewSettings, threads: int | None = None) -> VideoReader | ObjectMasks:
    """Open the video, images or masks of a view, whichever it has first.

    threads: number of threads that decode a video; None for all.
    Raises: InputError where the view has none of them.
    """
    if view.source is not None:
        return open_video(view.source, threads, rate=view.rate)
    if "masks" not in view.files:
        raise InputError(f"View {view.name} has neither video, images nor masks.")
    return open_masks(view.files["masks"], view.first_mask)


def check_picture_size(
    view: ViewSettings, camera: Camera, path: Path, size: tuple[int, int], notes: list[str] | None
) -> None:
    """Check that pictures of a given size can be those of a camera.

    path: the pictures.
    size: their width and height, px.
    notes: list to which a sentence is added where they are scaled; None for no sentence.
    Raises: CalibrationError where the shapes differ by more than 1 %.
    """
    if size == camera.size:
        return
    (w, h), (cw, ch) = size, camera.size
    ratio = (w / h) / (cw / ch)
    if abs(ratio - 1) > 0.01 and not view.accept_scaled:
        advice = (
            "calibrate at this size, or, if the images were stretched (not cut), set accept_scaled = true "
            "for this view in recording.toml"
        )
        if abs((h / w) / (cw / ch) - 1) <= 0.01:
            advice = "the images look turned by 90 degrees: turn them back, or calibrate turned images"
        raise CalibrationError(
            f"View {view.name}: {path} is {w} x {h} px, camera {camera.name} is calibrated for {cw} x {ch} "
            f"px; {advice}."
        )
    if notes is not None and not (path / SIDECAR).is_file():  # hypose's own masks are usually smaller
        notes.append(
            f"View {view.name}: {path.name} is {w} x {h} px, the calibration {cw} x {ch} px; the images are "
            "taken as scaled."
        )


def check_background(view: ViewSettings, camera: Camera, size: tuple[int, int] | None) -> None:
    """Check that the background of a view fits its pictures.

    size: (width, height) size of the view's pictures.
    Raises: InputError where it does not fit.
    """
    background = view.files["background"]
    if "depth" not in view.files:
        check_picture_size(view, camera, background, frame_size(background), None)
        return
    if not background.is_dir():
        raise InputError(
            f"View {view.name}: the background of a depth view is a folder of 16-bit PNG of the empty room, "
            f"{background} is not; leave it out to go by the floor."
        )
    room = frame_size(background)
    if room != size:
        raise InputError(
            f"View {view.name}: the empty room in {background} is {room[0]} x {room[1]} px, the maps in "
            f"{view.files['depth']} are not; record both in the same mode of the camera, or leave the background out."
        )


def stored_numbers(view: ViewSettings) -> NDArray[np.int64] | None:
    """Compute the stored frame for each frame of a video that is read by its time stamps; None where the numbers are
    equal.
    """
    return None if "video" not in view.files or view.rate is None else stored_frames(view.files["video"], view.rate)


def on_one_clock(
    where: str,
    given: float | None,
    views: Sequence[ViewSettings],
    clips: Sequence[list[_Clip]],
    reported: float | None,
    notes: list[str],
) -> tuple[list[ViewSettings], float]:
    """Determine the frame rate of a recording, and read irregular videos by their time stamps.

    The frame rate is the given one, else that of the videos (the lowest), else that of the key points' file. Videos
    with lost frames, or with another or a varying frame rate, are read by their time stamps.

    where: start of the error messages.
    given: frame rate of recording.toml, frames/s; None where it has none.
    views, clips: views, and the properties of their files as `look_together` gives them.
    reported: frame rate of the key points' file, frames/s; None where it has none.
    notes: list to which sentences about irregular videos are added.
    Returns: the views with `rate` set where needed, and the frame rate; n_frames of the files of such views are set to
        the number of frames that are read.
    Raises: InputError where no frame rate is known.
    """
    times = [frame_times(v.files["video"]) if "video" in v.files else None for v in views]
    rates = [
        c.frame_rate if t is None else 1 / _step(t)
        for v, t, found in zip(views, times, clips, strict=True)
        for c in found
        if c.path == v.source and c.frame_rate is not None
    ]
    alike = not rates or max(rates) / min(rates) <= _ALIKE
    found = (float(np.median(rates)) if alike else min(rates)) if rates else reported
    if given is None and found is None:
        what = "images" if any(clips) else "key points"
        raise InputError(f"{where}: {what} carry no frame rate; add frame_rate = ... (frames per second).")
    if given is not None and found is not None and abs(given / found - 1) > 0.005:
        says = "videos say" if rates else "file of key points says"
        notes.append(f"frame_rate = {given:g} is used as given; the {says} {found:g} frames/s.")
    timed_views = [replace(v, rate=found) if t is not None and rates else v for v, t in zip(views, times, strict=True)]
    for k, (view, t) in enumerate(zip(timed_views, times, strict=True)):
        stored = stored_numbers(view)
        if stored is None or t is None:
            timed_views[k] = views[k]
            continue
        for clip in clips[k]:
            clip.n_frames = clip.stated_frames = len(stored)
        notes.append(f"View {view.name}: {_of_times(t)}, so it is read by its time stamps at {found:g} frames/s.")
    return timed_views, float(given if given is not None else found or 0.0)


def _step(times: Array) -> float:
    """Compute the mean time between two frames, without the steps over lost frames, s."""
    steps = np.diff(times)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def _of_times(times: Array) -> str:
    """Describe the irregularity in the time stamps of a video."""
    steps, step = np.diff(times), _step(times)
    lost = np.round(steps / step) - 1
    if lost.any():
        first, count = float(times[int(np.argmax(lost > 0))]), int(lost.sum())
        return f"its video lost {count} of {len(times) + count} frames, the first after {first:.2f} s"
    if np.abs(steps / step - 1).max() > 0.05:
        return f"the frame rate of its video varies between {1 / steps.max():.1f} and {1 / steps.min():.1f} frames/s"
    return f"its video has {1 / step:.4g} frames/s"


def common_frames(views: Sequence[ViewSettings], clips: Sequence[list[_Clip]], notes: list[str]) -> int:
    """Count the frames that every view has.

    views, clips: views, and the properties of their files.
    notes: list to which sentences are added where views differ or files are cut off.
    Raises: InputError where a view has no frames.
    """
    counts = {}
    for view, found in zip(views, clips, strict=True):
        for clip in found:
            with_masks = len(found) > 1 and clip is found[-1]
            counts[f"{view.name} masks" if with_masks else view.name] = clip.n_frames
            if clip.stated_frames > clip.n_frames:
                notes.append(
                    f"View {view.name}: {clip.path.name} states {clip.stated_frames} frames but decoding ends after "
                    f"frame {clip.n_frames - 1}; it is cut off or damaged, or its program stated too many: copy it "
                    "again if more was recorded."
                )
            if clip.n_frames == 0:
                raise InputError(f"View {view.name}: {clip.path} has no frames; record or copy it again.")
    low, high = min(counts.values()), max(counts.values())
    if high - low > 2:
        said = ", ".join(f"{n} {c}" for n, c in counts.items())
        notes.append(
            f"The views have different numbers of frames ({said}); the first {low} frames, which all have, "
            "are used. Check that all cameras start at the same instant."
        )
        next_low = sorted(counts.values())[1]
        if len(views) > 2 and next_low > 1.05 * low:  # one camera stopped before the others
            first = min(counts, key=lambda n: counts[n])
            notes[-1] += f" Without {first}, the others' {next_low} frames could be tracked."
    return low


# ---- depth views ---------------------------------------------------------------------------------------------------
# The depth maps of one view of a recording, by frame number, undistorted and at working size, and the people in them.


_KEPT = 8
# Largest number of depth maps that describe the empty room.
_ROOM_FRAMES = 30


def depth_preparer(camera: Camera, small: Camera, shift: tuple[float, float]) -> Callable[[DepthMap], DepthMap]:
    """Make the function that converts stored depth maps to (h, w), m, of a pinhole camera at working size.

    Each pixel gets the nearest stored pixel, because no depth was measured between two pixels.

    camera: the calibrated camera.
    small: the pinhole camera of the working size.
    shift: (x, y) that is added to positions in the stored maps, px of the calibrated size.
    """
    places_of = lru_cache(maxsize=2)(partial(places_in_stored, camera, small.size, shift))

    def prepared(depth: DepthMap) -> DepthMap:
        places = places_of((depth.shape[1], depth.shape[0]))
        moved = cv2.remap(depth, places[..., 0], places[..., 1], cv2.INTER_NEAREST, borderValue=0)
        return np.asarray(moved, dtype=np.float32)

    return prepared


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
        self._prepared = depth_preparer(camera, small, view.image_shift)
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
            return person_on_floor(depth, camera, self._unlike_people, self._people)
        return person_before(depth, room, camera.K[0, 0], self._people)

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
    found = prepare.differing_box(image, segment.glance) if band is None else bounding_box(band)
    box = found or (0, 0, 0, 0)  # only the person's box is processed
    prepared = prepare.within(image, box)
    runs = segment.packed(prepared, band, box)
    if runs.area:
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
    numbered: files of a folder written by `write_masks`, by frame.
    """

    def __init__(self, view: ViewSettings, path: Path, prepare: Preparer, size: tuple[int, int]) -> None:
        self.path, self._prepare, self._size = path, prepare, size
        self._stored = stored_numbers(view)
        made_here = (path / SIDECAR).is_file()
        self._reader = None if made_here else open_masks(path, view.first_mask)
        self.numbered = {int(p.stem): p for p in list_images(path) if p.stem.isdigit()} if made_here else {}
        self.objects = self._reader if isinstance(self._reader, ObjectMasks) else None
        self.person = lru_cache(maxsize=1)(self._person)

    def _person(self, frame: int) -> Mask:
        """Read the mask (h, w) of a frame, of 0 and 1, at working size.

        Raises: InputError where there is none.
        """
        if self._reader is None:
            if frame not in self.numbered:
                raise InputError(f"{self.path} holds no mask of frame {frame}.")
            mask = as_mask(read_image(self.numbered[frame]), str(self.numbered[frame])) * np.uint8(255)
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

    Attributes:
    prepare: conversion of stored pictures to the working size.
    objects: masks of several objects of this view; None where its masks do not separate objects.
    segment: segmentation of the pictures against the background; None: not known yet.
    given: number and stored picture of a frame that need not be read.
    """

    def __init__(
        self, view: ViewSettings, camera: Camera, small: Camera, people: bool = False, parallel: int = 1
    ) -> None:
        self.view = view
        self._threads = max(1, default_threads() // parallel)
        self.prepare: Preparer = Preparer(camera, small, view.image_shift)
        masks = view.files.get("masks")
        self._masks = _MaskSource(view, masks, self.prepare, small.size) if masks else None
        self.depth = DepthSource(view, camera, small, people) if "depth" in view.files else None
        self.objects = self._masks.objects if self._masks else None
        self._given = self.depth or self._masks  # masks that need no segmentation of pictures
        self._reader: VideoReader | None = None
        self.segment: Segmenter | None = None
        self._broken: tuple[int, str] | None = None
        self._problems: dict[int, str] = {}  # why there is no mask, by frame
        self._shown: tuple[int, Image] | None = None
        self._memory: Image | None = None  # of the last picture of a video
        self.given: tuple[int, Image] | None = None

    @property
    def furnished(self) -> tuple[DepthBackground | None, float]:
        """Background model of the room before a depth camera, with the things that stand still in the recording, and
        the visible area of these things, m^2; (None, 0) for other cameras.
        """
        return self.depth.furnished if self.depth else (None, 0.0)

    def owners(self, frame: int) -> NDArray[np.uint8]:
        """Read the people whom each pixel (h, w) of a frame shows, as `Silhouettes.owners`; (0, 0) where unknown."""
        if self._masks is None or frame not in self._masks.numbered:
            return np.zeros((0, 0), np.uint8)
        found = np.negative(read_image(self._masks.numbered[frame])[..., 0])  # see hypose.pipeline.detect_keypoints
        return np.asarray(cv2.resize(found, self.prepare.size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)

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

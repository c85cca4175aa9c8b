"""Sources of frames by number: in memory, at corrected camera places, with pictures, or with detections by colour."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import InputError
from hypose.evidence.body_parts import detect_ends, end_colors
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, FrameSource, Keypoints, Picture, Silhouettes
from hypose.evidence.skin import skin_map
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS

if TYPE_CHECKING:  # recordings are opened elsewhere
    from hypose.io.recordings.recording import Recording
    from hypose.io.recordings.recording_views import ViewSource


@runtime_checkable
class RecordedFrames(FrameSource, Protocol):
    """Protocol of the frames of a recording: hypose.io.recordings.frames.FrameStream."""

    recording: Recording
    rig: CameraRig
    kinds: frozenset[type]
    keypoints: Sequence[Keypoints]
    unchosen: Sequence[Keypoints]
    others: int
    frames: range

    def pictures(self) -> list[ViewSource]:
        """Open the pictures of all views; the caller closes them."""
        ...


FrameRange = Callable[[range], Iterable[Frame]]
"""Function that reads the frames with the given numbers, one after the other."""


def frames_backwards(frames: FrameRange, stop: int, block: int = SETTINGS.sides_block) -> Iterator[Frame]:
    """Yield the frames stop - 1, stop - 2, ..., 0. They are read in blocks, because videos are slow to read
    backwards.
    """
    for end in range(stop, 0, -block):
        yield from list(frames(range(max(0, end - block), end)))[::-1]


class PictureFrames:
    """Frames of a source with the undistorted picture of its one camera, at working size (`Frame.picture`).

    The mask of a frame is put into its picture; where it shows no person, the picture has none. The frames of another
    source than a FrameStream, such as a synthetic scene, have their pictures already and are not changed.
    source: frames by number.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source, self._pictures = source, None
        if isinstance(source, RecordedFrames):
            # read forwards, while the stream makes masks ahead
            self._pictures = source.pictures()[0]

    def frame(self, index: int, /) -> Frame:
        """Read a frame with its picture, without the picture of the frame before.

        index: 0 <= index < length of the source.
        """
        frame = self._source.frame(index)
        if self._pictures is None or not isinstance(self._source, RecordedFrames):
            return frame
        mask = None
        for seen in frame.of(Silhouettes):
            if seen.usable[0] and seen.areas[0] >= SETTINGS.picture_smallest_mask:
                mask = seen.masks[0]
        picture = Picture(self._source.rig[0], self._pictures.image(frame.index), None, mask)
        return Frame(frame.time, frame.index, keypoints=frame.keypoints, picture=picture)

    def walk(self, indices: range) -> Iterator[Frame]:
        """Yield the frames one after the other, each with its picture and that of the frame before it.

        indices: frames, forwards or backwards; "before" is meant in this direction. The first frame has a picture
            before it too, unless the source begins (or ends) there.
        """
        behind = indices.start - indices.step
        begin = behind if indices and 0 <= behind < len(self._source) else indices.start
        numbers, before = range(begin, indices.stop, indices.step), None
        frames = map(self.frame, numbers) if indices.step > 0 else self._backwards(begin)
        for index, frame in zip(numbers, frames, strict=False):
            picture = frame.picture
            if index in indices:
                yield frame if picture is None else replace(frame, picture=replace(picture, before=before))
            before = None if picture is None else picture.image

    def _backwards(self, begin: int) -> Iterator[Frame]:
        """Yield the frames begin, begin - 1, ..., 0; as many at once as their memory allows."""
        size = 1 if self._pictures is None else 3 * int(np.prod(self._pictures.prepare.size))
        block = max(1, SETTINGS.picture_ahead_bytes // size)
        return frames_backwards(lambda numbers: map(self.frame, numbers), begin + 1, block)

    def close(self) -> None:
        """Release the video."""
        if self._pictures is not None:
            self._pictures.close()


def tracked_frames(
    source: FrameSource, indices: range, needs: Sequence[str], body: Body, start: Array
) -> Iterator[Frame]:
    """Yield the frames that a recipe tracks, with the evidence that it needs.

    source: frames by number.
    indices: frames, forwards or backwards.
    needs: kinds of evidence that the recipe uses, as in Recipe.
    body: of the person.
    start: (D,) pose in the first frame, which shows where the skin colours are learned.
    Returns: frames with the picture of the one camera where the recipe needs pictures; frames with detections by skin
        colour where it needs detections, and the recording has pictures but no key points; unchanged frames otherwise.
    """
    if "picture" in needs:
        with contextlib.closing(PictureFrames(source)) as frames:
            yield from frames.walk(indices)
        return
    if not (
        "detections" in needs
        and isinstance(source, RecordedFrames)
        and Keypoints not in source.kinds
        and all(view.source is not None for view in source.recording.views)
    ):
        yield from (source.frame(i) for i in indices)
        return
    with contextlib.closing(ColourDetections(source, body, start)) as coloured:
        yield from (coloured.frame(i) for i in indices)


class ColourDetections:
    """Frames of a recording with the detections of hands and head by skin colour (`Frame.detections`, without
    names).

    The skin colours are learned from the first frame, whose pose is known. A frame depends on the recording and that
    pose alone, not on the order in which frames are read. The pictures are read a second time, in addition to the
    masks.
    source: frames of the recording.
    body, start: body of the person, and its pose (D,) in the first frame.
    Raises: InputError where the pictures are grey, or the frames have no masks.
    """

    def __init__(self, source: RecordedFrames, body: Body, start: Array) -> None:
        self.source, self.body = source, body
        self._pictures = source.pictures()
        first = source.frame(0).the(Silhouettes)
        images = self._images(0, first)
        if np.ptp(images.astype(np.int16), axis=-1).max() < 8:
            raise InputError(
                "The videos are grey, and skin colour drives this recipe: give key points, or choose another recipe."
            )
        self._colours = end_colors(body, start, first, images)

    def frame(self, index: int, /) -> Frame:
        """Read a frame with its detections; without them where fewer than two views see the person."""
        frame = self.source.frame(index)
        for silhouettes in frame.of(Silhouettes):
            centre = centre_of(silhouettes)
            if centre is not None:
                images = self._images(index, silhouettes)
                maps = np.stack([skin_map(i, m, self._colours) for i, m in zip(images, silhouettes.masks, strict=True)])
                detections, _ = detect_ends(silhouettes, maps, centre, self.body.stature)
                return replace(frame, detections=detections)
        return frame

    def close(self) -> None:
        """Release the videos."""
        for view in self._pictures:
            view.close()

    def _images(self, index: int, silhouettes: Silhouettes) -> NDArray[np.uint8]:
        """Read the undistorted pictures of a frame, in the pixels of its masks.

        index: frame, counted from the start of recording.frames.
        silhouettes: masks of the frame.
        Returns: (C, h, w, 3) BGR; black where a view is not usable.
        """
        out = np.zeros((*silhouettes.masks.shape, 3), np.uint8)
        for c in np.flatnonzero(silhouettes.usable):
            picture = self._pictures[int(c)].image(self.source.frames[index])
            out[c, : picture.shape[0], : picture.shape[1]] = picture
        return out


def centre_of(silhouettes: Silhouettes) -> Array | None:
    """Triangulate the middle of the person (3,) m from the centroids of the masks; None with fewer than two views."""
    middle = np.zeros((len(silhouettes.masks), 1, 2))
    for c, mask in enumerate(silhouettes.masks):
        rows, columns = np.nonzero(mask)
        if len(rows):
            middle[c, 0] = columns.mean(), rows.mean()
    seen = (silhouettes.usable & (silhouettes.areas > 0)).astype(np.float64)[:, None]
    point, views = triangulate(silhouettes.rig, middle, seen)
    return point[0] if views[0] >= 2 else None


@dataclass(frozen=True)
class FrameList:
    """Frames in memory that can be tracked like a recording, for example those of a synthetic scene or of your own
    cameras.

    frame_rate: Hz.
    """

    frames: Sequence[Frame]
    frame_rate: float = 25.0

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def keypoints(self) -> list[Keypoints | None]:
        """Key points of all frames."""
        return [f.keypoints for f in self.frames]

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, 0 <= index < len."""
        return self.frames[index]


@dataclass(frozen=True)
class Places:
    """Places of the cameras from frame `since` on.

    camera_from_world: (C, 4, 4).
    """

    since: int
    camera_from_world: Array


@dataclass(frozen=True)
class ChangedFrames:
    """Some frames of a source, each changed by a function of its number in the source.

    numbers: numbers of the frames in the source.
    """

    source: FrameSource
    change: Callable[[int, Frame], Frame]
    numbers: range

    def __len__(self) -> int:
        return len(self.numbers)

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, counted from the first of `numbers`."""
        return self.change(self.numbers[index], self.source.frame(self.numbers[index]))


def placed_source(source: FrameSource, places: Sequence[Places]) -> ChangedFrames:
    """Return the source with corrected camera places; in each frame the last of the places that have begun counts."""

    def at_place(index: int, frame: Frame) -> Frame:
        now = [p for p in places if p.since <= index]
        return placed(frame, now[-1].camera_from_world) if now else frame

    return ChangedFrames(source, at_place, range(len(source)))


def placed(frame: Frame, camera_from_world: Array) -> Frame:
    """Return the frame with the cameras placed at camera_from_world (C, 4, 4)."""
    depth, silhouettes = frame.the(Depth), frame.the(Silhouettes)
    cameras = (replace(c, camera_from_world=e) for c, e in zip(depth.rig, camera_from_world, strict=True))
    rig = type(depth.rig)(tuple(cameras))
    return replace(frame, silhouettes=replace(silhouettes, rig=rig), depth=replace(depth, rig=rig))

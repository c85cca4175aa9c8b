"""Hands and head by the colour of the skin, from the videos of a recording, for the recipes that detections drive."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import triangulate
from hypose.errors import InputError
from hypose.evidence.body_parts import detect_ends, end_colors
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.skin import skin_map
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.view_source import ViewSource
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.pictures import FrameSource, PictureFrames


def tracked_frames(source: FrameSource, indices: range, needs: Sequence[str], subject: Subject) -> Iterator[Frame]:
    """The frames that a recipe is to track, with what it needs: the picture of one camera; detections by colour where
    it needs detections and the recording has neither key points nor anything else that detects ends, but pictures."""
    if "picture" in needs:
        with contextlib.closing(PictureFrames(source)) as frames:
            yield from frames.walk(indices)
        return
    if not (
        "detections" in needs
        and isinstance(source, FrameStream)
        and source.keypoints is None
        and all(view.source is not None for view in source.recording.views)
    ):
        yield from (source.frame(i) for i in indices)
        return
    with contextlib.closing(ColourDetections(source, subject.body, subject.start)) as coloured:
        yield from (coloured.frame(i) for i in indices)


class ColourDetections:
    """The frames of a recording with the ends that skin colour shows (`Frame.detections`, unnamed).

    The colours are the person's own, learnt in the first frame, whose pose (D,) is known. Every frame is a function of
    the recording and that pose alone, in whatever order frames are asked for. The pictures are read a second time,
    beside the masks. An InputError when they are grey: there skin has no colour."""

    def __init__(self, source: FrameStream, body: Body, start: Array) -> None:
        self.source, self.body = source, body
        views = zip(source.recording.views, source.recording.rig, source.rig, strict=True)
        self._pictures = [ViewSource(view, camera, small) for view, camera, small in views]
        first = source.frame(0).silhouettes
        if first is None:
            raise InputError("Skin colour is looked for inside the silhouettes; choose an evidence that has them.")
        images = self._images(0, first)
        if np.ptp(images.astype(np.int16), axis=-1).max() < 8:
            raise InputError(
                "The videos are grey, and skin colour drives this recipe: give key points, or choose another recipe."
            )
        self._colours = end_colors(body, start, first, images)

    def __len__(self) -> int:
        return len(self.source)

    def frame(self, index: int, /) -> Frame:
        """Frame number index with its detections."""
        frame = self.source.frame(index)
        silhouettes = frame.silhouettes
        centre = None if silhouettes is None else centre_of(silhouettes)
        if silhouettes is None or centre is None:
            return frame
        images = self._images(index, silhouettes)
        maps = np.stack([skin_map(i, m, self._colours) for i, m in zip(images, silhouettes.masks, strict=True)])
        detections, _ = detect_ends(silhouettes, maps, centre, self.body.stature)
        return dataclasses.replace(frame, detections=detections)

    def close(self) -> None:
        """Release the videos."""
        for view in self._pictures:
            view.close()

    def _images(self, index: int, silhouettes: Silhouettes) -> NDArray[np.uint8]:
        """(C, h, w, 3) at the masks' pixels; black where there is no picture."""
        out = np.zeros((*silhouettes.masks.shape, 3), np.uint8)
        for c in np.flatnonzero(silhouettes.usable):
            picture = self._pictures[int(c)].image(self.source.frames[index])
            out[c, : picture.shape[0], : picture.shape[1]] = picture
        return out


def centre_of(silhouettes: Silhouettes) -> Array | None:
    """(3,) m: about the middle of the person, where the masks' centroids meet; None with fewer than two views."""
    middle = np.zeros((len(silhouettes.masks), 1, 2))
    for c, mask in enumerate(silhouettes.masks):
        rows, columns = np.nonzero(mask)
        if len(rows):
            middle[c, 0] = columns.mean(), rows.mean()
    seen = (silhouettes.usable & (silhouettes.areas > 0)).astype(np.float64)[:, None]
    point, views = triangulate(silhouettes.rig, middle, seen)
    return point[0] if views[0] >= 2 else None

"""What one camera sees when nobody is there, learnt at the start and kept up to date; masks and outlines from that.

The room is learnt from pictures of it without anybody, and then follows slowly what changes: the light, the camera's
own exposure, a chair that was moved. Where the person is nothing is learnt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from hypose.cameras.camera import Camera
from hypose.compute import mask_runs
from hypose.evidence.background import BackgroundModel, Image, from_frames, gain_between
from hypose.evidence.outlines import OUTLINE_POINTS, WORKING_HEIGHT, ViewOutline, outline_of_runs
from hypose.evidence.silhouettes import Mask, Segmenter, SilhouetteSettings, bounding_box, make_segmenter
from hypose.io.recordings.view_source import Preparer, mask_in

EVERY_S = 1.0
"""s between two looks at what has changed"""
_LIGHT_S, _THING_S = 10.0, 30.0
"""Time constants: of the room where it looks like the room, and of what is not the room and not the person"""
_SPARSE = 3
"""px between two that tell how much brighter the light is"""
_MARGIN = 0.15
"""of the person's height in the picture, about the person, in which nothing is learnt"""


class ViewRoom:
    """One view. camera: as calibrated; small: pinhole, of the working size; background: where it is known already. Used
    by one thread at a time."""

    def __init__(
        self,
        camera: Camera,
        small: Camera,
        shift: tuple[float, float],
        options: SilhouetteSettings,
        background: BackgroundModel | None = None,
    ) -> None:
        self._prepare, self._options = Preparer(camera, small, shift), options
        self.size = small.size
        self.background: BackgroundModel | None = None
        self._segment: Segmenter | None = None
        self._learnt = -np.inf
        if background is not None:
            self._take(background)

    def learn(self, images: Sequence[Image]) -> None:
        """Take stored pictures (H, W, 3) for those of the empty room."""
        self._take(from_frames([self._prepare(image) for image in images]))

    def mask(self, image: Image) -> tuple[Mask, ViewOutline | None]:
        """What is not the room in a stored picture, (h, w), and its outline for tracking (None: it is empty). The room
        must be known."""
        assert self._segment is not None
        runs, _ = mask_in(image, self._prepare, self._segment)
        return mask_runs.draw(runs), outline_of_runs(runs, OUTLINE_POINTS, WORKING_HEIGHT) if runs.area else None

    def due(self, time: float) -> bool:
        """Whether it is time to look at what has changed."""
        return self.background is not None and time - self._learnt >= EVERY_S

    def follow(self, image: Image, time: float, person: Mask | None) -> None:
        """Learn what has changed, if it is time for that. person (h, w): where the person is, None where that is not
        known: then nothing that stands out is taken for a part of the room."""
        if not self.due(time):
            return
        passed, self._learnt = time - self._learnt, time
        if self.background is None or not np.isfinite(passed):
            return
        assert self._segment is not None
        found, picture = mask_runs.draw(mask_in(image, self._prepare, self._segment)[0]), self._prepare(image)
        sparse, before = np.s_[::_SPARSE, ::_SPARSE], self.background.mean
        gain = gain_between(before[sparse], picture[sparse].astype(np.float32))
        mean = np.clip(before * gain, 0, 255)
        other = _around(found)
        free = np.ones_like(other) if person is None else 1 - _around(person)
        cv2.accumulateWeighted(picture, mean, -np.expm1(-passed / _LIGHT_S), free & (1 - other))
        if person is not None:
            cv2.accumulateWeighted(picture, mean, -np.expm1(-passed / _THING_S), free & other)
        self._take(replace(self.background, mean=mean))

    def _take(self, background: BackgroundModel) -> None:
        self.background = background
        self._segment = make_segmenter(background, self._options)


def _around(mask: Mask) -> Mask:
    """The mask and what is near it, 0 or 1."""
    box = bounding_box(mask)
    if box is None:
        return mask
    size = 2 * max(2, round(_MARGIN * (box[1] - box[0]))) + 1
    return np.asarray(cv2.dilate(mask, np.ones((size, size), np.uint8)), dtype=np.uint8)

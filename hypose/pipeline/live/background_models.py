"""Model the empty scene of one live camera and segment the person; for colour cameras, depth cameras and a network.

The background is learned from pictures without people. That of a colour camera then follows slow changes: light,
exposure, a chair that was moved. Where the person is, nothing is learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute import packed_masks
from hypose.evidence.background import BackgroundModel, from_frames, gain_between
from hypose.evidence.depth_background import DepthBackground, learn_background, person_before
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import OUTLINE_POINTS, WORKING_HEIGHT, ViewOutline, view_outline
from hypose.evidence.pose_network import Crop, PoseDetector, owners_of_pixels
from hypose.evidence.silhouettes import (
    Segmenter,
    SilhouetteSettings,
    bounding_box,
)
from hypose.geometry import DepthMap, Image, Mask
from hypose.io.recordings.recording_views import Preparer, depth_preparer, mask_in, places_in_stored
from hypose.pipeline.settings import SETTINGS


class ViewBackground:
    """Background and segmentation of one colour view; used by one thread at a time.

    camera: calibrated camera.
    small: pinhole camera of the working size.
    shift: (x, y) offset that is added to positions in the stored pictures, px of the calibrated size.
    options: settings of the masks.
    background: background model, where it is known already; None: `learn` must be called first.
    """

    def __init__(
        self,
        camera: Camera,
        small: Camera,
        shift: tuple[float, float],
        options: SilhouetteSettings,
        background: BackgroundModel | None = None,
    ) -> None:
        self._prepare, self._options = Preparer(camera, small, shift), options
        self.background: BackgroundModel | None = None
        self._segment: Segmenter | None = None
        self._learnt = -np.inf
        if background is not None:
            self._take(background)

    @property
    def moved(self) -> bool:
        """Whether something moved while the background was learned, such as a person who has not left; False without a
        background.
        """
        known = self.background
        return known is not None and float((known.sd.max(2) > SETTINGS.scene_moved_grey).mean()) > (
            SETTINGS.scene_moved_share
        )

    def learn(self, images: Sequence[Image]) -> None:
        """Learn the background from stored pictures (H, W, 3) BGR of the empty room; it replaces the former one."""
        self._take(from_frames([self._prepare(image) for image in images]))

    def mask(self, image: Image) -> tuple[Mask, ViewOutline | None]:
        """Segment a stored picture (H, W, 3) BGR; the background must be known.

        Returns: mask (h, w) of 0 and 1, undistorted and at working size, and its outline for tracking (None: the mask
            is empty).
        """
        assert self._segment is not None
        runs, _ = mask_in(image, self._prepare, self._segment)
        return packed_masks.draw(runs), view_outline(runs, OUTLINE_POINTS, WORKING_HEIGHT) if runs.area else None

    def due(self, time: float) -> bool:
        """Return whether an update of the background is due at a time (s): the background is known, and its last
        update is a second ago.
        """
        return self.background is not None and time - self._learnt >= 1.0

    def follow(self, image: Image, time: float, person: Mask | None) -> None:
        """Update the background to slow changes of the scene; call it when an update is due.

        image: stored picture (H, W, 3) BGR.
        time: time of the picture, s.
        person: (h, w) mask of the person, at working size; None: not known, then nothing that differs from the
            background is learned.
        """
        passed, self._learnt = time - self._learnt, time
        if self.background is None or not np.isfinite(passed):
            return
        assert self._segment is not None
        found, picture = packed_masks.draw(mask_in(image, self._prepare, self._segment)[0]), self._prepare(image)
        sparse, before = np.s_[:: SETTINGS.scene_sparse, :: SETTINGS.scene_sparse], self.background.mean
        gain = gain_between(before[sparse], picture[sparse].astype(np.float32))
        mean = np.clip(before * gain, 0, 255)
        other = _around(found)
        free = np.ones_like(other) if person is None else 1 - _around(person)
        cv2.accumulateWeighted(picture, mean, -np.expm1(-passed / SETTINGS.scene_light_s), free & (1 - other))
        if person is not None:
            cv2.accumulateWeighted(picture, mean, -np.expm1(-passed / SETTINGS.scene_thing_s), free & other)
        self._take(replace(self.background, mean=mean))

    def _take(self, background: BackgroundModel) -> None:
        self.background = background
        self._segment = Segmenter(background, self._options)


def _around(mask: Mask) -> Mask:
    """Dilate a mask by a margin in proportion to its height; values 0 or 1."""
    box = bounding_box(mask)
    if box is None:
        return mask
    size = 2 * max(2, round(SETTINGS.scene_margin * (box[1] - box[0]))) + 1
    return np.asarray(cv2.dilate(mask, np.ones((size, size), np.uint8)), dtype=np.uint8)


class NetworkBackground:
    """Segmentation of one view by a network that finds people, in place of a `ViewBackground`; it needs no background,
    and is used by one thread at a time.

    camera: as calibrated.
    small: pinhole camera of the working size.
    shift: px of the calibrated size that are added to image positions.
    network: finds people and their masks in a picture.
    """

    background, moved = "not needed", False

    def __init__(self, camera: Camera, small: Camera, shift: tuple[float, float], network: PoseDetector) -> None:
        self._camera, self._small, self._shift, self._network = camera, small.size, shift, network
        self._number, self._before = 0, list[Crop]()
        self._places: dict[tuple[int, int], NDArray[np.float32]] = {}

    def learn(self, images: Sequence[Image]) -> None:
        """Forget the people found so far, who guide the search in the next picture.

        images: not used, because the network needs no background.
        """
        self._before = []

    def mask(self, image: Image) -> tuple[Mask, ViewOutline | None]:
        """Segment the people in a stored picture (H, W, 3) BGR; call it for the pictures in their order.

        Returns: mask (h, w) of 0 and 1, undistorted and at working size, and its outline for tracking (None: no person
            is seen).
        """
        stored = (image.shape[1], image.shape[0])
        if stored not in self._places:
            self._places[stored] = places_in_stored(self._camera, self._small, self._shift, stored)
        people = self._network.look(image, self._number, self._before)
        self._number, self._before = self._number + 1, [p.following for p in people if p.following is not None]
        mask = np.minimum(owners_of_pixels(people, self._places[stored]), 1)
        return mask, view_outline(mask, working_height=WORKING_HEIGHT) if mask.any() else None


Millimetres = NDArray[np.uint16]


class DepthViewBackground:
    """Background and segmentation of one depth view, in place of a `ViewBackground`; used by one thread at a time.

    camera: calibrated camera.
    small: pinhole camera of the working size.
    shift: (x, y) offset that is added to positions in the stored maps, px of the calibrated size.
    background: background model, where it is known already; None: `learn` must be called first. It is not updated,
        since light does not change depth.
    """

    def __init__(
        self, camera: Camera, small: Camera, shift: tuple[float, float], background: DepthBackground | None = None
    ) -> None:
        self._prepare, self.background = depth_preparer(camera, small, shift), background
        self._focal_px = float(small.K[0, 0])
        self.seen: Millimetres | None = None
        """(h, w) mm: the last map that was segmented."""

    @property
    def moved(self) -> bool:
        """Whether something moved while the background was learned; False without a background."""
        background = self.background
        if background is None or not background.depth.any():
            return False
        return float((background.sd[background.depth > 0] > SETTINGS.scene_moved_m).mean()) > SETTINGS.scene_moved_share

    def learn(self, maps: Sequence[DepthMap]) -> None:
        """Learn the background from stored maps (H, W) m of the empty room."""
        self.background = learn_background([self._prepare(m) for m in maps])

    def mask(self, depth: DepthMap) -> tuple[Mask, ViewOutline | None]:
        """Segment the person in front of the background in a stored map (H, W) m; the background must be known.

        Returns: mask (h, w), undistorted and at working size, and its outline for tracking (None: no person).
        """
        assert self.background is not None
        own = self._prepare(depth)
        self.seen = np.minimum(own * 1000 + 0.5, 65535).astype(np.uint16)
        mask = person_before(own, self.background, self._focal_px)
        return mask, view_outline(mask, working_height=WORKING_HEIGHT) if mask.any() else None


def depth_of(silhouettes: Silhouettes, maps: Sequence[Millimetres | None]) -> Depth | None:
    """Collect the depth (m) inside the silhouettes from maps; None where no usable view has one.

    maps: per view (h, w) mm, or None.
    """
    usable = silhouettes.usable & np.array([m is not None for m in maps])
    if not usable.any():
        return None
    out = np.zeros(silhouettes.masks.shape, np.float32)
    for c in np.flatnonzero(usable):
        own = maps[int(c)]
        assert own is not None
        np.multiply(own, np.float32(1e-3), out=out[c, : own.shape[0], : own.shape[1]])
    return Depth(out, silhouettes.masks * usable.astype(np.uint8)[:, None, None], silhouettes.rig, usable)

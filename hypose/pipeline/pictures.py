"""One camera of a recording as frames with its picture, for the recipes that look at that."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import InputError
from hypose.evidence.body_parts import detect_ends, end_colors
from hypose.evidence.frame import Frame, Picture, Silhouettes
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.evidence.skin import skin_map
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.view_source import ViewSource
from hypose.pipeline.first_frame import Subject
from hypose.tracking.monocular.evidence import SMALLEST_MASK

TARGET_PX = 250.0
"""The person's size in the pictures that are worked on: larger ones cost time, smaller ones limbs."""
SMALLEST_SIDE = 320
_AHEAD_BYTES = 250_000_000
"""Of pictures that are read forwards and kept, so that no video is decoded backwards."""


def one_view(recording: Recording, camera: str | None) -> Recording:
    """The recording limited to the named camera (None: its only one); an InputError lists the cameras."""
    names = [v.name for v in recording.views]
    if camera is None and len(names) > 1:
        raise InputError(
            f"The recording {recording.name} has {len(names)} cameras ({', '.join(names)}); name one with --camera."
        )
    if camera is not None and camera not in names:
        raise InputError(
            f"The recording {recording.name} has no camera {camera!r}; it has {', '.join(names)}: give one of them "
            "with --camera."
        )
    k = 0 if camera is None else names.index(camera)
    view = recording.views[k]
    if view.source is None:
        raise InputError(
            f"Camera {view.name} has masks but neither video nor images, and one camera alone needs pictures; give its "
            "video in recording.toml."
        )
    return replace(recording, views=(view,), rig=CameraRig((recording.rig[k],)))


def working_side(recording: Recording, person_px: float, picture: tuple[int, int]) -> int:
    """Longer side of the pictures to work on, px, so that somebody who is person_px tall in pictures of that size
    (width, height) is about TARGET_PX tall."""
    longest = max(recording.rig[0].size)
    share = person_px / max(picture)
    return round(float(np.clip(TARGET_PX / max(share, 1e-3), min(SMALLEST_SIDE, longest), longest)))


def has_masks(recording: Recording) -> bool:
    """Whether a recording of one camera provides masks; a background learnt from the clip itself holds the person."""
    view = recording.views[0]
    return view.masks is not None or view.background is not None


def masks_of(recording: Recording, evidence: str) -> SilhouetteSettings | None:
    """How the masks of the one camera are made, None without; an InputError when the evidence asks for masks or key
    points that are not there."""
    view = recording.views[0]
    if evidence in ("silhouettes", "both") and not has_masks(recording):
        raise InputError(
            f"Camera {view.name} has neither masks nor a background, so it gives no silhouettes; add masks or a "
            "background in recording.toml, or leave --evidence out."
        )
    if evidence in ("keypoints", "both") and (recording.keypoint_set is None or not view.keypoints):
        raise InputError(
            f"Camera {view.name} has no key points; add keypoints = ... to the view in recording.toml, or leave "
            "--evidence out."
        )
    return SilhouetteSettings() if has_masks(recording) and evidence in ("auto", "silhouettes", "both") else None


class FrameSource(Protocol):
    """Frames by number: hypose.io.recordings.frames.FrameStream, or any synthetic scene."""

    def __len__(self) -> int: ...

    def frame(self, index: int, /) -> Frame:
        """Frame number index, 0 <= index < len."""
        ...


class PictureFrames:
    """The frames of a source with the picture of its one camera, undistorted, at working size; the mask is a part of
    it, left out where it shows nobody. Frames that are in memory have their pictures already."""

    def __init__(self, source: FrameSource) -> None:
        self._source, self._pictures = source, None
        self._kept: dict[int, Frame] = {}
        if isinstance(source, FrameStream):
            # read forwards, while the stream makes masks ahead
            self._pictures = ViewSource(source.recording.views[0], source.recording.rig[0], source.rig[0])

    def frame(self, index: int, /) -> Frame:
        """Frame number index, its picture without the one before."""
        frame = self._source.frame(index)
        if self._pictures is None or not isinstance(self._source, FrameStream):
            return frame
        seen, mask = frame.silhouettes, None
        if seen is not None and seen.usable[0] and seen.areas[0] >= SMALLEST_MASK:
            mask = seen.masks[0]
        picture = Picture(self._source.rig[0], self._pictures.image(frame.index), None, mask)
        return Frame(frame.time, frame.index, keypoints=frame.keypoints, picture=picture)

    def walk(self, indices: range) -> Iterator[Frame]:
        """The frames one after the other, forwards or backwards; the picture before is the one behind, whether or not
        it belongs to the walk."""
        behind = indices.start - indices.step
        last = self._read(behind, indices.step) if indices and 0 <= behind < len(self._source) else None
        for index in indices:
            frame = self._read(index, indices.step)
            if frame.picture is not None:
                before = None if last is None or last.picture is None else last.picture.image
                yield replace(frame, picture=replace(frame.picture, before=before))
            else:
                yield frame
            last = frame

    def _read(self, index: int, step: int) -> Frame:
        if step > 0:
            return self.frame(index)
        if index not in self._kept:
            first = self.frame(index) if not self._kept else next(iter(self._kept.values()))
            size = 1 if first.picture is None else first.picture.image.nbytes
            self._kept = {i: self.frame(i) for i in range(max(0, index + 1 - max(1, _AHEAD_BYTES // size)), index + 1)}
        return self._kept[index]

    def close(self) -> None:
        """Release the video."""
        if self._pictures is not None:
            self._pictures.close()


def depth_note(motion: Motion, modes: Modes) -> str:
    """A sentence that says how uncertain the depth is, in mm, and how many poses are still possible."""
    depth = 1e3 * float(np.nanmedian(modes.depth_sd))
    whole = 3 * np.asarray(motion.joint_sd) ** 2
    across = 1e3 * float(np.nanmedian(np.sqrt(np.maximum(whole - modes.depth_sd**2, 0.0) / 2)))
    rival = modes.alive > 1
    spread = 0.0
    if rival.any():
        apart = np.linalg.norm(modes.joints[:, 1:] - modes.joints[:, :1], axis=-1)
        spread = 1e3 * float(np.nanmedian(np.nanmax(apart[rival], axis=(1, 2))))
    others = np.median(modes.alive) - 1
    return (
        f"one camera does not measure depth: along its line of sight a joint is known to +-{depth:.0f} mm (1 sd, "
        f"median), across it to +-{across:.0f} mm; beside the best pose {others:.0f} others explain the pictures "
        f"nearly as well (median), whose joints lie up to {spread:.0f} mm elsewhere: see modes.npz"
    )


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

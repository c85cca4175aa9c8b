"""One camera of a recording as frames with its picture, for the recipes that look at that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from hypose.body.motion import Modes, Motion
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Frame, Picture
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.view_source import ViewSource
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

"""One camera of a recording as frames of the monocular tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.evidence.silhouettes import SilhouetteOptions
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameOptions, FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.view_source import ViewSource
from hypose.monocular.evidence import SMALLEST_MASK
from hypose.monocular.types import MonoFrame

CUES = ("auto", "edges", "silhouettes", "keypoints", "both")
"""What is used besides edges and flow: all there is, nothing, masks, key points, or both."""
TARGET_PX = 250.0
"""The person's size in the pictures that are worked on: larger ones cost time, smaller ones limbs."""
SMALLEST_SIDE = 320


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


class MonoStream:
    """Pictures of the one camera of a recording at working size, undistorted, with the cues that are wanted.

    camera: the pinhole of the working size. keypoint_names: () without key points. Use it in a `with` block."""

    def __init__(self, recording: Recording, cues: str = "auto", longer_side: int = 480) -> None:
        if cues not in CUES:
            raise InputError(f"There is no evidence {cues!r}; choose {', '.join(CUES)}.")
        view = recording.views[0]
        has_masks = view.masks is not None or view.background is not None
        if cues in ("silhouettes", "both") and not has_masks:
            raise InputError(
                f"Camera {view.name} has neither masks nor a background, so it gives no silhouettes; add masks or a "
                "background in recording.toml, or leave --evidence out."
            )
        self.recording = recording
        self._masked = has_masks and cues in ("auto", "silhouettes", "both")
        # masks only where the recording provides for them: a background learnt from the clip itself holds the person
        masks = SilhouetteOptions() if self._masked else None
        self._stream = FrameStream(recording, FrameOptions(longer_side, silhouettes=masks))
        points = self._stream.keypoints
        if cues in ("keypoints", "both") and points is None:
            raise InputError(
                f"Camera {view.name} has no key points; add keypoints = ... to the view in recording.toml, or leave "
                "--evidence out."
            )
        self._points = points if cues in ("auto", "keypoints", "both") else None
        self.start_points = points
        self.camera: Camera = self._stream.rig[0]
        # read forwards, while the stream makes masks ahead
        self._pictures = ViewSource(view, recording.rig[0], self.camera)
        self.keypoint_names: tuple[str, ...] = () if self._points is None else self._points[0].names

    def __enter__(self) -> MonoStream:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        self._pictures.close()

    def __len__(self) -> int:
        return len(self._stream)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user about the camera's evidence."""
        used = ["edges", "optical flow"]
        used += ["silhouettes"] if self._masked else []
        used += ["key points"] if self._points is not None else []
        return (f"one camera ({self.recording.views[0].name}): {', '.join(used)}", *self._stream.notes)

    def frame(self, index: int) -> MonoFrame:
        """Frame number index, without points (they depend on the body)."""
        mask = None
        if self._masked:
            silhouettes = self._stream.frame(index).silhouettes
            if silhouettes is not None and silhouettes.usable[0] and silhouettes.areas[0] >= SMALLEST_MASK:
                mask = silhouettes.masks[0]
        number = self.recording.frames[index]
        return MonoFrame(number, number / self.recording.frame_rate, self._pictures.image(number), mask)

    def keypoints(self, index: int) -> Array | None:
        """(K, 3) = (u px, v px, confidence) of the working camera, None without key points."""
        return None if self._points is None else np.asarray(self._points[index].points[0])

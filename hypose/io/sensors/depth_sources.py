"""Depth cameras as they deliver: a RealSense, and folders of depth maps played at their own pace."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from hypose.errors import HyposeError, InputError
from hypose.io.sensors.depth import DepthMap, read_depth_png
from hypose.io.sensors.realsense import RealSenseDepth, open_realsense
from hypose.io.videos.camera_sources import CameraSource, Shot, StreamEnded, played
from hypose.io.videos.video import list_images

FOLDER, REALSENSE = "depth:", "realsense"
"""How the address of a depth camera begins: a folder of maps, and a camera, whose serial number may follow"""


def is_depth(address: str) -> bool:
    """Whether an address is that of a depth camera."""
    return address.startswith(FOLDER) or address == REALSENSE or address.startswith(f"{REALSENSE}:")


def open_depth_camera(address: str, rate: float, begin: float | None = None) -> CameraSource:
    """A depth camera by its address: `realsense`, `realsense:SERIAL`, or `depth:FOLDER` with 16-bit PNG in millimetres,
    which are played at `rate` Hz, the first at `begin` (s, monotonic). Its shots hold maps (h, w) float32 m. An
    InputError says what cannot be opened."""
    if not address.startswith(FOLDER):
        serial = address.partition(":")[2]
        return _RealSense(open_realsense(serial or None), address)
    folder = Path(address.removeprefix(FOLDER))
    if not folder.is_dir():
        raise InputError(f"There is no folder {folder}; a depth recording is a folder of 16-bit PNG in millimetres.")
    return played(_Maps(folder), rate, time.monotonic() if begin is None else begin)


class _RealSense:
    """A connected camera."""

    live = True

    def __init__(self, found: RealSenseDepth, what: str) -> None:
        self._what, self._frames = what, found.frames

    def read(self) -> Shot:
        """See `CameraSource`."""
        try:
            frame = next(self._frames, None)
        except InputError as error:  # it may be plugged in again
            raise StreamEnded(str(error)) from None
        if frame is None:
            raise StreamEnded(f"{self._what} delivers nothing more.")
        return Shot(time.monotonic(), frame.time, frame.depth)

    def close(self) -> None:
        """See `CameraSource`."""
        close = getattr(self._frames, "close", None)
        if close is not None:
            close()


class _Maps:
    """A folder of depth maps as what is played reads it."""

    frame_rate: float | None = None

    def __init__(self, folder: Path) -> None:
        self.path, self._files, self.position = folder, list_images(folder), 0
        self.n_frames = len(self._files)

    def read(self, number: int) -> DepthMap:
        """Map `number`; one that is damaged shows nothing."""
        self.position = number + 1
        try:
            return read_depth_png(self._files[number])
        except HyposeError:
            return np.zeros((1, 1), np.float32)

    def close(self) -> None:
        """Nothing is open."""

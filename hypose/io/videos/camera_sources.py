"""Live cameras: devices of this computer, network streams, and files that are played at their own speed.

A source gives images one after another, each with its time.
"""

from __future__ import annotations

import contextlib
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import HyposeError, InputError
from hypose.io.videos.video import VideoReader, open_video, quiet


class StreamEnded(HyposeError):
    """The end of a source: a file is over, or a camera was disconnected and may come back."""


@dataclass(frozen=True)
class CameraImage:
    """An image of a camera at one instant.

    arrival: time of arrival, s of this computer's monotonic clock.
    stamp: time of the camera's own clock, s; None where it sends none.
    picture: (h, w, 3) uint8 BGR, or a depth map (h, w) float32 m.
    """

    arrival: float
    stamp: float | None
    picture: NDArray[Any]


class CameraSource(Protocol):
    """Interface of everything that delivers images.

    live: the camera does not wait, and images that are not read are lost.
    """

    live: bool

    def read(self) -> CameraImage:
        """Wait for the next image, a few seconds at most, and return it.

        Raises: StreamEnded where there is none.
        """
        ...

    def close(self) -> None:
        """Release the camera."""
        ...


def open_camera(
    address: str, rate: float, size: tuple[int, int], begin: float | None = None, loop_s: float | None = None
) -> CameraSource:
    """Open a camera by its address.

    address: number of a device (0), address of a stream (http://, https://, rtsp://), a video file or a folder of
        pictures.
    rate: frame rate requested from a device, or of a file that has none, Hz.
    size: width and height requested from a device, px.
    begin: time of a file's first picture, s of the monotonic clock, so that several files can start together; now by
        default.
    loop_s: period after which a file begins again, s, the same for all that belong together; None: it ends.
    Raises: InputError where it cannot be opened.
    """
    if is_device(address):
        return _device(int(address), rate, size)
    if "://" in address:
        return _stream(address)
    if not Path(address).exists():
        raise InputError(
            f"There is no file {address}; a camera is the number of a device (0), an address (http://, rtsp://), a "
            "video or a folder of pictures."
        )
    return Played(open_video(Path(address)), rate, time.monotonic() if begin is None else begin, loop_s)


def is_device(address: str) -> bool:
    """Test whether an address is the number of a camera of this computer."""
    return address.isascii() and address.isdigit() and len(address) < 3  # OpenCV takes hundreds for back ends


# ---- devices and streams that OpenCV reads ---------------------------------------------------------------------


class _Captured:
    """A camera that OpenCV reads: a device of this computer or a network stream."""

    live = True

    def __init__(self, what: str, advice: str, *arguments: Any) -> None:
        self._what = what
        with quiet():
            self.capture = cv2.VideoCapture(*arguments)
        if not self.capture.isOpened():
            raise InputError(f"{what} cannot be opened; {advice}")

    def read(self) -> CameraImage:
        """Wait for the next image; StreamEnded where there is none."""
        image: NDArray[np.uint8] | None = None
        arrival = 0.0
        with quiet(), contextlib.suppress(cv2.error):  # raised for a damaged picture of a device
            ok = self.capture.grab()
            arrival = time.monotonic()
            if ok:
                ok, found = self.capture.retrieve()
                image = np.asarray(found, dtype=np.uint8) if ok else None
        if image is None:
            raise StreamEnded(f"{self._what} delivers nothing more.")
        return CameraImage(arrival, None, image)

    def close(self) -> None:
        """Release the camera."""
        self.capture.release()


def _device(number: int, rate: float, size: tuple[int, int]) -> _Captured:
    """Open a camera of this computer with OpenCV's own back end (V4L2, DirectShow, AVFoundation).

    number: number of the device, from 0.
    rate, size: frame rate (Hz), width and height (px) that are requested; the camera may give others.
    """
    advice = "is it plugged in, and does no other program use it? Devices are numbered from 0."
    camera = _Captured(f"Camera {number} of this computer", advice, number)
    # raw pictures of two cameras are more than one USB bus carries
    camera.capture.set(cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*"MJPG")))
    for key, value in (
        (cv2.CAP_PROP_FRAME_WIDTH, size[0]),
        (cv2.CAP_PROP_FRAME_HEIGHT, size[1]),
        (cv2.CAP_PROP_FPS, rate),
        (cv2.CAP_PROP_BUFFERSIZE, 1),
    ):
        camera.capture.set(key, float(value))
    return camera


def _stream(address: str) -> _Captured:
    """Open a network stream that FFmpeg reads (motion JPEG over HTTP, RTSP and others)."""
    waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 5000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 5000]
    advice = (
        "check the address with its name and password, and that the camera is on. In names and passwords / is written "
        "%2F, @ %40, # %23."
    )
    return _Captured(f"The stream {without_password(address)}", advice, address, cv2.CAP_FFMPEG, waits)


def without_password(address: str) -> str:
    """Replace the password in an address by dots, so that the address can be shown."""
    return re.sub(r"(://[^/:@]*):.*@", r"\1:...@", address)


# ---- files -----------------------------------------------------------------------------------------------------------


class Played:
    """A video or folder of pictures that is played at its own speed as a `CameraSource`.

    As with a camera, pictures whose time has passed are skipped. Each picture has the time at which it was due.

    reader: the video or folder.
    rate: Hz, where the film's own rate is not known.
    begin: time of the first picture, s of the monotonic clock.
    loop_s: period after which it begins again, s; None: it ends.
    """

    live = False

    def __init__(self, reader: VideoReader, rate: float, begin: float, loop_s: float | None = None) -> None:
        self._reader, self._rate, self._begin, self._loop_s = reader, reader.frame_rate or rate, begin, loop_s

    def read(self) -> CameraImage:
        """Wait until the next picture is due, and return it; StreamEnded after the last."""
        now, next_one = time.monotonic(), self._reader.position
        due_s, following = now - self._begin, next_one / self._rate
        if self._loop_s is not None and max(due_s, following) >= self._loop_s - 0.5 / self._rate:
            laps = max(1, int(due_s // self._loop_s))
            self._begin += laps * self._loop_s
            due_s, next_one = now - self._begin, 0
        number = max(next_one, min(int(due_s * self._rate), self._reader.n_frames - 1))
        if next_one >= self._reader.n_frames:
            raise StreamEnded(f"{self._reader.path} is over.")
        image = self._reader.read(number)
        at = self._begin + number / self._rate
        left = at - time.monotonic()
        if left > 0:
            time.sleep(left)
        return CameraImage(time.monotonic(), at, image)

    def close(self) -> None:
        """Release the files."""
        self._reader.close()

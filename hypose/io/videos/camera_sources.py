"""Live cameras: devices of this computer, network streams, and files that are played at their own speed.

A source gives images one after another, each with its time. `CameraImage.picture` decodes an image only when it is
needed, at a half, quarter or eighth of its size where that is enough, because decoding is most of the work.
"""

from __future__ import annotations

import base64
import contextlib
import http.client
import math
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import HyposeError, InputError
from hypose.io.videos.video import open_video, quiet

LARGEST_PART = 32 << 20
"""Largest size of one picture of a stream, bytes."""
_LONGEST_LINE = 4096
_REDUCED = ((8, cv2.IMREAD_REDUCED_COLOR_8), (4, cv2.IMREAD_REDUCED_COLOR_4), (2, cv2.IMREAD_REDUCED_COLOR_2))


class StreamEnded(HyposeError):
    """The end of a source: a file is over, or a camera was disconnected and may come back."""


@dataclass(frozen=True)
class CameraImage:
    """An image of a camera at one instant.

    arrival: time of arrival, s of this computer's monotonic clock.
    stamp: time of the camera's own clock, s; None where it sends none.
    data: the picture (h, w, 3), the bytes of a JPEG, or a depth map (h, w) float32 m.
    """

    arrival: float
    stamp: float | None
    data: NDArray[Any] | bytes

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the image as sent, px; None where the JPEG's header does not give them."""
        if isinstance(self.data, np.ndarray):
            return self.data.shape[1], self.data.shape[0]
        return _jpeg_size(self.data)

    def picture(self, least: tuple[int, int] | None = None) -> NDArray[Any] | None:
        """Decode the picture.

        least: width and height that the result must have at least; larger pictures are decoded at a reduced size.
        Returns: (h, w, 3) uint8 BGR, or the depth map; None where the image is damaged.
        """
        if isinstance(self.data, np.ndarray):
            return self.data
        raw = np.frombuffer(self.data, np.uint8)
        how = cv2.IMREAD_COLOR
        size = self.size
        if size is not None and least is not None:
            fits = (flag for n, flag in _REDUCED if size[0] >= n * least[0] and size[1] >= n * least[1])
            how = next(fits, cv2.IMREAD_COLOR)
        with quiet(), contextlib.suppress(cv2.error):
            image = cv2.imdecode(raw, how)
            return None if image is None else np.asarray(image, dtype=np.uint8)
        return None


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
    if address.lower().startswith(("http://", "https://")):
        return _MotionJpeg(address)
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
    """Open a network stream that FFmpeg reads."""
    waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 5000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 5000]
    advice = "check the address, and that the camera is on."
    return _Captured(f"The stream {without_password(address)}", advice, address, cv2.CAP_FFMPEG, waits)


def without_password(address: str) -> str:
    """Replace the password in an address by dots, so that the address can be shown."""
    return re.sub(r"(://[^/:@]*):.*@", r"\1:...@", address)


# ---- motion JPEG over HTTP -----------------------------------------------------------------------------------------


class _MotionJpeg:
    """A motion JPEG stream (multipart/x-mixed-replace) of an IP camera or phone.

    The header X-Timestamp (s) of a part, where there is one, is the camera's own time.
    """

    live = True

    def __init__(self, address: str) -> None:
        self._what = f"The stream {without_password(address)}"
        try:
            answer = _asked(address, 5.0)
        except OSError as error:
            if isinstance(error, urllib.error.HTTPError) and error.code in (401, 403):
                raise InputError(
                    f"{self._what} asks for another name or password; write http://NAME:PASSWORD@ADDRESS."
                ) from None
            reason = getattr(error, "reason", None) or error
            raise InputError(f"{self._what} cannot be opened ({reason}); check the address.") from None
        except (http.client.HTTPException, ValueError):  # their texts would show the address with the password
            raise InputError(
                f"{self._what} cannot be opened (the address is not valid, or no camera answers); check the address. "
                "In names and passwords / is written %2F, @ %40, # %23."
            ) from None
        self._answer, self._line = answer, b""  # a line that was read ahead and belongs to the next header
        kind = str(answer.headers.get("Content-Type", ""))
        if not kind.lower().startswith("multipart/"):
            self.close()
            raise InputError(
                f"{self._what} is {kind.partition(';')[0] or 'of no known kind'}, and motion JPEG (multipart/"
                "x-mixed-replace) is needed; cameras have an address for it, often ending in /video or /mjpeg."
            )
        self._boundary = (answer.headers.get_boundary("") or "").lstrip("-").encode()

    def read(self) -> CameraImage:
        """Wait for the next image; StreamEnded where the connection breaks."""
        try:
            length, stamp = self._head()
            data = self._body(length)
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise StreamEnded(f"{self._what} broke off ({error}).") from None
        return CameraImage(time.monotonic(), stamp, data)

    def _head(self) -> tuple[int | None, float | None]:
        """Read the header of the next part: its length and its time, None where not given."""
        length: int | None = None
        stamp: float | None = None
        begun = False
        for _ in range(64):
            line, self._line = self._line or self._answer.readline(_LONGEST_LINE), b""
            if not line:
                raise ValueError("the connection was closed")
            text = line.strip()
            name, _, value = text.lower().partition(b":")
            # empty lines, and the line between two parts, which some cameras leave out before the first
            if not begun and not name.startswith(b"content-"):
                begun = text.startswith(b"--")
                continue
            begun = True
            if not text:
                return length, stamp
            if name == b"content-length":
                length = int(value)
            elif name == b"x-timestamp":
                with contextlib.suppress(ValueError):
                    stamp = float(value) if math.isfinite(float(value)) else None
        raise ValueError("a part begins with too many lines")

    def _body(self, length: int | None) -> bytes:
        """Read a picture of `length` bytes, or up to the next boundary where the length is not known (None)."""
        if length is not None:
            if not 0 < length <= LARGEST_PART:
                raise ValueError(f"a picture of {length} bytes")
            data = self._answer.read(length)
            if len(data) < length:
                raise ValueError("the connection was closed")
            return data
        lines: list[bytes] = []
        total = 0
        while True:  # up to the next boundary, which belongs to the next header
            line = self._answer.readline(1 << 16)
            if not line or total > LARGEST_PART:
                raise ValueError("the connection was closed" if not line else "a picture without an end")
            if line.startswith(b"--" + self._boundary):
                self._line = line
                return b"".join(lines).rstrip(b"\r\n")
            lines.append(line)
            total += len(line)

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._answer.close()


def _asked(address: str, seconds: float) -> http.client.HTTPResponse:
    """Open an address with the name and password in it, by Basic or Digest authentication.

    seconds: longest time to wait for the connection and for each read.
    Why: Basic is sent at once, because many cameras do not request it.
    """
    parts, known = urllib.parse.urlsplit(address), urllib.request.HTTPPasswordMgrWithDefaultRealm()
    where = urllib.parse.urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    request = urllib.request.Request(where)
    if parts.username is not None:
        name, password = urllib.parse.unquote(parts.username), urllib.parse.unquote(parts.password or "")
        known.add_password(None, where, name, password)
        secret = base64.b64encode(f"{name}:{password}".encode()).decode()
        request.add_header("Authorization", f"Basic {secret}")
    digest = urllib.request.HTTPDigestAuthHandler(known)
    return urllib.request.build_opener(urllib.request.ProxyHandler({}), digest).open(request, timeout=seconds)


# ---- files -----------------------------------------------------------------------------------------------------------


class Film(Protocol):
    """Interface of everything that can be played: numbered pictures.

    path: file or folder, for the error messages.
    frame_rate: Hz; None where not known.
    n_frames: number of pictures.
    """

    path: Path
    frame_rate: float | None
    n_frames: int

    @property
    def position(self) -> int:
        """Number of the picture that comes next."""
        ...

    def read(self, number: int, /) -> NDArray[Any]:
        """Read a picture by its number."""
        ...

    def close(self) -> None:
        """Release the files."""
        ...


class Played:
    """A video or folder of pictures that is played at its own speed as a `CameraSource`.

    As with a camera, pictures whose time has passed are skipped. Each picture has the time at which it was due.

    reader: the video or folder.
    rate: Hz, where the film's own rate is not known.
    begin: time of the first picture, s of the monotonic clock.
    loop_s: period after which it begins again, s; None: it ends.
    """

    live = False

    def __init__(self, reader: Film, rate: float, begin: float, loop_s: float | None = None) -> None:
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


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Read width and height from the header of a JPEG; None where it does not give them."""
    at = 2
    while data[:2] == b"\xff\xd8" and at + 9 < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None

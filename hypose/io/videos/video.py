"""Videos and image folders: reading by exact frame number, counting of frames, writing; sound of videos; live cameras.

The number of frames in a container is often wrong (capture software that adds two, files cut off during copying). So it
is checked by decoding the last frame, and counted when that fails. Seeking with cv2.CAP_PROP_POS_FRAMES is not exact
for all codecs and frame rates, so going back opens the file again and decodes forward: slower, but always exact. A
reader for a user who drags along a timeline seeks (`VideoReader.jumps`) where that was found to be exact in the video.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import struct
import subprocess
import time
import wave
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.errors import HyposeError, InputError, refuse
from hypose.geometry import Array, Image
from hypose.io.files import atomic_path, natural_key, open_file, read_bytes, utf8_path

# Suppresses FFmpeg's own messages between those of hypose; OpenCV reads this when it first opens a video.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


VIDEO_ENDINGS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".wmv", ".mts")
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MAX_IMAGE_BYTES = 512 << 20
# Encoders by ending; the first that opens is used. Tested with opencv-python-headless 5.0.0.93: the wheel cannot encode
# H.264 (avc1), which both players and browsers show; in .mp4 it writes mp4v, MJPG, VP9 and FFV1.
_CODECS = {
    ".mp4": ("mp4v", "avc1"),
    ".m4v": ("mp4v", "avc1"),
    ".mov": ("mp4v", "avc1"),
    ".avi": ("MJPG", "mp4v"),
    ".mkv": ("FFV1", "mp4v"),
    ".webm": ("VP80",),
}
# A video is read frame by frame when its time stamps would need more than this many times its number of frames.
_MOST_REPEATS = 4
_DECODED_AHEAD, _TRIAL = 24, 10
"""Frames ahead that are faster decoded than reached by seeking, and the frame on which seeking is tested."""
# Codecs whose stored packets are one frame each, so that counting packets counts frames.
_PICTURE_PER_PACKET = {cv2.VideoWriter.fourcc(*name) for name in ("avc1", "h264", "hevc", "hvc1")}


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress OpenCV's messages in the terminal within a with block; hypose gives its own."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def read_image_file(path: Path) -> bytes:
    """Read the bytes of an image file.

    Raises: InputError where the file does not exist, is empty or too large.
    """
    return read_bytes(path, "an image", _MAX_IMAGE_BYTES)  # cv2.imread fails on some names under Windows


def png_header(data: bytes) -> tuple[int, int, int, int]:
    """Read width, height, bits per value and colour type (0 grey, 3 palette) of a PNG; zeros for other data."""
    if not data.startswith(PNG_SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        return 0, 0, 0, 0
    return struct.unpack(">IIBB", data[16:26])


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Split a PNG into chunks: the kind and the whole of each, up to the last that the data hold completely."""
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        begin, at = at, at + 12 + length
        if at <= len(data):
            yield kind, data[begin:at]


def decode(data: bytes, how: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Decode an image; None where it is no image, or damaged.

    how: OpenCV's flag for the conversion of colours.
    Why: of a PNG that is cut off, OpenCV (from 4.11) allocates the size that a chunk states, half a gigabyte for a
        damaged file of a kilobyte.
    """
    if data.startswith(PNG_SIGNATURE) and b"IEND" not in dict(png_chunks(data)):
        return None
    with quiet(), contextlib.suppress(cv2.error):
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), how)


def read_image(path: str | Path) -> Image:
    """Read an image file as (h, w, 3) uint8 BGR. A grey one of 16 bits counts as a depth map: near is bright, holes are
    black.

    Raises: InputError where the file does not exist or is damaged.
    """
    data = read_image_file(Path(path))
    depth = png_header(data)[2:] == (16, 0)
    image = decode(data, cv2.IMREAD_UNCHANGED if depth else cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(f"{path} is not an image or is damaged; replace it with a PNG or JPEG file.")
    if depth:
        shade = np.where(image > 0, np.clip(255 - image.astype(np.float32) * (200 / 6000), 40, 255), 0)
        image = np.repeat(shade.astype(np.uint8).reshape(*image.shape[:2], -1)[..., :1], 3, 2)
    return np.asarray(image, dtype=np.uint8)


def list_images(folder: Path) -> list[Path]:
    """List the image files of a folder in natural order."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_ENDINGS and not p.name.startswith(".")]
    return sorted((p for p in found if p.is_file()), key=lambda p: natural_key(p.name))


def sequence_numbers(files: Sequence[Path]) -> NDArray[np.int64] | None:
    """Read the last number (T,) in the name of each file; None where the names differ in more than this number."""
    parts = [re.split(r"(\d+)(?=\D*$)", f.name) for f in files]
    if any(len(p) != 3 or len(p[1]) > 15 for p in parts) or len({(p[0], p[2]) for p in parts}) > 1:
        return None
    return np.array([int(p[1]) for p in parts], dtype=np.int64)


def check_numbers(folder: Path) -> None:
    """Check that no picture is missing in a numbered sequence.

    Names that differ in more than one number are not a sequence, and a sequence may count in steps.

    Raises: InputError where one is missing, because all later pictures would be shifted in time.
    """
    images = list_images(folder)
    numbers = sequence_numbers(images)
    if numbers is None or len(images) < 3:
        return
    steps = np.diff(numbers)
    usual = int(np.median(steps))
    if usual < 1 or (steps == usual).all():
        return
    missing = sorted(set(range(int(numbers[0]), int(numbers[-1]), usual)) - set(numbers.tolist()))
    if not missing:
        return  # the step changes: which number is missing is not known
    named = ", ".join(str(n) for n in missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
    raise InputError(
        f"The image sequence {folder} lacks number {named} ({images[0].name} to {images[-1].name}): all later images "
        "would be shifted against the other cameras; put them back, or copies of others, or leave this view out."
    )


class VideoReader:
    """Reader of the frames of a video file, a folder of images, or one image: BGR uint8 (h, w, 3).

    Open it with `open_video`. Iteration gives the frames from the present position (0 after opening) to the end. It is
    a context manager.

    path: the file or folder.
    threads: number of threads that decode a video; None for all.
    rate: frames/s at which a video is read by its time stamps; the frame before replaces a missing one. None: frame by
        frame.

    Attributes:
    size: width and height, px.
    frame_rate: frames/s; None for images.
    n_frames: number of frames that can be decoded.
    stated_frames: number of frames that the container states.
    position: index of the frame that comes next.
    jumps: frames far away are reached by seeking, where that is exact in this video; False after opening.
    is_sequence: whether the frames are image files.
    """

    def __init__(self, path: Path, threads: int | None = None, rate: float | None = None) -> None:
        self.path, self._threads = path, threads
        self._stored: NDArray[np.int64] | None = None if rate is None else stored_frames(path, rate)
        self._images: list[Path] | None = _images_of(path)
        self._capture: cv2.VideoCapture | None = None  # opened when the first frame is asked for
        self.position, self._decoded, self.jumps = 0, 0, False
        self._memory: Image | None = None  # of the last frame
        self.is_sequence: bool = self._images is not None
        self.size, self.frame_rate, self.stated_frames, self.n_frames = _about(path)
        if self._stored is not None:
            self.n_frames = len(self._stored)

    def __iter__(self) -> Iterator[Image]:
        while self.position < self.n_frames:
            yield self._advance()

    def seek(self, index: int) -> None:
        """Go to a frame (from 0) exactly. Going back in a video decodes it again from its start.

        Raises: InputError where there is no such frame.
        """
        if not 0 <= index <= self.n_frames:
            raise InputError(
                f"{self.path} has no frame {index}; its frames are 0 to {self.n_frames - 1}: choose a frame "
                "range inside."
            )
        self.position = index
        if self._images is None and index < self.n_frames:
            self._go_to(self._stored_number())

    def _stored_number(self) -> int:
        return self.position if self._stored is None else int(self._stored[self.position])

    def _go_to(self, number: int) -> None:
        """Decode up to a stored frame, so that it is the next, or stay where it is the last decoded one and still in
        memory.
        """
        if number == self._decoded - 1 and self._stored is not None and self._memory is not None:
            return
        if self.jumps and not 0 <= number - self._decoded <= _DECODED_AHEAD and self._seeks_exactly:
            self._opened().set(cv2.CAP_PROP_POS_FRAMES, number)
            self._decoded, self._memory = number, None
        elif number < self._decoded:
            self.close()
        while self._decoded < number:
            if not self._opened().grab():
                raise self._broken()
            self._decoded, self._memory = self._decoded + 1, None

    def read(self, index: int | None = None, out: Image | None = None) -> Image:
        """Read frame `index`, or the next one.

        out: (h, w, 3) memory that may be used for a frame of a video; new memory for each costs a tenth of decoding.
        Raises: InputError where there is no such frame or it is damaged.
        """
        if index is not None:
            self.seek(index)
        if self.position >= self.n_frames:
            raise InputError(
                f"{self.path} ends with frame {self.n_frames - 1}, frame {self.position} was asked for; choose "
                "a frame range inside."
            )
        return self._advance(out)

    def close(self) -> None:
        """Close the file; it is opened again, and decoded from its start, where a frame is read later."""
        if self._capture is not None:
            self._capture.release()
        self._capture, self._decoded = None, 0

    def __enter__(self) -> VideoReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def _seeks_exactly(self) -> bool:
        """Whether seeking to frame _TRIAL gives the frame that decoding gives."""
        if count_frames(self.path) <= _TRIAL + 1:
            return False
        with _capturing(self.path) as forward, _capturing(self.path) as jumping:
            for _ in range(_TRIAL):
                forward.grab()
            jumping.set(cv2.CAP_PROP_POS_FRAMES, count_frames(self.path) - 1)  # first seek to another frame
            jumping.set(cv2.CAP_PROP_POS_FRAMES, _TRIAL)
            (_, true), (ok, found) = forward.read(), jumping.read()
            return ok and np.array_equal(found, true)

    def _opened(self) -> cv2.VideoCapture:
        if self._capture is None:
            self._capture = open_capture(self.path, self._threads)
        return self._capture

    def _advance(self, out: Image | None = None) -> Image:
        if self._images is not None:
            image = read_image(self._images[self.position])
            if (image.shape[1], image.shape[0]) != self.size:
                raise InputError(
                    f"{self._images[self.position]} is {image.shape[1]} x {image.shape[0]} px, the first image "
                    f"of its folder is {self.size[0]} x {self.size[1]} px; give all images of a view one "
                    "size."
                )
        else:
            number = self._stored_number()
            self._go_to(number)
            if number == self._decoded:
                ok, frame = self._opened().read(out)
                if not ok:
                    error = self._broken()
                    if self.jumps:  # where the file stands now is not known
                        self.close()
                    raise error
                self._memory = np.asarray(frame, dtype=np.uint8)
                self._decoded += 1
            assert self._memory is not None
            image = self._memory if self._stored is None else self._memory.copy()
        self.position += 1
        return image

    def _broken(self) -> InputError:
        return InputError(
            f"The video {self.path} cannot be decoded beyond frame {self._decoded - 1} of {self.n_frames}; it "
            "is damaged or was changed while being read: copy it again, or set frame_range to end at frame "
            f"{self._decoded}."
        )


def open_video(path: str | Path, threads: int | None = None, rate: float | None = None) -> VideoReader:
    """Open a video file, a folder of images (natural order) or one image.

    threads: number of threads that decode a video; None for all.
    rate: frames/s at which a video is read by its time stamps; None: frame by frame.
    Raises: InputError where it does not exist or cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; check the file name in recording.toml.")
    return VideoReader(path, threads, rate)


def _images_of(path: Path) -> list[Path] | None:
    """List the images of a folder, or the one image of a path; None for a video."""
    if not path.is_dir():
        return [path] if path.suffix.lower() in IMAGE_ENDINGS else None
    if images := list_images(path):
        return images
    raise InputError(
        f"The folder {path} holds no images ({', '.join(IMAGE_ENDINGS)}); check the path in recording.toml."
    )


def frame_size(path: str | Path) -> tuple[int, int]:
    """Read the width and height of the first frame of a video, image folder or image, px."""
    return _about(Path(path)).size


def count_frames(path: str | Path) -> int:
    """Count the frames that can be decoded: the stated number if the last frame decodes, else one by one."""
    return _about(Path(path)).n_frames


def frame_times(path: Path) -> Array | None:
    """Read the time of each frame of a video from its time stamps.

    Returns: (T,) s from the first frame; None where there is not one increasing time stamp per frame.
    """
    about = path.stat()
    times = _stamps(path.absolute(), about.st_size, about.st_mtime_ns)
    if len(times) < 2 or len(times) != count_frames(path) or not (np.diff(times) > 0).all():
        return None
    return times - times[0]


@lru_cache(maxsize=64)
def _stamps(path: Path, size: int, changed: int) -> Array:
    """Read the time stamps of all stored packets, in increasing order, s."""
    with _capturing(path, raw=True) as capture:
        found = [capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3 for _ in iter(capture.grab, False)]
    return np.sort(found)  # packets are stored in the order of decoding


def stored_frames(path: Path, rate: float) -> NDArray[np.int64] | None:
    """Choose the stored frame that is shown at each instant of a constant frame rate.

    rate: frames/s.
    Returns: indices of stored frames; None where frames have no usable times, or have this constant rate already.
    """
    times = frame_times(path)
    if times is None or (np.abs(times * rate - np.arange(len(times))) < 0.5).all():
        return None
    count = int(round(times[-1] * rate)) + 1
    if count > _MOST_REPEATS * len(times):
        return None
    moments = np.arange(count) / rate
    after = np.clip(np.searchsorted(times, moments), 1, len(times) - 1)
    nearest = np.where(moments - times[after - 1] <= times[after] - moments, after - 1, after)
    missing = np.abs(times[nearest] - moments) * rate > 0.75
    return np.where(missing, np.searchsorted(times, moments, side="right") - 1, nearest)


def evenly_spread(first: int, stop: int, count: int) -> list[int]:
    """Choose at most `count` frames from first to stop - 1, evenly spread."""
    return np.unique(np.linspace(first, stop - 1, min(count, stop - first)).round().astype(int)).tolist()


class _About(NamedTuple):
    """Properties of a video, folder of images or image; fields as in `VideoReader`."""

    size: tuple[int, int]
    frame_rate: float | None
    stated_frames: int
    n_frames: int


def _about(path: Path) -> _About:
    """Read the properties of a video or of images; those of a video are cached until its size or time changes."""
    if images := _images_of(path):
        height, width = read_image(images[0]).shape[:2]
        return _About((width, height), None, len(images), len(images))
    about = path.stat() if path.is_file() else None  # the error of a missing file is raised where it is opened
    return _looked_into(path.absolute(), about and (about.st_size, about.st_mtime_ns, about.st_ino))


@lru_cache(maxsize=256)
def _looked_into(path: Path, state: tuple[int, ...] | None) -> _About:
    with _capturing(path, 1) as capture:
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        stated = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        codec = int(capture.get(cv2.CAP_PROP_FOURCC))
        ok, first = capture.read()
        if not ok:
            raise InputError(
                f"The video {path} contains no frame that can be decoded (it is empty, cut off or of an unknown "
                "codec); record or copy it again, or convert it with: ffmpeg -i INPUT -c:v libx264 OUTPUT.mp4."
            )
    packets = len(_stamps(path, *state[:2])) if state and codec in _PICTURE_PER_PACKET else 0
    whole = stated > 0 and (packets == stated or _ends_with(path, stated))
    count = stated
    if not whole:
        with _capturing(path) as capture:
            count = sum(1 for _ in iter(capture.grab, False))
    return _About((first.shape[1], first.shape[0]), rate if 0 < rate < 100_000 else None, stated, count)


def _ends_with(path: Path, stated: int) -> bool:
    """Test whether the stated last frame of a video can be decoded and is the last."""
    with _capturing(path) as capture:
        # position: some files jump elsewhere without complaint; one frame more: the container may say too little
        capture.set(cv2.CAP_PROP_POS_FRAMES, stated - 1)
        landed = round(capture.get(cv2.CAP_PROP_POS_FRAMES))
        return landed == stated - 1 and capture.grab() and not capture.grab()


@contextlib.contextmanager
def _capturing(path: Path, threads: int | None = None, raw: bool = False) -> Iterator[cv2.VideoCapture]:
    """Open a video and release it at the end of a with block; threads, raw: as for `open_capture`."""
    capture = open_capture(path, threads, raw)
    try:
        yield capture
    finally:
        capture.release()


def open_capture(path: Path, threads: int | None = None, raw: bool = False) -> cv2.VideoCapture:
    """Open a video with OpenCV's reader.

    threads: number of threads that decode; None for one per core.
    raw: give the stored packets, not decoded frames.
    Raises: InputError where it cannot be opened.
    Why: only FFmpeg is used, because OpenCV's other back ends take numbers in file names for image sequences.
    """
    faults = {
        "does not exist; check the file name in recording.toml": not path.is_file(),
        "is empty (0 bytes); record or copy it again": path.is_file() and path.stat().st_size == 0,
    }
    refuse(f"The video {path} ", faults)
    with quiet(), utf8_path(path) as name:
        try:
            how = [] if threads is None else [cv2.CAP_PROP_N_THREADS, threads]
            how += [cv2.CAP_PROP_FORMAT, -1] if raw else []
            capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, how)
        except cv2.error:
            capture = None
    if capture is None or not capture.isOpened():
        raise InputError(
            f"{path} cannot be opened as a video (not a video, cut off, or an unknown codec); copy it again, "
            "or convert it with: ffmpeg -i INPUT -c:v libx264 OUTPUT.mp4."
        )
    return capture


class VideoWriter:
    """Writer of frames (h, w, 3), uint8 BGR, to a video; open it with `writing_video`.

    path: the file, for error messages.
    writer: OpenCV's writer.
    size: width and height, px.

    Attributes:
    n_frames: number of frames written so far.
    """

    def __init__(self, path: Path, writer: cv2.VideoWriter, size: tuple[int, int]) -> None:
        self._path, self._writer, self.size = path, writer, size
        self.n_frames: int = 0

    def write(self, image: Image) -> None:
        """Append one frame (h, w, 3) uint8 BGR of the writer's size.

        Raises: InputError where the frame has another size or type.
        """
        h, w = image.shape[:2]
        if (w // 2 * 2, h // 2 * 2) != self.size or image.ndim != 3 or image.dtype != np.uint8:
            raise InputError(
                f"{self._path}: frame {self.n_frames} is {image.shape} {image.dtype}, needed are "
                f"{self.size[0]} x {self.size[1]} px, three channels, uint8; scale it first."
            )
        self._writer.write(np.ascontiguousarray(image[: self.size[1], : self.size[0]]))
        self.n_frames += 1


@contextlib.contextmanager
def writing_video(path: str | Path, frame_rate: float, size: tuple[int, int]) -> Iterator[VideoWriter]:
    """Write a video within a with block.

    The ending determines the codec: .mp4 MPEG-4 (players show it, browsers do not), .webm VP8 (browsers show it, it
        takes ten times as long), .avi motion JPEG, .mkv FFV1 (lossless).
    The file has another name until it is complete, and its frames are then counted, because OpenCV reports no write
        errors; after an exception in the block nothing remains.

    frame_rate: frames/s.
    size: width and height, px; rounded down to even numbers, as codecs need them.
    Raises: InputError where the file cannot be written.
    """
    path, even = Path(path), (int(size[0]) // 2 * 2, int(size[1]) // 2 * 2)
    codecs = _CODECS.get(path.suffix.lower(), ())
    faults = {
        f": name the video {', '.join(_CODECS)}": not codecs,
        f" with {frame_rate:g} frames/s and {size[0]} x {size[1]} px; give a positive frame rate and at least 2 x "
        "2 px": not 0 < frame_rate < 10_000 or min(even) < 2,
    }
    refuse(f"{path} cannot be written", faults)
    with atomic_path(path) as temporary:
        with quiet(), utf8_path(temporary) as name:
            made = (
                cv2.VideoWriter(name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), float(frame_rate), even)
                for codec in codecs
            )
            opened = next((one for one in made if one.isOpened()), None)
        if opened is None:
            raise InputError(
                f"{path} cannot be written: this OpenCV has no encoder for {' or '.join(codecs)}; choose another "
                f"ending ({', '.join(_CODECS)}) or install opencv-python-headless from PyPI."
            )
        writer = VideoWriter(path, opened, even)
        try:
            yield writer
        finally:
            opened.release()
        if writer.n_frames == 0:
            raise InputError(f"{path} was not written because no frame was given; choose a range with frames.")
        written = 0
        with contextlib.suppress(InputError):
            written = count_frames(temporary)
        if written != writer.n_frames:
            raise InputError(
                f"{path} could not be completed: {written} of {writer.n_frames} frames arrived on the disk, which may "
                "be full; free some space and write it again."
            )


# ---- sound ---------------------------------------------------------------------------------------------------------
# The sound of a video: a WAV file next to it, or decoded by ffmpeg.


_RATE = 16000
_MAX_BYTES = 4 << 30


@dataclass(frozen=True)
class Sound:
    """The sound of a video.

    rate: Hz.
    samples: (N,) from -1 to 1; the first is at the start of frame 0.
    """

    rate: int
    samples: Array


def read_sound(video: Path) -> Sound:
    """Read the sound of a video, all channels mixed to one.

    It comes from a WAV file of the same name next to the video, or is decoded with ffmpeg.

    Raises: InputError where there is no sound or ffmpeg is not installed.
    """
    wav = video.with_suffix(".wav")
    if wav.is_file():
        return _read_wav(wav)
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is not None:
        command = [
            ffmpeg,
            "-v",
            "error",
            "-i",
            str(video.absolute()),
            "-vn",
            "-ac",
            "1",
            "-ar",
            str(_RATE),
            "-f",
            "s16le",
            "-",
        ]
        done = subprocess.run(command, capture_output=True, check=False, cwd=Path(__file__).parent)
        if done.returncode == 0 and len(done.stdout) > 2:
            return Sound(_RATE, np.frombuffer(done.stdout, np.int16).astype(np.float64) / 32768)
        raise InputError(f"{video} has no sound that ffmpeg can read; use --by motion, or put {wav.name} next to it.")
    raise InputError(
        f"The sound of {video} cannot be read, since ffmpeg is not installed; install it, or write the sound to "
        f"{wav.name} next to the video (mono or stereo WAV)."
    )


def _read_wav(path: Path) -> Sound:
    try:
        with open_file(path, "a WAV file", _MAX_BYTES) as stream, wave.open(stream) as file:
            width, channels, rate = file.getsampwidth(), file.getnchannels(), file.getframerate()
            data = file.readframes(file.getnframes())
    except (wave.Error, EOFError, OSError) as error:
        raise InputError(f"{path} is no WAV file that can be read ({error}); export it as 16-bit PCM.") from None
    if width not in (1, 2, 4) or channels < 1 or rate < 1000:
        raise InputError(f"{path}: {8 * width} bits at {rate} Hz; export it as 16-bit PCM with at least 8000 Hz.")
    kind, whole = {1: np.uint8, 2: np.int16, 4: np.int32}[width], len(data) // (width * channels) * width * channels
    samples = np.frombuffer(data[:whole], kind).astype(np.float64)
    samples = (samples - 128) / 128 if width == 1 else samples / float(np.iinfo(kind).max)
    return Sound(int(rate), samples.reshape(-1, channels).mean(1))


# ---- live cameras ----------------------------------------------------------------------------------------------------
# Live cameras: devices of this computer, network streams, and files that are played at their own speed.
#
# A source gives images one after another, each with its time.


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

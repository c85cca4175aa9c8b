"""Read recorded pictures and masks of any frame of a result, for the View screen.

A user who drags along the timeline requests frames in any order, and decoding a long video from its start would take
seconds. So frames are reached by seeking where that was found to be exact in this video, and by decoding otherwise.
"""

from __future__ import annotations

import math
import struct
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.reports.result_pictures import as_shown, jpeg, mask_outline
from hypose.app.studio.lru_cache import LruCache
from hypose.errors import InputError
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array, Image
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.object_masks import ObjectMasks
from hypose.io.recordings.recording import Recording, ViewSettings
from hypose.io.recordings.recording_views import open_pictures
from hypose.io.videos.video import VideoReader, open_capture, open_video

_DECODED_AHEAD = 24  # frames ahead that are faster decoded than reached by seeking
_TRIAL = 10  # the frame at which seeking is tested
_CACHE_BYTES = 16 << 20
_PER_PIXEL, _PER_WORKING_PIXEL = 40, 60
"""Approximate memory of an open video per pixel of its frames, and of a view's masks per pixel of the working size,
bytes.
"""


class AnyFrame:
    """Frames of one view in any order; a folder of images is read directly."""

    def __init__(self, view: ViewSettings) -> None:
        source = view.source or view.masks
        assert source is not None
        self.only_masks = view.source is None
        self._reader: VideoReader | ObjectMasks = open_pictures(view)
        self._jumps: cv2.VideoCapture | None = None
        self._next = 0
        self._exact: bool | None = None if source.is_file() else False
        self._path = source

    def read(self, index: int) -> Image | None:
        """Return frame `index` (BGR); None beyond the end."""
        if not 0 <= index < self._reader.n_frames:
            return None
        reader = self._reader
        if isinstance(reader, ObjectMasks) or self._path.is_dir():
            return reader.read(index)
        if 0 <= index - reader.position <= _DECODED_AHEAD or not self._can_jump():
            return self._reader.read(index)
        return self._jump(index)

    def _can_jump(self) -> bool:
        if self._exact is None:
            self._exact = False
            if self._reader.n_frames > _TRIAL + 1:
                with open_video(self._path) as forward:
                    true = forward.read(_TRIAL)
                self._jumps = open_capture(self._path)
                self._jumps.set(cv2.CAP_PROP_POS_FRAMES, self._reader.n_frames - 1)  # first seek to another frame
                self._next = -1
                tried = self._jump(_TRIAL)
                self._exact = tried is not None and np.array_equal(tried, true)
        return self._exact

    def _jump(self, index: int) -> Image | None:
        capture = self._jumps
        assert capture is not None
        if self._next < 0 or not 0 <= index - self._next <= _DECODED_AHEAD:
            capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            self._next = index
        while self._next < index:
            capture.grab()
            self._next += 1
        ok, frame = capture.read()
        self._next = index + 1 if ok else -1
        return np.asarray(frame, np.uint8) if ok else None

    def close(self) -> None:
        """Release the file."""
        self._reader.close()
        if self._jumps is not None:
            self._jumps.release()


class ViewPictures:
    """Pictures and masks of a recording by row of a motion whose row 0 is frame `first`; for several threads."""

    def __init__(self, recording: Recording, first: int, rows: int) -> None:
        self._recording = replace(recording, frame_range=(first, first + rows))
        self._first, self._rows = first, rows
        self._views = [AnyFrame(v) if v.source or v.masks else None for v in recording.views]
        self._stream: FrameStream | None = None
        self._lock, self._mask_lock = threading.Lock(), threading.Lock()
        self._kept: LruCache[bytes] = LruCache(_CACHE_BYTES, len, one_more=True)

    @property
    def held(self) -> int:
        """Approximate memory in use, bytes."""
        rig = self._recording.rig
        working = 0 if self._stream is None else sum(math.prod(c.size) for c in self._stream.rig)
        return self._kept.held + _PER_PIXEL * sum(math.prod(c.size) for c in rig) + _PER_WORKING_PIXEL * working

    def row(self, row: int, width: int) -> bytes:
        """Encode the pictures of all views in a row as JPEG, at most `width` px wide.

        Returns: number of views (uint32), length of each file (uint32, 0 = no picture), then the files; little-endian.
        """
        self._check(row)
        if not 32 <= width <= 4096:
            raise InputError(f"Pictures cannot be {width} px wide; ask for 32 to 4096.")

        def make() -> bytes:
            with self._lock, ThreadPoolExecutor(len(self._views)) as pool:
                files = list(pool.map(partial(self._jpeg, row=row, width=width), self._views))
            return struct.pack(f"<{1 + len(files)}I", len(files), *map(len, files)) + b"".join(files)

        with self._kept.use((row, width), make) as data:
            return data

    def seen(self, row: int, points: Array) -> tuple[Image, Array] | None:
        """Return the picture (BGR) of the first view that has one in `row`, and the pixels (N, 2) of points (N, 3) m,
        world, in it; None where no view has one.
        """
        self._check(row)
        with self._lock:
            for reader, view, camera in zip(self._views, self._recording.views, self._recording.rig, strict=True):
                image = reader.read(self._first + row) if reader is not None else None
                if image is not None:
                    return image, as_shown(view, camera, (image.shape[1], image.shape[0])).project(points)
        return None

    def outlines(self, row: int) -> list[list[list[float]]]:
        """Compute the outlines of the masks that tracking uses in a row. The first call builds the background and takes
        seconds.

        Returns: per view, polygons [x0, y0, x1, y1, ...] in px of the calibrated size, shifted by image_shift.
        """
        self._check(row)
        with self._mask_lock:
            if self._stream is None:
                self._stream = FrameStream(self._recording)
            masks = self._stream.frame(row).of(Silhouettes)
        found: list[list[list[float]]] = [[] for _ in self._views]
        for silhouettes in masks:
            for c, (view, camera) in enumerate(zip(self._recording.views, self._recording.rig, strict=True)):
                shown = as_shown(view, camera, camera.size)
                lines = mask_outline(shown, silhouettes.rig[c], silhouettes.masks[c])
                found[c] = [_pixels(line) for line in lines]
        return found

    def close(self) -> None:
        """Release the files."""
        self._kept.drop()
        with self._lock, self._mask_lock:
            for view in self._views:
                if view is not None:
                    view.close()
            if self._stream is not None:
                self._stream.close()

    def _check(self, row: int) -> None:
        if not 0 <= row < self._rows:
            raise InputError(f"There is no frame {row} in this result; its frames are 0 to {self._rows - 1}.")

    def _jpeg(self, view: AnyFrame | None, row: int, width: int) -> bytes:
        image = view.read(self._first + row) if view is not None else None
        if view is None or image is None:
            return b""
        if view.only_masks:
            image = (image // 3 + 40).astype(np.uint8)
        return jpeg(image, width)


def _pixels(line: NDArray[np.int32]) -> list[float]:
    """Convert OpenCV's 1/16 px to numbers, every second point, which is enough for a screen."""
    step = 2 if len(line) > 60 else 1
    return (np.round(line[::step, 0] / 16, 1)).ravel().tolist()

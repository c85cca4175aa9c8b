"""Read the pictures and masks of any frame of an open recording, for the View and Set up screens."""

from __future__ import annotations

import struct
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from hypose.app.reports.result_pictures import ViewImages, as_shown, jpeg, mask_outline
from hypose.cameras.camera import Camera
from hypose.errors import InputError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import Image, Mask
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.recording_views import Preparer


class OpenRecording:
    """Pictures and masks of a recording that is open, by row, for several threads. Files are opened when they are
    needed first.

    recording: the recording.
    frames: frame of the first row, and the frame after that of the last row; None: all frames, so that row numbers
        are frame numbers.
    """

    def __init__(self, recording: Recording, frames: tuple[int, int] | None = None) -> None:
        self.recording, self._frames = recording, frames
        self._first, self._end = frames or (0, recording.n_frames)
        self._readers: dict[int, ViewImages] = {}
        self._last: dict[int, tuple[int, Image]] = {}  # row and picture that each reader read last
        self._lenses: dict[int, Preparer] = {}  # of the size that each view was asked for last
        self._stream: FrameStream | None = None
        self._lock, self._mask_lock = threading.RLock(), threading.Lock()

    def read(self, view: int, row: int) -> Image | None:
        """Read the recorded picture of a view, grey where it has only masks; the last one of each view is kept.

        view, row: view and row of the picture.
        Returns: (h, w, 3) BGR; None beyond the end of the view, or where it has no pictures.
        """
        if view not in self._readers:
            self._readers[view] = ViewImages(self.recording.views[view], self.recording.rig[view], jumps=True)
        row_of_last, image = self._last.get(view, (-1, None))
        if row_of_last != row:
            image = self._readers[view].read(self._first + row)
            if image is not None:
                image = image.copy()  # the reader uses its memory again
                self._last[view] = row, image
        return image

    def undistorted(self, view: int, row: int, small: Camera) -> Image:
        """Return the undistorted picture of a view, of the size of the pinhole camera `small`.

        Raises: InputError where the view has no such frame.
        """
        v = self.recording.views[view]
        with self._lock:
            stored = self.read(view, row)
            if stored is None:
                raise InputError(f"{v.name} has no frame {row}.")
            if view not in self._lenses or self._lenses[view].size != small.size:
                self._lenses[view] = Preparer(self.recording.rig[view], small, v.image_shift)
            return self._lenses[view](stored)

    def mask(self, view: int, row: int, settings: SilhouetteSettings) -> Mask:
        """Compute the mask that tracking would get with other settings.

        view, row: view and row of the picture.
        settings: settings of the mask.
        Returns: (h, w) 0/1, at working size.
        """
        with self._lock, self._mask_lock:
            stored = self.read(view, row) if self.recording.views[view].source else None
            return self._masks().mask(view, self._first + row, stored, settings)

    def row(self, row: int, width: int) -> bytes:
        """Encode the pictures of all views in a row as JPEG, at most `width` px wide.

        Returns: number of views (uint32), length of each file (uint32, 0 = no picture), then the files; little-endian.
        Raises: InputError where there is no such row or width.
        """
        self.check(row, width)
        views = range(len(self.recording.views))
        with self._lock, ThreadPoolExecutor(len(views)) as pool:
            files = list(pool.map(partial(self._jpeg, row=row, width=width), views))
        return struct.pack(f"<{1 + len(files)}I", len(files), *map(len, files)) + b"".join(files)

    def _jpeg(self, view: int, row: int, width: int) -> bytes:
        """Encode the picture of a view in a row, at most `width` px wide; empty where there is none."""
        image = self.read(view, row)
        return b"" if image is None else jpeg(image, width)

    def first_picture(self, row: int) -> tuple[Image, Camera] | None:
        """Return the picture (BGR) of the first view that has one in `row`, and the camera whose pixels are those of
        it; None where no view has one.
        """
        with self._lock:
            for k, (view, camera) in enumerate(zip(self.recording.views, self.recording.rig, strict=True)):
                if (image := self.read(k, row)) is not None:
                    return image, as_shown(view, camera, image.shape[1::-1])
        return None

    def outlines(self, row: int) -> list[list[list[float]]]:
        """Compute the outlines of the masks that tracking uses in a row. The first call builds the background and takes
        seconds.

        Returns: per view, polygons [x0, y0, x1, y1, ...] in px of the calibrated size, shifted by image_shift.
        Raises: InputError where there is no such row.
        """
        self.check(row)
        with self._mask_lock:
            masks = self._masks().frame(row).of(Silhouettes)
        found: list[list[list[float]]] = [[] for _ in self.recording.views]
        for silhouettes in masks:
            for c, (view, camera) in enumerate(zip(self.recording.views, self.recording.rig, strict=True)):
                shown = as_shown(view, camera, camera.size)
                lines = mask_outline(shown, silhouettes.rig[c], silhouettes.masks[c])
                # OpenCV's 1/16 px; every second point is enough for a screen
                found[c] = [np.round(x[:: 2 if len(x) > 60 else 1, 0] / 16, 1).ravel().tolist() for x in lines]
        return found

    def check(self, row: int, width: int = 640) -> None:
        """Raise InputError where there is no such row, or pictures cannot have this width, px."""
        if not 0 <= row < self._end - self._first:
            raise InputError(f"There is no frame {row} here; the frames are 0 to {self._end - self._first - 1}.")
        if not 32 <= width <= 4096:
            raise InputError(f"Pictures cannot be {width} px wide; ask for 32 to 4096.")

    def _masks(self) -> FrameStream:
        """Return the stream that makes masks; called with the lock of the masks."""
        if self._stream is None:
            self._stream = FrameStream(replace(self.recording, frame_range=self._frames))
        return self._stream

    def close(self) -> None:
        """Release the files."""
        with self._lock, self._mask_lock:
            for source in (*self._readers.values(), *([] if self._stream is None else [self._stream])):
                source.close()
            self._readers.clear()
            self._last.clear()
            self._stream = None

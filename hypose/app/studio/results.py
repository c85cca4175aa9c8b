"""Read results and recorded pictures for the View and Set up screens: facts for lists, the block of bytes to show,
pictures and masks of any frame, thumbnails and gait.
"""

from __future__ import annotations

import contextlib
import struct
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hypose.app.reports.result_pictures import ViewImages, as_shown, close_up, draw_skeleton, jpeg, mask_outline
from hypose.app.studio.catalog import Catalog, Item, NotFound
from hypose.app.studio.view_bundle import ViewResult, first_frame, load_view, quality_of, view_bundle
from hypose.cameras.camera import Camera
from hypose.errors import HyposeError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.geometry import Image, Mask
from hypose.io.motions.results import Checkpoint, load_body, load_motion
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.object_masks import ObjectMasks
from hypose.io.recordings.recording import Recording, ViewSettings
from hypose.io.recordings.view_source import Preparer
from hypose.io.videos.video import open_capture, open_video
from hypose.pipeline.gait import angle_cycles, gait_of
from hypose.tracking.tracker import estimates_from_arrays, motion_of

if TYPE_CHECKING:
    from hypose.app.studio.job_kinds import Plan
    from hypose.app.studio.recordings import Recordings

# ---- pictures of any frame -----------------------------------------------------------------------------------------
# A user who drags along the timeline requests frames in any order, and decoding a long video from its start would take
# seconds. So frames are reached by seeking where that was found to be exact in this video, and by decoding otherwise.


_DECODED_AHEAD = 24  # frames ahead that are faster decoded than reached by seeking
_TRIAL = 10  # the frame at which seeking is tested


class AnyFrame(ViewImages):
    """Recorded pictures of one view in any order."""

    def __init__(self, view: ViewSettings, camera: Camera) -> None:
        super().__init__(view, camera)
        self._jumps: cv2.VideoCapture | None = None
        self._next = 0
        self._exact: bool | None = None if view.source is not None and view.source.is_file() else False

    def stored(self, index: int) -> Image | None:
        """Read a frame of the video, folder of images or masks; other frames stay valid."""
        reader = self.reader
        assert reader is not None
        if isinstance(reader, ObjectMasks) or 0 <= index - reader.position <= _DECODED_AHEAD or not self._can_jump():
            return reader.read(index)
        return self._jump(index)

    def _can_jump(self) -> bool:
        """Return whether seeking is exact in this video; the first call tests it on frame _TRIAL."""
        if self._exact is None:
            path, count, self._exact = self.view.source, 0 if self.reader is None else self.reader.n_frames, False
            if path is not None and count > _TRIAL + 1:
                with open_video(path) as forward:
                    true = forward.read(_TRIAL)
                self._jumps = open_capture(path)
                self._jumps.set(cv2.CAP_PROP_POS_FRAMES, count - 1)  # first seek to another frame
                self._next = -1
                tried = self._jump(_TRIAL)
                self._exact = tried is not None and np.array_equal(tried, true)
        return self._exact

    def _jump(self, index: int) -> Image | None:
        """Read a frame by seeking, or by decoding a few frames more; None where it cannot be read."""
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
        super().close()
        if self._jumps is not None:
            self._jumps.release()


class OpenRecording:
    """Pictures and masks of a recording that is open, by row, for several threads. Files are opened when they are
    needed first.

    recording: the recording.
    frames: frame of the first row, and the frame after that of the last row; None: all frames, so that row numbers
        are frame numbers.
    users: number of users at present.
    """

    def __init__(self, recording: Recording, frames: tuple[int, int] | None = None) -> None:
        self.recording, self._frames = recording, frames
        self._first, self._end = frames or (0, recording.n_frames)
        self._readers: dict[int, AnyFrame] = {}
        self._last: dict[int, tuple[int, Image]] = {}  # row and picture that each reader read last
        self._lenses: dict[int, Preparer] = {}  # of the size that each view was asked for last
        self.users = 0
        self._stream: FrameStream | None = None
        self._lock, self._mask_lock = threading.RLock(), threading.Lock()

    def read(self, view: int, row: int) -> Image | None:
        """Read the recorded picture of a view, grey where it has only masks; the last one of each view is kept.

        view, row: view and row of the picture.
        Returns: (h, w, 3) BGR; None beyond the end of the view, or where it has no pictures.
        """
        if view not in self._readers:
            self._readers[view] = AnyFrame(self.recording.views[view], self.recording.rig[view])
        row_of_last, image = self._last.get(view, (-1, None))
        if row_of_last != row:
            image = self._readers[view].read(self._first + row)
            if image is not None:
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


# ---- results ---------------------------------------------------------------------------------------------------------


_READ = ("motion.npz", "body.npz", "assessment.json", "modes.npz", "checkpoint.npz")
"""Files of a result that its facts are read from."""
_SIZE = (192, 144)
"""Width and height of a thumbnail, px."""
Stamp = tuple[float | None, ...]


class Results:
    """Provider of the data that the View screen of the studio shows of results. Several threads may use it.

    catalog: items of the served folder.
    recordings: open recordings of the studio.
    """

    def __init__(self, catalog: Catalog, recordings: Recordings) -> None:
        self._catalog, self._recordings = catalog, recordings
        self._heads: dict[str, tuple[Stamp, dict[str, Any]]] = {}
        self._one = threading.Lock()  # one thread at a time loads a whole motion, since it is large

    def block(self, item: Item) -> bytearray:
        """Pack a result into the block of bytes that the View screen reads (layout: `view_bundle`)."""
        with self._one:
            return view_bundle(load_view(item.path))

    def pictures(self, item: Item) -> AbstractContextManager[OpenRecording]:
        """Open the pictures of a result's recording, as a context; results of the same frames share them.

        Raises: NotFound where there is no recording.
        """
        folder = self._catalog.recording_of(item.path)
        if folder is None:
            raise NotFound("The result is in no recording's folder, so there are no pictures of it.")
        facts = self.head(item)  # the motion itself, which may be large, is not needed
        return self._recordings.opened(folder, (facts["first_frame"], facts["first_frame"] + facts["frames"]))

    def head(self, item: Item) -> dict[str, Any]:
        """Return the facts of a result for the list of results: title, method, frames, rate and quality.

        Returns: JSON values, read again where files of the result have changed; "frames" is 0 where the motion cannot
            be read.
        """
        stamp, known = _stamp(item.path), self._heads.get(item.id)
        if known is None or known[0] != stamp:
            with self._one:
                known = self._heads[item.id] = stamp, self._read_head(item, stamp)
        return known[1]

    def _read_head(self, item: Item, stamp: Stamp) -> dict[str, Any]:
        """Read the facts of a result; stamp: times of change of its files."""
        folder = self._catalog.recording_of(item.path)
        recipe, correctable, quality, first = "unknown", False, {}, 0
        try:
            motion = load_motion(item.path / "motion.npz")
            frames, rate = len(motion), motion.frame_rate
            recipe = str(motion.provenance.get("recipe", recipe))
            first = first_frame(motion)
            correctable = folder is not None and motion.poses is not None and not (item.path / "modes.npz").exists()
            quality = quality_of(item.path, motion)
        except HyposeError:
            frames, rate = 0, 0.0
        return {
            "id": item.id,
            "title": f"{folder.name}: {item.path.name}" if folder is not None else item.path.name,
            "name": item.path.name,
            "path": self._catalog.shown(item.path),
            "recording": self._catalog.id_of("recording", folder) if folder is not None else None,
            "recipe": recipe,
            "frames": frames,
            "first_frame": first,
            "frame_rate": rate,
            "seconds": frames / rate if rate else 0.0,
            "complete": frames > 0 and not (item.path / "checkpoint.npz").exists(),
            "changed": stamp[0] or item.changed,
            "correctable": correctable,
            "pictured": folder is not None,
            **quality,
        }

    def thumbnail(self, item: Item) -> bytes:
        """Make a JPEG of 192 x 144 px around the person in the middle frame, with the skeleton.

        Returns: the file's bytes. The picture is that of the first camera that has one; the first frame is shown where
            no camera has a picture of the middle one.
        Raises: NotFound where there are no pictures; InputError where the motion cannot be read.
        """
        motion = load_motion(item.path / "motion.npz")
        seen = np.flatnonzero(np.isfinite(motion.joints).all((1, 2))).tolist()
        with self.pictures(item) as opened:
            for row in seen and [seen[len(seen) // 2], seen[0]]:
                if (found := opened.first_picture(row)) is not None:
                    small, camera = close_up(*found, motion.joints[row], _SIZE, 1.5)
                    draw_skeleton(small, camera, motion.skeleton, motion.joints[row])
                    return jpeg(small, _SIZE[0])
        raise NotFound("There are no pictures of this result.")

    def gait(self, item: Item) -> dict[str, Any]:
        """Compute the gait of a result for the page.

        Returns: table of lists: "events" (time in s, side, kind), "figures" (name, unit, mean, low, high, number), and
            "cycles" (of each joint angle the mean and standard deviation in degrees, from 0 to 100 % of the cycle). All
            are empty where the person does not walk, or the motion has no poses or no body.
        """
        with self._one, contextlib.suppress(HyposeError):
            motion, body = load_motion(item.path / "motion.npz"), load_body(item.path / "body.npz")
            if motion.poses is not None and body.skeleton.joint_names == motion.skeleton.joint_names:
                found = gait_of(motion, body)
                return {
                    "events": [{"time": e.time, "side": e.side, "kind": e.kind} for e in found.events],
                    "figures": [asdict(f) for f in found.figures],
                    "cycles": [
                        {"name": c.name, "mean": np.degrees(c.mean), "sd": np.degrees(c.sd), "n": c.n}
                        for c in angle_cycles(found.events, motion)
                    ],
                }
        return {"events": [], "figures": [], "cycles": []}

    def so_far(self, plan: Plan, began: float | None) -> bytearray | None:
        """Pack the frames that a job has tracked so far into the block of bytes that the View screen reads.

        The frames are those of the job's checkpoint; without a checkpoint, those of the finished result.
        plan: command of the job.
        began: time at which the job began, s since 1970; a result that is older belongs to another job. None: it has
            not begun.
        Returns: the block (layout: `view_bundle`); None while there are no frames.
        Raises: NotFound where the job makes no motion, or its method keeps none that can be shown before the end.
        """
        folder = plan.folder
        if folder is None or plan.recording is None:
            raise NotFound("This job makes no motion.")
        recording = self._recordings.load(self._catalog.find("recording", plan.recording))
        checkpoint, motion = folder / "checkpoint.npz", folder / "motion.npz"
        if not checkpoint.is_file():
            if began is None or not motion.is_file() or motion.stat().st_mtime < began:
                return None
            return view_bundle(load_view(folder, recording))
        saved = Checkpoint.read(checkpoint)
        first_person = "0_done_"  # a checkpoint holds all people
        done = {k.removeprefix(first_person): v for k, v in saved.arrays.items() if k.startswith(first_person)}
        if not done:
            return None
        if not {"poses", "joint_covariances", "flags"} <= done.keys():
            raise NotFound("What this method has tracked so far cannot be shown; wait for its end.")
        estimates, body = estimates_from_arrays(done), load_body(folder / "body.npz")
        times = np.arange(len(estimates)) / recording.frame_rate
        frames = saved.identity.get("settings", {}).get("frames")
        tracked = motion_of(body, times, estimates, saved.identity)
        first = int(frames[0]) if frames else 0
        return view_bundle(ViewResult(recording.name, tracked, body, recording, first_frame=first, complete=False))


def _stamp(folder: Path) -> Stamp:
    """Return the times of change of the files that a result's facts are read from, to notice changes.

    Returns: s since 1970 by file; None where it does not exist. Of a checkpoint, which changes often, 0 stands for the
        time.
    """

    def written(name: str) -> float | None:
        try:
            at = (folder / name).stat().st_mtime
        except OSError:
            return None
        return 0.0 if name == "checkpoint.npz" else at

    return tuple(written(n) for n in _READ)

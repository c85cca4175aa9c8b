"""Record a live run as a recording that `hypose track` can solve again: pictures, masks and poses."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import cv2
import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError, InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.files import RecordingFolder, folder_for
from hypose.io.recordings.frames import mask_folder
from hypose.io.recordings.recording import Recording, write_recording
from hypose.io.recordings.recording_views import ViewSettings
from hypose.pipeline.live.capture import LiveView, live_working_rig, stored
from hypose.pipeline.live.engine import Listener, LiveResult
from hypose.pipeline.settings import SETTINGS

_POSES = "poses.jsonl"


class LiveRecorder(Listener):
    """Listener of the live engine that writes a recording; the engine must deliver pictures. `close` ends it.

    folder: new or empty; it stays empty until there is something to record.
    height: height of the person, m, where known.
    failed: why recording ended early; "" while it continues.
    Raises: InputError where the folder holds something or cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        rig: CameraRig,
        views: Sequence[LiveView],
        silhouettes: SilhouetteSettings,
        height: float | None = None,
    ) -> None:
        self._made = not folder.exists()
        RecordingFolder(folder)
        self.folder, self._rig, self._views, self._silhouettes = folder, rig, tuple(views), silhouettes
        self._height = height
        self.left_out = self.written = 0
        self.failed = ""
        self._small = live_working_rig(rig, views)
        self._times: list[float] = []
        self._followed: list[bool] = []
        self._rows, self._described = 0, -np.inf
        self._last = [_black(c.size, v.depth) for c, v in zip(rig, views, strict=True)]
        self._waiting: queue.Queue[LiveResult | None] = queue.Queue(SETTINGS.recorder_waiting)
        self._files: list[dict[str, Path]] = []
        """Folders of each view by kind of evidence, as in `ViewSettings`."""
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def seen(self, seen: LiveResult) -> None:
        """Queue an instant to be written; it is left out where the queue is full."""
        if self.failed:
            return
        try:
            self._waiting.put_nowait(seen)
        except queue.Full:
            self.left_out += 1

    def close(self) -> bool:
        """Write the waiting instants and recording.toml.

        Returns: whether there was anything to record.
        Raises: InputError where not everything could be written; what was written is a valid recording.
        """
        begun = self._thread.is_alive()
        self._waiting.put(None)
        self._thread.join()
        recorded = len(self._times) > 1
        if begun and recorded:
            self._describe()
        elif begun and self._made:
            with contextlib.suppress(OSError):  # there is something in it
                self.folder.rmdir()
        if self.failed:
            kept = f"the {self.written} instants before that are" if recorded else "nothing is"
            raise InputError(f"{self.failed.rstrip('.')}; {kept} recorded.")
        return recorded

    def _describe(self) -> None:
        views = tuple(
            ViewSettings(v.name, files, v.shift, v.stretched) for v, files in zip(self._views, self._files, strict=True)
        )
        recording = Recording(
            self.folder,
            self.folder.name,
            self._rig,
            views,
            self._rate(),
            None,
            None,
            subject_height=self._height,
            n_frames=len(self._times),
            silhouettes=self._silhouettes,
        )
        write_recording(recording, self.folder)

    def _rate(self) -> float:
        """Compute the rate (Hz) while a person was tracked, without pauses of a second: before that, instants are
        processed less often.
        """
        steps, followed = np.diff(self._times), np.array(self._followed)
        known = followed[1:] & followed[:-1]
        steps = steps[known] if known.any() else steps
        return float(1 / steps[steps < max(1.0, 2 * np.median(steps))].mean())

    def _run(self) -> None:
        poses: TextIO | None = None
        while (seen := self._waiting.get()) is not None:
            if self.failed:
                continue
            try:
                poses = poses or self._opened()
                self._write(seen, poses)
            except OSError as error:
                self.failed = f"{self.folder} cannot be written to ({error.strerror}); the recording ends there."
            except HyposeError as error:  # e.g. a link that leads out of the folder
                self.failed = str(error)
        with contextlib.suppress(OSError):  # its buffer holds only the instant that could not be written
            if poses is not None:
                poses.close()
        if self.failed:
            self._forget()

    def _opened(self) -> TextIO:
        """Make the folders, and open the file of poses."""
        self._files = [
            {"depth": folder_for(self.folder / "depth", v.name)}  # a depth camera needs no masks
            if v.depth
            else {
                "images": folder_for(self.folder / "pictures", v.name),
                "masks": mask_folder(self.folder / "masks", v.name, camera),
            }
            for v, camera in zip(self._views, self._small, strict=True)
        ]
        return open(self.folder / _POSES, "x", encoding="utf-8", newline="\n")

    def _write_empty(self, empty: Sequence[Sequence[bytes]]) -> None:
        """Write the maps from which the empty room was learned, in place of earlier ones."""
        for c, maps in enumerate(empty):
            if maps:
                folder = self._files[c]["background"] = folder_for(self.folder / "background", self._views[c].name)
                for old in folder.glob("*.png"):
                    old.unlink()
                for k, data in enumerate(maps):
                    (folder / f"{k:06d}.png").write_bytes(data)

    def _write(self, seen: LiveResult, poses: TextIO) -> None:
        number = self.written
        self._write_empty(seen.captured.empty)
        shown = zip(self._files, seen.captured.views, seen.captured.jpegs, strict=True)
        for c, (files, view, jpeg) in enumerate(shown):
            if view is not None and jpeg is not None:
                self._last[c] = jpeg
            kind, ending = ("depth", "png") if self._views[c].depth else ("images", "jpg")
            (files[kind] / f"{number:06d}.{ending}").write_bytes(self._last[c])
            if "masks" in files:
                width, height = self._small[c].size
                mask = np.zeros((height, width), np.uint8) if view is None else np.unpackbits(view[0], 1, width)
                data = cv2.imencode(".png", mask * np.uint8(255))[1].tobytes()
                (files["masks"] / f"{number:06d}.png").write_bytes(data)
        people = [
            {
                "id": p.person,
                "lost": p.lost,
                "pose": np.asarray(p.motion.poses)[0].round(6).tolist(),
                "joints": p.joints.round(5).tolist(),
                "sd": p.motion.joint_sd[0].astype(float).round(5).tolist(),
            }
            for p in seen.poses
        ]
        instant = {"n": number, "time": round(seen.frame.time, 6), "people": people}
        line = json.dumps(instant, separators=(",", ":")) + "\n"
        poses.write(line)
        poses.flush()
        self._rows += len(line)
        self._times.append(seen.frame.time)
        self._followed.append(len(people) > 0)
        self.written += 1
        now = time.monotonic()
        if self.written > 1 and now - self._described >= SETTINGS.recorder_describe_s:
            self._describe()  # so that the recording of a killed process can be read
            self._described = now

    def _forget(self) -> None:
        """Remove the files of the instant that failed; this also frees space for recording.toml."""
        with contextlib.suppress(OSError):
            os.truncate(self.folder / _POSES, self._rows)
        for folder in (folder for files in self._files for kind, folder in files.items() if kind != "background"):
            for path in folder.glob(f"{self.written:06d}.*"):
                with contextlib.suppress(OSError):
                    path.unlink()


def _black(size: tuple[int, int], depth: bool) -> bytes:
    """Encode a black picture, for a camera that has not shown anything yet."""
    nothing = np.zeros((size[1], size[0]), np.float32) if depth else np.zeros((size[1], size[0], 3), np.uint8)
    return stored(nothing) or b""

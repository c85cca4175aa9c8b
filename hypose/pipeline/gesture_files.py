"""Read and write gestures on disk: model files (one .npz without pickle) and recordings of sessions.

A recording is a folder from which gestures can be learned again, offline or online:
session.json: {"format": "hypose-gesture-session", "version": 1, "gestures": [names], "lens": [fx, fy, cx, cy], "size":
    [width, height]}.
frames.csv: frame,time,file,phase,segment,gesture,x,y, one row per depth picture: phase in which it was taken, number of
    its learning segment (0 = none), gesture (from 1) and the box's centre where it was learned as one.
actions.csv: time,action,detail, everything the user did; "undo N" takes segment N back.
depth/: 16-bit PNG in millimetres.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.gestures import model as model_arrays
from hypose.gestures.depth_pictures import DepthLens, millimetres
from hypose.gestures.model import GestureModel
from hypose.gestures.online import Example
from hypose.io.files import RecordingFolder, numbers_of, read_bytes, read_json, text_lines, write_text
from hypose.io.motions.results import Archive, to_json, write_archive
from hypose.io.sensors.depth import read_depth_png, write_millimetres_png
from hypose.io.videos.video import list_images
from hypose.pipeline.settings import SETTINGS

_FORMAT = "hypose-gesture-session"
SESSION_PHASES = ("do_gesture", "positive", "release", "negative", "test", "free")
_FRAMES = ["frame", "time", "file", "phase", "segment", "gesture", "x", "y"]


def save_model(model: GestureModel, path: str | Path) -> None:
    """Write a model file; equal models give equal bytes."""
    write_archive(path, model_arrays.to_arrays(model))


def load_model(path: str | Path) -> GestureModel:
    """Load a model file; its forest can continue to learn exactly as before.

    Raises: InputError names the cause.
    """
    kind = Archive("gesture model", "give a model that `hypose gesture train` wrote")
    return kind.load(Path(path), model_arrays.from_arrays)


def content_of(folder: Path) -> str:
    """Compute the hash of a session's first pictures, which identifies the session whatever its folder is called.

    folder: folder of the session.
    Returns: hash as text; "" where there are no pictures.
    """
    pictures = list_images(folder / "depth")[: SETTINGS.gesture_telling] if (folder / "depth").is_dir() else []
    digest = hashlib.sha256()
    for picture in pictures:
        digest.update(read_bytes(picture, "a depth picture", 1 << 26))
    return digest.hexdigest() if pictures else ""


@dataclass(frozen=True)
class RecordedFrame:
    """One depth picture of a gesture session, as a row of frames.csv.

    time: s.
    file: its file.
    phase: phase of the session.
    segment: number of the learning segment.
    gesture: number of the gesture that the person does, 0 for other movement.
    x, y: pixel at which the gesture is done; negative where not known.
    """

    time: float
    file: Path
    phase: str
    segment: int
    gesture: int
    x: float
    y: float


@dataclass(frozen=True)
class GestureRecording:
    """Recorded gesture session.

    gestures: names; gesture number n is gestures[n - 1].
    size: (width, height), px.
    frames: in the order of time.
    undone: numbers of the segments that were taken back.
    """

    folder: Path
    gestures: tuple[str, ...]
    lens: DepthLens
    size: tuple[int, int]
    frames: tuple[RecordedFrame, ...]
    undone: frozenset[int]

    def number(self, name: str) -> int:
        """Return the number of a gesture by its name.

        Raises: InputError lists the names.
        """
        if name not in self.gestures:
            raise InputError(f"{self.folder} has no gesture {name!r}; it has {', '.join(self.gestures)}.")
        return self.gestures.index(name) + 1

    def learned(self) -> list[RecordedFrame]:
        """Return the frames of learning segments that were not taken back."""
        return [f for f in self.frames if f.phase in ("positive", "negative") and f.segment not in self.undone]

    def examples(self, name: str) -> Iterator[Example]:
        """Yield the training examples of one gesture in the order of time; other gestures are background."""
        number = self.number(name)
        for f in self.learned():
            depth = self.picture(f)
            if f.phase == "positive" and f.gesture == number:
                yield Example(depth, self.lens, 1, f.x, f.y)
            else:
                yield Example(depth, self.lens)

    def picture(self, frame: RecordedFrame) -> DepthImage:
        """Read a frame's picture (h, w), uint16 mm.

        Raises: InputError names the file that cannot be read, is no depth in millimetres, or has another size than the
            recording.
        """
        depth = millimetres(np.rint(read_depth_png(frame.file) * 1000).astype(np.uint16), str(frame.file))
        if depth.shape != (self.size[1], self.size[0]):
            raise InputError(
                f"{frame.file} has {depth.shape[1]} x {depth.shape[0]} pixels, session.json says {self.size[0]} x "
                f"{self.size[1]}; all pictures of a recording must have one size."
            )
        return depth


def read_recording(folder: str | Path) -> GestureRecording:
    """Read a recording of a gesture session.

    Raises: InputError names the file and line that cannot be used.
    """
    folder = Path(folder)
    path = folder / "session.json"
    value = read_json(path, "a session.json")
    with numbers_of(str(path)):
        if (value["format"], value["version"]) != (_FORMAT, 1):
            raise InputError(f'{path} is no gesture session; it must say "format": "{_FORMAT}", "version": 1.')
        gestures, lens = tuple(map(str, value["gestures"])), DepthLens(*map(float, value["lens"]))
        width, height = map(int, value["size"])
    frames, actions = _read_frames(folder, len(gestures)), folder / "actions.csv"
    rows = [line.split(",") for line in text_lines(actions, "an actions.csv")] if actions.exists() else []
    undone = frozenset(int(row[2]) for row in rows if len(row) == 3 and row[1] == "undo" and row[2].isdigit())
    return GestureRecording(folder, gestures, lens, (width, height), tuple(frames), undone)


def _read_frames(folder: Path, gestures: int) -> list[RecordedFrame]:
    path = folder / "frames.csv"
    first, *lines = text_lines(path, "a frames.csv")
    if first.split(",") != _FRAMES:
        raise InputError(f"{path}: the first line must be {','.join(_FRAMES)}.")
    out: list[RecordedFrame] = []
    for number, line in enumerate(lines, 2):
        try:
            _, time, file, phase, segment, gesture, x, y = line.split(",")
            row = RecordedFrame(float(time), folder / file, phase, int(segment), int(gesture), float(x), float(y))
            outside = Path(file).is_absolute() or ".." in Path(file).parts
            if outside or phase not in SESSION_PHASES or not 0 <= row.gesture <= gestures:
                raise ValueError
            if not all(map(math.isfinite, (row.time, row.x, row.y))):
                raise ValueError
        except ValueError:
            if number == len(lines) + 1:  # a line that was not completely written
                break
            raise InputError(
                f"{path}, line {number}: {line!r} is no frame; it must be {','.join(_FRAMES)}, files lie in the "
                f"folder, phases are {', '.join(SESSION_PHASES)}, gestures 0 to {gestures}."
            ) from None
        out.append(row)
    if not out:
        raise InputError(f"{path} has no frames; record some.")
    return out


class SessionWriter:
    """Writer of a gesture session while it is recorded; what was written so far can be read at any time.

    A thread of its own compresses and writes the pictures in order, at most SETTINGS.gesture_waiting behind. Why:
    writing takes as long as learning from them. An error there is raised by the next call.
    """

    def __init__(
        self,
        folder: str | Path,
        gestures: Sequence[str],
        lens: DepthLens,
        size: tuple[int, int],
    ) -> None:
        self._folder = RecordingFolder(folder)
        self.folder = self._folder.path
        value = {
            "format": _FORMAT,
            "version": 1,
            "gestures": list(gestures),
            "lens": [lens.fx, lens.fy, lens.cx, lens.cy],
            "size": list(size),
        }
        with self._folder.writing():
            (self.folder / "depth").mkdir(exist_ok=True)
        write_text(self.folder / "session.json", to_json(value))
        self._frames = self._folder.table("frames.csv", _FRAMES)
        self._actions = self._folder.table("actions.csv", ["time", "action", "detail"])
        self._count = 0
        self._thread = ThreadPoolExecutor(1, "session")
        self._waiting: deque[Future[None]] = deque()

    def add(
        self,
        time: float,
        depth: DepthImage,
        phase: str = "free",
        segment: int = 0,
        gesture: int = 0,
        at: tuple[float, float] = (-1.0, -1.0),
    ) -> None:
        """Add one depth picture.

        time: time at which it was taken, s.
        depth: (h, w) uint16 mm.
        phase, segment: phase of the session, and number of the learning segment.
        gesture: number of the gesture that the person does, 0 for other movement.
        at: (x, y) pixel at which the gesture is done; (-1, -1): not known.
        """
        file = f"depth/{self._count:06d}.png"
        row = f"{self._count},{time:.6f},{file},{phase},{segment},{gesture},{float(at[0])!r},{float(at[1])!r}\n"
        self._settle(SETTINGS.gesture_waiting - 1)
        self._waiting.append(self._thread.submit(self._write, file, depth.copy(), row))
        self._count += 1

    def _write(self, file: str, depth: DepthImage, row: str) -> None:
        write_millimetres_png(self.folder / file, depth)
        with self._folder.writing():
            self._frames.write(row)
            self._frames.flush()

    def _settle(self, left: int) -> None:
        """Wait until at most `left` pictures are still to be written."""
        while len(self._waiting) > left:
            self._waiting.popleft().result()

    def act(self, time: float, action: str, detail: str = "") -> None:
        """Record an action of the user; "undo" with the number of the segment."""
        with self._folder.writing():
            self._actions.write(f"{time:.6f},{action},{detail}\n")
            self._actions.flush()

    def close(self) -> None:
        """Write the waiting pictures and close the files.

        Raises: InputError where the recording was removed meanwhile.
        """
        try:
            self._settle(0)
        finally:
            self._thread.shutdown()
            self._folder.close()

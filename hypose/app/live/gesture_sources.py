"""Open sources of depth pictures for gestures: recorded sessions, recordings of cameras, a live camera, a simulated
sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT, DepthLens, millimetres

if TYPE_CHECKING:
    from hypose.io.sensors.depth import DepthFile

PERSON_RATE = 15.0
"""Rate of the simulated person, Hz."""
_TEST_S = 2.0
"""Time (s) for which the simulated person alternately does the gesture and does not, while no phase asks for it."""


@dataclass(frozen=True)
class Taken:
    """One depth picture of a source.

    time: s.
    depth: (h, w) uint16 mm.
    box: (x, y) px where the gesture is done, if the source provides it.
    """

    time: float
    depth: DepthImage
    box: tuple[float, float] | None = None


@dataclass(frozen=True)
class GestureSource:
    """Source of depth pictures.

    name: name of the source.
    lens: lens parameters of the camera.
    size: (width, height), px.
    take: function take(phase) that returns the next picture, None at the end; phase is the phase of the session,
        which only a simulated person follows.
    close: function that releases the device.
    clear: function that returns whether the last picture clearly shows the gesture, or clearly does not; False where
        the source does not provide it.
    """

    name: str
    lens: DepthLens
    size: tuple[int, int]
    take: Callable[[str], Taken | None]
    close: Callable[[], None] = lambda: None
    clear: Callable[[], bool] = lambda: False


def open_source(text: str, gesture: str = "tee", seed: int = 0) -> GestureSource:
    """Open a source by its name.

    text: folder of a recorded session, FILE.mkv (Azure Kinect), FILE.bag or FILE.db3 (RealSense), FILE.r3d (Record3D),
        "realsense", "simulated" or "simulated:PERSON".
    gesture, seed: gesture and seed of the simulated person.
    Raises: InputError for other texts.
    """
    if text == "simulated" or text.startswith("simulated:"):
        return _simulated(text.partition(":")[2] or "0", gesture, seed)
    from hypose.io.sensors.depth import open_depth, open_realsense, read_realsense

    if text == "realsense":
        return _opened("realsense", open_realsense())
    path = Path(text)
    if path.suffix.lower() in (".bag", ".db3"):
        return _opened(path.name, read_realsense(path))
    if path.suffix.lower() in (".mkv", ".r3d"):
        return _opened(path.name, open_depth(path))
    if path.is_dir():
        return _recorded(path)
    raise InputError(
        f"There is no depth source {text!r}; give a recorded session's folder, a recording of an Azure Kinect "
        "(.mkv), RealSense (.bag, .db3) or Record3D (.r3d), realsense, or simulated."
    )


def _recorded(folder: Path) -> GestureSource:
    from hypose.pipeline.gesture_files import read_recording

    recording = read_recording(folder)
    pictures = recording.pictures()

    def take(phase: str) -> Taken | None:
        for frame, depth in pictures:  # the next one
            return Taken(frame.time, depth, (frame.x, frame.y) if frame.gesture else None)
        return None

    return GestureSource(folder.name, recording.lens, recording.size, take)


def _opened(name: str, opened: DepthFile) -> GestureSource:
    """Make the source of an opened depth camera or recording."""
    k = opened.camera.K  # distortion is left out: tests span a hand
    lens = DepthLens(*(float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])))

    def take(phase: str) -> Taken | None:
        frame = next(opened.frames, None)
        return None if frame is None else Taken(frame.time, millimetres(frame.depth, name))

    return GestureSource(name, lens, opened.camera.size, take, getattr(opened.frames, "close", lambda: None))


def _simulated(who: str, gesture: str, seed: int) -> GestureSource:
    """Open the simulated person.

    who: number of the person, as text.
    gesture: that the person does when a phase asks for it.
    """
    from hypose.synthetic.gesture_scenes import live_person

    if not who.isdigit():
        raise InputError(f"There is no simulated person {who!r}; give simulated:0, for example.")
    frames = live_person(int(who), gesture, np.random.default_rng([93, seed, int(who)]), PERSON_RATE)
    count, clear = 0, False

    def take(phase: str) -> Taken | None:
        nonlocal count, clear
        asked = phase in ("do_gesture", "positive")
        if phase in ("test", "free"):
            asked = int(count / PERSON_RATE / _TEST_S) % 2 == 1
        frame = frames.send(asked) if count else next(frames)
        count, clear = count + 1, frame.clear
        return Taken((count - 1) / PERSON_RATE, frame.depth, frame.point)

    return GestureSource(f"simulated:{who}", KINECT, (640, 480), take, clear=lambda: clear)

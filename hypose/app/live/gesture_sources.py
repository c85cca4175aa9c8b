"""Where depth comes from: recorded sessions, recordings of cameras, a live camera, or the simulated sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hypose.compute import Depth
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT, Lens, millimetres

SIMULATED_FPS = 10.0


@dataclass(frozen=True)
class Taken:
    """A depth picture (h, w) uint16 mm, its time (s), and where the gesture is done (x, y px), if the source knows."""

    time: float
    depth: Depth
    box: tuple[float, float] | None = None


@dataclass(frozen=True)
class Source:
    """lens and size (width, height); take(phase): the next picture, None at the end. phase: what the person is asked to
    do just now; the simulated person does it. close: lets go of the device."""

    name: str
    lens: Lens
    size: tuple[int, int]
    take: Callable[[str], Taken | None]
    close: Callable[[], None] = lambda: None


def open_source(text: str, gesture: str = "tee", seed: int = 0) -> Source:
    """A source by its name: a recorded session's folder, FILE.mkv (Azure Kinect), FILE.bag or FILE.db3
    (RealSense), "realsense", "simulated" or "simulated:PERSON"."""
    if text == "simulated" or text.startswith("simulated:"):
        return _simulated(text.partition(":")[2] or "0", gesture, seed)
    if text == "realsense":
        return _realsense(None)
    path = Path(text)
    if path.suffix.lower() in (".bag", ".db3"):
        return _realsense(path)
    if path.suffix.lower() == ".mkv":
        return _azure(path)
    if path.is_dir():
        return _recorded(path)
    raise InputError(
        f"There is no depth source {text!r}; give a recorded session's folder, a recording of an Azure Kinect "
        "(.mkv) or RealSense (.bag, .db3), realsense, or simulated."
    )


def _recorded(folder: Path) -> Source:
    from hypose.pipeline.gesture_files import read_recording

    recording = read_recording(folder)
    pictures = recording.pictures()

    def take(phase: str) -> Taken | None:
        frame, depth = next(pictures, (None, None))
        if frame is None or depth is None:
            return None
        return Taken(frame.time, depth, (frame.x, frame.y) if frame.gesture else None)

    return Source(folder.name, recording.lens, recording.size, take)


# sensor pixels that a depth mode of the Azure Kinect cuts off left and above, and how many it joins
_AZURE_MODES = {(640, 576): (192, 180, 1), (320, 288): (192, 180, 2), (512, 512): (0, 0, 2), (1024, 1024): (0, 0, 1)}


def _azure(path: Path) -> Source:
    from hypose.io.sensors.depth import read_azure_mkv

    calibration, frames = read_azure_mkv(path)
    first = next(frames, None)
    if first is None:
        raise InputError(f"{path} has no depth pictures; record with depth switched on.")
    size = (first.depth.shape[1], first.depth.shape[0])

    def every() -> Iterator[Taken]:
        yield Taken(first.time, millimetres(first.depth, str(path)))
        for f in frames:
            yield Taken(f.time, millimetres(f.depth, str(path)))

    pictures = every()
    return Source(path.name, azure_lens(calibration, size, path), size, lambda phase: next(pictures, None))


def azure_lens(calibration: dict[str, Any], size: tuple[int, int], path: Path) -> Lens:
    """The depth camera's pinhole from an Azure recording's calibration; distortion is left out (tests span a hand)."""
    try:
        cameras = calibration["CalibrationInformation"]["Cameras"]
        depth = next(c for c in cameras if "Depth" in c["Purpose"])
        cx, cy, fx, fy = (float(v) for v in depth["Intrinsics"]["ModelParameters"][:4])
        left, above, joined = _AZURE_MODES[size]
    except (KeyError, TypeError, ValueError, StopIteration, IndexError):
        raise InputError(
            f"{path}: the depth camera's calibration is missing or its picture of {size[0]} x {size[1]} is of no known "
            "mode; record with k4arecorder."
        ) from None
    side = 1024.0
    return Lens(
        fx * side / joined,
        fy * side / joined,
        (cx * side - left) / joined - 0.5,
        (cy * side - above) / joined - 0.5,
    )


def _realsense(path: Path | None) -> Source:
    from hypose.io.sensors.depth import open_realsense, read_realsense

    opened = open_realsense() if path is None else read_realsense(path)
    name = "realsense" if path is None else path.name

    def take(phase: str) -> Taken | None:
        frame = next(opened.frames, None)
        return None if frame is None else Taken(frame.time, millimetres(frame.depth, name))

    close = getattr(opened.frames, "close", lambda: None)
    return Source(name, Lens(*opened.intrinsics), opened.size, take, close)


def _simulated(who: str, gesture: str, seed: int) -> Source:
    from hypose.synthetic.gesture_people import load_people
    from hypose.synthetic.gesture_poses import GESTURES
    from hypose.synthetic.gesture_scenes import Setting, Stage, make_room, make_view, picture

    people = load_people()
    if not who.isdigit() or int(who) >= len(people):
        raise InputError(f"There is no simulated person {who!r}; give simulated:0 to simulated:{len(people) - 1}.")
    if gesture not in GESTURES:
        raise InputError(f"The simulated person cannot do {gesture!r}; the gestures are {', '.join(GESTURES)}.")
    rng = np.random.default_rng([92, seed, int(who)])
    setting = Setting.new(make_room(rng, "furnished"), make_view(rng, rng.uniform(1.4, 2.4)))
    stage = Stage(("furnished",), 0.0, settings=(setting,))
    count = 0

    def take(phase: str) -> Taken | None:
        nonlocal count
        shows = phase in ("do_gesture", "positive") or (phase in ("test", "free") and count // 20 % 2 == 1)
        others = [g for g in GESTURES if g != gesture]
        kind = gesture if shows else str(rng.choice(others)) if rng.random() < 0.3 else "movement"
        frame = picture(int(who), kind, stage, rng)
        count += 1
        box = (frame.x + rng.normal(0, 1.5), frame.y + rng.normal(0, 1.5)) if shows else None
        return Taken((count - 1) / SIMULATED_FPS, frame.depth, box)

    return Source(f"simulated:{who}", KINECT, (640, 480), take)

"""A recording folder of skeletons: session.json, frames.csv, skeleton.csv, and depth maps if wanted.

session.json: {"format": "hypose-skeletons", "version": 1, "name": ..., "reference": SENSOR, "clock": "common" or
  "own", "sensors": [{"name": ..., "joints": [names], "unit": "m" or "mm" (default m), "depth": {"intrinsics":
  [fx, fy, cx, cy], "y_up": false}}]}. depth is there when the sensor has depth maps; y_up: the skeleton's y axis
  points up (Kinect v2) instead of down (Azure, OpenCV).
frames.csv: sensor,frame,time[,depth], one row per sensor frame: frame is a whole number of the sensor's own, time in
  seconds, depth the path of a 16-bit PNG in millimetres (0 = hole), relative to the folder.
skeleton.csv: sensor,frame,person,joint,x,y,z,state, one row per joint; rows or coordinates that are absent are missing
  joints. A frame without rows is one in which the sensor saw nobody.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import RecordingFolder, read_json, text_lines, write_text
from hypose.io.motions.results import to_json
from hypose.io.sensors.depth import depth_at_joints, read_depth_png
from hypose.io.sensors.skeleton_streams import MAX_JOINTS, MAX_SENSORS, SkeletonRecording, StreamRows, checked_recording
from hypose.io.text_in import bounded_lines

FORMAT = "hypose-skeletons"
_FRAMES = ["sensor", "frame", "time"]
_SKELETON = ["sensor", "frame", "person", "joint", "x", "y", "z", "state"]
_SCALE = {"m": 1.0, "mm": 0.001}


@dataclass
class _Sensor:
    rows: StreamRows
    scale: float
    intrinsics: tuple[float, float, float, float] | None
    y_up: bool
    joint: dict[str, int]
    times: dict[int, float] = field(default_factory=dict)
    depth: dict[int, str] = field(default_factory=dict)


def read_folder(folder: str | Path) -> SkeletonRecording:
    """Read a recording folder; an InputError names the file and line that cannot be used."""
    folder = Path(folder)
    session = folder / "session.json"
    value = _session(session)
    sensors = {s.rows.name: s for s in (_sensor(session, x) for x in value["sensors"])}
    if len(sensors) < len(value["sensors"]):
        raise InputError(f"{session} names a sensor twice; every sensor needs its own name.")
    frames, skeleton = folder / "frames.csv", folder / "skeleton.csv"
    _read_frames(frames, sensors)
    bodies = _read_bodies(skeleton, sensors)
    notes: list[str] = []
    for s in sensors.values():
        _fill(s, bodies[s.rows.name], folder)
    filled = [s.rows for s in sensors.values() if s.rows.times]
    notes += [f"{s.rows.name}: nobody was seen, the sensor is left out" for s in sensors.values() if not s.rows.times]
    return checked_recording(
        str(value.get("name", folder.resolve().name)),
        filled,
        str(folder),
        {p.name: p for p in (session, frames, skeleton)},
        reference=value.get("reference"),
        notes=notes,
        common_clock=value.get("clock", "common") == "common",
    )


def _session(path: Path) -> dict[str, Any]:
    value = read_json(path, "a session.json")
    if not isinstance(value, dict) or value.get("format") != FORMAT or value.get("version") != 1:
        raise InputError(f'{path} is no session of skeletons; it must say "format": "{FORMAT}", "version": 1.')
    sensors = value.get("sensors")
    if not isinstance(sensors, list) or not 1 <= len(sensors) <= MAX_SENSORS:
        raise InputError(f"{path}: sensors must be a list of 1 to {MAX_SENSORS} sensors.")
    if value.get("clock", "common") not in ("common", "own"):
        raise InputError(f"{path}: clock must be common or own.")
    if not isinstance(value.get("reference", ""), str):
        raise InputError(f"{path}: reference must be the name of a sensor.")
    return value


def _sensor(path: Path, value: Any) -> _Sensor:
    if not isinstance(value, dict) or not isinstance(value.get("name"), str) or not 1 <= len(value["name"]) <= 64:
        raise InputError(f"{path}: every sensor needs a name of 1 to 64 characters.")
    name, joints, unit = value["name"], value.get("joints"), value.get("unit", "m")
    if (
        not isinstance(joints, list)
        or not 1 <= len(joints) <= MAX_JOINTS
        or not all(isinstance(j, str) and j for j in joints)
        or len(set(joints)) < len(joints)
    ):
        raise InputError(f"{path}: the joints of sensor {name} must be a list of 1 to {MAX_JOINTS} different names.")
    if unit not in ("m", "mm"):
        raise InputError(f"{path}: the unit of sensor {name} must be m or mm.")
    depth, intrinsics, y_up = value.get("depth"), None, False
    if depth is not None:
        k = depth.get("intrinsics") if isinstance(depth, dict) else None
        fine = isinstance(k, list) and len(k) == 4 and all(isinstance(v, int | float) and abs(v) < 1e5 for v in k)
        if not fine or not k or min(k[:2]) <= 0:
            raise InputError(f"{path}: depth of sensor {name} needs intrinsics [fx, fy, cx, cy] in pixels.")
        intrinsics = (float(k[0]), float(k[1]), float(k[2]), float(k[3]))
        y_up = depth.get("y_up", False) is True
    rows = StreamRows(name, tuple(joints))
    return _Sensor(rows, _SCALE[unit], intrinsics, y_up, {n: i for i, n in enumerate(joints)})


def _table(path: Path, header: Sequence[str], kind: str, take: Callable[[list[str]], None]) -> None:
    lines = bounded_lines(path, kind)
    names = [c.strip() for c in next(lines, "").split(",")]
    if names[: len(header)] != list(header):
        raise InputError(f"{path}: the first line must be {','.join(header)}.")
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(names):
            raise InputError(
                f"{path}: line {number} has {len(cells)} cells, the first line {len(names)}; the file may be cut off."
            )
        try:
            take(cells)
        except KeyError as error:
            raise InputError(
                f"{path}: line {number}: {error.args[0]!r} is not in session.json or frames.csv."
            ) from None
        except (ValueError, OverflowError) as error:
            reason = str(error) if isinstance(error, _Reason) else "something is not a number"
            raise InputError(f"{path}: line {number}: {reason}.") from None


class _Reason(ValueError):
    """A ValueError whose text is for the user."""


def _read_frames(path: Path, sensors: Mapping[str, _Sensor]) -> None:
    def take(cells: list[str]) -> None:
        sensor, number, time = sensors[cells[0].strip()], int(cells[1]), float(cells[2])
        if number in sensor.times:
            raise _Reason(f"the frame {number} of sensor {cells[0].strip()} is there twice")
        if not math.isfinite(time):
            raise _Reason("the time is not a number")
        sensor.times[number] = time
        if len(cells) > 3 and cells[3].strip():
            sensor.depth[number] = cells[3].strip()

    _table(path, _FRAMES, "frames.csv of a skeleton recording", take)


_Bodies = dict[tuple[int, int], tuple[Array, NDArray[np.uint8]]]


def _read_bodies(path: Path, sensors: Mapping[str, _Sensor]) -> dict[str, _Bodies]:
    bodies: dict[str, _Bodies] = {name: {} for name in sensors}

    def take(cells: list[str]) -> None:
        name = cells[0].strip()
        sensor = sensors[name]
        frame, person = int(cells[1]), int(cells[2] or 0)
        if frame not in sensor.times:
            raise KeyError(f"frame {frame} of {name}")
        joint = sensor.joint[cells[3].strip()]
        body = bodies[name].get((frame, person))
        if body is None:
            count = len(sensor.joint)
            body = bodies[name][frame, person] = (np.full((count, 3), np.nan), np.zeros(count, dtype=np.uint8))
        if not 0 <= person < 2**63:
            raise _Reason("person must be a whole number from 0")
        state = int(cells[7]) if cells[7].strip() else 2
        if state not in (0, 1, 2):
            raise _Reason(f"the state is {state}, it must be 0, 1 or 2")
        xyz = [float(c) if c.strip() else math.nan for c in cells[4:7]]
        if any(map(math.isinf, xyz)):
            raise _Reason("a coordinate is infinite")
        body[0][joint], body[1][joint] = xyz, state

    _table(path, _SKELETON, "skeleton.csv of a skeleton recording", take)
    return bodies


def _fill(sensor: _Sensor, bodies: _Bodies, folder: Path) -> None:
    """The sensor's rows in the order of its frames' numbers, which is that of arrival."""
    by_frame: dict[int, list[tuple[int, Array, NDArray[np.uint8]]]] = {}
    for (frame, person), (positions, state) in bodies.items():
        scaled = np.where(positions > -9000, positions * sensor.scale, positions)
        by_frame.setdefault(frame, []).append((person, scaled, state))
    with_depth = sensor.intrinsics is not None and bool(sensor.depth)
    for frame in sorted(sensor.times):
        time = sensor.times[frame]
        if frame not in by_frame:
            sensor.rows.empty.append(time)
            continue
        image = None
        if with_depth and frame in sensor.depth:
            image = read_depth_png(_inside(folder, sensor.depth[frame]))
        for person, positions, state in by_frame[frame]:
            sensor.rows.add(time, person, positions, state)
            if with_depth and sensor.intrinsics is not None:
                found = np.zeros(len(positions))
                if image is not None:
                    found = depth_at_joints(image, positions, sensor.intrinsics, sensor.y_up)
                sensor.rows.joint_depth.append(found)


def _inside(folder: Path, name: str) -> Path:
    """A path in the folder; an InputError for one that leads out of it."""
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{folder / 'frames.csv'} names the depth map {name!r}, which lies outside the folder.")
    return path


# ---- writing -------------------------------------------------------------------------------------------------


class FolderWriter:
    """Writes a recording folder while it is being recorded; what was written so far can be read at any time."""

    def __init__(self, folder: str | Path, name: str = "", clock: str = "own") -> None:
        self._folder = RecordingFolder(folder)
        self.folder = self._folder.path
        self._name, self._clock = name or self.folder.name, clock
        self._joints: dict[str, tuple[str, ...]] = {}
        self._frame: dict[str, tuple[int, float]] = {}
        self._frames = self._folder.table("frames.csv", _FRAMES)
        self._skeleton = self._folder.table("skeleton.csv", _SKELETON)

    def add(
        self,
        sensor: str,
        time: float,
        person: int | None,
        joint_names: Sequence[str],
        positions: Array,
        state: NDArray[np.uint8],
    ) -> None:
        """One body (person None: the sensor saw nobody). Bodies of one sensor frame come together, with equal times."""
        with self._folder.writing():
            if sensor not in self._joints and person is not None:
                self._joints[sensor] = tuple(joint_names)
                self._session()
            number, last = self._frame.get(sensor, (-1, math.nan))
            if time != last:
                number += 1
                self._frame[sensor] = (number, time)
                self._frames.write(f"{sensor},{number},{time:.6f}\n")
            if person is None:
                return
            rows = [
                f"{sensor},{number},{person},{joint},{x:.5f},{y:.5f},{z:.5f},{s}\n"
                for joint, (x, y, z), s in zip(joint_names, positions.tolist(), state.tolist(), strict=True)
                if s
            ]
            self._skeleton.write("".join(rows))

    def _session(self) -> None:
        sensors = [{"name": n, "joints": list(j)} for n, j in self._joints.items()]
        value = {"format": FORMAT, "version": 1, "name": self._name, "clock": self._clock, "sensors": sensors}
        write_text(self.folder / "session.json", to_json(value))

    def flush(self) -> None:
        """Hand everything to the system; an InputError when it cannot be written or the recording was removed."""
        with self._folder.writing():
            self._frames.flush()
            self._skeleton.flush()
        self._folder.check()

    def close(self) -> None:
        """Close the files; sensors that saw nobody are not in session.json, so their frames are taken out. An
        InputError when not all could be written, or the recording was removed meanwhile."""
        with self._folder.writing():
            for stream in (self._frames, self._skeleton):
                stream.close()
        self._folder.check()
        silent = set(self._frame) - set(self._joints)
        if silent:
            path = self.folder / "frames.csv"
            kept = [line for line in text_lines(path, "a frames.csv") if line.split(",", 1)[0] not in silent]
            write_text(path, "\n".join([*kept, ""]))

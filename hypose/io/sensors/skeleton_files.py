"""Files of recorded skeletons: hypose's own folder (session.json, frames.csv, skeleton.csv, depth maps) and other
formats.

session.json: {"format": "hypose-skeletons", "version": 1, "name": ..., "reference": SENSOR, "clock": "common" or
  "own", "sensors": [{"name": ..., "joints": [names], "unit": "m" or "mm" (default m), "depth": {"intrinsics":
  [fx, fy, cx, cy], "y_up": false}}]}. depth is given when the sensor has depth maps; y_up: the skeleton's y axis
  points up (Kinect v2) and not down (Azure, OpenCV).
frames.csv: sensor,frame,time[,depth], one row per sensor frame: frame is the sensor's own whole number, time is in
  seconds, depth is the path of a 16-bit PNG in millimetres (0 = hole), relative to the folder.
skeleton.csv: sensor,frame,person,joint,x,y,z,state, one row per joint; absent rows or coordinates are missing joints.
  In a frame without rows the sensor saw no person.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.geometry import Array, so3_exp
from hypose.io.files import (
    MAX_TEXT_BYTES,
    RecordingFolder,
    csv_rows,
    numbers_of,
    read_json,
    text_lines,
    text_of,
    write_text,
)
from hypose.io.formats import Format, FormatTable, Source
from hypose.io.motions.results import to_json
from hypose.io.sensors.depth import read_depth_png, sample_depth
from hypose.io.sensors.skeleton_streams import (
    MAX_JOINTS,
    MISSING_MARK,
    SKELETON_UNITS,
    SkeletonRecording,
    StreamRows,
    checked_recording,
    read_lines,
)

_FORMAT = "hypose-skeletons"
_FRAMES = ["sensor", "frame", "time"]
_SKELETON = ["sensor", "frame", "person", "joint", "x", "y", "z", "state"]


def read_folder(source: Source) -> SkeletonRecording:
    """Read a recording folder of skeletons, or that of a session.json.

    Raises: InputError where a file or line cannot be used; it names both.
    """
    folder = source.path if source.path.is_dir() else source.path.parent
    session, frames, skeleton = (folder / name for name in ("session.json", "frames.csv", "skeleton.csv"))
    with numbers_of(str(session)):
        value = read_json(session, "a session.json")
        stated, clock = (value["format"], value["version"]), value.get("clock", "common")
        sensors = {s.rows.name: s for s in (_described(session, x) for x in value["sensors"])}
        twice = len(sensors) < len(value["sensors"])
    if stated != (_FORMAT, 1) or clock not in ("common", "own") or twice:
        raise InputError(
            f'{session} must say "format": "{_FORMAT}", "version": 1, "clock": "common" or "own", and name each sensor '
            "once; correct it."
        )
    for where, cells in _rows_of(frames, _FRAMES, "frames.csv of a skeleton recording"):
        _read_frame(where, cells, sensors)
    for where, cells in _rows_of(skeleton, _SKELETON, "skeleton.csv of a skeleton recording"):
        _read_joint(where, cells, sensors)
    for sensor in sensors.values():
        _add_rows(sensor, folder)
    return checked_recording(
        str(value.get("name", folder.resolve().name)),
        [s.rows for s in sensors.values()],
        str(folder),
        {p.name: p for p in (session, frames, skeleton)},
        reference=value.get("reference"),
        common_clock=clock == "common",
    )


@dataclass
class _Sensor:
    """A sensor of a recording folder while it is read.

    rows: its bodies, in the order of frames.
    scale: metres per unit.
    intrinsics: fx, fy, cx, cy of its depth maps, px; None where it has none.
    y_up: whether y of the positions points up.
    times: time, s, of each frame.
    depth: path of the depth map of a frame.
    bodies: positions (J, 3), in the sensor's unit, and states (J,) of each frame and person.
    """

    rows: StreamRows
    scale: float
    intrinsics: tuple[float, float, float, float] | None
    y_up: bool
    times: dict[int, float] = field(default_factory=dict)
    depth: dict[int, str] = field(default_factory=dict)
    bodies: dict[tuple[int, int], tuple[Array, NDArray[np.uint8]]] = field(default_factory=dict)


def _described(path: Path, value: Mapping[str, Any]) -> _Sensor:
    """Convert the entry of a sensor in session.json; InputError, which names the file, where it is not valid."""
    name, joints, unit, depth = value["name"], value["joints"], value.get("unit", "m"), value.get("depth")
    named = all(isinstance(text, str) and 1 <= len(text) <= 64 for text in [name, *joints])
    if not named or len(set(joints)) < len(joints) or not 1 <= len(joints) <= MAX_JOINTS or unit not in SKELETON_UNITS:
        raise InputError(
            f"{path}: each sensor needs a name, a list of 1 to {MAX_JOINTS} different names of joints, and the unit m "
            "or mm; correct it."
        )
    lens, y_up = None, False
    if depth is not None:
        fx, fy, cx, cy = map(float, depth["intrinsics"])
        lens, y_up = (fx, fy, cx, cy), depth.get("y_up", False) is True
        if not (0 < fx < 1e5 and 0 < fy < 1e5 and abs(cx) < 1e5 and abs(cy) < 1e5):
            raise InputError(f"{path}: depth of sensor {name} needs intrinsics [fx, fy, cx, cy] in pixels.")
    return _Sensor(StreamRows(name, tuple(joints)), SKELETON_UNITS[unit], lens, y_up)


def _sensor_of(where: str, sensors: Mapping[str, _Sensor], cells: Sequence[str]) -> _Sensor:
    if cells[0] not in sensors:
        raise InputError(f"{where}: the sensor {cells[0]!r} is not in session.json.")
    return sensors[cells[0]]


def _read_frame(where: str, cells: Sequence[str], sensors: Mapping[str, _Sensor]) -> None:
    """Add a row of frames.csv to its sensor; where: file and line."""
    sensor = _sensor_of(where, sensors, cells)
    with numbers_of(where):
        number, time = int(cells[1]), float(cells[2])
    if number in sensor.times:
        raise InputError(f"{where}: the frame {number} of sensor {cells[0]} is there twice.")
    sensor.times[number] = time
    if "".join(cells[3:4]):
        sensor.depth[number] = cells[3]


def _read_joint(where: str, cells: Sequence[str], sensors: Mapping[str, _Sensor]) -> None:
    """Add a row of skeleton.csv to the bodies of its sensor; where: file and line."""
    sensor = _sensor_of(where, sensors, cells)
    with numbers_of(where):
        frame, person, state = int(cells[1]), int(cells[2] or 0), int(cells[7] or 2)
        xyz = [float(c or "nan") for c in cells[4:7]]
    joints = sensor.rows.joint_names
    if cells[3] not in joints or frame not in sensor.times:
        raise InputError(f"{where}: the joint {cells[3]!r} or the frame {frame} is not in session.json or frames.csv.")
    if not 0 <= person < 2**63 or state not in (0, 1, 2) or any(map(math.isinf, xyz)):
        raise InputError(
            f"{where}: person must be a whole number from 0, the state 0, 1 or 2, and coordinates must be finite; "
            f"got {person}, {state} and {xyz}."
        )
    nothing = np.full((len(joints), 3), np.nan), np.zeros(len(joints), dtype=np.uint8)
    positions, states = sensor.bodies.setdefault((frame, person), nothing)
    joint = joints.index(cells[3])
    positions[joint], states[joint] = xyz, state


def _add_rows(sensor: _Sensor, folder: Path) -> None:
    """Add the bodies to the sensor's rows in the order of frame numbers, which is the order of arrival.

    folder: folder of the recording, which holds the depth maps.
    """
    lens, rows = sensor.intrinsics if sensor.depth else None, sensor.rows
    by_frame: dict[int, list[tuple[int, Array, NDArray[np.uint8]]]] = {number: [] for number in sensor.times}
    for (frame, person), (positions, state) in sensor.bodies.items():
        scaled = np.where(positions > -9000, positions * sensor.scale, positions)
        by_frame[frame].append((person, scaled, state))
    for frame, seen in sorted(by_frame.items()):
        image, name = None, sensor.depth.get(frame)
        if not seen:
            rows.empty.append(sensor.times[frame])
        elif lens is not None and name is not None:
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                raise InputError(
                    f"{folder / 'frames.csv'} names the depth map {name!r}, which lies outside the folder."
                )
            image = read_depth_png(folder / name)
        for person, positions, state in seen:
            rows.add(sensor.times[frame], person, positions, state)
            if lens is not None:
                none = np.zeros(len(positions))
                rows.joint_depth.append(none if image is None else sample_depth(image, positions, lens, sensor.y_up))


def _rows_of(path: Path, header: Sequence[str], kind: str) -> Iterator[tuple[str, list[str]]]:
    """Read the rows of a CSV file after checking its header: file and line as text, and the cells."""
    names, rows = csv_rows(path, kind)
    if names[: len(header)] != list(header):
        raise InputError(f"{path}: the first line must be {','.join(header)}.")
    for number, cells in rows:
        yield f"{path}: line {number}", cells


# ---- writing -------------------------------------------------------------------------------------------------


class FolderWriter:
    """Writer of a recording folder during the recording. The part that is already written can be read at any time.

    folder: a new or empty folder.
    name: name of the recording; the folder's by default.
    clock: "own" where each sensor has its own clock, "common" where all have the same.
    """

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
        """Write one body. Bodies of the same sensor frame come one after another with equal times.

        time: s.
        person: the sensor's number of the person; None where the sensor saw no person.
        joint_names: names of the J joints, the same for all bodies of the sensor.
        positions: (J, 3) m.
        state: (J,) 0 not tracked, 1 inferred, 2 tracked.
        Raises: InputError where the folder cannot be written.
        """
        with self._folder.writing():
            if sensor not in self._joints and person is not None:
                self._joints[sensor] = tuple(joint_names)
                sensors = [{"name": n, "joints": list(j)} for n, j in self._joints.items()]
                about = {"format": _FORMAT, "version": 1, "name": self._name, "clock": self._clock}
                write_text(self.folder / "session.json", to_json(about | {"sensors": sensors}))
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

    def flush(self) -> None:
        """Flush the files to the system.

        Raises: InputError where they cannot be written or were removed.
        """
        with self._folder.writing():
            self._frames.flush()
            self._skeleton.flush()
        self._folder.check()

    def close(self) -> None:
        """Close the files, and remove the frames of sensors that saw no person, which session.json does not list.

        Raises: InputError where they could not be written or were removed.
        """
        with self._folder.writing():
            for stream in (self._frames, self._skeleton):
                stream.close()
        self._folder.check()
        silent = set(self._frame) - set(self._joints)
        if silent:
            path = self.folder / "frames.csv"
            kept = [line for line in text_lines(path, "a frames.csv") if line.split(",", 1)[0] not in silent]
            write_text(path, "\n".join([*kept, ""]))


# ---- other formats -------------------------------------------------------------------------------------------------


def read_kinect_csv(source: Source) -> SkeletonRecording:
    """Read a CSV of KinectMultiTrack (C.-J. Wu, 2015; .csv or .csv.gz): one stream per Kinect_Id, people by Person_Id.

    Times are those of Tracker_Time (one clock, ms), shifted to start at 0. No tracking state is logged, so a joint that
    is present counts as tracked.
    The logger moves every skeleton into the frame of the first row's sensor, by the angle and distance at which the
    person first stood in front of each sensor (Skeleton_Init_Angle, Skeleton_Init_Dist). This is undone, so the
    positions are in each sensor's own frame, m.

    Raises: InputError where columns are missing or a line cannot be used.
    """
    path = source.path
    header, lines = csv_rows(path, source.kind)
    at = {name: i for i, name in enumerate(header)}
    starts = [i for i, c in enumerate(header) if c.endswith("_X")]
    joints = tuple(header[i][:-2] for i in starts)
    wrong = [c for i, c in zip(starts, joints, strict=True) if header[i : i + 3] != [f"{c}_{x}" for x in "XYZ"]]
    if not 1 <= len(joints) <= MAX_JOINTS or wrong or len(set(joints)) < len(joints):
        raise InputError(
            f"{path} needs columns <Joint>_X, <Joint>_Y, <Joint>_Z of 1 to {MAX_JOINTS} joints; export it "
            "with such a first line."
        )
    sensor_column = at[next((n for n in at if n.startswith("Kinect_Id") or n == "Kinect#"), "Kinect_Id")]
    person_column = at.get("Person_Id", at.get("Skeleton_Id"))
    time_column, turned = at["Tracker_Time"], [at[n] for n in ("Skeleton_Init_Angle", "Skeleton_Init_Dist") if n in at]
    turns: dict[str, Array] = {}
    sensors: dict[str, StreamRows] = {}
    for number, cells in lines:
        with numbers_of(f"{path}: line {number}"):
            time = float(cells[time_column]) * 1e-3
            person = int(float(cells[person_column])) if person_column is not None else 0
            values = np.array([[float(c) for c in cells[i : i + 3]] for i in starts])
            turn = np.array([float(cells[i]) for i in turned])
        name = cells[sensor_column]
        if len(turn) == 2:
            own, known = turns.setdefault(name, turn), (values > MISSING_MARK).all(1)
            # the program moved the points to the first sensor's frame; here they come back to their own
            first = next(iter(turns.values()))
            back = so3_exp(np.array([0.0, own[0] - first[0], 0.0]))
            values[known] = (values[known] - [0.0, 0.0, first[1]]) @ back + [0.0, 0.0, own[1]]
        sensors.setdefault(name, StreamRows(name, joints)).add(time, person, values, np.full(len(joints), 2))
    # seconds since the year 1 would lose microseconds in later arithmetic
    zero = min((t for rows in sensors.values() for t in rows.times), default=0.0)
    for rows in sensors.values():
        rows.times = [t - zero for t in rows.times]
    title = path.name.removesuffix(".gz").removesuffix(".csv")
    return checked_recording(title, list(sensors.values()), str(path), {path.name: path})


def read_azure(source: Source) -> SkeletonRecording:
    """Read the .json files of Azure Kinect's offline_processor, one per sensor, each with its own clock.

    Positions are in millimetres. confidence_level (0 none, 1 low, 2 medium, 3 high) becomes the joint's state; without
    it every joint counts as tracked.

    Raises: InputError where a file is not of this format.
    """
    paths, sensors = source.files(".json"), []
    for path in paths:
        with numbers_of(str(path)):
            value = _json(path)
            rows = StreamRows(text_of(path.stem), tuple(map(str, value["joint_names"])))
            frames = list(value["frames"])
        for i, frame in enumerate(frames):
            with numbers_of(f"{path}, frame {i}"):
                time = float(frame["timestamp_usec"]) * 1e-6
                for body in frame["bodies"]:
                    xyz = np.array(body["joint_positions"], dtype=np.float64).reshape(len(rows.joint_names), 3) * 1e-3
                    state = np.array(body.get("confidence_level", [2] * len(xyz)), dtype=np.uint8).reshape(len(xyz))
                    rows.add(time, int(body["body_id"]), xyz, np.minimum(state, 2))
                if not frame["bodies"]:
                    rows.empty.append(time)
        sensors.append(rows)
    inputs, name = {p.name: p for p in paths}, text_of(paths[0].stem)
    return checked_recording(name, sensors, str(paths[0]), inputs, common_clock=len(paths) == 1)


def _json(path: Path) -> Any:
    return read_json(path, "recorded skeletons", MAX_TEXT_BYTES)


# ---- skeleton formats ----------------------------------------------------------------------------------------------
# Recorded skeletons of any known program.


SKELETONS = FormatTable(
    "a recording of skeletons",
    "give the recording of a sensor (other archives than .gz must be unpacked first)",
    (
        Format(
            "hypose",
            ("/", "session.json"),
            read_folder,
            lambda source: (source.path / "session.json").exists() or source.path.is_file(),
            FolderWriter,
            "positions in steps of 0.01 mm, times of 1 us",
            1e-5,
        ),
        Format(
            "Azure Kinect (offline_processor)",
            ("/", ".json"),
            read_azure,
            lambda source: any("joint_names" in _json(file) for file in source.files(".json")[:1]),
        ),
        Format(
            "KinectMultiTrack",
            (".csv", ".csv.gz"),
            read_kinect_csv,
            lambda source: any("Kinect" in c for c in source.header),
        ),
        Format("lines of hypose", (".jsonl", ".ndjson", ".jsonl.gz", ".ndjson.gz"), read_lines),
    ),
)
"""Skeletons: readers of a source; writers are opened with a new folder and take one body after another."""


def read_skeletons(path: str | Path) -> SkeletonRecording:
    """Read recorded skeletons in any known format (`SKELETONS`).

    Raises: InputError where the path has no known format or cannot be used.
    """
    return SKELETONS.read(path)

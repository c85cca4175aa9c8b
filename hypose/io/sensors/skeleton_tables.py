"""Skeleton tables of others: CSV of several Kinects (KinectMultiTrack), and NTU RGB+D .skeleton files.

Sources: the logger of KinectMultiTrack (C.-J. Wu, 2015): one row per skeleton, columns named <Joint>_X, _Y, _Z in
metres, -9999 = missing. NTU RGB+D (Shahroudy et al. 2016): plain numbers, per frame a number of bodies, per body a
line of ten values, the number of joints and a line of twelve values per joint; 25 Kinect v2 joints at 30 frames/s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.geometry import Array, so3_exp
from hypose.io.file_names import text_of
from hypose.io.sensors.skeleton_streams import (
    MAX_JOINTS,
    MISSING_MARK,
    SkeletonRecording,
    StreamRows,
    checked_recording,
)
from hypose.io.text_in import bounded_lines

KINECT_V2 = tuple(
    "SpineBase SpineMid Neck Head ShoulderLeft ElbowLeft WristLeft HandLeft ShoulderRight ElbowRight WristRight "
    "HandRight HipLeft KneeLeft AnkleLeft FootLeft HipRight KneeRight AnkleRight FootRight SpineShoulder HandTipLeft "
    "ThumbLeft HandTipRight ThumbRight".split()
)
"""The 25 joints in the order of the SDK and of NTU files."""
NTU_RATE = 30.0
_MAX_FRAMES = 1_000_000
_KIND = "a CSV of skeletons with one row per skeleton and columns <Joint>_X, <Joint>_Y, <Joint>_Z"


def read_kinect_csv(path: str | Path, clock: str = "tracker") -> SkeletonRecording:
    """Read a KinectMultiTrack CSV (.csv or .csv.gz): one stream per Kinect_Id, persons by Person_Id.

    clock: "tracker" takes Tracker_Time (one clock, ms), "sensor" each Kinect's own Skeleton_Time (100 ns). Times start
    at 0. No tracking state is logged: a joint that is there counts as tracked. The logger turns every skeleton by how
    the person stood before its sensor at first (Skeleton_Init_Angle, Skeleton_Init_Dist), and puts it where the first
    row's sensor saw it; here each sensor's are put back before it, all by what its first row says.
    """
    if clock not in ("tracker", "sensor"):
        raise InputError(f"There is no clock {clock!r}; choose tracker or sensor.")
    lines = bounded_lines(path, _KIND)
    header = [c.strip() for c in next(lines, "").split(",")]
    at = {name: i for i, name in enumerate(header)}
    starts = [i for i, c in enumerate(header) if c.endswith("_X")]
    joints = tuple(header[i][:-2] for i in starts)
    wrong = [c[:-2] for i, c in zip(starts, joints, strict=True) if header[i : i + 3] != [f"{c}_{x}" for x in "XYZ"]]
    if not joints or len(joints) > MAX_JOINTS or wrong or len(set(joints)) < len(joints):
        raise InputError(f"{path} is not {_KIND}: its first line does not name 1 to {MAX_JOINTS} joints that way.")
    time_name, unit = ("Tracker_Time", 1e-3) if clock == "tracker" else ("Skeleton_Time", 1e-7)
    sensor_column = next((at[n] for n in ("Kinect_Id", "Kinect#", "Kinect_Id(0=FOR)") if n in at), None)
    if sensor_column is None:
        sensor_column = next((i for i, n in enumerate(header) if n.startswith("Kinect_Id")), None)
    if sensor_column is None or time_name not in at:
        missing = time_name if time_name not in at else "Kinect_Id"
        raise InputError(f"{path}: the column {missing} is missing; it must be in the first line.")
    person_column = at.get("Person_Id", at.get("Skeleton_Id"))
    first, count = starts[0], 3 * len(joints)
    contiguous = starts == list(range(first, first + count, 3))
    where = [c + k for c in starts for k in range(3)]
    turned = [at[n] for n in ("Skeleton_Init_Angle", "Skeleton_Init_Dist") if n in at]
    turns: dict[str, Array] = {}
    sensors: dict[str, StreamRows] = {}
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(header):
            raise InputError(
                f"{path}: line {number} has {len(cells)} cells, the first line {len(header)}; the file may be cut off."
            )
        try:
            time = float(cells[at[time_name]]) * unit
            person = int(float(cells[person_column])) if person_column is not None else 0
            numbers = cells[first : first + count] if contiguous else [cells[i] for i in where]
            values = np.array([float(c) for c in numbers]).reshape(-1, 3)
            turn = np.array([float(cells[i]) for i in turned])
        except (ValueError, OverflowError):
            raise InputError(f"{path}: line {number} holds something that is not a number.") from None
        if not math.isfinite(time):
            raise InputError(f"{path}: line {number} has no time; {time_name} must be a number.")
        name = cells[sensor_column].strip()
        if len(turn) == 2:
            own, known = turns.setdefault(name, turn), (values > MISSING_MARK).all(1)
            values[known] = _before_own_sensor(values[known], next(iter(turns.values())), own)
        rows = sensors.setdefault(name, StreamRows(name, joints))
        rows.add(time, person, values, np.full(len(joints), 2))
    # numbers of seconds since the year 1 lose microseconds in later arithmetic
    starts_at = {n: min(r.times) for n, r in sensors.items()}
    common = min(starts_at.values(), default=0.0)
    for name, rows in sensors.items():
        zero = common if clock == "tracker" else starts_at[name]
        rows.times = [t - zero for t in rows.times]
    p = Path(path)
    title = p.name.removesuffix(".gz").removesuffix(".csv")
    return checked_recording(title, list(sensors.values()), str(p), {p.name: p}, common_clock=clock == "tracker")


def _before_own_sensor(points: Array, first: Array, own: Array) -> Array:
    """Points (N, 3) m that a sensor's skeleton has where the first sensor saw it, as its own sensor saw them; first,
    own: angle rad about the vertical and distance m of the person at first."""
    moved = (points - [0.0, 0.0, first[1]]) @ so3_exp(np.array([0.0, own[0] - first[0], 0.0]))
    return np.asarray(moved + [0.0, 0.0, own[1]])


_NTU_NAME = re.compile(r"(S\d{3})C(\d{3})(P\d{3}R\d{3}A\d{3})", re.IGNORECASE)


def read_ntu(files: Sequence[str | Path]) -> SkeletonRecording:
    """Read NTU RGB+D .skeleton files of one action, one file per camera. All-zero joints count as missing."""
    if not files:
        raise InputError("No .skeleton file was given; give at least one.")
    paths = [Path(f) for f in files]
    actions = {(m[1] + m[3]).upper() if (m := _NTU_NAME.search(p.name)) else p.stem for p in paths}
    if len(paths) > 1 and len(actions) > 1:
        raise InputError(
            f"The folder {paths[0].parent} holds {len(actions)} different actions ({', '.join(sorted(actions)[:3])}, "
            "...); give the files of one action, which differ in the camera (C001, C002, C003) only."
        )
    sensors = []
    for p in paths:
        m = _NTU_NAME.search(p.name)
        sensors.append(_ntu_rows(p, f"C{m[2]}" if m else text_of(p.stem)))
    filled = [s for s in sensors if s.times]
    notes = [f"{s.name}: nobody was seen, the camera is left out" for s in sensors if not s.times]
    title = actions.pop() if len(actions) == 1 else paths[0].stem
    return checked_recording(title, filled, str(paths[0].parent), {p.name: p for p in paths}, notes=notes)


def _ntu_rows(path: Path, name: str) -> StreamRows:
    rows = StreamRows(name, KINECT_V2)
    lines = enumerate((ln.strip() for ln in bounded_lines(path, "an NTU RGB+D .skeleton file")), start=1)
    ids: dict[str, int] = {}

    def read(what: str) -> tuple[int, list[str]]:
        number, text = next(lines, (0, ""))
        if not number:
            raise InputError(f"{path} ends where {what} should follow; the file is cut off, fetch it again.")
        return number, text.split()

    def count(what: str, most: int) -> int:
        number, cells = read(what)
        if len(cells) != 1 or not cells[0].isdecimal() or len(cells[0]) > 9 or int(cells[0]) > most:
            raise InputError(
                f"{path}: line {number} should be {what} (0 to {most}), as in an NTU RGB+D .skeleton file."
            )
        return int(cells[0])

    frames = count("the number of frames", _MAX_FRAMES)
    for frame in range(frames):
        bodies = count("the number of bodies", 64)
        for _ in range(bodies):
            number, head = read("a body")
            if len(head) != 10:
                raise InputError(f"{path}: line {number} has {len(head)} values, a body's line has 10.")
            joints = count("the number of joints", MAX_JOINTS)
            if joints != len(KINECT_V2):
                raise InputError(
                    f"{path}: a body in frame {frame} has {joints} joints, Kinect v2 has {len(KINECT_V2)}."
                )
            values = np.empty((joints, 12))
            for j in range(joints):
                number, cells = read("a joint")
                try:
                    if len(cells) != 12:
                        raise ValueError
                    values[j] = [float(c) for c in cells]
                except ValueError:
                    raise InputError(f"{path}: line {number} is no joint of 12 numbers.") from None
            xyz, state = values[:, :3], values[:, 11]
            state = np.where(np.isin(state, (0, 1, 2)), state, 0).astype(np.uint8)
            state[(xyz == 0).all(1)] = 0
            if state.any():
                rows.add(frame / NTU_RATE, ids.setdefault(head[0], len(ids)), xyz, state)
        if not bodies:
            rows.empty.append(frame / NTU_RATE)
    return rows

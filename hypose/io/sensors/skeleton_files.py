"""Skeletons of depth sensors: streams, the line protocol, and files of all known formats.

Hypose's own format is a folder with session.json, frames.csv, skeleton.csv and depth maps.

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

import json
import math
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.errors import InputError, refuse
from hypose.evidence.frame import FARTHEST_M, MISSING_MARK, SensorJoints, SensorReport, clean_joints
from hypose.geometry import Array, so3_exp
from hypose.io.files import (
    MAX_TEXT_BYTES,
    RecordingFolder,
    bounded_lines,
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
from hypose.json_text import parse_json

# ---- streams of sensors ----------------------------------------------------------------------------------------------
# One stream per sensor, and all streams at the same instants. Common faults of sensors are corrected here, with a note:
# rows out of order, clocks that jump back, people whose number changes.


MAX_SENSORS = 16
MAX_PEOPLE = 16
"""Largest number of people that one sensor may report at a time."""
MAX_JOINTS = 64
SKELETON_UNITS = {"m": 1.0, "mm": 0.001}
"""Metres per unit of positions."""
REORDER_S = 0.2
"""A time that is further back than this, s, means that the clock was set back; otherwise the row came late."""
_SLOWEST_S = 5.0  # largest usual step of a sensor, s: a larger one means that milliseconds were given as seconds


@dataclass(frozen=True)
class SensorStream:
    """Skeletons of one sensor at T instants, with at most P people at a time and J joints.

    times: (T,) s, increasing.
    positions: (T, P, J, 3) in the sensor's frame, m; NaN where missing.
    state: (T, P, J) 0 not tracked, 1 inferred, 2 tracked.
    person_ids: (T, P) the sensor's number of the person; -1 for none. A person keeps the column while it is seen.
    joint_names: J names.
    joint_depth: (T, P, J) depth map at the joint's pixel, m, 0 for a hole; None without depth maps.
    """

    name: str
    times: Array
    positions: Array
    state: NDArray[np.uint8]
    person_ids: NDArray[np.int64]
    joint_names: tuple[str, ...]
    joint_depth: Array | None = None

    @property
    def rate(self) -> float:
        """Number of instants per second, Hz, from the median time step; 30 for a single instant."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 30.0


@dataclass(frozen=True)
class SkeletonRecording:
    """The streams of all sensors of one recording.

    reference: name of the sensor whose frame the result uses.
    inputs: path of each file by a short name, for the provenance.
    notes: sentences about corrected faults.
    common_clock: all sensors' times are from one clock.
    """

    name: str
    streams: tuple[SensorStream, ...]
    reference: str
    inputs: Mapping[str, Path]
    notes: tuple[str, ...] = ()
    common_clock: bool = True

    def stream(self, name: str) -> SensorStream:
        """Get the stream of a sensor by name.

        Raises: InputError where there is no such sensor; it lists the names.
        """
        found = {s.name: s for s in self.streams}
        if name not in found:
            raise InputError(f"The recording {self.name} has no sensor {name!r}; its sensors are {', '.join(found)}.")
        return found[name]

    def reports(self) -> Iterator[SensorReport]:
        """Yield all reports one by one in order of time, as they would arrive live."""
        for time, k, n in sorted((float(t), k, n) for k, s in enumerate(self.streams) for n, t in enumerate(s.times)):
            s = self.streams[k]
            seen = np.flatnonzero(s.person_ids[n] >= 0)
            if not len(seen):
                yield empty_report(s.name, time)
            for p in seen:
                yield SensorReport(
                    s.name, time, int(s.person_ids[n, p]), s.joint_names, s.positions[n, p], s.state[n, p]
                )


# ---- from reports to streams -------------------------------------------------------------------------------


def empty_report(sensor: str, time: float, arrival: float | None = None) -> SensorReport:
    """Make the report of a sensor that sees no person."""
    return SensorReport(sensor, time, None, (), np.zeros((0, 3)), np.zeros(0, np.uint8), arrival)


def build_stream(reports: Sequence[SensorReport], where: str) -> tuple[SensorStream, tuple[str, ...]]:
    """Build a stream with increasing times from the reports of a sensor, at least one of them of a person.

    A body that is less than 0.2 s late is sorted in. A single time far ahead of its neighbours is removed. After a
    clock was set back, time continues with the sensor's usual step.

    reports: in the order of arrival, all with the same joints.
    where: the recording, for the error messages.
    Returns: the stream, and notes about corrected faults.
    Raises: InputError where there are too many people, or times or positions that cannot be correct.
    """
    bodies = [r for r in reports if r.person is not None]
    people_of = [r.person or 0 for r in bodies]
    name, joints = bodies[0].sensor, bodies[0].joint_names
    arrival = np.array([r.time for r in bodies])
    forward = np.diff(np.unique(arrival[np.isfinite(arrival)]))
    usual = float(np.median(forward)) if len(forward) else 0.0
    faults = {
        f"a time of the sensor {name} is not a number; times are seconds": not (
            np.isfinite([r.time for r in reports]).all()
        ),
        f"the frames of the sensor {name} lie {usual:g} s apart, and times are seconds; divide milliseconds by "
        "1000": usual > _SLOWEST_S,
        f"the sensor {name} numbers a person beyond 64 bits; the file is damaged": any(
            not -(2**63) <= person < 2**63 for person in people_of
        ),
    }
    refuse(f"{where}: ", faults)
    repaired, keep, clock_notes = repair_clock(arrival)
    notes = [f"{name}: {text}" for text in clock_notes]
    order = np.flatnonzero(keep)[np.argsort(repaired[keep], kind="stable")]
    empty = [] if clock_notes else [r.time for r in reports if r.person is None]
    instants, first = np.unique(np.concatenate([repaired[order], empty]), return_inverse=True)
    present: list[dict[int, int]] = [{} for _ in instants]
    for i, at in zip(order.tolist(), first[: len(order)].tolist(), strict=True):
        present[at][people_of[i]] = i
    if doubled := len(order) - sum(map(len, present)):
        notes.append(f"{name}: {doubled} bodies came twice for the same person and time; the last one counts")
    columns = _columns([list(p) for p in present])
    people = max((c + 1 for row in columns for c in row.values()), default=1)
    if people > MAX_PEOPLE:
        raise InputError(f"{where}: the sensor {name} reports {people} persons at once; at most {MAX_PEOPLE}.")
    t, j = len(instants), len(joints)
    positions = np.full((t, people, j, 3), np.nan)
    state = np.zeros((t, people, j), dtype=np.uint8)
    ids = np.full((t, people), -1, dtype=np.int64)
    mapped = np.zeros((t, people, j)) if any(r.joint_depth is not None for r in bodies) else None
    for n, (there, column) in enumerate(zip(present, columns, strict=True)):
        for person, i in there.items():
            c, body = column[person], bodies[i]
            positions[n, c], state[n, c], ids[n, c] = body.positions, body.state, person
            if mapped is not None:
                mapped[n, c] = body.joint_depth
    positions, state = clean_joints(positions, state, f"{where}, sensor {name}", joints)
    return SensorStream(name, instants, positions, state, ids, joints, mapped), tuple(notes)


def _columns(present: Sequence[Sequence[int]]) -> list[dict[int, int]]:
    """Assign people to columns at every instant: the same column while a person is seen, else the lowest free one.

    present: numbers of the people at each instant.
    Returns: column of each person by number, at each instant.
    """
    out: list[dict[int, int]] = []
    for people in present:
        now = {p: c for p, c in out[-1].items() if p in people} if out else {}
        for p in people:
            if p not in now:
                now[p] = next(c for c in range(len(now) + 1) if c not in now.values())
        out.append(now)
    return out


def repair_clock(times: ArrayLike) -> tuple[Array, NDArray[np.bool_], tuple[str, ...]]:
    """Correct faults in the times of a sensor: late rows, single wrong stamps and clocks that were set back.

    times: (T,) s, in the order of arrival.
    Returns: times (T,) on one clock, which rows to keep (T,), and notes.
    """
    t = np.array(times, dtype=np.float64)
    keep = np.ones(len(t), dtype=bool)
    notes: list[str] = []
    if len(t) < 2:
        return t, keep, ()
    forward = np.diff(t)
    usual = float(np.median(forward[forward > 0])) if (forward > 0).any() else 1 / 30
    # one time stamp far ahead of regular neighbours is a wrong stamp, not a changed clock
    ahead = np.zeros(len(t), dtype=bool)
    ahead[1:-1] = (t[1:-1] > t[2:] + REORDER_S) & (t[2:] >= t[:-2]) & (t[2:] - t[:-2] < 10 * usual + REORDER_S)
    keep &= ~ahead
    if ahead.any():
        notes.append(f"{int(ahead.sum())} rows with a time far ahead of their neighbours were left out")
    rows = np.flatnonzero(keep)
    shift, latest, jumps, late = 0.0, t[rows[0]], 0, 0
    for i in rows[1:].tolist():
        value = t[i] + shift
        if value < latest - REORDER_S:
            shift += latest + usual - value
            value = latest + usual
            jumps += 1
        late += value < latest
        t[i], latest = value, max(latest, value)
    if jumps:
        notes.append(
            f"the clock was set back {jumps} time(s); time goes on with the usual step of {usual * 1000:.0f} ms"
        )
    if late:
        notes.append(f"{late} rows came late and were sorted in")
    return t, keep, tuple(notes)


# ---- the same instants for all -------------------------------------------------------------------------------


def common_times(streams: Sequence[SensorStream], rate: float | None = None) -> Array:
    """Compute evenly spaced instants from the first sensor's start to the last sensor's end.

    streams: streams of all sensors, on one clock.
    rate: Hz; by default that of the first stream, rounded to a whole number when it is within 5 %.
    Returns: (N,) s.
    Raises: InputError where the rate is out of range or the span is too long.
    """
    if rate is None:
        rate = streams[0].rate
        rate = float(round(rate)) if abs(rate - round(rate)) < 0.05 * rate and round(rate) > 0 else rate
    if not 0.1 <= rate <= 1000:
        raise InputError(f"A rate of {rate:g} Hz is not possible; give 0.1 to 1000 with --rate.")
    start, stop = min(s.times[0] for s in streams), max(s.times[-1] for s in streams)
    count = int(np.floor((stop - start) * rate + 1e-6)) + 1
    if count > 10_000_000:
        raise InputError(
            f"The sensors' times span {(stop - start) / 3600:.1f} hours, too much for one recording; they seem to be "
            'on different clocks: say so with "clock": "own" in session.json.'
        )
    return start + np.arange(count) / rate


def resample(stream: SensorStream, times: ArrayLike) -> SensorStream:
    """Interpolate a stream linearly at other instants.

    Nothing is interpolated over a gap longer than 3.2 steps of the stream, or between samples of different people. A
    joint that only one of the two samples has is kept for half a step. The state is the lower of the two.

    times: (N,) s.
    Returns: stream with N instants.
    """
    at = np.asarray(times, dtype=np.float64)
    step = 1 / stream.rate
    after = np.searchsorted(stream.times, at, side="right")
    i, k = np.clip(after - 1, 0, None), np.clip(after, None, len(stream.times) - 1)
    before_first = after == 0
    span = stream.times[k] - stream.times[i]
    w = np.where(span > 0, (at - stream.times[i]) / np.where(span > 0, span, 1.0), 0.0)
    a, b = stream.positions[i], stream.positions[k]
    near_a = np.abs(at - stream.times[i]) <= step * 0.5 + 1e-9
    near_b = np.abs(at - stream.times[k]) <= step * 0.5 + 1e-9
    exact = np.abs(at - stream.times[i]) <= 1e-9
    same = (stream.person_ids[i] == stream.person_ids[k]) & ((span > 0) & (span <= 3.2 * step))[:, None]
    between = a + w[:, None, None, None] * (b - a)
    both = same[..., None] & np.isfinite(between).all(-1)
    # alone: the nearer sample, for half a step
    use_a = (near_a & (w < 0.5) & ~before_first | exact)[:, None]
    use_b = (near_b & ((w >= 0.5) | before_first))[:, None]
    chosen = [both, use_a[..., None], use_b[..., None]]
    positions = np.select([c[..., None] for c in chosen], [between, a, b], np.nan)
    lower = np.minimum(stream.state[i], stream.state[k])
    state = np.select(chosen, [lower, stream.state[i], stream.state[k]], 0).astype(np.uint8)
    ids = np.select([same | use_a, use_b], [stream.person_ids[i], stream.person_ids[k]], -1)
    missing, depth = ~np.isfinite(positions).all(-1), None
    state[missing] = 0
    if stream.joint_depth is not None:
        # depth maps are not interpolated: at an edge, that would create a surface that does not exist
        depth = np.where(missing, 0.0, stream.joint_depth[np.where(w < 0.5, i, k)])
    return SensorStream(stream.name, at, positions, state, ids, stream.joint_names, depth)


def join_observations(
    synced: Sequence[SensorStream], times: ArrayLike, columns: Sequence[NDArray[np.int64]]
) -> list[SensorJoints]:
    """Combine one person's skeletons of all sensors at every instant.

    synced: streams at the same instants.
    times: (N,) s.
    columns: per sensor (N,) column of the person; -1 where not seen.
    Returns: N observations of all sensors.
    """
    at = np.asarray(times, dtype=np.float64)
    rows = np.arange(len(at))
    own = [np.maximum(c, 0) for c in columns]
    visible = [(c >= 0) & (s.state[rows, k] > 0).any(1) for s, c, k in zip(synced, columns, own, strict=True)]

    def stacked(values: Sequence[np.ndarray], hidden: float) -> np.ndarray:
        """Stack arrays (T, ...) of the sensors; `hidden` where a sensor does not see the person."""
        shown = (v.reshape(-1, *[1] * (a.ndim - 1)) for v, a in zip(visible, values, strict=True))
        return np.stack([np.where(v, a, hidden) for v, a in zip(shown, values, strict=True)], 1)

    p = stacked([s.positions[rows, k] for s, k in zip(synced, own, strict=True)], np.nan)
    q = stacked([s.state[rows, k] for s, k in zip(synced, own, strict=True)], 0).astype(np.uint8)
    t = stacked([at] * len(synced), np.nan)
    known = [s.joint_depth[rows, k] for s, k in zip(synced, own, strict=True) if s.joint_depth is not None]
    d = stacked(known, 0.0) if len(known) == len(synced) else [None] * len(at)
    names, joints = tuple(s.name for s in synced), synced[0].joint_names
    return [SensorJoints(p[n], q[n], t[n], joints, names, joint_depth=d[n]) for n in range(len(at))]


def shifted(stream: SensorStream, seconds: float) -> SensorStream:
    """Copy a stream with `seconds` added to all its times."""
    return replace(stream, times=stream.times + seconds)


def checked_recording(
    name: str,
    reports: Mapping[str, Sequence[SensorReport]],
    where: str,
    inputs: Mapping[str, Path],
    *,
    reference: str | None = None,
    common_clock: bool = True,
) -> SkeletonRecording:
    """Build a recording from the reports of its sensors; sensors that saw no person are left out, with a note.

    reports: reports of each sensor by its name, as for `build_stream`.
    where: the recording, for the error messages.
    inputs: path of each file by a short name.
    reference: sensor whose frame the result uses; the first by default.
    common_clock: all sensors' times are from one clock.
    Raises: InputError where there is no skeleton, there are too many sensors, or the reference has no skeleton.
    """
    seen = [sensor for sensor, of_sensor in reports.items() if any(r.person is not None for r in of_sensor)]
    faults = {
        f" has {len(reports)} sensors, at most {MAX_SENSORS} are fused; split the recording": len(reports)
        > MAX_SENSORS,
        " holds no skeleton; give a recording in which a person was seen": not seen,
    }
    refuse(where, faults)
    built = [build_stream(reports[sensor], where) for sensor in seen]
    if reference not in (None, *seen):
        raise InputError(
            f"{where} names the reference sensor {reference!r}, which has no skeleton; choose one of {', '.join(seen)}."
        )
    notes = [f"{sensor}: no person was seen, the sensor is left out" for sensor in reports if sensor not in seen]
    notes += [note for _, of_stream in built for note in of_stream]
    return SkeletonRecording(
        name, tuple(s for s, _ in built), reference or seen[0], dict(inputs), tuple(notes), common_clock
    )


# ---- skeleton lines ------------------------------------------------------------------------------------------------
# The line protocol for skeletons: one JSON object per line, recorded (.jsonl) or live (docs/live.md).
#
#     {"sensor": "left", "time": 12.345, "person": 0, "joints": {"head": [0.1, 0.6, 2.4], "neck": null, ...}}
#
# sensor: 1-32 of A-Z a-z 0-9 _ . -; time: s on the sensor's own clock; person: the sensor's number of the person (0
# when left out); joints: every joint of the sensor's set by name, [x, y, z] or [x, y, z, state] in metres in the
# sensor's frame (state 0 not tracked, 1 inferred, 2 tracked), null = missing. "joints": null says that the sensor
# sees no person. "unit": "mm" divides by 1000. "token" and "received" (s on the host's clock) are for the live server
# and for what it records.


MAX_SKELETON_LINE = 16384
"""Largest size of one line, bytes; 32 joints with all digits take 3 KiB."""
_KNOWN = frozenset({"sensor", "time", "person", "joints", "unit", "token", "received", "v"})
_SENSOR = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_JOINT = re.compile(r"[A-Za-z0-9_ .-]{1,48}")
_NUMBERS = frozenset({float, int})
_MISSING = [math.nan, math.nan, math.nan, 0]


def parse_line(data: bytes | str) -> tuple[SensorReport, str]:
    """Parse one line of the skeleton protocol.

    Returns: the report, and the token in the line, "" without one.
    Raises: InputError where the line is not valid.
    Why: the limit of 16 KiB per line bounds time and memory.
    """
    if len(data) > MAX_SKELETON_LINE:
        raise InputError(
            f"the line has {len(data)} bytes, at most {MAX_SKELETON_LINE} are read; send one body per line"
        )
    try:
        value = parse_json(data)
    except (ValueError, RecursionError):  # bad UTF-8 is a ValueError as well
        raise InputError("the line is no JSON; send one JSON object per line, in UTF-8") from None
    if not isinstance(value, dict):
        raise InputError('the line is no JSON object; it must look like {"sensor": ..., "time": ..., "joints": {...}}')
    if unknown := value.keys() - _KNOWN:
        raise InputError(f"there is no field {min(unknown)[:40]!r}; the fields are {', '.join(sorted(_KNOWN))}")
    sensor, token, unit = value.get("sensor"), value.get("token", ""), value.get("unit", "m")
    joints, person = value.get("joints", ...), value.get("person", 0)
    faults = {
        "sensor must be a name of 1 to 32 letters, digits, _ . -": not (
            isinstance(sensor, str) and _SENSOR.fullmatch(sensor)
        ),
        "token must be text": not isinstance(token, str),
        "unit must be m or mm": not isinstance(unit, str) or unit not in SKELETON_UNITS,
        "person must be a whole number from 0": not (
            isinstance(person, int) and not isinstance(person, bool) and 0 <= person < 2**63
        ),
        f"joints must be an object with 1 to {MAX_JOINTS} joints, or null when no person is seen": not (
            joints is None or (isinstance(joints, dict) and 1 <= len(joints) <= MAX_JOINTS)
        ),
    }
    refuse("", faults)
    time = _number(value.get("time"), "time")
    received = None if value.get("received") is None else _number(value["received"], "received")
    if not isinstance(joints, dict):  # null: no person is seen
        return empty_report(str(sensor), time, received), token
    names = tuple(joints)
    _check_names(names)
    return SensorReport(str(sensor), time, person, names, *_positions(joints, SKELETON_UNITS[unit]), received), token


@lru_cache(maxsize=64)
def _check_names(names: tuple[str, ...]) -> None:
    """Check the names of joints; cached, because a sensor sends the same names in every line."""
    for name in names:
        if not _JOINT.fullmatch(name):
            raise InputError("a joint's name must be 1 to 48 letters, digits, blanks, _ . -")


def _positions(joints: Mapping[str, Any], scale: float) -> tuple[Array, NDArray[np.uint8]]:
    """Convert the cells of all joints at once to positions (J, 3), m, and states (J,).

    joints: cells of each joint by name, as the protocol has them.
    scale: metres per unit.
    Raises: InputError where a cell is not valid.
    Why: a line of 15 joints is parsed 540 times a second live, and cell by cell it takes three times as long.
    """
    rows = [_MISSING if c is None else [*c, 2] if type(c) is list and len(c) == 3 else c for c in joints.values()]
    flat = list(chain.from_iterable(r if type(r) is list and len(r) == 4 else ("",) for r in rows))
    if not _NUMBERS.issuperset(map(type, flat)):
        raise InputError("each joint must be [x, y, z], [x, y, z, state] or null, and hold numbers")
    try:
        table = np.array(flat, dtype=np.float64).reshape(-1, 4)
    except OverflowError:
        raise InputError("a joint holds an integer that is too large") from None
    positions, level = table[:, :3] * scale, table[:, 3]
    if not ((level == 0) | (level == 1) | (level == 2)).all():
        raise InputError("the state of a joint must be 0, 1 or 2")
    missing = (level == 0) | (table[:, :3] <= MISSING_MARK).any(1) | np.isnan(positions).any(1)
    far = ~missing & (np.abs(positions) > FARTHEST_M).any(1)
    if far.any():
        name = list(joints)[int(far.argmax())]
        raise InputError(
            f'the joint {name} lies beyond {FARTHEST_M:.0f} m; say "unit": "mm" if the sensor reports millimetres'
        )
    positions[missing] = np.nan
    return positions, np.where(missing, 0, level).astype(np.uint8)


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise InputError(f"{name} must be a number of seconds")
    return float(value)


def format_line(line: SensorReport) -> str:
    """Format a report as a line of the skeleton protocol, in steps of 0.01 mm, without its line end."""
    value: dict[str, Any] = {"sensor": line.sensor, "time": round(line.time, 6)}
    if line.arrival is not None:
        value["received"] = round(line.arrival, 6)
    if line.person is None:
        value["joints"] = None
    else:
        value["person"] = line.person
        value["joints"] = {
            n: [*(round(x, 5) for x in p), s] if s and not any(map(math.isnan, p)) else None
            for n, p, s in zip(line.joint_names, line.positions.tolist(), line.state.tolist(), strict=True)
        }
    return json.dumps(value, separators=(",", ":"))


def read_lines(source: Source) -> SkeletonRecording:
    """Read a file of protocol lines (.jsonl or .jsonl.gz), in the order of arrival.

    Each line has its sensor's own time. Where the time ranges of sensors do not overlap, their clocks are separate
    (`common_clock` False).

    Raises: InputError where a line is not valid.
    """
    p, sensors = source.path, dict[str, list[SensorReport]]()
    for number, text in enumerate(bounded_lines(p, "skeletons as JSON lines", line_limit=MAX_SKELETON_LINE), start=1):
        if not text.strip():
            continue
        try:
            line, _ = parse_line(text)
        except InputError as error:
            raise InputError(f"{p}: line {number}: {str(error).rstrip('.')}.") from None
        if line.sensor not in sensors and line.person is None:
            continue  # no person yet: its joints are not known
        of_sensor = sensors.setdefault(line.sensor, [line])
        names = of_sensor[0].joint_names
        if line.person is not None and line.joint_names != names:
            if set(line.joint_names) != set(names):
                raise InputError(
                    f"{p}: line {number}: the sensor {line.sensor} reports {len(line.joint_names)} joints, before it "
                    f"reported {len(names)} (others); name every joint of its set in each line."
                )
            order = [line.joint_names.index(n) for n in names]
            line = replace(line, joint_names=names, positions=line.positions[order], state=line.state[order])
        if line is not of_sensor[0]:
            of_sensor.append(line)
    title = p.name.removesuffix(".gz").rsplit(".", 1)[0]
    times = [[r.time for r in of_sensor] for of_sensor in sensors.values()]
    spans = sorted((min(t), max(t)) for t in times)
    ends = accumulate((end for _, end in spans), max)
    together = all(begin <= end for (begin, _), end in zip(spans[1:], ends, strict=False))
    return checked_recording(title, sensors, str(p), {p.name: p}, common_clock=together)


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
        sensors = {s.name: s for s in (_described(session, x) for x in value["sensors"])}
        twice = len(sensors) < len(value["sensors"])
    if stated != (_FORMAT, 1) or clock not in ("common", "own") or twice:
        raise InputError(
            f'{session} must say "format": "{_FORMAT}", "version": 1, "clock": "common" or "own", and name each sensor '
            "once; correct it."
        )
    reports: dict[str, list[SensorReport]] = {name: [] for name in sensors}
    times, maps = dict[tuple[str, int], float](), dict[tuple[str, int], str]()  # by sensor and frame
    for where, cells in _rows_of(frames, _FRAMES, sensors):
        with numbers_of(where):
            at, time = (cells[0], int(cells[1])), float(cells[2])
        if at in times:
            raise InputError(f"{where}: the frame {at[1]} of sensor {cells[0]} is there twice.")
        times[at] = time
        if "".join(cells[3:4]):
            maps[at] = cells[3]
    bodies: dict[tuple[str, int], dict[int, tuple[Array, NDArray[np.uint8]]]] = {at: {} for at in times}
    for where, cells in _rows_of(skeleton, _SKELETON, sensors):
        _add_joint(where, cells, sensors[cells[0]].joints, bodies)
    with_maps = {name for name, _ in maps}
    for at, people in sorted(bodies.items()):  # the order of frame numbers is that of arrival
        sensor, image = sensors[at[0]], None
        lens = sensor.lens if at[0] in with_maps else None
        if people and lens is not None and at in maps:
            if not (folder / maps[at]).resolve().is_relative_to(folder.resolve()):
                raise InputError(f"{frames} names the depth map {maps[at]!r}, which lies outside the folder.")
            image = read_depth_png(folder / maps[at])
        if not people:
            reports[at[0]].append(empty_report(at[0], times[at]))
        for person, (xyz, state) in people.items():
            p = np.where(xyz > -9000, xyz * sensor.scale, xyz)
            depth = None if lens is None else np.zeros(len(p))
            depth = depth if lens is None or image is None else sample_depth(image, p, lens, sensor.y_up)
            report = SensorReport(at[0], times[at], person, sensor.joints, p, state, joint_depth=depth)
            reports[at[0]].append(report)
    return checked_recording(
        str(value.get("name", folder.resolve().name)),
        reports,
        str(folder),
        {p.name: p for p in (session, frames, skeleton)},
        reference=value.get("reference"),
        common_clock=clock == "common",
    )


@dataclass(frozen=True)
class _Sensor:
    """A sensor of a recording folder.

    scale: metres per unit of positions.
    lens: fx, fy, cx, cy of its depth maps, px; None where it has none.
    y_up: whether y of the positions points up.
    """

    name: str
    joints: tuple[str, ...]
    scale: float
    lens: tuple[float, float, float, float] | None
    y_up: bool


def _described(path: Path, value: Mapping[str, Any]) -> _Sensor:
    """Convert the entry of a sensor in session.json; InputError, which names the file, where it is not valid."""
    name, joints, unit, depth = value["name"], value["joints"], value.get("unit", "m"), value.get("depth")
    named = all(isinstance(text, str) and 1 <= len(text) <= 64 for text in [name, *joints])
    if not named or len(set(joints)) < len(joints) or not 1 <= len(joints) <= MAX_JOINTS or unit not in SKELETON_UNITS:
        raise InputError(
            f"{path}: each sensor needs a name, a list of 1 to {MAX_JOINTS} different names of joints, and the unit m "
            "or mm; correct it."
        )
    if depth is None:
        return _Sensor(name, tuple(joints), SKELETON_UNITS[unit], None, False)
    fx, fy, cx, cy = map(float, depth["intrinsics"])
    if not (0 < fx < 1e5 and 0 < fy < 1e5 and abs(cx) < 1e5 and abs(cy) < 1e5):
        raise InputError(f"{path}: depth of sensor {name} needs intrinsics [fx, fy, cx, cy] in pixels.")
    return _Sensor(name, tuple(joints), SKELETON_UNITS[unit], (fx, fy, cx, cy), depth.get("y_up", False) is True)


def _add_joint(
    where: str,
    cells: Sequence[str],
    joints: Sequence[str],
    bodies: Mapping[tuple[str, int], dict[int, tuple[Array, NDArray[np.uint8]]]],
) -> None:
    """Add a row of skeleton.csv to the positions (J, 3) and states (J,) of its person.

    where: file and line.
    joints: names of the sensor's J joints.
    bodies: those of each person by the person's number, in every frame by sensor and number.
    """
    with numbers_of(where):
        frame, person, state = int(cells[1]), int(cells[2] or 0), int(cells[7] or 2)
        xyz = [float(c or "nan") for c in cells[4:7]]
    if cells[3] not in joints or (cells[0], frame) not in bodies:
        raise InputError(f"{where}: the joint {cells[3]!r} or the frame {frame} is not in session.json or frames.csv.")
    if not 0 <= person < 2**63 or state not in (0, 1, 2) or any(map(math.isinf, xyz)):
        raise InputError(
            f"{where}: person must be a whole number from 0, the state 0, 1 or 2, and coordinates must be finite; "
            f"got {person}, {state} and {xyz}."
        )
    nothing = np.full((len(joints), 3), np.nan), np.zeros(len(joints), dtype=np.uint8)
    positions, states = bodies[cells[0], frame].setdefault(person, nothing)
    joint = joints.index(cells[3])
    positions[joint], states[joint] = xyz, state


def _rows_of(path: Path, header: Sequence[str], sensors: Container[str]) -> Iterator[tuple[str, list[str]]]:
    """Read the rows of a CSV file after checking its header and their sensor: file and line as text, and the cells."""
    names, rows = csv_rows(path, f"{path.name} of a skeleton recording")
    if names[: len(header)] != list(header):
        raise InputError(f"{path}: the first line must be {','.join(header)}.")
    for number, cells in rows:
        if cells[0] not in sensors:
            raise InputError(f"{path}: line {number}: the sensor {cells[0]!r} is not in session.json.")
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

    def add(self, report: SensorReport) -> None:
        """Write one body. Bodies of the same sensor frame come one after another with equal times.

        Raises: InputError where the folder cannot be written.
        """
        sensor = report.sensor
        with self._folder.writing():
            if sensor not in self._joints and report.person is not None:
                self._joints[sensor] = report.joint_names
                sensors = [{"name": n, "joints": list(j)} for n, j in self._joints.items()]
                about = {"format": _FORMAT, "version": 1, "name": self._name, "clock": self._clock}
                write_text(self.folder / "session.json", to_json(about | {"sensors": sensors}))
            number, last = self._frame.get(sensor, (-1, math.nan))
            if report.time != last:
                number += 1
                self._frame[sensor] = (number, report.time)
                self._frames.write(f"{sensor},{number},{report.time:.6f}\n")
            rows = zip(report.joint_names, report.positions.tolist(), report.state.tolist(), strict=True)
            for joint, (x, y, z), state in rows:
                if state:
                    self._skeleton.write(f"{sensor},{number},{report.person},{joint},{x:.5f},{y:.5f},{z:.5f},{state}\n")

    def flush(self) -> None:
        """Flush the files to the system.

        Raises: InputError where they cannot be written or were removed.
        """
        self._folder.flush()

    def close(self) -> None:
        """Close the files, and remove the frames of sensors that saw no person, which session.json does not list.

        Raises: InputError where they could not be written or were removed.
        """
        self._folder.close()
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
    found: dict[str, list[SensorReport]] = {}
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
        tracked = np.full(len(joints), 2, np.uint8)
        found.setdefault(name, []).append(SensorReport(name, time, person, joints, values, tracked))
    # seconds since the year 1 would lose microseconds in later arithmetic
    zero = min((r.time for of_sensor in found.values() for r in of_sensor), default=0.0)
    sensors = {name: [replace(r, time=r.time - zero) for r in of_sensor] for name, of_sensor in found.items()}
    title = path.name.removesuffix(".gz").removesuffix(".csv")
    return checked_recording(title, sensors, str(path), {path.name: path})


def read_azure(source: Source) -> SkeletonRecording:
    """Read the .json files of Azure Kinect's offline_processor, one per sensor, each with its own clock.

    Positions are in millimetres. confidence_level (0 none, 1 low, 2 medium, 3 high) becomes the joint's state; without
    it every joint counts as tracked.

    Raises: InputError where a file is not of this format.
    """
    paths, sensors = source.files(".json"), dict[str, list[SensorReport]]()
    for path in paths:
        with numbers_of(str(path)):
            value = _json(path)
            joints, frames = tuple(map(str, value["joint_names"])), list(value["frames"])
        name = text_of(path.stem)
        of_sensor = sensors.setdefault(name, [])
        for i, frame in enumerate(frames):
            with numbers_of(f"{path}, frame {i}"):
                time = float(frame["timestamp_usec"]) * 1e-6
                for body in frame["bodies"]:
                    xyz = np.array(body["joint_positions"], dtype=np.float64).reshape(len(joints), 3) * 1e-3
                    state = np.array(body.get("confidence_level", [2] * len(xyz)), dtype=np.uint8).reshape(len(xyz))
                    of_sensor.append(SensorReport(name, time, int(body["body_id"]), joints, xyz, np.minimum(state, 2)))
                if not frame["bodies"]:
                    of_sensor.append(empty_report(name, time))
    inputs = {p.name: p for p in paths}
    return checked_recording(next(iter(sensors)), sensors, str(paths[0]), inputs, common_clock=len(paths) == 1)


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

"""The line protocol for skeletons: one JSON object per line, recorded (.jsonl) or live (docs/live.md).

    {"sensor": "left", "time": 12.345, "person": 0, "joints": {"head": [0.1, 0.6, 2.4], "neck": null, ...}}

sensor: 1-32 of A-Z a-z 0-9 _ . -; time: s on the sensor's own clock; person: the sensor's number of the person (0
when left out); joints: every joint of the sensor's set by name, [x, y, z] or [x, y, z, state] in metres in the sensor's
frame (state 0 not tracked, 1 inferred, 2 tracked), null = missing. "joints": null says that the sensor sees nobody.
"unit": "mm" divides by 1000. "token" and "received" (s on the host's clock) are for the live server and for what it
records.
"""

from __future__ import annotations

import json
import math
import re
from functools import lru_cache
from itertools import accumulate, chain
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.evidence.frame import FARTHEST_M, MISSING_MARK, SensorReport
from hypose.geometry import Array
from hypose.io.files import bounded_lines
from hypose.io.sensors.skeleton_streams import MAX_JOINTS, MAX_SENSORS, SkeletonRecording, StreamRows, checked_recording
from hypose.json_text import parse_json

MAX_SKELETON_LINE = 16384
"""Bytes of one line; 32 joints with all digits take 3 KiB."""
_KNOWN = frozenset({"sensor", "time", "person", "joints", "unit", "token", "received", "v"})
_SENSOR = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_JOINT = re.compile(r"[A-Za-z0-9_ .-]{1,48}")
_SCALE = {"m": 1.0, "mm": 0.001}
_NUMBERS = frozenset({float, int})


def parse_line(data: bytes | str) -> tuple[SensorReport, str]:
    """One line of the protocol, and the token in it (""); an InputError says what is wrong with it. Time and memory are
    bounded by the line's 16 KiB."""
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
        _bad(f"there is no field {min(unknown)[:40]!r}; the fields are {', '.join(sorted(_KNOWN))}")
    sensor, token, joints = value.get("sensor"), value.get("token", ""), value.get("joints", ...)
    if not isinstance(sensor, str) or not _SENSOR.fullmatch(sensor):
        _bad("sensor must be a name of 1 to 32 letters, digits, _ . -")
    if not isinstance(token, str):
        _bad("token must be text")
    unit = value.get("unit", "m")
    if not isinstance(unit, str) or unit not in _SCALE:
        _bad("unit must be m or mm")
    time = _number(value.get("time"), "time")
    received = None if value.get("received") is None else _number(value["received"], "received")
    person = value.get("person", 0)
    if isinstance(person, bool) or not isinstance(person, int) or not 0 <= person < 2**63:
        _bad("person must be a whole number from 0")
    if joints is None:
        nobody = np.zeros((0, 3))
        return SensorReport(sensor, time, None, (), nobody, np.zeros(0, dtype=np.uint8), received), token
    if not isinstance(joints, dict) or not 1 <= len(joints) <= MAX_JOINTS:
        _bad(f"joints must be an object with 1 to {MAX_JOINTS} joints, or null when nobody is seen")
    names, scale = tuple(joints), _SCALE[unit]
    _check_names(names)
    table = _whole(joints, scale)
    if table is not None:
        return SensorReport(sensor, time, person, names, *table, received), token
    positions, state = np.full((len(joints), 3), np.nan), np.zeros(len(joints), dtype=np.uint8)
    for j, (name, cell) in enumerate(joints.items()):
        if cell is not None:
            _joint(cell, name, scale, positions, state, j)
    return SensorReport(sensor, time, person, names, positions, state, received), token


@lru_cache(maxsize=64)
def _check_names(names: tuple[str, ...]) -> None:
    """A sensor sends the same names in every line."""
    for name in names:
        if not _JOINT.fullmatch(name):
            _bad("a joint's name must be 1 to 48 letters, digits, blanks, _ . -")


def _whole(joints: dict[str, Any], scale: float) -> tuple[Array, NDArray[np.uint8]] | None:
    """The usual line at once: every joint tracked or inferred, four plain numbers each. None: anything else, which is
    looked at cell by cell. It takes a third of the time, and live a line of 15 joints is parsed 540 times a second."""
    cells = list(joints.values())
    if not all(type(c) is list and len(c) == 4 for c in cells):
        return None
    flat = list(chain.from_iterable(cells))
    if not _NUMBERS.issuperset(map(type, flat)):
        return None
    try:
        table = np.array(flat, dtype=np.float64).reshape(-1, 4)
    except OverflowError:  # an integer too large for a float
        return None
    level, positions = table[:, 3], table[:, :3] * scale
    # False for NaN as well
    if not (np.abs(positions).max() <= FARTHEST_M and ((level == 1) | (level == 2)).all()):
        return None
    return positions, level.astype(np.uint8)


def _joint(cell: Any, name: str, scale: float, positions: Array, state: NDArray[np.uint8], j: int) -> None:
    if not isinstance(cell, list) or len(cell) not in (3, 4):
        _bad(f"the joint {name} must be [x, y, z], [x, y, z, state] or null")
    for x in cell:
        if type(x) is not float and type(x) is not int:
            _bad(f"the joint {name} holds something that is not a number")
    x, y, z = cell[:3]
    level = cell[3] if len(cell) == 4 else 2
    if level not in (0, 1, 2):
        _bad(f"the state of the joint {name} must be 0, 1 or 2")
    if level == 0 or min(cell[:3]) <= MISSING_MARK or x != x or y != y or z != z:
        return
    if max(abs(x), abs(y), abs(z)) > FARTHEST_M / scale:  # not the product: an integer may be too large for a float
        _bad(f'the joint {name} lies beyond {FARTHEST_M:.0f} m; say "unit": "mm" if the sensor reports millimetres')
    positions[j] = x * scale, y * scale, z * scale
    state[j] = level


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        _bad(f"{name} must be a number of seconds")
    return float(value)


def _bad(reason: str) -> NoReturn:
    raise InputError(reason)


def format_line(line: SensorReport, token: str = "", digits: int = 5) -> str:
    """The protocol's line without its line end (positions to 0.01 mm by default)."""
    value: dict[str, Any] = {"sensor": line.sensor, "time": round(line.time, 6)}
    if token:
        value["token"] = token
    if line.arrival is not None:
        value["received"] = round(line.arrival, 6)
    if line.person is None:
        value["joints"] = None
    else:
        value["person"] = line.person
        value["joints"] = {
            n: [*(round(x, digits) for x in p), s] if s and not any(map(math.isnan, p)) else None
            for n, p, s in zip(line.joint_names, line.positions.tolist(), line.state.tolist(), strict=True)
        }
    return json.dumps(value, separators=(",", ":"))


def read_lines(path: str | Path) -> SkeletonRecording:
    """Read a file of such lines (.jsonl or .jsonl.gz), in the order in which they arrived.

    Lines carry their sensor's own time, of any origin: sensors that by it were never on together have clocks of their
    own (`common_clock` False).
    """
    p = Path(path)
    sensors: dict[str, StreamRows] = {}
    names: dict[str, tuple[str, ...]] = {}
    for number, text in enumerate(bounded_lines(p, "skeletons as JSON lines", line_limit=MAX_SKELETON_LINE), start=1):
        if not text.strip():
            continue
        try:
            line, _ = parse_line(text)
        except InputError as error:
            raise InputError(f"{p}: line {number}: {error}.") from None
        rows = sensors.get(line.sensor)
        if rows is None:
            if line.person is None:
                continue  # nobody yet: its joints are not known
            if len(sensors) >= MAX_SENSORS:
                raise InputError(f"{p}: line {number}: more than {MAX_SENSORS} sensors; split the recording.")
            rows = sensors[line.sensor] = StreamRows(line.sensor, line.joint_names)
            names[line.sensor] = line.joint_names
        if line.person is None:
            rows.empty.append(line.time)
            continue
        positions, state = line.positions, line.state
        if line.joint_names != rows.joint_names:
            if set(line.joint_names) != set(rows.joint_names):
                raise InputError(
                    f"{p}: line {number}: the sensor {line.sensor} reports {len(line.joint_names)} joints, before it "
                    f"reported {len(rows.joint_names)} (others); name every joint of its set in each line."
                )
            order = [line.joint_names.index(n) for n in rows.joint_names]
            positions, state = positions[order], state[order]
        rows.add(line.time, line.person, positions, state)
    title = p.name.removesuffix(".gz").rsplit(".", 1)[0]
    spans = sorted((min(t), max(t)) for rows in sensors.values() if (t := [*rows.times, *rows.empty]))
    ends = accumulate((end for _, end in spans), max)
    together = all(begin <= end for (begin, _), end in zip(spans[1:], ends, strict=False))
    return checked_recording(title, list(sensors.values()), str(p), {p.name: p}, common_clock=together)

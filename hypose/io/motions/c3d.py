"""C3D marker files: written with ezc3d as 32-bit floats in millimetres, read with a bounded reader of hypose.

Axes are those of the world, z up; the parameters X_SCREEN = +X and Y_SCREEN = +Z say so.
Residuals follow the C3D manual: -1 for not seen, 0 for computed and not measured (here: lost or predicted frames),
    positive for measured (here: the standard deviation in whole millimetres, at least 1).
Why: ezc3d 1.7 accepts truncated files without a warning and allocates what a damaged header asks for. The reader here
    compares every size with the file first.
Source: the C3D file format, user guide.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.file_names import utf8_path
from hypose.io.files import atomic_path, open_file, unreadable
from hypose.io.motions.marker_files import Markers, metres_per_unit

_KIND = "a C3D file"
_BLOCK = 512
_MAX_BYTES = 512 * 2**20
_MOST = 65_535  # the header counts frames in 16 bits


def write_c3d(
    path: str | Path,
    names: Sequence[str],
    points: ArrayLike,
    frame_rate: float,
    residuals_mm: ArrayLike | None = None,
    events: Sequence[tuple[float, str, str]] = (),
    subjects: Sequence[str] = (),
) -> None:
    """Write points as a C3D file of floats in mm.

    names: M names; more than 255 continue in the parameters LABELS2, LABELS3 and so on.
    points: (T, M, 3) world, m; NaN points get residual -1. T is at most 65535, the format's limit.
    frame_rate: Hz.
    residuals_mm: (T, M) 0 where a point was computed and not measured, else its standard deviation; the format keeps
        whole millimetres from 1 to 255, and NaN counts as 1.
    events: seconds after the first frame, context such as Left, label such as Foot Strike; at most 255, all of the
        first subject.
    subjects: names of the people in the file. With several people, names of points begin with SUBJECT and a colon, as
        in files of Vicon.
    Raises: InputError where there are too many frames or the file cannot be written.
    """
    p = np.asarray(points, dtype=np.float64)
    t, m = p.shape[:2]
    if t > _MOST:
        raise InputError(f"{path}: C3D holds at most {_MOST} frames, these are {t}; write TRC.")
    residuals = np.ones((t, m)) if residuals_mm is None else np.array(residuals_mm, dtype=np.float64)
    positive = np.clip(np.ceil(np.where(np.isnan(residuals), 1, residuals)), 1, 255)
    residuals = np.where(residuals == 0, 0.0, positive)
    residuals[np.isnan(p).any(-1)] = -1
    import ezc3d  # 0.2 s to load: only when a C3D is written

    # ezc3d is a compiled module without types
    file: Any = ezc3d.c3d()
    for key, value in {"RATE": [float(frame_rate)], "LABELS": tuple(names), "UNITS": ("mm",)}.items():
        file["parameters"]["POINT"][key]["value"] = value
    file.add_parameter("POINT", "X_SCREEN", ("+X",))
    file.add_parameter("POINT", "Y_SCREEN", ("+Z",))
    # both groups as Vicon writes them
    several = len(subjects) > 1
    if subjects:
        about: dict[str, Any] = {"USED": [len(subjects)], "IS_STATIC": [0], "USES_PREFIXES": [int(several)]}
        about |= {"NAMES": list(subjects), "LABEL_PREFIXES": [f"{s}:" if several else "" for s in subjects]}
        _add_group(file, "SUBJECTS", about)
    if events := events[:255]:
        times, contexts, labels = zip(*events, strict=True)
        about = {"USED": [len(events)], "CONTEXTS": list(contexts), "LABELS": list(labels)}
        about |= {"SUBJECTS": [subjects[0] if subjects else ""] * len(events)}
        about |= {"ICON_IDS": [1 if label == "Foot Strike" else 2 for label in labels]}
        about |= {"TIMES": np.array([[time // 60 for time in times], [time % 60 for time in times]])}
        _add_group(file, "EVENT", about)
    data = np.ones((4, m, t))
    data[:3] = p.transpose(2, 1, 0) * 1000
    file["data"]["points"] = data
    file["data"]["meta_points"]["residuals"] = residuals.T[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, m, t), dtype=bool)
    with atomic_path(path) as temporary:
        with utf8_path(temporary) as name:
            file.write(name)


def _add_group(file: Any, group: str, about: Mapping[str, Any]) -> None:
    """Add the parameters `about` (values by name) to a group of a file of ezc3d."""
    for name, value in about.items():
        file.add_parameter(group, name, value)


def read_c3d(path: str | Path) -> Markers:
    """Read the points of a C3D file of integers or floats, in the byte order of Intel, DEC or MIPS.

    Labels of LABELS, LABELS2 and so on are joined, and a point without a label is named point_<number>. Analog channels
    are skipped.

    Returns: points in metres, in the axes of the file; NaN where the residual is negative.
    Raises: InputError where the file is not C3D, damaged, truncated or without points.
    """
    try:
        with open_file(path, _KIND, _MAX_BYTES) as file:
            raw, layout, parameters, order = _read(file, os.fstat(file.fileno()).st_size, path)
    except OSError as error:
        raise unreadable(path, error) from None
    points = _points(raw, layout, order)
    names = _names(parameters, layout.points)
    unit = _first(parameters.get("POINT:UNITS"), "mm") or "mm"
    return Markers(names, points * metres_per_unit(unit, str(path)), layout.rate, unit)


def _read(file: BinaryIO, size: int, path: str | Path) -> tuple[bytes, _Layout, dict[str, tuple[Any, ...]], str]:
    """Read the frames of a file after checking every size against that of the file.

    file: the open file.
    size: size of the file, bytes.
    path: for the error messages.
    Returns: bytes of the frames, their layout, the parameters by GROUP:NAME, and the byte order: intel, dec or mips.
    Raises: InputError where the file is not C3D, damaged or truncated.
    """
    head = file.read(_BLOCK)
    if len(head) < _BLOCK or head[1] != 0x50 or head[0] < 1:
        raise InputError(f"{path} is not {_KIND}: its header lacks the C3D mark.")
    file.seek((head[0] - 1) * _BLOCK)
    start = file.read(4)
    if len(start) < 4 or start[3] not in _PROCESSORS:
        raise InputError(f"{path}: the C3D parameter section is missing or of an unknown processor type.")
    order = _PROCESSORS[start[3]]
    parameters = _parameters(start + file.read(max(start[2], 1) * _BLOCK - 4), order, path)
    layout = _layout(head, parameters, order, path)
    wanted = layout.frames * layout.frame_bytes
    if layout.data_start + wanted > size:
        held = max(0, size - layout.data_start) // layout.frame_bytes
        raise InputError(
            f"{path} is truncated: its header promises {layout.frames} frames, the file holds {held}; copy it again."
        )
    file.seek(layout.data_start)
    return file.read(wanted), layout, parameters, order


_PROCESSORS = {84: "intel", 85: "dec", 86: "mips"}


@dataclass(frozen=True)
class _Layout:
    """Layout of the frames in the file.

    points: number of points.
    analog: number of analog samples per frame.
    frames: number of frames.
    rate: frames/s.
    scale: factor of integers to the unit of the file; negative where the numbers are floats.
    data_start: byte of the file at which the first frame begins.
    """

    points: int
    analog: int
    frames: int
    rate: float
    scale: float
    data_start: int

    @property
    def frame_bytes(self) -> int:
        """Size of a frame, bytes; numbers are 32-bit floats or 16-bit integers."""
        return (4 * self.points + self.analog) * (4 if self.scale < 0 else 2)


def _integers(data: bytes, order: str) -> np.ndarray:
    return np.frombuffer(data, dtype=">i2" if order == "mips" else "<i2").astype(np.int64)


def _floats(data: bytes, order: str) -> Array:
    if order != "dec":
        return np.frombuffer(data, dtype=">f4" if order == "mips" else "<f4").astype(np.float64)
    # VAX F-floating: the two 16-bit halves are exchanged and the exponent's bias is larger by 2
    swapped = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1].astype("<u2")
    return swapped.copy().view("<f4").astype(np.float64).ravel() / 4


def _parameters(section: bytes, order: str, path: str | Path) -> dict[str, tuple[Any, ...]]:
    """Parse the parameters.

    section: bytes of the parameter section.
    order: byte order: intel, dec or mips.
    path: for the error message.
    Returns: strings or numbers of each parameter by "GROUP:NAME".
    Raises: InputError where the section is damaged.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, tuple[Any, ...]]] = []
    at = 4
    broken = InputError(f"{path}: the C3D parameter section is damaged; export the file again.")
    try:
        while at + 4 <= len(section):
            length, group = struct.unpack_from("bb", section, at)
            if length == 0:
                break
            name_end = at + 2 + abs(length)
            name = section[at + 2 : name_end].decode("latin-1").strip().upper()
            step = int(_integers(section[name_end : name_end + 2], order)[0]) & 0xFFFF
            if group < 0:
                groups[-group] = name
            elif group > 0:
                found.append((group, name, _value(section, name_end + 2, order)))
            if step == 0:
                break
            if step < 2:
                raise broken
            at = name_end + step
    except (struct.error, IndexError, ValueError):
        raise broken from None
    return {f"{groups.get(g, g)}:{name}": value for g, name, value in found}


def _value(section: bytes, at: int, order: str) -> tuple[Any, ...]:
    """Parse the strings or numbers of the parameter whose type stands at byte `at`; ValueError where it is damaged."""
    kind, dimensions = struct.unpack_from("bB", section, at)
    shape = list(section[at + 2 : at + 2 + dimensions])
    if dimensions > 7 or len(shape) < dimensions or kind not in (-1, 1, 2, 4):
        raise ValueError
    count = int(np.prod(shape, dtype=np.int64)) if shape else 1
    first = at + 2 + dimensions
    data = section[first : first + count * abs(kind)]
    if len(data) < count * abs(kind):
        raise ValueError
    if kind == -1:
        width = shape[0] if shape else 1
        return tuple(data[i : i + width].decode("latin-1").strip(" \0") for i in range(0, count, width or 1))
    if kind == 1:
        return tuple(data)
    return tuple((_integers if kind == 2 else _floats)(data, order).tolist())


def _first(value: tuple[Any, ...] | None, default: Any) -> Any:  # noqa: ANN401 (parameters hold text or numbers)
    return value[0] if value else default


def _layout(head: bytes, parameters: Mapping[str, tuple[Any, ...]], order: str, path: str | Path) -> _Layout:
    """Determine the layout of the frames; InputError where there are none, or the numbers are not possible.

    head: the first 512 bytes of the file.
    parameters: by GROUP:NAME; where they disagree with the header, they win.
    order: byte order: intel, dec or mips.
    """
    words = _integers(head, order) & 0xFFFF
    points = int(_first(parameters.get("POINT:USED"), words[1])) & 0xFFFF
    first, last = int(words[3]), int(words[4])
    start, end = parameters.get("TRIAL:ACTUAL_START_FIELD"), parameters.get("TRIAL:ACTUAL_END_FIELD")
    if start and end and len(start) == len(end) == 2:  # 32-bit frame numbers, low word first
        first, last = ((int(v[0]) & 0xFFFF) + ((int(v[1]) & 0xFFFF) << 16) for v in (start, end))
    scale = float(_first(parameters.get("POINT:SCALE"), _floats(head[12:16], order)[0]))
    rate = float(_first(parameters.get("POINT:RATE"), _floats(head[20:24], order)[0]))
    block = int(_first(parameters.get("POINT:DATA_START"), words[8])) & 0xFFFF
    if points == 0 and _first(parameters.get("ROTATION:USED"), 0):
        raise InputError(
            f"{path} holds rotations and positions of segments, as Theia3D writes them, and no points; export joint "
            "centres as points, from Visual3D for example."
        )
    if points == 0 or last < first or block < 2:
        raise InputError(f"{path} holds no points: {points} markers, frames {first} to {last}; a recording is needed.")
    if not np.isfinite([scale, rate]).all() or scale == 0 or not 0 < rate < 1e6:
        raise InputError(f"{path}: point scale {scale:g} and frame rate {rate:g} are not possible; export it again.")
    return _Layout(points, int(words[2]), last - first + 1, rate, scale, (block - 1) * _BLOCK)


def _points(raw: bytes, layout: _Layout, order: str) -> Array:
    values = _floats(raw, order) if layout.scale < 0 else _integers(raw, order).astype(np.float64)
    values = values.reshape(layout.frames, -1)[:, : 4 * layout.points].reshape(layout.frames, layout.points, 4)
    out = values[..., :3] * (1.0 if layout.scale < 0 else layout.scale)
    # ">= 0" is false for NaN too
    out[~((values[..., 3] >= 0) & np.isfinite(out).all(-1))] = np.nan
    return out


def _names(parameters: Mapping[str, tuple[Any, ...]], count: int) -> tuple[str, ...]:
    """Collect the names of the points; point_1 and so on for those without a label. count: number of points."""
    labels = list(parameters.get("POINT:LABELS", ()))
    k = 2
    while f"POINT:LABELS{k}" in parameters:
        labels += parameters[f"POINT:LABELS{k}"]
        k += 1
    labels = labels[:count] + [""] * (count - len(labels))
    return tuple(name or f"point_{i + 1}" for i, name in enumerate(labels))

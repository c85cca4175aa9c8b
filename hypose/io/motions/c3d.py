"""C3D marker files: written with ezc3d as 32-bit floats in millimetres, read with a bounded reader of hypose.

Axes are those of the world, z up; the parameters X_SCREEN = +X and Y_SCREEN = +Z say so.
Residuals follow the C3D manual: -1 for not seen, 0 for computed and not measured (here: lost or predicted frames),
    positive for measured (here: the standard deviation in whole millimetres, at least 1).
Why: ezc3d 1.7 accepts truncated files without a warning, reads no MIPS files, and ends the process (segmentation fault)
    at damaged parameter sections, which no check of the header finds.
Source: the C3D file format, user guide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.file_names import utf8_path
from hypose.io.files import atomic_path, numbers_of, read_bytes
from hypose.io.motions.marker_files import Markers, metres_per_unit

_KIND = "a C3D file"
_BLOCK = 512
_MAX_BYTES = 512 * 2**20
_MOST = 65_535  # the header counts frames in 16 bits


def joint_residuals(motion: Motion) -> Array:
    """Compute the residuals of a motion's joints for a C3D file.

    Returns: (T, J) standard deviation in mm, at least 0.001; 0 in frames that are lost or extrapolated, because 0 means
        that a point was computed and not measured.
    """
    computed = (motion.lost | motion.extrapolated).astype(bool)
    return np.where(computed[:, None], 0.0, np.maximum(motion.joint_sd * 1000, 1e-3))


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
    data = read_bytes(path, _KIND, _MAX_BYTES)
    if len(data) < _BLOCK or data[1] != 0x50 or data[0] < 1:
        raise InputError(f"{path} is not {_KIND}: its header lacks the C3D mark.")
    section = data[(data[0] - 1) * _BLOCK :]
    if len(section) < 4 or section[3] not in _PROCESSORS:
        raise InputError(f"{path}: the C3D parameter section is missing or of an unknown processor type.")
    order = _PROCESSORS[section[3]]
    with numbers_of(f"{path}: the C3D parameter section"):
        parameters = _parameters(section[: max(section[2], 1) * _BLOCK], order)
        points, rate = _points(data, parameters, order, path)
        unit = str(parameters.get("POINT:UNITS", [""])[0]) or "mm"
    labels, k = list(parameters.get("POINT:LABELS", ())), 2
    while more := parameters.get(f"POINT:LABELS{k}"):
        labels, k = labels + list(more), k + 1
    labels += [""] * (points.shape[1] - len(labels))
    names = tuple(name or f"point_{i}" for i, name in enumerate(labels[: points.shape[1]], start=1))
    return Markers(names, points * metres_per_unit(unit, str(path)), rate, unit)


_PROCESSORS = {84: "intel", 85: "dec", 86: "mips"}
_Parameters = Mapping[str, Sequence[Any]]


def _integers(data: bytes, order: str) -> NDArray[np.int64]:
    return np.frombuffer(data, dtype=">i2" if order == "mips" else "<i2").astype(np.int64)


def _floats(data: bytes, order: str) -> Array:
    if order != "dec":
        return np.frombuffer(data, dtype=">f4" if order == "mips" else "<f4").astype(np.float64)
    # VAX F-floating: the two 16-bit halves are exchanged and the exponent's bias is larger by 2
    swapped = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1].astype("<u2")
    return swapped.copy().view("<f4").astype(np.float64).ravel() / 4


def _parameters(section: bytes, order: str) -> _Parameters:
    """Parse the parameter section of a file.

    order: byte order: intel, dec or mips.
    Returns: strings or numbers of each parameter by "GROUP:NAME".
    Raises: ValueError or LookupError where the section is damaged.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Sequence[Any]]] = []
    at = step = 4
    while at + 4 <= len(section) and section[at] and step:
        length, group = np.frombuffer(section[at : at + 2], np.int8).tolist()
        end = at + 2 + abs(length)
        name = section[at + 2 : end].decode("latin-1").strip().upper()
        step = int(_integers(section[end : end + 2], order)[0]) & 0xFFFF
        if group < 0:
            groups[-group] = name
        elif group > 0:
            found.append((group, name, _value(section, end + 2, order)))
        if step == 1:
            raise ValueError("an entry is shorter than its own length")
        at = end + step
    return {f"{groups.get(g, g)}:{name}": value for g, name, value in found}


def _value(section: bytes, at: int, order: str) -> Sequence[Any]:
    """Parse the strings or numbers of the parameter whose type stands at byte `at`; ValueError where it is damaged."""
    kind, dimensions = section[at], section[at + 1]
    first = at + 2 + dimensions
    shape, size = section[at + 2 : first], {255: 1, 1: 1, 2: 2, 4: 4}.get(kind, 0)
    count = math.prod(shape)
    data = section[first : first + count * size]
    if dimensions > 7 or not size or len(data) < count * size:
        raise ValueError("a parameter is cut off or of an unknown type")
    if kind == 255:
        width = shape[0] if shape else 1
        return [data[i : i + width].decode("latin-1").strip(" \0") for i in range(0, count, width or 1)]
    return list(data) if kind == 1 else (_integers if kind == 2 else _floats)(data, order).tolist()


def _points(data: bytes, parameters: _Parameters, order: str, path: str | Path) -> tuple[Array, float]:
    """Read the points of all frames after checking their number against the size of the file.

    data: the whole file.
    parameters: by GROUP:NAME; where they disagree with the header, they win.
    order: byte order: intel, dec or mips.
    path: the file, for the error messages.
    Returns: points (T, M, 3) in the unit of the file, NaN where not seen, and the frame rate, Hz.
    Raises: InputError where there are no points, the numbers are not possible, or the file is truncated.
    """

    def stated(name: str, default: Any) -> Any:  # noqa: ANN401 (parameters hold text or numbers)
        return next(iter(parameters.get(name, ())), default)

    words = _integers(data[:_BLOCK], order) & 0xFFFF
    points, analog, first, last = (int(w) for w in words[1:5])
    points = int(stated("POINT:USED", points)) & 0xFFFF
    start, end = parameters.get("TRIAL:ACTUAL_START_FIELD"), parameters.get("TRIAL:ACTUAL_END_FIELD")
    if start and end and len(start) == len(end) == 2:  # 32-bit frame numbers, low word first
        first, last = ((int(v[0]) & 0xFFFF) + ((int(v[1]) & 0xFFFF) << 16) for v in (start, end))
    scale = float(stated("POINT:SCALE", _floats(data[12:16], order)[0]))
    rate = float(stated("POINT:RATE", _floats(data[20:24], order)[0]))
    begin = ((int(stated("POINT:DATA_START", words[8])) & 0xFFFF) - 1) * _BLOCK
    if points == 0 and stated("ROTATION:USED", 0):
        raise InputError(
            f"{path} holds rotations and positions of segments, as Theia3D writes them, and no points; export joint "
            "centres as points, from Visual3D for example."
        )
    if points == 0 or last < first or begin < _BLOCK:
        raise InputError(f"{path} holds no points: {points} markers, frames {first} to {last}; a recording is needed.")
    if not np.isfinite([scale, rate]).all() or scale == 0 or not 0 < rate < 1e6:
        raise InputError(f"{path}: point scale {scale:g} and frame rate {rate:g} are not possible; export it again.")
    frames, frame_bytes = last - first + 1, (4 * points + analog) * (4 if scale < 0 else 2)  # floats or integers
    raw = data[begin : begin + frames * frame_bytes]
    if len(raw) < frames * frame_bytes:
        raise InputError(
            f"{path} is truncated: its header promises {frames} frames, the file holds {len(raw) // frame_bytes}; copy "
            "it again."
        )
    values = (_floats if scale < 0 else _integers)(raw, order).astype(np.float64).reshape(frames, -1)
    values = values[:, : 4 * points].reshape(frames, points, 4)
    out = values[..., :3] * (1.0 if scale < 0 else scale)
    # ">= 0" is false for NaN too
    out[~((values[..., 3] >= 0) & np.isfinite(out).all(-1))] = np.nan
    return out, rate

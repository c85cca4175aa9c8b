"""Marker files (TRC, C3D), OpenSim motions (.mot) and tables for spreadsheets (CSV).

TRC files are tab-separated text with Y up, as OpenSim and Pose2Sim use them. Axes: TRC (x, y, z) = world (y, z, x), the
rotation of Pose2Sim between its z-up calibration and OpenSim's Y-up ground. A marker that was not seen is three empty
cells, which OpenSim 4.6 reads as NaN. Only the last cell of a row is written as NaN, because OpenSim refuses a file
whose last cell is empty.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.joint_angles import is_length
from hypose.body.motion import Motion, sd_per_axis
from hypose.errors import InputError, refuse
from hypose.geometry import Array
from hypose.io.files import (
    MAX_TEXT_BYTES,
    atomic_path,
    numbers_of,
    open_file,
    read_bytes,
    text_lines,
    utf8_path,
    write_text,
)

# ---- markers -------------------------------------------------------------------------------------------------------
# Markers: the type that every reader of marker files returns.


# metres per unit of length, by the names that marker files use
METRES = {"m": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(frozen=True)
class Markers:
    """Trajectories of markers, as every reader of marker files returns them.

    names: M names.
    points: (T, M, 3) m; NaN where a marker was not seen.
    frame_rate: Hz.
    """

    names: tuple[str, ...]
    points: Array
    frame_rate: float


def metres_per_unit(unit: str, where: str) -> float:
    """Convert the name of a unit of length to metres per unit.

    where: the file, for the error message.
    Raises: InputError for an unknown unit; it lists the known ones.
    """
    try:
        return METRES[unit.strip().lower()]
    except KeyError:
        raise InputError(f"{where} is in unit {unit!r}; known units are {', '.join(METRES)}.") from None


_KIND = "a TRC marker file"
# TRC axis k is world axis _WORLD[k]
_WORLD = (1, 2, 0)
_MAX_MARKERS = 10_000


def write_trc(
    path: str | Path,
    names: Sequence[str],
    points: ArrayLike,
    frame_rate: float,
    start_time: float = 0.0,
) -> None:
    """Write points as a TRC file in metres, with a resolution of 0.1 micrometre.

    names: M names.
    points: (T, M, 3) world, z up, m; NaN becomes empty cells.
    frame_rate: Hz.
    start_time: time of the first frame, s.
    Raises: InputError where the file cannot be written.
    """
    p = np.asarray(points, dtype=np.float64)
    rows = p[..., _WORLD].reshape(len(p), -1)
    rate = f"{frame_rate:.10g}"
    text = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{len(p)}\t{len(names)}\tm\t{rate}\t1\t{len(p)}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ"),
        "",
    ]
    for t, row in enumerate(rows):
        cells = ["" if math.isnan(v) else f"{v:.7f}" for v in row.tolist()]
        cells[-1] = cells[-1] or "NaN"
        text.append("\t".join([str(t + 1), f"{start_time + t / frame_rate:.9f}", *cells]))
    write_text(path, "\n".join(text) + "\n")


def read_trc(path: str | Path) -> Markers:
    """Read a TRC file with Y up.

    Returns: points in the world, z up, m; NaN for empty cells and NaN.
    Raises: InputError where the file is not TRC or a line cannot be used; it names the line.
    Why: the number of frames is that of the rows, because filtered files of Pose2Sim have one row fewer than their
        header says.
    """
    lines = text_lines(path, _KIND)
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path} is not {_KIND}: its first line does not start with PathFileType.")
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    with numbers_of(f"{path}: DataRate or NumMarkers in lines 2 and 3"):
        rate, count = (float(header.get(key, "")) for key in ("DataRate", "NumMarkers"))
    names = tuple(c.strip() for c in lines[3].split("\t")[2:] if c.strip())
    if not 0 < rate < 1e6 or not 1 <= count <= _MAX_MARKERS or len(names) != count:
        raise InputError(
            f"{path}: DataRate {rate:g} and NumMarkers {count:g} are not possible with the {len(names)} markers that "
            f"line 4 names; the rate must be positive and the markers 1 to {_MAX_MARKERS}."
        )
    scale = metres_per_unit(header.get("Units", "mm"), str(path))
    rows = [_row(line, len(names), f"{path}: line {n}") for n, line in enumerate(lines[5:], start=6) if line.strip()]
    if not rows:
        raise InputError(f"{path} has a header but no frames.")
    if lines[-1].rstrip("\t ").count("\t") < 1 + 3 * len(names):
        with open_file(path, _KIND, MAX_TEXT_BYTES) as stream:
            stream.seek(-1, os.SEEK_END)
            if stream.read() not in (b"\n", b"\r"):  # else the last number may lack digits
                raise InputError(f"{path} is cut off in its last line; copy it again.")
    data = np.array(rows).reshape(len(rows), len(names), 3)
    points = np.empty_like(data)
    points[..., _WORLD] = data * scale
    return Markers(names, points, rate)


def _row(line: str, markers: int, where: str) -> list[float]:
    """Parse the coordinates of a line of a TRC file; NaN for empty cells.

    markers: number of markers.
    where: file and line, for the error message.
    Raises: InputError where the line has another number of cells, or no numbers.
    """
    cells, wanted = line.rstrip("\t ").split("\t")[2:], 3 * markers
    # empty cells at the end may have been cut off; a marker is seen whole or not at all
    if len(cells) > wanted or len(cells) % 3:
        raise InputError(
            f"{where} has {len(cells)} cells, {wanted} are needed for {markers} markers; the file may be cut off."
        )
    cells += [""] * (wanted - len(cells))
    with numbers_of(where):
        values = [float(c) if c.strip() else math.nan for c in cells]
    if any(map(math.isinf, values)):
        raise InputError(f"{where} holds an infinite number.")
    return values


# ---- opensim -------------------------------------------------------------------------------------------------------
# OpenSim motion files (.mot): joint angles in degrees under OpenSim's coordinate names, pelvis position in
# metres, Y up.
#
# Names, signs and axes are those of body.joint_angles, which follows OpenSim's full-body model; only the neck
# is renamed, since the models that have one (Pose2Sim's among them) call the rotation about their Z axis
# neck_flexion although it is positive backwards. The pelvis position is our pelvis joint centre, not the origin
# of OpenSim's pelvis body, which lies some centimetres away.


_MOT = "an OpenSim motion file"
_RENAMED = {"neck_extension": "neck_flexion"}


def _table(names: Sequence[str], values: ArrayLike, times: ArrayLike) -> tuple[Array, Array, Array]:
    """Convert joint angles to degrees; positions stay in metres.

    names: A names of the columns; those that end in _tx, _ty, _tz are positions.
    values: (T, A) rad and m.
    times: (T,) s.
    Returns: converted values (T, A), times (T,) s, and the factor (A,) of each column.
    """
    v, t = np.asarray(values, dtype=np.float64), np.asarray(times, dtype=np.float64)
    scale = np.array([1.0 if is_length(n) else 180 / np.pi for n in names])
    return v * scale, t, scale


def write_mot(path: str | Path, names: Sequence[str], values: ArrayLike, times: ArrayLike) -> None:
    """Write joint angles as an OpenSim motion file (.mot), in degrees.

    names: A coordinate names.
    values: (T, A) rad; m for *_tx, *_ty, *_tz.
    times: (T,) s, increasing.
    Raises: InputError where no frame is finite.
    Why: OpenSim stops at NaN, so frames with NaN are left out; the times show the gap.
    """
    v, t, _ = _table(names, values, times)
    keep = np.isfinite(v).all(1)
    if not keep.any():
        raise InputError(f"{path}: no frame has finite joint angles, so there is nothing to write.")
    lines = [
        Path(path).stem,
        "version=1",
        f"nRows={int(keep.sum())}",
        f"nColumns={len(names) + 1}",
        "inDegrees=yes",
        "",
        "Units are S.I. units (second, meters, Newtons, ...)",
        "Angles are in degrees.",
        "",
        "endheader",
        "\t".join(["time", *(_RENAMED.get(n, n) for n in names)]),
    ]
    rows = np.concatenate([t[keep, None], v[keep]], axis=1)
    lines += ["\t".join(f"{x:.9f}" for x in row) for row in rows.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def read_mot(path: str | Path) -> tuple[Array, tuple[str, ...], Array]:
    """Read the coordinates of a .mot or .sto file of OpenSim.

    Returns: times (T,) s, A coordinate names (neck_flexion as neck_extension), values (T, A) in rad, or m for *_tx,
        *_ty, *_tz.
    Raises: InputError where the file is not an OpenSim motion or a line cannot be used; it names the line.
    """
    lines = text_lines(path, _MOT)
    end = next((i for i, line in enumerate(lines[:500]) if line.strip().lower() == "endheader"), None)
    if end is None or end + 1 >= len(lines):
        raise InputError(f"{path} is not {_MOT}: its header has no endheader.")
    degrees = any(line.replace(" ", "").lower() == "indegrees=yes" for line in lines[:end])
    header = lines[end + 1].split()
    if len(header) < 2 or header[0].lower() != "time" or len(header) > 5000 or len(set(header)) < len(header):
        raise InputError(f"{path}: the line after endheader must name time and the coordinates, each once.")
    rows = []
    for number, line in enumerate(lines[end + 2 :], start=end + 3):
        with numbers_of(f"{path}: line {number}"):
            row = [float(c) for c in line.split()]
        if len(row) not in (0, len(header)):
            raise InputError(f"{path}: line {number} has {len(row)} numbers, {len(header)} are needed; it may be cut.")
        rows += [row] if row else []
    values = np.array(rows)
    if not rows or not np.isfinite(values[:, 0]).all() or (np.diff(values[:, 0]) <= 0).any():
        raise InputError(f"{path} has no frames, or times that do not increase; export it again.")
    ours = {theirs: name for name, theirs in _RENAMED.items()}
    names = tuple(ours.get(n, n) for n in (h.split("/")[-2] if h.endswith("/value") else h for h in header[1:]))
    scale = np.array([1.0 if is_length(n) or not degrees else np.pi / 180 for n in names])
    return values[:, 0], names, values[:, 1:] * scale


# ---- angles --------------------------------------------------------------------------------------------------------
# Tables for spreadsheets: joint angles in degrees, and joint positions with their uncertainty in metres.
#
# Comma-separated, one header line whose names end in the unit, an empty cell where a value is not known.


def write_angles_csv(
    path: str | Path, names: Sequence[str], values: ArrayLike, times: ArrayLike, sd: ArrayLike | None = None
) -> None:
    """Write a table of joint angles in degrees as CSV.

    Columns: time_s; <name>_deg for angles and <name>_m for positions; with `sd`, in the same order, <name>_sd_deg and
        <name>_sd_m. Signs are those of `body.joint_angles`.

    names: A names.
    values: (T, A) rad; m for *_tx, *_ty, *_tz.
    times: (T,) s.
    sd: (T, A) standard deviations in the units of `values`, where they are known.
    """
    table, t, scale = _table(names, values, times)
    units = ["m" if is_length(n) else "deg" for n in names]
    header = ["time_s", *(f"{n}_{u}" for n, u in zip(names, units, strict=True))]
    if sd is not None:
        header += [f"{n}_sd_{u}" for n, u in zip(names, units, strict=True)]
        table = np.concatenate([table, np.asarray(sd, dtype=np.float64) * scale], axis=1)
    _write(path, header, [_cells([time, *row]) for time, row in zip(t.tolist(), table.tolist(), strict=True)])


def write_joints_csv(path: str | Path, motion: Motion) -> None:
    """Write a table of joint centres (world, z up, m), their standard deviations and the state of each frame as CSV.

    Columns of a frame: time_s, lost and extrapolated (0 or 1), n_views, low_confidence (0 or 1; empty where it was not
        computed). Lost and extrapolated frames keep the predicted positions.
    Columns of a joint: x_m, y_m, z_m, and sd_m per axis (root mean square of the three); systematic_sd_m, the part of
        sd_m that more frames and similar views would not reduce, where it is known; error_probability, the probability
        of an error above 100 mm, where it was computed.
    """
    columns = ["x_m", "y_m", "z_m", "sd_m"]
    series: list[np.ndarray] = [motion.joints, motion.joint_sd[..., None]]
    if motion.systematic_covariance is not None:
        columns.append("systematic_sd_m")
        series.append(sd_per_axis(motion.systematic_covariance)[..., None])
    if motion.error_probability is not None:
        columns.append("error_probability")
        series.append(motion.error_probability[..., None])
    header = ["time_s", "lost", "extrapolated", "n_views", "low_confidence"]
    header += [f"{n}_{c}" for n in motion.skeleton.joint_names for c in columns]
    data = np.concatenate(series, axis=2).reshape(len(motion), -1).tolist()
    flags = np.stack([motion.lost, motion.extrapolated, motion.n_views], axis=1).astype(int).tolist()
    judged = [""] * len(motion) if motion.low_confidence is None else [str(int(d)) for d in motion.low_confidence]
    rows = [
        [*_cells([time]), *map(str, known), low_confidence, *_cells(row)]
        for time, known, low_confidence, row in zip(motion.times.tolist(), flags, judged, data, strict=True)
    ]
    _write(path, header, rows)


def _cells(values: Sequence[float]) -> list[str]:
    """Format numbers with six digits; empty where a value is not finite."""
    return [f"{v:.6f}" if math.isfinite(v) else "" for v in values]


def _write(path: str | Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    write_text(path, "\n".join(",".join(row) for row in [header, *rows]) + "\n")


# ---- c3d -----------------------------------------------------------------------------------------------------------
# C3D marker files: written with ezc3d as 32-bit floats in millimetres, read with a bounded reader of hypose.
#
# Axes are those of the world, z up; the parameters X_SCREEN = +X and Y_SCREEN = +Z say so.
# Residuals follow the C3D manual: -1 for not seen, 0 for computed and not measured (here: lost or predicted frames),
#     positive for measured (here: the standard deviation in whole millimetres, at least 1).
# Why: ezc3d 1.7 accepts truncated files without a warning, reads no MIPS files, and ends the process (segmentation
# fault)
#     at damaged parameter sections, which no check of the header finds.
# Source: the C3D file format, user guide.


_C3D = "a C3D file"
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
    groups: dict[str, dict[str, Any]] = {"POINT": {"X_SCREEN": ("+X",), "Y_SCREEN": ("+Z",)}}
    several = len(subjects) > 1
    if subjects:  # this group and the next as Vicon writes them
        groups["SUBJECTS"] = {
            "USED": [len(subjects)],
            "IS_STATIC": [0],
            "USES_PREFIXES": [int(several)],
            "NAMES": list(subjects),
            "LABEL_PREFIXES": [f"{s}:" if several else "" for s in subjects],
        }
    if events := events[:255]:
        times, contexts, labels = zip(*events, strict=True)
        groups["EVENT"] = {
            "USED": [len(events)],
            "CONTEXTS": list(contexts),
            "LABELS": list(labels),
            "SUBJECTS": [subjects[0] if subjects else ""] * len(events),
            "ICON_IDS": [1 if label == "Foot Strike" else 2 for label in labels],
            "TIMES": np.array([[time // 60 for time in times], [time % 60 for time in times]]),
        }
    for group, name, value in ((g, n, v) for g, about in groups.items() for n, v in about.items()):
        file.add_parameter(group, name, value)
    data = np.ones((4, m, t))
    data[:3] = p.transpose(2, 1, 0) * 1000
    file["data"]["points"] = data
    file["data"]["meta_points"]["residuals"] = residuals.T[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, m, t), dtype=bool)
    with atomic_path(path) as temporary, utf8_path(temporary) as written:
        file.write(written)


def read_c3d(path: str | Path) -> Markers:
    """Read the points of a C3D file of integers or floats, in the byte order of Intel, DEC or MIPS.

    Labels of LABELS, LABELS2 and so on are joined, and a point without a label is named point_<number>. Analog channels
    are skipped.

    Returns: points in metres, in the axes of the file; NaN where the residual is negative.
    Raises: InputError where the file is not C3D, damaged, truncated or without points.
    """
    data = read_bytes(path, _C3D, _MAX_BYTES)
    if len(data) < _BLOCK or data[1] != 0x50 or data[0] < 1:
        raise InputError(f"{path} is not {_C3D}: its header lacks the C3D mark.")
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
    return Markers(names, points * metres_per_unit(unit, str(path)), rate)


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
    faults = {
        " holds rotations and positions of segments, as Theia3D writes them, and no points; export joint centres as "
        "points, from Visual3D for example": points == 0 and stated("ROTATION:USED", 0),
        f" holds no points: {points} markers, frames {first} to {last}; a recording is needed": (
            points == 0 or last < first or begin < _BLOCK
        ),
        f": point scale {scale:g} and frame rate {rate:g} are not possible; export it again": (
            not np.isfinite([scale, rate]).all() or scale == 0 or not 0 < rate < 1e6
        ),
    }
    refuse(str(path), faults)
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

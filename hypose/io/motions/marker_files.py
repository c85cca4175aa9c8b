"""Marker files (TRC), OpenSim motions (.mot) and tables for spreadsheets (CSV).

TRC files are tab-separated text with Y up, as OpenSim and Pose2Sim use them. Axes: TRC (x, y, z) = world (y, z, x), the
rotation of Pose2Sim between its z-up calibration and OpenSim's Y-up ground. A marker that was not seen is three empty
cells, which OpenSim 4.6 reads as NaN. Only the last cell of a row is written as NaN, because OpenSim refuses a file
whose last cell is empty.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.joint_angles import is_length
from hypose.body.motion import Motion, sd_per_axis
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import MAX_TEXT_BYTES, numbers_of, open_file, text_lines, write_text

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
    units: unit of length in the file.
    """

    names: tuple[str, ...]
    points: Array
    frame_rate: float
    units: str


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
    units = header.get("Units", "mm")
    scale = metres_per_unit(units, str(path))
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
    return Markers(names, points, rate, units)


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

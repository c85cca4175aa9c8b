"""TRC marker files (OpenSim, Pose2Sim): tab-separated text, Y up.

Axes: TRC (x, y, z) = world (y, z, x), the rotation that Pose2Sim uses between its z-up calibration and
OpenSim's Y-up ground. A marker that was not seen is three empty cells, which OpenSim 4.6 reads as NaN, except
that the last cell of a row says NaN: OpenSim counts an empty one as missing and refuses the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.errors import InputError
from hypose.io.files import text_lines, write_text
from hypose.io.motions.markers import Markers, checked, metres_per_unit

_KIND = "a TRC marker file"
# TRC axis k is world axis _WORLD[k]
_WORLD = (1, 2, 0)
_MAX_MARKERS = 10_000


def write_trc(
    path: str | Path,
    names: Sequence[str],
    points: ArrayLike,
    frame_rate: float,
    unit: str = "m",
    start_time: float = 0.0,
) -> None:
    """Write points (T, M, 3), world metres, z up; NaN becomes empty cells. `unit` is that of the file: m or
    mm.

    Cells have 0.1 micrometre; the file appears whole or not at all.
    """
    names, p = checked(names, points, frame_rate, str(path))
    scale = metres_per_unit(unit, str(path))
    digits = 7 + round(math.log10(scale))
    rows = p[..., _WORLD].reshape(len(p), -1) / scale
    rate = f"{frame_rate:.10g}"
    text = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{len(p)}\t{len(names)}\t{unit}\t{rate}\t1\t{len(p)}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ"),
        "",
    ]
    for t, row in enumerate(rows):
        cells = ["" if math.isnan(v) else f"{v:.{digits}f}" for v in row.tolist()]
        cells[-1] = cells[-1] or "NaN"
        text.append("\t".join([str(t + 1), f"{start_time + t / frame_rate:.9f}", *cells]))
    write_text(path, "\n".join(text) + "\n")


def read_trc(path: str | Path) -> Markers:
    """Read a Y-up TRC file into world metres, z up. Empty cells and NaN mean: not seen.

    The number of frames is that of the rows, not of the header (Pose2Sim's filtered files have one row fewer
    than they say). An InputError names the file and line that cannot be used.
    """
    lines = text_lines(path, _KIND)
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path} is not {_KIND}: its first line does not start with PathFileType.")
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    rate, count = _number(header, "DataRate", path), _number(header, "NumMarkers", path)
    if not 0 < rate < 1e6 or not 1 <= count <= _MAX_MARKERS or count != int(count):
        raise InputError(
            f"{path}: DataRate {rate:g} and NumMarkers {count:g} are not possible; the rate must be "
            f"positive and the markers 1 to {_MAX_MARKERS}."
        )
    m, units = int(count), header.get("Units", "mm")
    scale = metres_per_unit(units, str(path))
    names = tuple(c.strip() for c in lines[3].split("\t")[2:] if c.strip())
    if len(names) != m:
        raise InputError(f"{path}: line 4 names {len(names)} markers, but NumMarkers says {m}.")
    rows: list[list[float]] = []
    for number, line in enumerate(lines[5:], start=6):
        if line.strip():
            rows.append(_row(line, m, path, number))
    if not rows:
        raise InputError(f"{path} has a header but no frames.")
    data = np.array(rows).reshape(len(rows), m, 3)
    points = np.empty_like(data)
    points[..., _WORLD] = data * scale
    return Markers(names, points, rate, units)


def _number(header: dict[str, str], key: str, path: str | Path) -> float:
    try:
        return float(header[key])
    except (KeyError, ValueError):
        raise InputError(f"{path}: lines 2 and 3 give no number for {key}; a TRC header needs it.") from None


def _row(line: str, markers: int, path: str | Path, number: int) -> list[float]:
    cells, wanted = line.rstrip("\t ").split("\t")[2:], 3 * markers
    # empty cells at the end may have been cut off; a marker is seen whole or not at all
    if len(cells) > wanted or len(cells) % 3:
        raise InputError(
            f"{path}: line {number} has {len(cells)} cells, {wanted} are needed for {markers} markers; "
            "the file may be cut off."
        )
    cells += [""] * (wanted - len(cells))
    try:
        values = [float(c) if c.strip() else math.nan for c in cells]
    except ValueError:
        raise InputError(f"{path}: line {number} holds something that is not a number.") from None
    if any(math.isinf(v) for v in values):
        raise InputError(f"{path}: line {number} holds an infinite number.")
    return values

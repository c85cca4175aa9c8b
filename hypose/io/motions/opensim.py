"""OpenSim motion files (.mot): joint angles in degrees under OpenSim's coordinate names, pelvis position in
metres, Y up.

Names, signs and axes are those of body.joint_angles, which follows OpenSim's full-body model; only the neck
is renamed, since the models that have one (Pose2Sim's among them) call the rotation about their Z axis
neck_flexion although it is positive backwards. The pelvis position is our pelvis joint centre, not the origin
of OpenSim's pelvis body, which lies some centimetres away.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.joint_angles import is_length
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import text_lines, write_text

_KIND = "an OpenSim motion file"
_RENAMED = {"neck_extension": "neck_flexion"}


def write_sd_sto(path: str | Path, names: Sequence[str], sd: ArrayLike, times: ArrayLike) -> None:
    """Write standard deviations of joint angles beside their .mot, as OpenSim's storage: same columns, same units.

    names, times as for `write_mot`; sd (T, A) rad and m. OpenSim plots such a file, and tools weigh coordinates by it.
    """
    write_mot(path, names, sd, times)


def write_mot(path: str | Path, names: Sequence[str], values: ArrayLike, times: ArrayLike) -> None:
    """Write joint angles: names (A), values (T, A) in rad (m for *_tx, *_ty, *_tz), times (T,) s, increasing.

    OpenSim stops at NaN in a motion, so frames with one are refused frame by frame: they are left out (their
    times show the gap). An InputError when shapes differ or nothing is left.
    """
    v, t = np.asarray(values, dtype=np.float64), np.asarray(times, dtype=np.float64)
    if v.shape != (len(t), len(names)):
        raise InputError(f"{path}: {len(names)} names and {len(t)} times need values of that shape, got {v.shape}.")
    if (np.diff(t) <= 0).any() or not np.isfinite(t).all():
        raise InputError(f"{path}: frame times must increase; correct the recording's time stamps.")
    keep = np.isfinite(v).all(1)
    if not keep.any():
        raise InputError(f"{path}: no frame has finite joint angles, so there is nothing to write.")
    scale = np.array([1.0 if is_length(n) else 180 / np.pi for n in names])
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
    rows = np.concatenate([t[keep, None], v[keep] * scale], axis=1)
    lines += ["\t".join(f"{x:.9f}" for x in row) for row in rows.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def read_mot(path: str | Path) -> tuple[Array, tuple[str, ...], Array]:
    """Times (T,) s, coordinate names (A) and values (T, A), rad (metres for *_tx, *_ty, *_tz), of a .mot or .sto file;
    neck_flexion under our name for it. An InputError names the line that cannot be used."""
    lines = text_lines(path, _KIND)
    end = next((i for i, line in enumerate(lines[:500]) if line.strip().lower() == "endheader"), None)
    if end is None or end + 1 >= len(lines):
        raise InputError(f"{path} is not {_KIND}: its header has no endheader.")
    degrees = any(line.replace(" ", "").lower() == "indegrees=yes" for line in lines[:end])
    header = lines[end + 1].split()
    if len(header) < 2 or header[0].lower() != "time" or len(header) > 5000 or len(set(header)) < len(header):
        raise InputError(f"{path}: the line after endheader must name time and the coordinates, each once.")
    rows = []
    for number, line in enumerate(lines[end + 2 :], start=end + 3):
        if not line.strip():
            continue
        try:
            row = [float(c) for c in line.split()]
        except ValueError:
            raise InputError(f"{path}: line {number} holds something that is not a number.") from None
        if len(row) != len(header):
            raise InputError(f"{path}: line {number} has {len(row)} numbers, {len(header)} are needed; it may be cut.")
        rows.append(row)
    values = np.array(rows)
    if not rows or not np.isfinite(values[:, 0]).all() or (np.diff(values[:, 0]) <= 0).any():
        raise InputError(f"{path} has no frames, or times that do not increase; export it again.")
    ours = {theirs: name for name, theirs in _RENAMED.items()}
    names = tuple(ours.get(n, n) for n in (h.split("/")[-2] if h.endswith("/value") else h for h in header[1:]))
    scale = np.array([1.0 if is_length(n) or not degrees else np.pi / 180 for n in names])
    return values[:, 0], names, values[:, 1:] * scale

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
from hypose.io.files import write_text

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

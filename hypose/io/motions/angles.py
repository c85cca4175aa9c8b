"""Tables for spreadsheets: joint angles in degrees, and joint positions with their uncertainty in metres.

Comma-separated, one header line whose names end in the unit, an empty cell where a value is not known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hypose.body.joint_angles import is_length
from hypose.body.motion import Motion, sd_per_axis
from hypose.errors import InputError
from hypose.io.files import write_text


def write_angles_csv(
    path: str | Path, names: Sequence[str], values: ArrayLike, times: ArrayLike, sd: ArrayLike | None = None
) -> None:
    """Write joint angles: names (A), values (T, A) in rad (m for *_tx, *_ty, *_tz), times (T,) s, and their standard
    deviations sd (T, A) where they are known.

    Columns: time_s, <name>_deg, and <name>_m for positions; then, in the same order, <name>_sd_deg and <name>_sd_m.
    Signs: body.joint_angles.
    """
    v, t = np.asarray(values, dtype=np.float64), np.asarray(times, dtype=np.float64)
    if v.shape != (len(t), len(names)):
        raise InputError(f"{path}: {len(names)} names and {len(t)} times need values of that shape, got {v.shape}.")
    scale = np.array([1.0 if is_length(n) else 180 / np.pi for n in names])
    header = ["time_s", *(f"{n}_{'m' if is_length(n) else 'deg'}" for n in names)]
    table = v * scale
    if sd is not None:
        header += [f"{n}_sd_{'m' if is_length(n) else 'deg'}" for n in names]
        table = np.concatenate([table, np.asarray(sd, dtype=np.float64) * scale], axis=1)
    rows = [_cells([time, *row]) for time, row in zip(t.tolist(), table.tolist(), strict=True)]
    _write(path, header, rows)


def write_joints_csv(path: str | Path, motion: Motion) -> None:
    """Write joint centres (world, z up, m) with their standard deviation, and what is known of each frame.

    Columns: time_s, lost and extrapolated (0 or 1), n_views, doubtful (0 or 1; empty: not judged), then per joint x, y,
    z and sd; where it is known, systematic_sd, the part of sd that more frames and more views like these would not
    reduce; where it was judged, p_wrong, the probability that the joint is wrong by more than 100 mm. Standard
    deviations are per axis (root mean square of the three). Lost and extrapolated frames keep the predicted positions.
    """
    header = ["time_s", "lost", "extrapolated", "n_views", "doubtful"]
    columns, series = ["x_m", "y_m", "z_m", "sd_m"], [motion.joints, motion.joint_sd[..., None]]
    if motion.systematic_covariance is not None:
        lasting = sd_per_axis(motion.systematic_covariance)
        columns, series = [*columns, "systematic_sd_m"], [*series, lasting[..., None]]
    if motion.p_wrong is not None:
        columns, series = [*columns, "p_wrong"], [*series, motion.p_wrong[..., None]]
    header += [f"{n}_{c}" for n in motion.skeleton.joint_names for c in columns]
    data = np.concatenate(series, axis=2).reshape(len(motion), -1)
    rows = [
        [
            *_cells([float(motion.times[t])]),
            str(int(motion.lost[t])),
            str(int(motion.extrapolated[t])),
            str(int(motion.n_views[t])),
            "" if motion.doubtful is None else str(int(motion.doubtful[t])),
            *_cells(data[t].tolist()),
        ]
        for t in range(len(motion))
    ]
    _write(path, header, rows)


def _cells(values: Sequence[float]) -> list[str]:
    """With six digits; empty where a value is not finite."""
    return [f"{v:.6f}" if math.isfinite(v) else "" for v in values]


def _write(path: str | Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    write_text(path, "\n".join(",".join(row) for row in [header, *rows]) + "\n")

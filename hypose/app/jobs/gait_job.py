"""The files of `hypose gait`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hypose.app.reports.charts import cycle_chart
from hypose.body.motion import Motion
from hypose.io.files import write_text
from hypose.io.motions.c3d import write_c3d
from hypose.pipeline.gait import PERCENT, Gait, angle_cycles

_LABELS = {"strike": "Foot Strike", "off": "Foot Off"}


def write_gait(folder: Path, motion: Motion, gait: Gait) -> list[Path]:
    """events.csv, steps.csv, gait.csv and gait.c3d (joint centres with the events), and where there is a whole stride
    cycles.csv and cycles.svg (joint angles over the cycle); returns their paths."""
    start = float(motion.times[0])
    events = [
        (e.time, e.sd, e.side, e.kind, *e.place.tolist(), round((e.time - start) * motion.frame_rate))
        for e in gait.events
    ]
    steps = [
        (s.time, s.side, s.duration, s.duration_sd, s.length, s.length_sd, s.width, s.width_sd, s.double_support)
        for s in gait.steps
    ]
    figures = [(f.name, f.unit, f.mean, f.sd, f.low, f.high, f.n) for f in gait.figures]
    paths = [folder / n for n in ("events.csv", "steps.csv", "gait.csv", "gait.c3d")]
    _table(paths[0], "time_s,sd_s,side,event,x_m,y_m,z_m,frame", events)
    columns = "time_s,side,duration_s,duration_sd_s,length_m,length_sd_m,width_m,width_sd_m,double_support_s"
    _table(paths[1], columns, steps)
    _table(paths[2], "name,unit,mean,sd,low_90,high_90,n", figures)
    marks = [(e.time - start, e.side.capitalize(), _LABELS[e.kind]) for e in gait.events]
    computed = (motion.lost | motion.extrapolated).astype(bool)
    residuals = np.where(computed[:, None], 0.0, np.maximum(motion.joint_sd * 1000, 1e-3))
    write_c3d(paths[3], motion.skeleton.joint_names, motion.joints, motion.frame_rate, residuals, marks)
    cycles = angle_cycles(gait.events, motion)
    if not cycles:
        return paths
    paths += [folder / "cycles.csv", folder / "cycles.svg"]
    header = [f"{c.name}_{what}" for c in cycles for what in ("mean_deg", "sd_deg", "uncertainty_deg")]
    table = np.degrees([curve for c in cycles for curve in (c.mean, c.sd, c.uncertainty)]).T
    _table(
        paths[-2],
        ",".join(["percent", *header]),
        [(f"{p:g}", *row) for p, row in zip(PERCENT, table.tolist(), strict=True)],
    )
    write_text(paths[-1], cycle_chart(cycles))
    return paths


def _table(path: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    lines = [",".join(_cell(v) for v in row) for row in rows]
    write_text(path, "\n".join([header, *lines]) + "\n")


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5f}" if math.isfinite(value) else ""
    return str(value)

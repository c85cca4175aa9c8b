"""Gait in a report and in the files of `hypose gait`: events, figures, and the picture of its cycle, joint angles
from strike to strike with the mean and spread of the strides."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hypose.app.reports.figures import Figure
from hypose.app.reports.plots import LEFT, MIDDLE, RIGHT, svg
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.io.files import write_text
from hypose.io.motions.c3d import write_c3d
from hypose.pipeline.gait import PERCENT, AngleCycle, Gait, angle_cycles, gait_of

_PANELS = (
    ("hip flexion", "hip_flexion"),
    ("knee flexion", "knee_angle"),
    ("ankle dorsiflexion", "ankle_angle"),
    ("hip adduction", "hip_adduction"),
    ("pelvis", "pelvis"),
    ("trunk", "lumbar"),
)
_TRUNK = {"pelvis": ("tilt", "list"), "lumbar": ("extension", "bending", "rotation")}
_LEAST = 10.0  # degrees that a panel shows
_SHADES = (MIDDLE, "#2a9d6f", "#8e4ec6")
_LABELS = {"strike": "Foot Strike", "off": "Foot Off"}


def cycle_plot(cycles: Sequence[AngleCycle]) -> str:
    """SVG: degrees over the cycle, left orange and right blue; bands are one sd between strides, or of the tracking
    where there is one stride only."""
    known = {c.name: c for c in cycles}

    def draw(figure: Figure) -> None:
        for axes, (title, key) in zip(figure.subplots(2, 3, sharex=True).ravel(), _PANELS, strict=True):
            if key in _TRUNK:
                lines = [(f"{key}_{part}", colour, part) for part, colour in zip(_TRUNK[key], _SHADES, strict=False)]
            else:
                lines = [(f"{key}_l", LEFT, "left"), (f"{key}_r", RIGHT, "right")]
            for name, colour, label in lines:
                if name not in known:
                    continue
                cycle = known[name]
                mean, band = np.degrees(cycle.mean), np.degrees(cycle.sd if cycle.n > 1 else cycle.uncertainty)
                axes.plot(PERCENT, mean, color=colour, label=f"{label} (n = {cycle.n})")
                axes.fill_between(PERCENT, mean - band, mean + band, color=colour, alpha=0.18, lw=0)
            axes.set_title(f"{title} (°)", fontsize=9)
            axes.set_xlim(0, 100)
            low, high = axes.get_ylim()
            more = max(0.0, _LEAST - (high - low)) / 2  # what hardly moves is no curve
            axes.set_ylim(low - more, high + more)
            if axes.lines:
                axes.legend(fontsize=7, loc="best", handlelength=1.2)
        for axes in figure.axes[3:]:
            axes.set_xlabel("gait cycle (%)")

    return svg(draw, (10.6, 4.6))


def gait_section(motion: Motion, body: Body | None) -> str:
    """HTML: means with their intervals and the cycle; "" where nobody walks two steps, or poses are not known."""
    if motion.poses is None or body is None or not (found := gait_of(motion, body)).figures:
        return ""
    rows = "".join(
        f'<tr><td>{html.escape(f.name.replace("_", " "))}</td><td class="n">{f.mean:.3g} {html.escape(f.unit)}</td>'
        f'<td class="n">{f.low:.3g} to {f.high:.3g}</td><td class="n">{f.n}</td></tr>'
        for f in found.figures
    )
    head = "<tr><th></th><th>mean</th><th>with 90 %</th><th>n</th></tr>"
    out = f"<h2>Gait</h2><table>{head}{rows}</table>"
    if cycles := angle_cycles(found.events, motion):
        caption = "From strike to strike of the same foot. Bands: one standard deviation between strides, or of the "
        caption += "tracking where there is one. hypose gait writes the numbers, and each event and step."
        out += f"<figure>{cycle_plot(cycles)}<figcaption>{caption}</figcaption></figure>"
    return out


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
    write_text(paths[-1], cycle_plot(cycles))
    return paths


def _table(path: Path, header: str, rows: Sequence[Sequence[object]]) -> None:
    def cell(value: object) -> str:
        return str(value) if not isinstance(value, float) else f"{value:.5f}" if math.isfinite(value) else ""

    write_text(path, "\n".join([header, *(",".join(map(cell, row)) for row in rows)]) + "\n")

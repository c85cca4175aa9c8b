"""Gait in a report: its figures, and the picture of its cycle, joint angles from strike to strike with the mean and
spread of the strides."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

from hypose.app.reports.figures import Figure
from hypose.app.reports.plots import LEFT, MIDDLE, RIGHT, svg
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.pipeline.gait import PERCENT, AngleCycle, angle_cycles, gait_of

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

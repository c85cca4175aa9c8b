"""Plots of a result as SVG text, made with matplotlib's own renderer (no window, no network)."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hypose.app.jobs.truth import Truth
from hypose.app.reports.figures import Axes, Figure, FigureCanvasSVG, rc_context
from hypose.body.joint_angles import joint_angles
from hypose.body.motion import Motion
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import visible
from hypose.tracking.contacts import runs

LEFT, RIGHT, MIDDLE, INK = "#d9731a", "#2679c0", "#444444", "#222222"
LOST, EXTRAPOLATED = "#d62f2f", "#e0a800"
GROUPS = {
    "trunk and head": ("pelvis", "spine", "chest", "neck", "head"),
    "legs": ("hip", "knee", "ankle"),
    "arms": ("shoulder", "elbow", "wrist"),
}
_GROUP_COLOURS = {"trunk and head": MIDDLE, "legs": "#2a9d6f", "arms": "#8e4ec6"}
_MAX_POINTS = 3000
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.edgecolor": "#888888",
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "hypose",
}


def svg(draw: Callable[[Figure], None], size: tuple[float, float]) -> str:
    """What `draw` puts on an empty figure of `size` inches, as SVG text that loads nothing and steers nothing."""
    with rc_context(STYLE), warnings.catch_warnings():
        # a name may have letters that matplotlib's font lacks; a browser takes them from another
        warnings.filterwarnings("ignore", r"Glyph \d+", UserWarning)
        figure, buffer = Figure(figsize=size, layout="constrained"), io.StringIO()
        draw(figure)
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # savefig would draw everything twice
    text = buffer.getvalue()
    # the block of metadata names web addresses; nothing else in the file would be fetched, so nothing shall look so
    return visible(re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL))


def _thin(n: int) -> slice:
    return slice(None, None, max(1, -(-n // _MAX_POINTS)))


def _shade(axes: Axes, motion: Motion) -> None:
    """Lost and extrapolated stretches as coloured bands."""
    step = 1 / motion.frame_rate
    for flags, colour, name in (
        (motion.extrapolated & ~motion.lost, EXTRAPOLATED, "extrapolated"),
        (motion.lost, LOST, "lost"),
    ):
        for k, run in enumerate(runs(flags)):
            start, stop = float(motion.times[run.start]) - step / 2, float(motion.times[run.stop - 1]) + step / 2
            axes.axvspan(start, stop, color=colour, alpha=0.25, lw=0, label=name if k == 0 else None)


def fit_plot(motion: Motion) -> str:
    """Mean overlap of body and masks over time, and the number of views used."""

    def draw(figure: Figure) -> None:
        axes, views = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        t, k = motion.times, _thin(len(motion))
        axes.plot(t[k], (1 - motion.cost)[k], color=RIGHT)
        _shade(axes, motion)
        axes.set_ylim(0, 1)
        axes.set_ylabel("overlap with masks (IoU)")
        if motion.lost.any() or motion.extrapolated.any():
            axes.legend(loc="lower right", ncols=2)
        views.step(t[k], motion.n_views[k], where="mid", color=INK)
        views.set_ylim(0, max(1, int(motion.n_views.max(initial=1))) + 0.5)
        views.set_ylabel("views used")
        views.set_xlabel("time (s)")

    return svg(draw, (10.6, 3.2))


def sd_plot(motion: Motion) -> str:
    """Standard deviation of the joints' positions over time, median per body region."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        k = _thin(len(motion))
        for group, kinds in GROUPS.items():
            which = [j for j, n in enumerate(motion.skeleton.joint_names) if n.split("_")[-1] in kinds]
            sd = motion.joint_sd[:, which] * 1000
            known = np.isfinite(sd).any(1)
            if known.any():
                middle = np.full(len(sd), np.nan)
                middle[known] = np.nanmedian(sd[known], axis=1)
                axes.plot(motion.times[k], middle[k], color=_GROUP_COLOURS[group], label=group)
        _shade(axes, motion)
        axes.set_ylim(bottom=0)
        axes.set_ylabel("sd of joint position (mm)")
        axes.set_xlabel("time (s)")
        axes.legend(loc="upper right", ncols=3)

    return svg(draw, (10.6, 2.6))


_PANELS = (
    ("hip flexion", "hip_flexion"),
    ("knee flexion", "knee_angle"),
    ("ankle dorsiflexion", "ankle_angle"),
    ("shoulder flexion", "arm_flex"),
    ("elbow flexion", "elbow_flex"),
    ("trunk", "lumbar"),
)


def angle_plot(motion: Motion) -> str:
    """Joint angles over time in degrees with their sd as a band, left orange and right blue."""
    assert motion.poses is not None
    names, values = joint_angles(motion.skeleton, motion.poses)
    column = {n: np.degrees(values[:, i]) for i, n in enumerate(names)}
    sd = motion.angle_sd
    spread = {} if sd is None else {n: np.degrees(np.asarray(sd[:, i], np.float64)) for i, n in enumerate(names)}

    shown = _thin(len(motion))

    def line(axes: Axes, name: str, colour: str, label: str) -> None:
        """With a band of one standard deviation to either side."""
        t, v = motion.times[shown], column[name][shown]
        axes.plot(t, v, color=colour, label=label)
        if name in spread:
            s = spread[name][shown]
            axes.fill_between(t, v - s, v + s, color=colour, alpha=0.15, lw=0)

    def draw(figure: Figure) -> None:
        for axes, (title, key) in zip(figure.subplots(2, 3, sharex=True).ravel(), _PANELS, strict=True):
            if key == "lumbar":
                for part, colour in (("extension", MIDDLE), ("bending", "#2a9d6f"), ("rotation", "#8e4ec6")):
                    line(axes, f"lumbar_{part}", colour, part)
            else:
                line(axes, f"{key}_l", LEFT, "left")
                line(axes, f"{key}_r", RIGHT, "right")
            _shade(axes, motion)
            axes.set_title(f"{title} (°)", fontsize=9)
            if key in ("lumbar", "hip_flexion"):
                axes.legend(fontsize=7, loc="best", handlelength=1.2)
        for axes in figure.axes[3:]:
            axes.set_xlabel("time (s)")

    return svg(draw, (10.6, 4.2))


def top_view_plot(motion: Motion, rig: CameraRig | Sequence[Camera], truth: Truth | None = None) -> str:
    """Paths of pelvis and feet from above, with the cameras."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        k, s = _thin(len(motion)), motion.skeleton
        for name, colour, width in (("left_ankle", LEFT, 0.8), ("right_ankle", RIGHT, 0.8), ("pelvis", INK, 1.8)):
            if name in s.joint_names:
                path = motion.joints[k, s.joint(name)]
                axes.plot(path[:, 0], path[:, 1], color=colour, lw=width, label=name.replace("_", " "))
        if truth is not None:
            axes.plot(*truth.pelvis[k, :2].T, color=LOST, lw=0.9, ls="--", label="true pelvis")
        start = motion.joints[0, 0]
        axes.plot(start[0], start[1], "o", color=INK, ms=4)
        for camera in rig:
            x, y = camera.position[:2]
            ahead = camera.camera_from_world[2, :2]
            axes.plot(x, y, "s", color="#777777", ms=5)
            axes.annotate(
                "",
                (x + 0.5 * ahead[0], y + 0.5 * ahead[1]),
                (x, y),
                arrowprops={"arrowstyle": "->", "color": "#777777"},
            )
            axes.annotate(camera.name, (x, y), (4, 4), textcoords="offset points", fontsize=7, color="#555555")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        axes.legend(loc="best", fontsize=7)

    return svg(draw, (5.2, 4.6))


def error_plot(motion: Motion, truth: Truth) -> str:
    """Distance to the truth over time (mean of the joints) and per joint."""

    def draw(figure: Figure) -> None:
        axes, bars = figure.subplots(1, 2, width_ratios=(3, 2))
        axes.plot(motion.times, np.nanmean(truth.distances, axis=1) * 1000, color=LOST)
        _shade(axes, motion)
        axes.set_ylim(bottom=0)
        axes.set_ylabel("mean distance to the truth (mm)")
        axes.set_xlabel("time (s)")
        means = np.nanmean(truth.distances, axis=0) * 1000
        colours = [LEFT if n.startswith("left") else RIGHT if n.startswith("right") else MIDDLE for n in truth.names]
        at: Sequence[int] = range(len(means))
        bars.barh(at, means, color=colours)
        bars.set_yticks(at, [n.replace("_", " ") for n in truth.names], fontsize=7)
        bars.invert_yaxis()
        bars.set_xlabel("mm")

    return svg(draw, (10.6, 3.2))

"""Parts that commands, pages and the studio share: figures of a motion, descriptions of files, HTML of a page, and
charts as SVG text in the colours of the page around them.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.body.body import Body
from hypose.body.joint_angles import joint_angles
from hypose.body.motion import Motion
from hypose.errors import EvidenceError, visible
from hypose.geometry import Array
from hypose.pipeline.gait import PERCENT, AngleCycle

DESCRIPTIONS = {
    "motion.npz": "poses, joints, uncertainty and flags (numpy; metres, radians, seconds; world z up)",
    "body.npz": "the subject's body",
    "modes.npz": "one camera: all hypotheses of every frame with weights and covariances (hypose.io.motions.results)",
    "motion.trc": "joint centres for OpenSim (millimetres, y up)",
    "motion.c3d": "joint centres as float C3D (millimetres, z up; residual = standard deviation)",
    "motion.mot": "joint angles for OpenSim (degrees, metres)",
    "motion_sd.sto": "standard deviations of those angles (degrees, metres)",
    "motion.osim": "OpenSim model of this person, on which motion.mot plays (metres, kilograms)",
    "motion_markers.trc": "markers of that model (metres, y up)",
    "motion_ik.xml": "set-up of OpenSim's inverse kinematics with weights from the standard deviations",
    "motion.bvh": "skeleton animation (metres, degrees, y up)",
    "motion.glb": "skinned, animated body for Blender and browsers (metres, y up)",
    "angles.csv": "joint angles (degrees)",
    "joints.csv": "joint centres with their standard deviation (metres, z up) and flags per frame",
    "overlay.webm": "the body on the recorded images",
    "provenance.json": "settings, versions, inputs with their hashes",
    "assessment.json": "good, look at frames, or not to be trusted, and why; low-confidence frames by joint",
    "report.html": "this report",
}
"""Description of each file of a results folder."""
OPENSIM_FILES = ("motion.osim", "motion.mot", "motion_sd.sto", "motion.trc", "motion_markers.trc", "motion_ik.xml")


@dataclass(frozen=True)
class Summary:
    """Figures of a motion.

    frames, lost, extrapolated: numbers of frames.
    seconds: duration, s.
    iou, worst_iou: mean and least overlap with the masks; NaN where not known.
    sd_mm: median standard deviation over joints and frames, mm.
    """

    frames: int
    seconds: float
    lost: int
    extrapolated: int
    iou: float
    worst_iou: float
    sd_mm: float


def summarize(motion: Motion) -> Summary:
    """Compute the figures of a motion."""
    iou, sd = 1 - motion.cost, motion.joint_sd
    iou, sd = iou[np.isfinite(iou)], sd[np.isfinite(sd)]
    return Summary(
        len(motion),
        len(motion) / motion.frame_rate,
        int(motion.lost.sum()),
        int((motion.extrapolated & ~motion.lost).sum()),
        float(iou.mean()) if len(iou) else float("nan"),
        float(iou.min()) if len(iou) else float("nan"),
        float(np.median(sd)) * 1000 if len(sd) else float("nan"),
    )


def require_found(motion: Motion, name: str, kept: Path) -> None:
    """Raise EvidenceError where the person was found in no frame of a motion.

    name: name of the recording, for the message.
    kept: folder of the motion's files.
    """
    if not (motion.lost | motion.extrapolated).all():
        return
    raise EvidenceError(
        f"{name}: the person was found in none of {len(motion)} frames; {kept} keeps what was guessed, every frame "
        "marked. Look at the evidence (`hypose check` for cameras), and begin with frames that show the person."
    )


def subject_rows(body: Body) -> list[tuple[str, float]]:
    """List sizes of a body by name, m between joint centres; limbs: mean of both sides."""
    rows = [("stature", body.stature)]
    lengths: dict[str, float] = body.segment_lengths()
    for name, value in lengths.items():
        if name.startswith("left_"):
            plain = name.removeprefix("left_")
            rows.append((plain, 0.5 * (value + lengths[f"right_{plain}"])))
        elif not name.startswith("right_"):
            rows.append((name, value))
    return [(n.replace("_", " "), v) for n, v in rows]


# The colours are those of web/src/ui/theme.css, which is part of a report only where the front end was built.
_STYLE = """
:root { color-scheme: light; --bg: #eef1f4; --panel: #fff; --raised: #f3f6f8; --line: #d5dde4; --ink: #15202a;
  --dim: #566470; --bad: #b9262b; --good: #1d7a46; }
@media (prefers-color-scheme: dark) { :root { color-scheme: dark; --bg: #0d1115; --panel: #141a20; --raised: #1c242c;
  --line: #2a343e; --ink: #e7edf2; --dim: #9aa8b5; --bad: #ff7b7e; --good: #6fd39b; } }
body { margin: 0; background: var(--bg); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
.report { max-width: 1080px; margin: 0 auto; padding: 24px; font-size: 15px; } .wide { padding: 0 16px; }
.report h1 { font-size: 24px; margin: 0 0 2px; }
.report h2 { font-size: 17px; margin: 34px 0 6px; padding-bottom: 4px; border-bottom: 1px solid var(--line); }
.report p { margin: 6px 0; } .dim { color: var(--dim); } .good { color: var(--good); font-weight: 600; }
.bad { color: var(--bad); font-weight: 600; }
.report .cards { display: flex; flex-wrap: wrap; gap: 10px; margin: 16px 0 0; }
.report .card { border: 1px solid var(--line); border-radius: 6px; padding: 8px 14px; min-width: 110px;
  background: var(--panel); }
.report .card b { display: block; font-size: 21px; font-weight: 600; }
.report .card span { color: var(--dim); font-size: 13px; }
.report table { border-collapse: collapse; font-size: 14px; }
.report td, .report th { padding: 3px 14px 3px 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
.report td.n { text-align: right; font-variant-numeric: tabular-nums; }
.report img, .report svg, .report video { max-width: 100%; height: auto; } .report figure { margin: 12px 0; }
.report figcaption { color: var(--dim); font-size: 13px; } .report details { margin: 8px 0; }
.report pre { background: var(--raised); padding: 10px; overflow-x: auto; font-size: 12px; }
"""
# A report can load nothing, whatever is in it.
CONTENT_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def page(title: str, body: str, style: str = "", scripts: str = "", policy: str = CONTENT_POLICY) -> str:
    """Build an HTML page in the style of the reports.

    title: plain text.
    body: HTML.
    style, scripts: HTML of the viewer, whose place is in the body.
    policy: content security policy of the page.
    """
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        f"<style>{_STYLE}</style>{style}</head>\n"
        f'<body>\n<div class="report">{body}\n</div>\n{scripts}</body></html>\n'
    )


def html_table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), numbers: Container[int] = ()) -> str:
    """Build an HTML table.

    rows: HTML of the cells.
    head: texts above the columns; none: no head.
    numbers: columns of numbers, which are aligned to the right.
    """
    kinds = ("", ' class="n"')
    lines = ["".join(f"<td{kinds[k in numbers]}>{cell}</td>" for k, cell in enumerate(row)) for row in rows]
    top = ["".join(f"<th>{html.escape(h)}</th>" for h in head)] if head else []
    return "<table>" + "\n".join(f"<tr>{line}</tr>" for line in (*top, *lines)) + "</table>"


def html_list(texts: Iterable[str]) -> str:
    """Build an HTML list of plain texts."""
    return "<ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in texts) + "</ul>"


def picture_of(data: bytes, kind: str, caption: str = "") -> str:
    """Build the HTML of a picture that is embedded in the page.

    data: bytes of the file.
    kind: jpeg or png.
    """
    text, alt = base64.b64encode(data).decode("ascii"), html.escape(caption)
    below = f"<figcaption>{alt}</figcaption>" if caption else ""
    return f'<figure><img alt="{alt}" src="data:image/{kind};base64,{text}">{below}</figure>'


LEFT_COLOUR, RIGHT_COLOUR, INK, GREEN, VIOLET = "#d9731a", "#2679c0", "currentColor", "#2a9d6f", "#8e4ec6"
_LOST, _EXTRAPOLATED = "#d62f2f", "#e0a800"
_LINE = 15.0  # px of a line of text
_MAX_POINTS, _WIDTH = 3000, 1010


class Axes:
    """One panel of a chart, to which lines, bands and tints are added in the units of its axes.

    title, x, y: texts.
    low, high: ends of the y axis; None: fitted to the data.
    least: least length of the y axis.
    """

    def __init__(
        self,
        title: str = "",
        x: str = "",
        y: str = "",
        *,
        low: float | None = None,
        high: float | None = None,
        least: float = 1e-9,
    ) -> None:
        self.title, self.x, self.y = title, x, y
        self._low, self._high, self._least = low, high, least
        self._marks: list[tuple[str, Array, str]] = []  # kind, points (N, 2), SVG attributes
        self._legend: dict[str, str] = {}  # colour by label

    def line(self, x: Array, y: Array, colour: str, label: str = "") -> None:
        """Draw a line through points, interrupted where one is NaN.

        x, y: (N,) in the units of the axes.
        label: text in the legend; "": none.
        """
        self._add("line", x, y, f'fill="none" stroke="{colour}" stroke-width="1.4"', label, colour)

    def band(self, x: Array, low: Array, high: Array, colour: str) -> None:
        """Fill the area between two lines; points that are NaN are bridged.

        x, low, high: (N,) in the units of the axes.
        """
        known = np.isfinite(low) & np.isfinite(high)
        across, edges = (np.concatenate([v[known], w[known][::-1]]) for v, w in ((x, x), (low, high)))
        self._add("line", across, edges, f'fill="{colour}" fill-opacity="0.16"')

    def stretch(self, begin: float, end: float, colour: str, label: str) -> None:
        """Tint a part of the x axis over the whole height.

        begin, end: in the units of the x axis.
        label: text in the legend.
        """
        self._add("stretch", np.array([begin, end]), np.full(2, np.nan), f'fill="{colour}"', label, colour)

    def _add(self, kind: str, x: Array, y: Array, look: str, label: str = "", colour: str = "") -> None:
        self._marks.append((kind, np.column_stack([x, y])[:: max(1, -(-len(x) // _MAX_POINTS))], look))
        if label:
            self._legend[label] = colour

    def svg(self, x: float, y: float, w: float, h: float) -> str:
        """Return the panel as SVG in a box of w x h px with its upper left corner at (x, y)."""
        left = 38 + (_LINE if self.y else 0.0)
        head, foot = 22, 18 + (_LINE if self.x else 0.0)
        legend = " ".join(f'<tspan fill="{c}">&#9632; {_plain(name)}</tspan>' for name, c in self._legend.items())
        out = [f'<text x="{x + w - 10:.1f}" y="{y + 13:.1f}" text-anchor="end">{legend}</text>' if legend else ""]
        out.append(_text(x + left, y + 13, self.title, "start"))
        out.append(_text(x + left + (w - left) / 2, y + h - 5, self.x, "middle"))
        out.append(_text(x + 11, y + (h - foot + head) / 2, self.y, "middle", turned=True))
        x, y, w, h = x + left, y + head, w - left - 10, h - head - foot
        low, high = self._limits()
        scale = np.array([w, -h]) / (high - low)
        for value in _ticks(low[1], high[1], max(3, h / 26)):
            at = y + h + (value - low[1]) * scale[1]
            out.append(f'<path d="M{x:.1f} {at:.1f}h{w:.1f}" stroke="currentColor" stroke-opacity="0.15"/>')
            out.append(_text(x - 5, at + 4, f"{value:.6g}", "end"))
        for value in _ticks(low[0], high[0], max(3, w / 70)):
            at = x + (value - low[0]) * scale[0]
            out.append(f'<path d="M{at:.1f} {y:.1f}v{h:.1f}" stroke="currentColor" stroke-opacity="0.15"/>')
            out.append(_text(at, y + h + 13, f"{value:.6g}", "middle"))
        for kind, points, look in self._marks:
            out.append(_mark(kind, np.clip((points - low) * scale + [x, y + h], [x, y], [x + w, y + h]), look, y, h))
        return "".join(out)

    def _limits(self) -> tuple[Array, Array]:
        """Compute (x, y) at the lower left and upper right corner."""
        every = np.concatenate([np.zeros((0, 2)), *(p for _, p, _ in self._marks)])
        every = every[np.isfinite(every).all(1)]
        low, high = (every.min(0), every.max(0)) if len(every) else (np.zeros(2), np.ones(2))
        low[1], high[1] = (v if given is None else given for v, given in ((low[1], self._low), (high[1], self._high)))
        more = max(self._least - (high[1] - low[1]), 0.08 * (high[1] - low[1])) / 2
        low[1] -= more if self._low is None else 0.0
        high[1] += more if self._high is None else 0.0
        high[0] = max(high[0], low[0] + 1e-9)
        return low, high


def chart(rows: Sequence[Sequence[Axes]], height: float, shares: Sequence[float] = ()) -> str:
    """Arrange panels in rows and columns as SVG text, without external content or scripts.

    rows: panels by row.
    height: height of the whole, px.
    shares: shares of the height, per row; default: equal.
    """
    parts, shares = list[str](), shares or [1 / len(rows)] * len(rows)
    for i, row in enumerate(rows):
        w, y = _WIDTH / len(row), height * sum(shares[:i])
        parts += [axes.svg(w * k, y, w, height * shares[i]) for k, axes in enumerate(row)]
    look = 'font-size="11" font-family="system-ui, sans-serif" fill="currentColor"'
    size = f'width="{_WIDTH}" height="{height:.0f}" viewBox="0 0 {_WIDTH} {height:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {look}>{"".join(parts)}</svg>'


def _plain(text: str) -> str:
    return html.escape(visible(text))


def _text(x: float, y: float, text: str, anchor: str, turned: bool = False) -> str:
    turn = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turned else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{turn}>{_plain(text)}</text>' if text else ""


def _mark(kind: str, points: Array, look: str, y: float, h: float) -> str:
    """Return the SVG of one mark.

    kind: line or stretch.
    points: (N, 2) px.
    look: SVG attributes.
    y, h: top and height of the axes, px.
    """
    if kind == "stretch":
        begin, end = points[:, 0].tolist()
        return f'<rect x="{begin:.1f}" y="{y:.1f}" width="{end - begin:.1f}" height="{h:.1f}" opacity="0.25" {look}/>'
    known = np.asarray(np.isfinite(points).all(1))
    steps = np.where(known & ~np.concatenate([[False], known[:-1]]), "M", "L")[known].tolist()
    way = "".join(f"{step}{u:.1f} {v:.1f}" for step, (u, v) in zip(steps, points[known].tolist(), strict=True))
    return f'<path d="{way}" {look}/>'


def _ticks(low: float, high: float, most: float) -> list[float]:
    """Return round numbers from low to high; most: about the largest number of them."""
    least = abs(high - low) / max(most, 1.0)
    power = 10.0 ** math.floor(math.log10(least))
    step = power * next(n for n in (1, 2, 5, 10) if n * power >= least * (1 - 1e-9))
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


# ---- of a motion -----------------------------------------------------------------------------------------------------

_GROUPS = {
    "trunk and head": (("pelvis", "spine", "chest", "neck", "head"), INK),
    "legs": (("hip", "knee", "ankle"), GREEN),
    "arms": (("shoulder", "elbow", "wrist"), VIOLET),
}
_IN_TIME = (
    ("hip flexion", "hip_flexion"),
    ("knee flexion", "knee_angle"),
    ("ankle dorsiflexion", "ankle_angle"),
    ("shoulder flexion", "arm_flex"),
    ("elbow flexion", "elbow_flex"),
    ("trunk", "lumbar"),
)
_IN_CYCLE = (*_IN_TIME[:3], ("hip adduction", "hip_adduction"), ("pelvis", "pelvis"), ("trunk", "lumbar"))
_TRUNK = {"pelvis": ("tilt", "list"), "lumbar": ("extension", "bending", "rotation")}
_LEAST_ANGLE = 10.0  # degrees that a panel shows at least, so that small movements look small


def _add_flags(axes: Axes, motion: Motion) -> Axes:
    """Tint lost and extrapolated frames."""
    step = 1 / motion.frame_rate
    for flags, colour, name in (
        (motion.extrapolated & ~motion.lost, _EXTRAPOLATED, "extrapolated"),
        (motion.lost, _LOST, "lost"),
    ):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            axes.stretch(float(motion.times[a]) - step / 2, float(motion.times[b - 1]) + step / 2, colour, name)
    return axes


def fit_chart(motion: Motion) -> str:
    """Draw the mean overlap of body and masks over time, and the number of views used."""
    fit = _add_flags(Axes(y="overlap with masks (IoU)", low=0, high=1), motion)
    fit.line(motion.times, 1 - motion.cost, RIGHT_COLOUR)
    views = Axes(x="time (s)", y="views", low=0, high=max(1, int(motion.n_views.max(initial=1))) + 0.5)
    views.line(motion.times, motion.n_views, INK)
    return chart([[fit], [views]], 310, shares=(0.68, 0.32))


def sd_chart(motion: Motion) -> str:
    """Draw the standard deviation of the joints' positions over time, median per body region."""
    axes = _add_flags(Axes(x="time (s)", y="sd of joint position (mm)", low=0), motion)
    for group, (kinds, colour) in _GROUPS.items():
        which = [j for j, n in enumerate(motion.skeleton.joint_names) if n.split("_")[-1] in kinds]
        axes.line(motion.times, 1000 * over_known(np.nanmedian, motion.joint_sd[:, which]), colour, group)
    return chart([[axes]], 240)


def over_known(of: Callable[..., Array], values: Array) -> Array:
    """Compute a statistic of the known values in each row.

    of: function of (values, axis), such as np.nanmedian.
    values: (T, N).
    Returns: (T,); NaN where a row has no known value.
    """
    known, out = np.isfinite(values).any(1), np.full(len(values), np.nan)
    out[known] = of(values[known], axis=1)
    return out


def angle_chart(motion: Motion) -> str:
    """Draw joint angles over time in degrees with their sd as a band, left orange and right blue."""
    assert motion.poses is not None
    names, values = joint_angles(motion.skeleton, motion.poses)
    middle = dict(zip(names, np.degrees(values).T, strict=True))
    spread = {} if motion.angle_sd is None else dict(zip(names, np.degrees(motion.angle_sd).T, strict=True))
    panels = _angle_panels(_IN_TIME, "time (s)", motion.times, middle, spread, {})
    for axes in panels:
        _add_flags(axes, motion)
    return chart([panels[:3], panels[3:]], 400)


def cycle_chart(cycles: Sequence[AngleCycle]) -> str:
    """Draw joint angles over the gait cycle in degrees, left orange and right blue. Bands are one sd between strides,
    or of the tracking where there is one stride only.
    """
    middle = {c.name: np.degrees(c.mean) for c in cycles}
    spread = {c.name: np.degrees(c.sd if c.n > 1 else c.uncertainty) for c in cycles}
    count = {c.name: f" (n = {c.n})" for c in cycles if c.name.endswith(("_l", "_r"))}
    panels = _angle_panels(_IN_CYCLE, "gait cycle (%)", PERCENT, middle, spread, count)
    return chart([panels[:3], panels[3:]], 440)


def _angle_panels(
    kinds: Sequence[tuple[str, str]],
    across: str,
    x: Array,
    middle: Mapping[str, Array],
    spread: Mapping[str, Array],
    more: Mapping[str, str],
) -> list[Axes]:
    """Make one panel for each (title, angle).

    across: text of the x axis.
    x: (N,) values of the x axis.
    middle, spread: (N,) degrees by name of the angle.
    more: additional text for the legend by name.
    """
    panels = []
    for k, (title, key) in enumerate(kinds):
        axes = Axes(f"{title} (°)", across if k >= len(kinds) // 2 else "", least=_LEAST_ANGLE)
        lines = [(f"{key}_l", LEFT_COLOUR, "left"), (f"{key}_r", RIGHT_COLOUR, "right")]
        if key in _TRUNK:
            lines = [(f"{key}_{p}", c, p) for p, c in zip(_TRUNK[key], (INK, GREEN, VIOLET), strict=False)]
        for name, colour, label in lines:
            if name in middle:
                if name in spread:
                    axes.band(x, middle[name] - spread[name], middle[name] + spread[name], colour)
                axes.line(x, middle[name], colour, label + more.get(name, ""))
        panels.append(axes)
    return panels

"""Parts that commands, pages and the studio share: figures of a motion, descriptions of files, HTML of a page,
and tables.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import EvidenceError
from hypose.io.files import write_text

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
    lengths: dict[str, list[float]] = {}
    for name, value in body.segment_lengths().items():
        lengths.setdefault(name.removeprefix("left_").removeprefix("right_").replace("_", " "), []).append(value)
    return [("stature", body.stature), *((name, float(np.mean(values))) for name, values in lengths.items())]


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


def number_text(value: float) -> str:
    """Format a number with one digit after the point, "-" where it is not known."""
    return f"{value:.1f}" if math.isfinite(value) else "-"


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


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table completely or not at all; numbers have eight digits, and cells are empty for None and NaN.

    path: file to write.
    columns: headings.
    rows: values, as many as headings.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(map(_cell, row) for row in rows)
    write_text(path, text.getvalue())


def _cell(value: object) -> str:
    if value is None or isinstance(value, float):
        return f"{value:.8g}" if value is not None and math.isfinite(value) else ""
    # a spreadsheet would run a text that begins so
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "@", "\t") else str(value)

"""The results of a batch: one table (CSV), and one page with plots."""

from __future__ import annotations

import csv
import html
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hypose.app.reports.charts import INK, RIGHT, Axes, chart
from hypose.app.reports.report import page
from hypose.app.sweeps.sweep import Refused, Task
from hypose.io.files import write_text

COLUMNS = (
    *(
        "recording",
        "set",
        "state",
        "frames",
        "lost",
        "extrapolated",
        "doubtful",
        "iou",
        "worst_iou",
        "sd_mm",
        "error_mm",
    ),
    *("track_s", "attempts", "key", "results", "message"),
)
"""Columns of results.csv; empty where unknown. Files and lengths: millimetres, seconds."""
_PLOTS = (
    ("iou", "mean overlap with the masks (IoU)"),
    ("sd_mm", "median joint sd (mm)"),
    ("error_mm", "mean joint error (mm), where the truth is known"),
    ("track_s", "time to track (s)"),
)


def rows_of(
    tasks: Sequence[Task], refused: Sequence[Refused], figures: Mapping[str, Mapping[str, Any]], folder: Path
) -> list[dict[str, Any]]:
    """One row per task in the order of the sweep, then the recordings that were refused."""
    rows = []
    for task in tasks:
        row = {name: figures.get(task.key, {}).get(name) for name in COLUMNS}
        where = Path(os.path.relpath(task.results, folder)).as_posix()
        rows.append(row | {"recording": task.recording, "set": task.set_name, "key": task.key, "results": where})
    for one in refused:
        blank: dict[str, Any] = dict.fromkeys(COLUMNS)
        rows.append(blank | {"recording": one.recording, "set": one.set_name, "state": "failed", "message": one.reason})
    return rows


def write_table(rows: Sequence[Mapping[str, Any]], folder: Path) -> tuple[Path, Path]:
    """results.csv and results.html, each whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: _cell(v) for k, v in row.items()} for row in rows)
    write_text(folder / "results.csv", text.getvalue())
    write_text(folder / "results.html", _page(rows, folder))
    return folder / "results.csv", folder / "results.html"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    # a spreadsheet would run a text that begins so
    return f"'{text}" if isinstance(value, str) and text[:1] in ("=", "+", "@", "\t") else text


def _page(rows: Sequence[Mapping[str, Any]], folder: Path) -> str:
    states = {s: sum(r["state"] == s for r in rows) for s in ("done", "failed", "stopped")}
    counted = ", ".join(f"{n} {s}" for s, n in states.items() if n)
    parts = [f"<h1>{html.escape(folder.name)}</h1>", f'<p class="dim">{len(rows)} tasks: {counted}</p>']
    for name, title in _PLOTS:
        if any(r[name] is not None for r in rows):
            parts.append(f"<figure>{_by_set(rows, name, title)}</figure>")
    shown = ("recording", "set", "state", "frames", "lost", "iou", "sd_mm", "error_mm", "track_s", "message")
    parts.append("<h2>Tasks</h2><table><tr>" + "".join(f"<th>{c}</th>" for c in shown) + "</tr>")
    for row in rows:
        cells = [html.escape(_short(row[c])) for c in shown]
        if row["state"] == "done":
            cells[0] = f'<a href="{html.escape(row["results"], quote=True)}/report.html">{cells[0]}</a>'
        parts.append("<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    parts.append("</table>")
    return page(folder.name, "\n".join(parts))


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)


def _by_set(rows: Sequence[Mapping[str, Any]], name: str, title: str) -> str:
    """A dot per recording and a line at the median, one row per set."""
    sets = list(dict.fromkeys(str(r["set"]) for r in rows))

    axes = Axes(x=title, names=sets)
    for k, label in enumerate(sets):
        values = np.array([r[name] for r in rows if r["set"] == label and r[name] is not None], dtype=np.float64)
        if not len(values):
            continue
        # spread by rank, so that equal values stay visible and the picture is the same every time
        axes.dots(values, k + 0.5 * (np.argsort(np.argsort(values)) % 5 - 2) / 5, RIGHT, 0.6)
        axes.line(np.full(2, np.median(values)), np.array([k - 0.35, k + 0.35]), INK)
    return chart([[axes]], 70 + 40 * len(sets), width=860)

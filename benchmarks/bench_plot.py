"""Pictures of a benchmark's figures: bars per metric, grouped by what was measured, coloured by the method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL import Image

from hypose.errors import InputError
from hypose.io.files import atomic_path

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
ENDINGS = (".png", ".svg", ".pdf")
_WIDTH, _HEIGHT, _DPI = 4.6, 2.8, 90
_MOST_CASES = 90
_MOST_LINES = 16
_MOST_LETTERS = 60  # of the names of groups that fit side by side


@dataclass(frozen=True)
class Panels:
    """metrics: one panel each; plain: what the cases without a slash are called beside those with one; lines: the bars
    of a metric that are drawn across."""

    metrics: tuple[str, ...]
    plain: str = "all"
    lines: Mapping[str, float] | None = None


def check_plot_path(path: Path) -> None:
    """An InputError when no picture can be written under that name."""
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"--plot {path} has no ending that says what to draw; use one of {', '.join(ENDINGS)}.")


def plot_report(report: Mapping[str, Any], path: Path, panels: Panels | None = None) -> None:
    """Draw a benchmark's document (`benchmarks.bench_list.run_benchmark`) to a PNG, SVG or PDF file; without panels the
    first three metrics."""
    check_plot_path(path)
    rows: list[Mapping[str, Any]] = list(report["results"])
    known = panels or Panels(tuple(dict.fromkeys(r["metric"] for r in rows))[:3])
    drawn = [(m, chosen) for m in known.metrics if (chosen := [r for r in rows if r["metric"] == m])]
    if not drawn:
        raise InputError(f"The benchmark {report['name']} gave no figures that can be drawn; leave out --plot.")
    places = [grouped([r["case"] for r in chosen], known.plain) for _, chosen in drawn]
    names = dict.fromkeys(series for found in places for series, _ in found.values())
    in_groups = any(len({group for _, group in found.values()}) > 1 for found in places)
    colours = {name: f"C{k % 10}" for k, name in enumerate(names)}
    columns = min(2, len(drawn))
    lines = -(-len(drawn) // columns)
    with rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH * columns, _HEIGHT * lines), layout="constrained")
        axes = figure.subplots(lines, columns, squeeze=False)
        for axis in axes.flat[len(drawn) :]:
            axis.set_visible(False)
        for axis, (metric, chosen) in zip(axes.flat, drawn, strict=False):
            line = (known.lines or {}).get(metric)
            if in_groups:
                _bars(axis, metric, chosen, known.plain, colours, line)
            else:
                _list(axis, metric, chosen, line)
        handles = [Patch(color=colour, label=name) for name, colour in colours.items()]
        if in_groups and len(handles) > 1:
            figure.legend(handles=handles, loc="outside lower center", ncols=min(5, len(handles)), fontsize=8)
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format=path.suffix[1:].lower(), dpi=_DPI)
            if path.suffix.lower() == ".png":  # few colours: a third of the bytes in every clone
                Image.open(temporary).convert("RGB").quantize(64).save(temporary, "png", optimize=True)


def grouped(cases: Sequence[str], plain: str) -> dict[str, tuple[str, str]]:
    """{case: (series, group)}: 'apf/walk' is the series apf in the group walk. A case without a slash belongs to the
    series `plain` when its name is a group of others, else it is a series in the group `plain`."""
    pairs = {c: (c.split("/", 1)[0], c.split("/", 1)[1]) for c in cases if "/" in c}
    groups = {group for _, group in pairs.values()}
    return {c: pairs.get(c) or ((plain, c) if c in groups else (c, plain)) for c in cases}


def _bars(
    axis: Axes,
    metric: str,
    rows: Sequence[Mapping[str, Any]],
    plain: str,
    colours: Mapping[str, str],
    line: float | None,
) -> None:
    known = [r for r in rows if r["value"] is not None and np.isfinite(r["value"])]
    rows = known[:_MOST_CASES]
    places = grouped([r["case"] for r in rows], plain)
    series = list(dict.fromkeys(s for s, _ in places.values()))
    groups = list(dict.fromkeys(g for _, g in places.values()))
    width = 0.8 / max(1, len(series))
    for k, name in enumerate(series):
        mine = [r for r in rows if places[r["case"]][0] == name]
        at = [groups.index(places[r["case"]][1]) + (k - (len(series) - 1) / 2) * width for r in mine]
        value = [r["value"] for r in mine]
        axis.bar(at, value, 0.92 * width, yerr=_ends(mine), color=colours[name], error_kw={"lw": 0.8})
    if line is not None:
        axis.axhline(line, color="#222222", lw=0.8, ls="--")
    axis.set_xticks(range(len(groups)), groups if len(groups) > 1 else [""])
    if sum(map(len, groups)) > _MOST_LETTERS:
        axis.tick_params(axis="x", labelrotation=90)
    axis.set_ylim(bottom=0)
    _title(axis, metric, rows, len(known))
    axis.grid(axis="x", visible=False)


def _list(axis: Axes, metric: str, rows: Sequence[Mapping[str, Any]], line: float | None) -> None:
    """Lying bars with their names beside them: for cases that are no series."""
    known = [r for r in rows if r["value"] is not None and np.isfinite(r["value"])]
    rows = known[:_MOST_LINES]
    at = np.arange(len(rows))[::-1]
    axis.barh(at, [r["value"] for r in rows], 0.7, xerr=_ends(rows) if rows else None, color="C0", error_kw={"lw": 0.8})
    if line is not None:
        axis.axvline(line, color="#222222", lw=0.8, ls="--")
    axis.set_yticks(at, [r["case"] for r in rows], fontsize=8)
    axis.set_xlim(left=0)
    _title(axis, metric, rows, len(known))
    axis.grid(axis="y", visible=False)


def _ends(rows: Sequence[Mapping[str, Any]]) -> NDArray[np.float64]:
    """(2, n): how far the whiskers go down and up: the sd, but not below 0, and for shares not above 1."""
    value = np.array([r["value"] for r in rows], dtype=np.float64)
    spread = np.array([r.get("sd") or 0.0 for r in rows], dtype=np.float64)
    most = 1.0 if rows[0]["unit"] in ("1", "share") and value.max() <= 1 else np.inf
    return np.clip(np.stack([np.minimum(spread, value), np.minimum(spread, most - value)]), 0, None)


def _title(axis: Axes, metric: str, rows: Sequence[Mapping[str, Any]], known: int) -> None:
    unit = rows[0]["unit"] if rows else ""
    title = metric if unit == "1" or metric.endswith(f"_{unit}") else f"{metric} ({unit})"
    axis.set_title(title + (f", first {len(rows)} of {known}" if len(rows) < known else ""), fontsize=9)

"""Pages made of the kept figures: docs/benchmarks.md and docs/accuracy.md, which `make docs` writes.

`./run bench NAME --keep` keeps a benchmark's document in benchmarks/results. What the pages show of it stands in
`benchmarks.targets` and in the template benchmarks/accuracy.md.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from benchmarks.bench_origin import ROOT, commit
from benchmarks.targets import TARGETS, Benchmark, Figure, Rows
from hypose.errors import InputError

RESULTS = ROOT / "benchmarks" / "results"
TEMPLATE = ROOT / "benchmarks" / "accuracy.md"
Document = Mapping[str, Any]
_MOST_ROWS = 2  # of a benchmark, missed targets not counted

_HEAD = """---
hide: [navigation, toc]
---
# Benchmarks

Written by `make docs` from `benchmarks/results`; `./run bench NAME --case CASE --keep` measures again. The table shows
every missed target and up to four other figures of each benchmark. The linked file has all figures, the commit, the
date and the machine. `x / y` is a figure and its baseline in the same run. DATA is the folder of the recordings, PARTS
a folder for the finished parts of a long benchmark. A benchmark without a linked file has no kept figures yet.
The [accuracy page](accuracy.md) is the summary."""


def documents() -> dict[str, Document]:
    """Return the kept documents by the benchmark's name."""
    return {p.stem: json.loads(p.read_text(encoding="utf-8")) for p in sorted(RESULTS.glob("*.json"))}


def rows_of(document: Document) -> Rows:
    """Return the rows of a document by (metric, case)."""
    return {(r["metric"], r["case"]): r for r in document["results"]}


def number(value: float | None) -> str:
    """Return a value with three digits, without an exponent; "never" for None (not finite)."""
    if value is None:
        return "never"
    if abs(value) < 1e-4:
        return "0" if abs(value) < 1e-9 else f"{value:.6f}".rstrip("0")
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def benchmarks_page(kept: Mapping[str, Document]) -> str:
    """Return docs/benchmarks.md."""
    met = [m for b in TARGETS if b.name in kept for f in b.figures if (m := f.met(rows_of(kept[b.name]))) is not None]
    lines = [_HEAD, "", f"{sum(met)} of {len(met)} targets are met.", ""]
    lines += ["| benchmark | metric | case | value | target | command |", "|" + " --- |" * 6]
    for benchmark in TARGETS:
        lines += _lines(benchmark, kept.get(benchmark.name))
    return "\n".join(lines) + "\n"


def _lines(benchmark: Benchmark, document: Document | None) -> list[str]:
    if document is None:
        return [f"| {benchmark.name}: {benchmark.says} | | | | | `./run bench {benchmark.name}` |"]
    rows = rows_of(document)
    missed = [f for f in benchmark.figures if f.met(rows) is False]
    others = [f for f in benchmark.figures if f not in missed][:_MOST_ROWS]
    first = f"[{benchmark.name}](../benchmarks/results/{benchmark.name}.json): {benchmark.says}"
    last = f"`{document['command']}`"
    out = []
    for figure in (f for f in benchmark.figures if f in missed or f in others):
        cells = (first, figure.metric, figure.case, _value(figure, rows), _target(figure, rows), last)
        out.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
        first = last = ""
    return out


def _value(figure: Figure, rows: Rows) -> str:
    row = rows.get((figure.metric, figure.case))
    if row is None:
        return ""
    unit = "" if row["unit"] in ("1", "share", "") else f" {row['unit']}"
    if figure.ratio or (row["baseline"] and row["unit"] in ("s", "ms", "us", "1/s")):
        return f"{number(row['value'])} / {number(row['baseline_value'])}{unit}"
    return f"{number(row['value'])}{unit}"


def _target(figure: Figure, rows: Rows) -> str:
    if figure.at_least is not None and figure.at_most is not None:
        words = f"{figure.at_least:g} to {figure.at_most:g}"
    elif figure.at_least is not None:
        words = f"≥ {figure.at_least:g}"
    elif figure.at_most is not None:
        words = f"≤ {figure.at_most:g}"
    else:
        return ""
    words += f" × {figure.of}" if figure.of else " × baseline" if figure.ratio else ""
    return words + {True: "", False: ", **missed**", None: ", not measured"}[figure.met(rows)]


def accuracy_page(kept: Mapping[str, Document]) -> str:
    """Return docs/accuracy.md: the template with {benchmark | metric | case} replaced by that figure.

    A factor may follow ({... | * 100}). An InputError names a figure that is not kept.
    """

    def figure(match: re.Match[str]) -> str:
        name, metric, case, *factor = (part.strip() for part in match[1].split("|"))
        row = rows_of(kept[name]).get((metric, case)) if name in kept else None
        if row is None:
            raise InputError(f"{TEMPLATE.name} names {match[1]!r}, which is not kept; measure it or take it out.")
        value = row["value"] * float(factor[0].removeprefix("*")) if factor else row["value"]
        return number(round(value, 2))

    return re.sub(r"\{([^{}|]+\|[^{}]+)\}", figure, TEMPLATE.read_text(encoding="utf-8"))


def written() -> dict[str, str]:
    """Return the text of each page by its name in docs/."""
    kept = documents()
    return {"benchmarks.md": benchmarks_page(kept), "accuracy.md": accuracy_page(kept)}


def check_keep(quick: bool) -> None:
    """Raise an InputError when figures could not be kept: quick ones are not quoted, and the commit must be known."""
    if quick:
        raise InputError("--keep keeps figures that are quoted, and --quick gives none: run it without --quick.")
    if commit() is None:
        raise InputError("--keep needs to know the commit that is measured; run it in a git checkout, or use --json.")

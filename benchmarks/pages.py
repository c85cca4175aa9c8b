"""docs/benchmarks.md, made of the kept figures:  python -m benchmarks.pages

`./run bench NAME --keep` keeps a benchmark's document in benchmarks/results, draws its picture and makes the page anew.
What is said of each benchmark stands in `bench_pages`.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.bench_origin import ROOT, commit
from benchmarks.bench_pages import SECTIONS
from benchmarks.bench_plot import plot_report
from benchmarks.bench_tables import Page, Rows, lines_of, table, verdicts
from hypose.errors import InputError
from hypose.io.files import write_text
from hypose.io.motions.results import to_json

RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "benchmarks.md"
IMAGES = ROOT / "docs" / "images"
Document = Mapping[str, Any]

_HEAD = """# Benchmarks

Made by `python -m benchmarks.pages` from `benchmarks/results`; what is not there says so. `./run bench NAME --keep`
measures again and keeps. Bars are what was asked for. DATA is the folder with the recordings that a benchmark names,
PARTS one that keeps what a long table has so far. The machines are shared with other work, so seconds are upper bounds:
every speed has its ratio to a baseline of the same run, which such work slows as well ("OpenCV fill": filling 550
triangles in 640 x 480 and comparing, about one silhouette). What was tried is in the
[decisions](decisions/ledger.md).
"""


def documents() -> dict[str, Document]:
    """The kept documents by the benchmark's name."""
    return {p.stem: json.loads(p.read_text(encoding="utf-8")) for p in sorted(RESULTS.glob("*.json"))}


def pages() -> dict[str, Page]:
    """What is said of each benchmark, by its name."""
    return {page.name: page for section in SECTIONS.values() for page in section}


def rows_of(document: Document) -> Rows:
    """The rows of a document by (metric, case)."""
    return {(r["metric"], r["case"]): r for r in document["results"]}


def page_text(kept: Mapping[str, Document]) -> str:
    """docs/benchmarks.md."""
    parts = [_HEAD, _overview(kept)]
    for title, several in SECTIONS.items():
        parts.append(f"## {title}")
        parts += [_entry(page, kept.get(page.name)) for page in several]
    return "\n\n".join(p.strip() for p in parts) + "\n"


def _overview(kept: Mapping[str, Document]) -> str:
    out = ["| benchmark | bars met | measured |", "| --- | --- | --- |"]
    for page in pages().values():
        document, met, measured = kept.get(page.name), "", "not yet"
        if document is not None:
            rows = rows_of(document)
            every = [m for line in lines_of(page, rows) for _, m in verdicts(page, line, rows) if m is not None]
            met = f"{sum(every)} of {len(every)}" if every else ""
            measured = f"{document['date'][:10]}{', quick' if document['settings']['quick'] else ''}"
        out.append(f"| [{page.name}](#{_anchor(page.name)}) | {met} | {measured} |")
    return "\n".join(out)


def _anchor(name: str) -> str:
    return name.replace(".", "")  # as the site's headings have it


def _entry(page: Page, document: Document | None) -> str:
    parts = [f"### {page.name}", wrapped(page.prose)]
    if document is None:
        parts.append(f"Not measured yet in this form: `./run bench {page.name} --keep`.")
    else:
        parts += [table(page, rows_of(document)), wrapped(_origin(document))]
        parts.append(f"![{page.name}](images/{picture_path(page.name).name})")
    return "\n\n".join(parts)


def wrapped(text: str) -> str:
    """Text in lines of at most 120 letters."""
    return textwrap.fill(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)


def _origin(document: Document) -> str:
    m, settings = document["machine"], document["settings"]
    plain = {k: v for k, v in sorted(settings.items()) if _is_short(v) and k != "quick"}
    said = "; ".join(f"{k} {', '.join(map(str, v)) if isinstance(v, list) else v}" for k, v in plain.items())
    seconds = document["seconds"]
    took = f", {seconds / 60:.0f} min" if seconds > 100 else f", {seconds:.0f} s"
    took = "" if "--parts" in document["command"] else took  # what was kept before took time as well
    return (
        f"`{document['command']}`{', QUICK FORM' if settings['quick'] else ''}; commit {document['commit']}, "
        f"{document['date'][:10]}; {m['processor']}, {m['cores']} cores, load {m['load']:.0f}{took}."
        + (f" {said}." if said else "")
    )


def _is_short(value: Any) -> bool:
    if isinstance(value, list):
        return len(value) <= 10 and not any(isinstance(v, list | dict) for v in value) and len(str(value)) < 80
    return not isinstance(value, dict) and len(str(value)) < 80


def picture_path(name: str) -> Path:
    """Where a benchmark's picture is."""
    return IMAGES / f"bench-{name}.png"


def check_keep(name: str, quick: bool) -> None:
    """An InputError when figures could not be kept: quick ones are no figures to quote, and a commit must be known."""
    if quick:
        raise InputError(f"--keep keeps figures that are quoted, and --quick gives none: run {name} without --quick.")
    if commit() is None:
        raise InputError("--keep needs to know the commit that is measured; run it in a git checkout, or use --json.")


def keep_report(report: Document) -> list[Path]:
    """Keep a benchmark's document, draw its picture, make the page anew; the files written."""
    kept = RESULTS / f"{report['name']}.json"
    write_text(kept, to_json(report))
    picture = draw(report)
    write_text(PAGE, page_text(documents()))
    return [kept, picture, PAGE]


def draw(report: Document, path: Path | None = None) -> Path:
    """The picture of a document, where that of kept ones is or elsewhere."""
    path = path or picture_path(report["name"])
    plot_report(report, path, pages()[report["name"]].picture)
    return path


if __name__ == "__main__":
    for kept in documents().values():
        draw(kept)
    write_text(PAGE, page_text(documents()))

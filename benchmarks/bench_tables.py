"""What a page says of a benchmark, declared as values: which figures stand in its table, and what was asked of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.bench_plot import Panels

Rows = Mapping[tuple[str, str], Mapping[str, Any]]
"""The rows of a benchmark's document by (metric, case)."""


@dataclass(frozen=True)
class Column:
    """A column of a table: for each line the row (metric, case), where {} in case is the line's own; without a metric
    the line's. scale: what values are multiplied by; spread: with the sd behind; ratio: the ratio, not the value."""

    title: str
    metric: str = ""
    case: str = "{}"
    scale: float = 1.0
    spread: bool = False
    ratio: bool = False


@dataclass(frozen=True)
class Bar:
    """What is asked of a line's figure in a column (by its number), in the column's units: at least a limit (and at
    most `highest`), or at most. than: the limit is that many times the figure of this case in the same column."""

    limit: float
    at_least: bool
    column: int = 0
    than: str = ""
    highest: float | None = None


@dataclass(frozen=True)
class Line:
    """A line of a table. more: what stands in the page's last column, when it has one (what others published)."""

    title: str
    case: str
    bars: tuple[Bar, ...] = ()
    metric: str = ""
    more: str = ""
    digits: int = 3
    scale: float = 1.0


@dataclass(frozen=True)
class Page:
    """What docs/benchmarks.md says of a benchmark: prose of at most five lines; columns and lines (none: one for each
    case of the first column's metric); more: title of a last column with what others published; picture: what is drawn
    of it."""

    name: str
    prose: str
    columns: tuple[Column, ...] = (Column("measured"),)
    lines: tuple[Line, ...] = ()
    more: str = ""
    picture: Panels | None = None


def most(limit: float, column: int = 0, than: str = "") -> Bar:
    """At most that."""
    return Bar(limit, False, column, than)


def least(limit: float, column: int = 0, than: str = "") -> Bar:
    """At least that."""
    return Bar(limit, True, column, than)


def within(lowest: float, highest: float, column: int = 0) -> Bar:
    """Between the two."""
    return Bar(lowest, True, column, "", highest)


def lines_of(page: Page, rows: Rows) -> tuple[Line, ...]:
    """The page's lines, or one for each case of its first column."""
    if page.lines:
        return page.lines
    return tuple(Line(case, case) for metric, case in rows if metric == page.columns[0].metric)


def figure(column: Column, line: Line, rows: Rows) -> Mapping[str, Any] | None:
    """The row that a cell shows; None when it was not measured."""
    return rows.get((column.metric or line.metric, column.case.replace("{}", line.case)))


def number(value: float, digits: int = 3) -> str:
    """So many figures, without an exponent."""
    if abs(value) < 1e-4:  # of rounding only, or a share too small to read
        return "0" if abs(value) < 1e-9 else f"{value:.{digits + 3}f}".rstrip("0")
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def cell(column: Column, line: Line, rows: Rows) -> str:
    """A cell: the figure ("never" where it is not finite), with its unit where the column has none, and for speeds the
    ratio to the baseline."""
    row = figure(column, line, rows)
    if row is None:
        return ""
    value = row["ratio"] if column.ratio else row["value"]
    if value is None:
        return "" if column.ratio else "never"
    scale = column.scale * line.scale
    text = number(scale * value, line.digits)
    if column.spread and row["sd"] is not None:
        text += f" ({number(scale * row['sd'], 2)})"
    if not column.metric and not column.ratio:
        text += "" if row["unit"] in ("1", "share") else f" {row['unit']}"
        if row["ratio"] is not None:
            text += f", {number(row['ratio'])} x {row['baseline']}"
    return text


def verdicts(page: Page, line: Line, rows: Rows) -> list[tuple[str, bool | None]]:
    """Of each bar of a line: its words, and whether it is met; None when the figure was not measured."""
    out: list[tuple[str, bool | None]] = []
    for bar in line.bars:
        column = page.columns[bar.column]
        row, limit, words = figure(column, line, rows), bar.limit, number(bar.limit, 4)
        if bar.than:
            other = figure(column, Line("", bar.than, metric=line.metric), rows)
            limit = None if other is None or other["value"] is None else bar.limit * column.scale * other["value"]
            words = f"{'' if bar.limit == 1 else f'{number(bar.limit)} x '}{bar.than}"
        if bar.highest is not None:
            words += f" to {number(bar.highest, 4)}"
        sign = "" if bar.highest is not None else "≥ " if bar.at_least else "≤ "
        words = f"{column.title} {sign}{words}" if len(page.columns) > 1 else f"{sign}{words}"
        if row is None or limit is None:
            out.append((words, None))
            continue
        value = row["ratio"] if column.ratio else row["value"]
        if value is None:  # not finite: never reached
            out.append((words, False))
            continue
        value *= column.scale * line.scale
        met = value >= limit if bar.at_least else value <= limit
        out.append((words, met and (bar.highest is None or value <= bar.highest)))
    return out


def table(page: Page, rows: Rows) -> str:
    """The Markdown table of a page, its bars in the last column."""
    lines = lines_of(page, rows)
    barred = any(line.bars for line in lines)
    titles = ["", *(c.title for c in page.columns), *([page.more] if page.more else []), *(["bar"] if barred else [])]
    out = ["| " + " | ".join(titles) + " |", "|" + " --- |" * len(titles)]
    for line in lines:
        cells = [line.title, *(cell(c, line, rows) for c in page.columns)]
        cells += [line.more] if page.more else []
        if barred:
            said = {True: "met", False: "**missed**", None: "not measured"}
            cells.append("; ".join(f"{words}: {said[met]}" for words, met in verdicts(page, line, rows)))
        out.append("| " + " | ".join(cells) + " |")
    return "\n".join(out)

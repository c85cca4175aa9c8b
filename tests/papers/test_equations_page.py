"""docs/equations.md: every number of the papers has a row, and what the rows say of code and tests is so."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
NUMBERS = {
    "Alcoverro 2014, chapter 2": [
        *(f"2.{n}" for n in range(1, 22)),
        *(f"Algorithm {n}" for n in range(1, 6)),
        *(f"Table 2.{n}" for n in range(1, 5)),
    ],
    "Alcoverro 2014, chapter 3": [
        *(f"3.{n}" for n in range(1, 7)),
        "Algorithm 6",
        *(f"Table 3.{n}" for n in range(1, 4)),
    ],
    "Asteriadis et al. 2013": [*(str(n) for n in range(1, 9)), "Table 1"],
    "Sminchisescu and Triggs 2001": [*(str(n) for n in range(1, 12)), "Figure 4"],
}


class Row(NamedTuple):
    """One row of the page. paper: its heading; code: module:name, empty where nothing is built."""

    paper: str
    number: str
    code: tuple[str, ...]
    test: str


@cache
def rows() -> tuple[Row, ...]:
    out, paper = [], ""
    for line in (ROOT / "docs/equations.md").read_text().splitlines():
        if line.startswith("## "):
            paper = line[3:].partition(":")[0]
        if not line.startswith("| ") or line.startswith(("| no.", "| ---")):
            continue
        cells = [c.strip() for c in line.strip("|").split("|")]
        assert len(cells) == 5, line
        number, _, code, test, _ = cells
        names = tuple(re.findall(r"`((?:hypose|benchmarks)[\w.]*:[\w.]+)`", code))
        assert names or code.startswith("not built: "), line
        out.append(Row(paper, number, names, test.strip("`")))
    return tuple(out)


def named(row: Row) -> str:
    return f"{row.paper} {row.number}"


def found(name: str) -> object:
    module, _, path = name.partition(":")
    out: object = importlib.import_module(module)
    for part in path.split("."):
        out = getattr(out, part)
    return out


@cache
def written_tests(path: str) -> set[str]:
    tree = ast.parse((ROOT / path).read_text())
    return {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}


@pytest.mark.parametrize("paper", NUMBERS)
def test_every_number_of_the_paper_has_a_row(paper):
    listed = [r.number for r in rows() if r.paper == paper and not r.number.startswith(("§", "Figure"))]
    assert [n for n in NUMBERS[paper] if n not in {r.number for r in rows() if r.paper == paper}] == []
    assert len(listed) == len(set(listed))
    assert set(listed) <= set(NUMBERS[paper])


@pytest.mark.parametrize("row", rows(), ids=named)
def test_what_a_row_names_exists(row: Row):
    path, _, test = row.test.partition("::")
    assert test in written_tests(path), row.test
    assert all(found(name).__doc__ for name in row.code)

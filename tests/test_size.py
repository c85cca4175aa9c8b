"""What counts against the ceilings of size, and that no command raises one."""

import ast

import pytest

from scripts import size

TOML = "[tool.x]\nfiles = 3\n\n[tool.hypose.size]\nstatements = 100\nfiles = 10\n\n[tool.y]\nz = 1\n"


def trees(**sources):
    return {f"hypose/{name.replace('__', '/')}.py": ast.parse(text) for name, text in sources.items()}


def test_statements_are_counted_not_lines():
    assert size.statements(trees(a='def f():\n    """Said\n    at length."""\n    return (\n        1,\n    )')) == 3


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("x = 0.3 + 7", 2),
        ("x = [0, 1, -1, 2, 0.5, 1.0]; y = True; z = '3'", 0),
        ("class FitSettings:\n    sd: float = 0.3", 0),
        ("class Fit:\n    sd: float = 0.3", 1),
        ("def f(x=3): return x[4]", 2),
    ],
)
def test_numbers_that_belong_into_settings(source, count):
    assert size.literals(ast.parse(source)) == count


def test_public_names_that_two_files_define():
    files = trees(a="def f(): ...\nB = C = 1\ndef _g(): ...", b="class f: ...\nB: int = 2\n_g = 1", c="import f, C")
    assert size.twice(files) == ["B", "f"]
    assert size.twice(trees(compute__a="def f(): ...", compute__b="def f(): ...")) == []


def test_long_signatures_leave_out_self_and_kernels():
    nine = "def f(a, b, c, d, e, *, g, h, i, j): ..."
    files = trees(
        a=nine,
        b=nine.replace("a, ", ""),
        c=f"class X:\n    {nine.replace('(a', '(self')}",
        compute__k=f"@kernel\n{nine}",
    )
    assert size.long_signatures(files) == ["hypose/a.py:1 f"]


def test_a_number_above_its_ceiling_or_without_one_is_named():
    assert size.above({"files": 10, "tests": 5}, {"files": 10, "tests": 5}) == []
    assert size.above({"files": 11, "twice": 1}, {"files": 10}) == [
        "size: files is 11, the ceiling is 10",
        "size: twice is 1, the ceiling is missing",
    ]


def test_ceilings_only_fall():
    text = size.lowered(TOML, {"statements": 90, "files": 12})
    assert text == TOML.replace("= 100", "= 90")


def test_the_command_shows_writes_and_fails(tmp_path, monkeypatch, capsys):
    (tmp_path / "pyproject.toml").write_text(TOML)
    monkeypatch.setattr(size, "ROOT", tmp_path)
    monkeypatch.setattr(size, "sizes", lambda: {"statements": 90, "files": 11})
    assert size.main(["--print", "--lower", "--json", str(tmp_path / "size.json")]) == 1
    printed = capsys.readouterr().out
    assert "size: files is 11, the ceiling is 10" in printed and "statements" in printed
    assert "statements = 90\nfiles = 10" in (tmp_path / "pyproject.toml").read_text()
    assert '"metric": "files"' in (tmp_path / "size.json").read_text()

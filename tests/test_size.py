"""What counts against the ceilings of size, and that no command raises one."""

import ast

from scripts import size, words

TOML = "[tool.x]\nfiles = 3\n\n[tool.hypose.size]\nstatements = 100\nfiles = 10\n\n[tool.y]\nz = 1\n"


def trees(**sources):
    return {f"hypose/{name.replace('__', '/')}.py": ast.parse(text) for name, text in sources.items()}


def test_public_names_that_two_files_define():
    files = trees(a="def f(): ...\nB = C = 1\ndef _g(): ...", b="class f: ...\nB: int = 2\n_g = 1", c="import f, C")
    assert size.twice(files) == ["B", "f"]
    assert size.twice(trees(compute__a="def f(): ...", compute__b="def f(): ...")) == []


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


def test_words_that_are_not_used_are_found_in_docstrings_comments_and_names():
    source = '"""What is told."""\nbeside_masks = "beside"  # anew\n\n\ndef f(toldYou): ...\n'
    assert sorted(words.found(source)) == [
        (1, "What is"),
        (1, "told"),
        (2, "anew"),
        (2, "beside (in beside_masks)"),
        (5, "told (in toldYou)"),
    ]

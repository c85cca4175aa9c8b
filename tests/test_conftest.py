"""The rules of a run that tests/conftest.py keeps: nothing left behind, any order, a line on what was not tested."""

import os
import subprocess
import sys
from types import SimpleNamespace

from tests import missing
from tests.conftest import ROOT, files_below, shuffled


def run_of_tests(folder, text, *options):
    """(exit code, lines) of pytest with the rules of this project on a module of this text, in a folder of its own."""
    (folder / "test_it.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-c", os.devnull, "--rootdir", folder, "-rs"]
    command += ["-p", "tests.conftest", "-p", "no:cacheprovider", *(options or [folder / "test_it.py"])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()


def test_what_was_not_tested_is_said_before_the_last_line(tmp_path):
    text = """
from tests import missing
def test_a(): missing.skip("the page", "apt install chromium")
def test_b(): missing.module("no_such_module", "depth", "make setup")
def test_c(): pass
def test_d(tmp_path, monkeypatch):
    (tmp_path / "hurt.py").write_text("raise ImportError('libx.so; not found')")
    monkeypatch.syspath_prepend(tmp_path)
    missing.module("hurt", "x", "pip install hurt")
"""
    code, lines = run_of_tests(tmp_path, text)
    assert code == 0 and "1 passed, 3 skipped" in lines[-1]
    assert lines[-2] == (
        "Not tested: the page (1 test: apt install chromium); depth (1 test: make setup); "
        "x (1 test: mend hurt, which cannot be loaded (libx.so, not found))."
    )
    assert sum("test_it.py:" in line for line in lines if line.startswith("SKIPPED")) == 3
    assert "Not tested" not in "".join(lines[:-2])


def test_what_is_left_behind_is_an_error(tmp_path):
    leaves = {
        "results.npz": "open('results.npz', 'w').close()",
        "results": "os.makedirs('results')",
        ".thing": "pathlib.Path.home().joinpath('.thing').touch()",
        "have changed the working folder": "os.chdir('/')",
        "": "pathlib.Path('note.md').touch(); os.makedirs('__pycache__', exist_ok=True)",  # a person's and Python's
    }
    for k, does in enumerate(leaves.values()):
        (tmp_path / f"test_{k}.py").write_text(f"import os, pathlib\ndef test_it(): {does}\n")
    code, lines = run_of_tests(tmp_path, "def test_it(): pass", tmp_path)
    errors = [line for line in lines if line.startswith("E   ") and "of this module have" in line]
    assert code == 1 and len(errors) == 4 and "6 passed, 4 errors" in lines[-1]
    assert all(told in error for told, error in zip(leaves, errors, strict=False))
    assert not (tmp_path / ".thing").exists()  # the home of whoever runs the tests is not theirs


def test_a_home_that_is_not_set_stays_so(tmp_path, monkeypatch):
    text = "import os\ndef test_it(): assert 'HOME' not in os.environ\n"
    assert run_of_tests(tmp_path, text)[0] == 1
    command = [sys.executable, "-m", "pytest", "-q", "-c", os.devnull, "-p", "tests.conftest", "-p", "no:cacheprovider"]
    bare = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*command, tmp_path / "test_it.py"], cwd=tmp_path, env=bare, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_an_order_keeps_modules_together_and_is_drawn_by_its_seed():
    items = [SimpleNamespace(path=path, name=k) for path in "abcdef" for k in range(5)]
    got = [(i.path, i.name) for i in shuffled(items, 3)]
    assert got == [(i.path, i.name) for i in shuffled(items, 3)] and got != [(i.path, i.name) for i in items]
    assert sorted(got) == [(i.path, i.name) for i in items]
    modules = [path for path, _ in got]
    assert sum(a != b for a, b in zip(modules, modules[1:], strict=False)) == 5
    assert got != [(i.path, i.name) for i in shuffled(items, 4)]


def test_the_line_is_one_part_per_remedy_the_most_tests_first():
    form = "NOT tested: {}; {}".format
    reasons = [form("a", "x"), form("b", "y"), form("c", "y"), "Skipped: " + form("b", "y"), "root may write anywhere"]
    line = missing.closing_line(reasons)
    assert line.startswith("Not tested: b, c (3 tests: y); a (1 test: x); ") and line.endswith(
        "(1 test: listed above)."
    )
    assert missing.closing_line([]) == ""


def test_files_below_leaves_out_what_tools_keep(tmp_path):
    for name in (".cache/x.npz", "web/node_modules/y", "a/b.npz", "a/c.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "empty").mkdir()
    assert files_below(tmp_path) == {os.path.join("a", "b.npz"), "empty"}

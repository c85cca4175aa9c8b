"""The rules of a run that tests/conftest.py keeps: nothing left behind, any order, a line on what was not tested."""

import os
import subprocess
import sys

from tests.conftest import ROOT


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
    assert all(reported in error for reported, error in zip(leaves, errors, strict=False))
    assert not (tmp_path / ".thing").exists()  # the home of whoever runs the tests is not theirs

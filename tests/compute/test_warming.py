"""Compiling ahead: in other processes, nothing twice, and what happens when one of them fails."""

import os
import subprocess
import sys

import pytest

from hypose.compute import compiled, warming
from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """(the parts that ran in this process, those that another was asked for) with a cache of its own; the other fails
    with outlines."""
    here, others = [], []
    made = {name: (lambda part=name: here.append(part),) for name in warming.KERNEL_GROUPS}
    monkeypatch.setattr(warming, "KERNEL_GROUPS", made)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(warming, "failures", [])
    assert warming._can_keep()  # makes the folder

    def elsewhere(part, began):
        others.append(part)
        if part != "outlines":
            warming._mark(part).touch()

    monkeypatch.setattr(warming, "_in_another_process", elsewhere)
    return here, others


def test_what_is_there_is_not_done_again_and_nothing_twice(parts):
    here, others = parts
    warm_up("solver", load=False)  # nothing to share out
    assert (here, others) == (["solver"], [])
    warm_up("solver", "scorer", "pictures", load=False)
    assert (here, sorted(others)) == (["solver"], ["pictures", "scorer"])
    warm_up("scorer")
    assert here == ["solver", "scorer"] and kept("solver", "scorer")


def test_what_another_process_could_not_do_is_done_here(parts):
    here, others = parts
    warm_up(load=False)
    assert here == ["outlines"] and sorted(others) == sorted(TRACKING_KERNELS)


@pytest.mark.parametrize("change", [(compiled, "cache_folder", lambda: None), (sys, "executable", "/opt/bin/studio")])
def test_where_nothing_can_be_kept_or_python_is_embedded_only_this_process_compiles(parts, monkeypatch, change):
    here, others = parts
    monkeypatch.setattr(*change)
    warm_up("solver", "scorer", load=False)
    assert (here, others) == (["solver", "scorer"], []) and kept("solver") == (change[0] is sys)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="rights as on POSIX")
def test_a_group_that_shares_a_cache_shares_what_is_compiled(tmp_path, monkeypatch):
    tmp_path.chmod(0o770)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    assert warming._can_keep()
    (folder,) = tmp_path.iterdir()
    assert folder.stat().st_mode & 0o777 == 0o770


def test_a_compiling_process_imports_nothing_of_the_folder_it_stands_in_and_ends_with_its_input(tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit('not the numpy of this installation')")
    environment = {**os.environ, "HYPOSE_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-P", "-c", warming._PROGRAM, "\n".join(sys.path), "solver"]
    done = subprocess.run(command, cwd=tmp_path, input=b"", capture_output=True, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (1, b"", b"")
    assert len(list(tmp_path.glob("cache/*/*.kernel"))) < 20  # of some tens

"""Compiling ahead: what processes share, what is not done twice, and what happens when one of them fails."""

import contextlib
import os
import subprocess
import sys

import numpy as np
import pytest

from hypose import compute
from hypose.compute import compiled, warming


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """(the parts that ran in this process, the shares of others) with a cache of its own and two cores."""
    here, others = [], []
    made = {name: lambda _, name=name: here.append(name) for name in warming.PARTS}
    monkeypatch.setattr(warming, "PARTS", made)
    monkeypatch.setattr(warming, "default_threads", lambda: 2)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    (tmp_path / compiled._VERSIONS).mkdir()

    @contextlib.contextmanager
    def processes(shares):
        done = []
        yield done
        for share in shares:
            others.append(share)
            done += share if "shape" not in share else []  # the one that makes this ends with an error

    monkeypatch.setattr(warming, "_processes", processes)
    return here, others


def test_what_another_process_could_not_do_is_done_here_and_nothing_twice(parts):
    here, others = parts
    compute.warm_up("solver", "scorer", load=False)
    assert (here, others) == (["solver"], [["scorer"]])
    compute.warm_up("solver", "pictures", load=False)  # nothing to share out
    assert (here, others) == (["solver", "pictures"], [["scorer"]])
    compute.warm_up("solver", "scorer", "pictures", load=False)
    assert len(here) == 2 and len(others) == 1
    compute.warm_up("scorer")
    assert here[2:] == ["scorer"]


def test_a_process_that_fails_leaves_its_parts_to_whoever_asked(parts):
    here, others = parts
    compute.warm_up(load=False)
    assert others == [["scorer", "shape", "pictures"]]
    assert here == ["solver", "outlines", *others[0]]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_shares_hold_every_part_once_the_dearest_first(count):
    names = ["solver", "scorer", "outlines", "pictures", "monocular"]
    shares = warming._shared_out(names, count)
    assert len(shares) == count and "solver" in shares[0]
    assert sorted(n for share in shares for n in share) == sorted(names)
    costs = [sum(warming._COST[n] for n in share) for share in shares]
    assert max(costs) <= max(warming._COST["solver"], 1.2 * sum(costs) / count)


def test_other_sources_are_not_ready(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    file = compiled.ready("solver")
    assert file != compiled.ready("scorer") and file == compiled.ready("solver")
    (tmp_path / "own.py").write_text("x = 1")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert compiled.ready("solver") != file
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    assert compiled.ready("solver") is None


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="rights as on POSIX")
def test_a_group_that_shares_a_cache_shares_what_is_compiled(tmp_path, monkeypatch):
    tmp_path.chmod(0o770)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    assert compiled.can_keep()
    assert (tmp_path / compiled._VERSIONS).stat().st_mode & 0o777 == 0o770


def test_a_folder_that_cannot_be_looked_into_is_compiled_for(parts, monkeypatch):
    look = os.stat

    def refused(path, **options):
        if compiled._VERSIONS in str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return look(path, **options)

    here, others = parts
    monkeypatch.setattr(os, "stat", refused)
    compute.warm_up("solver", "scorer", load=False)
    assert (here, others) == (["solver", "scorer"], [])  # nobody compiles what cannot be kept


def test_what_could_not_be_kept_is_not_said_to_be_there(parts, monkeypatch):
    here, _ = parts
    monkeypatch.setitem(warming.PARTS, "solver", lambda _: compiled._not_kept.append("solve"))
    monkeypatch.setattr(compiled, "_not_kept", [])
    compute.warm_up("solver", load=False)
    assert not compute.kept("solver")
    compute.warm_up("pictures", load=False)
    assert compute.kept("pictures") and here == ["pictures"]


def test_what_nobody_used_for_long_goes_with_that_of_older_versions(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    files = [tmp_path / folder / name for folder in ("kernels-old", compiled._VERSIONS) for name in ("a", "b")]
    for file in files:
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"")
    for file in files[::2]:
        os.utime(file, (0, 0))
    assert compiled.can_keep()
    assert [file.exists() for file in files] == [False, True, False, True]


def test_a_compiling_process_imports_nothing_of_the_folder_it_stands_in(tmp_path):
    (tmp_path / "numpy.py").write_text("raise SystemExit('not the numpy of this installation')")
    with subprocess.Popen(warming._command([]), cwd=tmp_path, stdin=subprocess.PIPE) as process:
        assert process.wait() == 0


def test_a_compiling_process_ends_with_whoever_asked(tmp_path):
    environment = {**os.environ, "HYPOSE_CACHE_DIR": str(tmp_path)}
    with subprocess.Popen(warming._command(["solver"]), env=environment, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait() == 1
    assert len(list(tmp_path.glob("*/*.kernel"))) < 5  # of some tens


def test_a_program_that_python_is_embedded_in_is_not_started_again(monkeypatch):
    began = []
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: began.append(a))
    monkeypatch.setattr(sys, "executable", "/opt/studio/bin/studio")
    with warming._processes([["solver"]]) as done:
        pass
    assert not done and not began


def called(a, b):
    return a[0] * b


def test_kernels_that_kernels_call_are_compiled_once_for_all_constants(monkeypatch):
    kept = []
    monkeypatch.setattr(compiled.KernelCache, "save_overload", lambda self, sig, _: kept.append(self._function))
    inner = compiled.kernel(called)
    outer = compiled.kernel(lambda a: inner(a, 2) + inner(a, 3) + inner(a, a.shape[0]))
    a = np.array([1.5, 0, 0, 0])
    assert outer(a) == 1.5 * 9
    assert inner.signatures == [] and called not in kept  # no way in from Python was compiled
    assert inner(a, 5) == 7.5 and len(inner.signatures) == 1 and kept[-1] is called
    assert compiled.kernel(lambda a: inner(a, 4))(a) == 6.0 and len(inner.signatures) == 1

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
    """(the pieces that ran in this process, those that another took) with a cache of its own and two cores; the other
    takes whatever is left at once, and fails with what fits a body."""
    here, others = [], []
    made = {
        name: tuple(lambda _, piece=(name, k): here.append(piece) for k in range(len(pieces)))
        for name, pieces in warming.PARTS.items()
    }
    monkeypatch.setattr(warming, "PARTS", made)
    monkeypatch.setattr(warming, "default_threads", lambda: 2)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    (tmp_path / compiled._VERSIONS).mkdir()

    @contextlib.contextmanager
    def processes(count, left):
        undone = []
        taken = [left.pop(0) for _ in range(count * len(left))]
        others.extend(taken)
        yield undone
        undone += [piece for piece in taken if piece[0] == "shape"]

    monkeypatch.setattr(warming, "_processes", processes)
    return here, others


def test_what_is_there_is_not_done_again_and_nothing_twice(parts):
    here, others = parts
    compute.warm_up("solver", "scorer", load=False)
    assert (here, others) == ([("solver", 0)], [("scorer", 0), ("scorer", 1)])
    compute.warm_up("solver", "shape", load=False)  # nothing to share out
    assert here == [("solver", 0), ("shape", 0)] and len(others) == 2
    compute.warm_up("solver", "scorer", "shape", load=False)
    assert len(here) == 2 and len(others) == 2
    compute.warm_up("scorer")
    assert here[2:] == [("scorer", 0), ("scorer", 1)]


def test_a_process_that_fails_leaves_its_piece_to_whoever_asked(parts):
    here, others = parts
    compute.warm_up(load=False)
    assert here == [("solver", 0), ("shape", 0)]
    costs = [warming._cost(piece) for piece in others]
    assert costs == sorted(costs, reverse=True) and len(set(others)) == 8


def test_no_more_processes_than_have_something_to_do():
    for names, count in ((["solver"], 1), (["solver", "scorer"], 2), (["shape", "outlines"], 3)):
        assert warming._worth(warming._dearest_first(names)) == count
    assert {name: len(pieces) for name, pieces in warming.PARTS.items()} == {
        name: len(costs) for name, costs in warming._COST.items()
    }


def test_a_process_takes_pieces_until_none_is_left_and_leaves_the_one_it_ends_in(tmp_path, monkeypatch):
    program = "import sys\nfor line in sys.stdin:\n    if 'scorer' in line: break\n    print('kept', flush=True)\n"
    monkeypatch.setattr(warming, "_command", lambda: [sys.executable, "-c", program])
    left = [("solver", 0), ("outlines", 0), ("scorer", 0), ("shape", 0)]
    with warming._processes(1, left) as undone:
        pass
    assert (left, undone) == ([("shape", 0)], [("scorer", 0)])


def test_other_sources_are_not_ready(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    (tmp_path / compiled._VERSIONS).mkdir()
    compiled.note_ready("solver")
    assert compiled.is_ready("solver") and not compiled.is_ready("scorer")
    (tmp_path / "own.py").write_text("x = 1")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert not compiled.is_ready("solver")
    compiled.note_ready("solver")
    assert compiled.is_ready("solver")
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    compiled.note_ready("solver")
    assert not compiled.is_ready("solver")


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
    assert (here, others) == ([("solver", 0), ("scorer", 0), ("scorer", 1)], [])  # nobody compiles what cannot be kept


def test_what_could_not_be_kept_is_not_said_to_be_there(parts, monkeypatch):
    here, _ = parts
    monkeypatch.setitem(warming.PARTS, "solver", (lambda _: compiled._not_kept.append("solve"),))
    monkeypatch.setattr(compiled, "_not_kept", [])
    compute.warm_up("solver", load=False)
    assert not compute.kept("solver")
    compute.warm_up("shape", load=False)
    assert compute.kept("shape") and here == [("shape", 0)]


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
    answer = subprocess.run(warming._command(), cwd=tmp_path, input=b"", capture_output=True, check=True)
    assert answer.stdout == answer.stderr == b""


def test_a_compiling_process_ends_with_whoever_asked(tmp_path):
    environment = {**os.environ, "HYPOSE_CACHE_DIR": str(tmp_path)}
    subprocess.run(warming._command(), env=environment, input=b"solver 0\nscorer 0\n", check=True)
    assert len(list(tmp_path.glob("*/*.kernel"))) < 5  # of some tens


def test_a_program_that_python_is_embedded_in_is_not_started_again(monkeypatch):
    began = []
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: began.append(a))
    monkeypatch.setattr(sys, "executable", "/opt/studio/bin/studio")
    left = [("solver", 0)]
    with warming._processes(1, left) as undone:
        pass
    assert not undone and not began and left == [("solver", 0)]


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

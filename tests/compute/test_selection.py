"""Choosing the back end, and spreading work over threads."""

import subprocess
import sys

import pytest

from hypose import compute
from hypose.compute import selection


def test_importing_the_package_does_not_import_numba():
    rooms = "hypose.compute, hypose.body.skeleton, hypose.fitting, hypose.fusion.fuse, hypose.gestures.forest"
    code = f"import sys, {rooms}; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_back_end_is_restored_after_the_block_and_after_an_error():
    assert selection.backend() == "numba"
    with pytest.raises(ZeroDivisionError), compute.use("numpy"):
        assert selection.backend() == "numpy"
        raise ZeroDivisionError
    assert selection.backend() == "numba"


@pytest.mark.parametrize(("n", "threads"), [(0, 2), (1, 4), (7, 3), (16, 1)])
def test_chunks_cover_everything_once(n, threads):
    seen = [0] * n

    def work(first, last):
        for k in range(first, last):
            seen[k] += 1

    selection.over_chunks(work, n, threads)
    assert seen == [1] * n


def test_an_error_in_any_chunk_is_raised():
    def work(first, last):
        if last == 6:
            raise ValueError("in the last chunk")

    with pytest.raises(ValueError, match="last chunk"):
        selection.over_chunks(work, 6, 3)


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_call_beside_is_made_once_whoever_makes_it(threads, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    made = []
    results = [selection.beside(lambda n=n: made.append(n) or n * n) for n in range(5)]
    assert [result() for result in results] == [0, 1, 4, 9, 16]
    assert sorted(made) == [0, 1, 2, 3, 4]

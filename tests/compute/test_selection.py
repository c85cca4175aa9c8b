"""Choosing the back end, spreading work over threads, and never running kernels older than their source."""

import os
import subprocess
import sys

import pytest

from hypose import compute
from hypose.compute import selection


def test_importing_the_package_does_not_import_numba():
    code = "import sys, hypose.compute, hypose.body.skeleton, hypose.fitting; assert 'numba' not in sys.modules"
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


def test_kernels_older_than_a_source_they_are_made_from_are_forgotten(tmp_path, monkeypatch):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    now = 1_700_000_000
    sources = {"far": "", "near": "from hypose.compute.far import x\n", "own": "", "other": ""}
    sources["own"] = "from hypose.compute.near import (\n    y,\n)\n"
    for name, text in sources.items():
        (tmp_path / f"{name}.py").write_text(text)
        os.utime(tmp_path / f"{name}.py", (now + 10 * (name == "far"),) * 2)
        for kernel, age in (("old", 5), ("new", 20)):
            (cache / f"{name}.{kernel}-1.py311.nbi").write_text("")
            os.utime(cache / f"{name}.{kernel}-1.py311.nbi", (now + age,) * 2)
    monkeypatch.setattr(selection, "__file__", str(tmp_path / "selection.py"))
    selection.drop_stale_kernels.__wrapped__()
    left = sorted(p.name.split("-")[0] for p in cache.iterdir())
    assert left == ["far.new", "near.new", "other.new", "other.old", "own.new"]

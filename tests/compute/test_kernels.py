"""The cache of compiled kernels: found again, never trusted blindly, and never the end of a run."""

import hashlib
import importlib
import logging
import os
import pkgutil
import shutil
import subprocess
import sys

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from hypose import compute
from hypose.compute import compiled


def add(a, b):
    return a + b


@pytest.fixture
def place(tmp_path, monkeypatch, caplog):
    caplog.set_level(logging.WARNING, "hypose")
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    compiled.log_cache.cache_clear()
    compiled.make_folder.cache_clear()
    yield tmp_path
    compiled.log_cache.cache_clear()
    compiled.make_folder.cache_clear()


def compiled_anew():
    """A new dispatcher, as in a new process: (its sum of 2 and 3, was it compiled and not loaded)."""
    function = compiled.kernel(add)
    return function(2.0, 3.0), sum(function.stats.cache_misses.values()) == 1


def files(place):
    return sorted(place.glob("*/*"))


def test_a_kernel_is_compiled_once_and_found_again(place, caplog):
    assert compiled_anew() == (5.0, True)
    assert len(files(place)) == 1
    assert compiled_anew() == (5.0, False)
    assert compiled.kernel(add)(2, 3) == 5  # another signature, another file
    assert len(files(place)) == 2
    assert not caplog.records


def _flip(data):
    changed = bytearray(data)
    changed[len(data) // 2] ^= 1
    return bytes(changed)


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:10],
        lambda data: data[: len(data) // 2],
        lambda data: data + b"x",
        lambda data: bytes(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8)),
        _flip,
        lambda data: hashlib.sha256(b"no kernel").digest() + b"no kernel",
    ],
    ids=["empty", "head", "half", "longer", "garbage", "one bit", "right checksum of garbage"],
)
def test_a_damaged_file_is_compiled_again_and_said_once(place, caplog, damage):
    compiled_anew()
    (path,) = files(place)
    whole = path.read_bytes()
    for _ in range(2):
        path.write_bytes(damage(whole))
        assert compiled_anew() == (5.0, True)
        assert compiled_anew() == (5.0, False)
    assert path.read_bytes()[:32] == hashlib.sha256(path.read_bytes()[32:]).digest()
    assert [r.message for r in caplog.records] == [
        f"Damaged files of compiled code in {path.parent} are compiled again."
    ]


def test_a_full_disk_leaves_no_half_file(place, caplog, monkeypatch):
    def full(self, data):
        with open(self, "wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    assert compiled_anew() == (5.0, True)
    assert files(place) == []
    assert "no space left" in caplog.text


def test_files_that_have_not_been_used_for_long_are_removed(place):
    compiled_anew()
    (path,) = files(place)
    old = [path.with_name("old.kernel"), place / "kernels-of-before" / "x.kernel"]
    for one in old:
        one.parent.mkdir(exist_ok=True)
        one.write_bytes(b"")
        os.utime(one, (0, 0))
    compiled.make_folder.cache_clear()
    compiled.kernel(add)(2, 3)
    assert path.exists() and not any(one.exists() for one in old)


@pytest.fixture
def run_room(tmp_path):
    """A function that imports the room of kernels of a tiny package in a new process: prints outer(1.0) and how often
    it was compiled; and the room's folder."""
    room = tmp_path / "hypose" / "compute"
    room.mkdir(parents=True)
    (tmp_path / "hypose" / "__init__.py").write_text("")
    (room / "__init__.py").write_text("")
    shutil.copy(compiled.__file__, room)
    head = "from hypose.compute.compiled import kernel\n"
    (room / "inner.py").write_text(f"{head}@kernel\ndef inner(x):\n    return x + 1\n")
    (room / "outer.py").write_text(
        f"{head}from hypose.compute.inner import inner\n@kernel\ndef outer(x):\n    return 10 * inner(x)\n"
    )
    program = "from hypose.compute.outer import outer; print(outer(1.0), sum(outer.stats.cache_misses.values()))"
    environment = {**os.environ, "HYPOSE_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}

    def run():
        return subprocess.Popen(
            [sys.executable, "-c", program], cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True
        )

    return run, room


def test_an_edited_inner_function_in_another_file_is_seen(run_room):
    run, room = run_room
    assert [run().communicate()[0].split() for _ in range(2)] == [["20.0", "1"], ["20.0", "0"]]
    source = room / "inner.py"
    written = os.stat(source).st_mtime
    source.write_text(source.read_text().replace("x + 1", "x + 2"))
    os.utime(source, (written,) * 2)
    run().communicate()  # an edit within the same second: Python runs its older bytecode
    os.utime(source, (written + 2,) * 2)
    later = [run().communicate()[0].split() for _ in range(2)]
    assert [value for value, _ in later] == ["30.0"] * 2 and later[1][1] == "0"


def test_two_processes_at_once_find_the_same_and_leave_whole_files(run_room):
    run, room = run_room
    both = [run() for _ in range(2)]
    assert [process.communicate()[0].split()[0] for process in both] == ["20.0", "20.0"]
    assert run().communicate()[0].split() == ["20.0", "0"]
    assert {path.suffix for path in (room.parents[1] / "cache").glob("*/*")} == {".kernel"}


def test_no_kernel_lets_the_processor_choose_the_order_of_sums():
    names = [m.name for m in pkgutil.walk_packages(compute.__path__, "hypose.compute.")]
    found = {v for name in names for v in vars(importlib.import_module(name)).values() if isinstance(v, Dispatcher)}
    assert len(found) > 100
    for kernel in found:
        assert not kernel.targetoptions.get("fastmath"), kernel
        assert isinstance(kernel._cache, compiled.KernelCache), kernel

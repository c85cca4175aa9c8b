"""The cache of compiled kernels: found again, never trusted blindly, and never the end of a run."""

import importlib
import logging
import os
import pkgutil

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from hypose import compute
from hypose.compute import cache_place, compiled


def add(a, b):
    return a + b


@pytest.fixture
def place(tmp_path, monkeypatch, caplog):
    caplog.set_level(logging.WARNING, "hypose")
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    cache_place.note.cache_clear()
    compiled._folder_for_writing.cache_clear()
    yield tmp_path
    cache_place.note.cache_clear()
    compiled._folder_for_writing.cache_clear()


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


def test_what_calls_a_kernel_from_disk_has_a_copy_of_its_own(place):
    compiled_anew()
    found = compiled.kernel(add)
    assert found(2.0, 3.0) == 5.0 and not found.stats.cache_misses
    caller = compiled.kernel(lambda a: found(a, 1.0) + found(a, a))
    assert caller(2.0) == 7.0 and not found.stats.cache_misses
    again = compiled.kernel(caller.py_func)
    assert again(2.0) == 7.0 and not again.stats.cache_misses


def test_a_file_holds_machine_code_alone(place):
    compiled_anew()
    (path,) = files(place)
    (name, kind, (code, names)), *_, environments = compiled.loads(path.read_bytes()[len(compiled._MAGIC) + 32 :])
    assert (name, kind, environments) == ("add", "object", ()) and isinstance(code, bytes)
    assert sum("cpython" in one for one in names) == 1
    assert path.stat().st_size < len(code) + 8000


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
        lambda data: compiled._sealed(b"the checksum holds, but this is no kernel"),
    ],
    ids=["empty", "head", "half", "longer", "garbage", "one bit", "sealed garbage"],
)
def test_a_damaged_file_is_thrown_away_compiled_again_and_told_once(place, caplog, damage):
    compiled_anew()
    (path,) = files(place)
    whole = path.read_bytes()
    for _ in range(2):
        path.write_bytes(damage(whole))
        assert compiled_anew() == (5.0, True)
        assert compiled_anew() == (5.0, False)
    assert path.read_bytes()[:16] == compiled._MAGIC
    assert [r.message for r in caplog.records] == [
        f"Damaged files of compiled code in {path.parent} are thrown away and compiled again."
    ]


def test_a_place_that_cannot_be_written_costs_time_only(place, caplog, monkeypatch):
    blocked = place / "file"
    blocked.write_text("")
    monkeypatch.setattr(compiled, "cache_folder", lambda: blocked)
    assert compiled_anew() == (5.0, True)
    assert compiled_anew() == (5.0, True)
    messages = [r.message for r in caplog.records]
    assert len(messages) == len(set(messages)) <= 2 and any("compiles it again" in m for m in messages)


def test_a_full_disk_leaves_no_half_file(place, caplog, monkeypatch):
    def full(self, data):
        with open(self, "wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    assert compiled_anew() == (5.0, True)
    assert files(place) == []
    assert "no space left" in caplog.text


def test_without_a_place_kernels_are_compiled_in_every_process(monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    assert compiled_anew() == (5.0, True)
    assert compiled_anew() == (5.0, True)


def test_files_that_nobody_has_used_for_long_are_forgotten(place):
    compiled_anew()
    (path,) = files(place)
    old = path.with_name("old.kernel")
    old.write_bytes(b"")
    os.utime(old, (0, 0))
    compiled._folder_for_writing.cache_clear()
    compiled.kernel(add)(2, 3)
    assert path.exists() and not old.exists()


def test_a_kernel_is_made_from_all_that_it_imports_of_the_room(tmp_path, monkeypatch):
    room = tmp_path / "hypose" / "compute"
    (room / "rows").mkdir(parents=True)
    sources = {
        "far": "",
        "rows/near": "from hypose.compute.far import x\n",
        "own": "from hypose.compute.rows.near import (\n    y,\n)\n",
        "other": "",
    }
    for name, text in sources.items():
        (room / f"{name}.py").write_text(text)
    monkeypatch.setattr(compiled, "__file__", str(room / "kernels.py"))

    def digests():
        compiled._digest_of_sources.cache_clear()
        return [compiled._digest_of_sources(f"hypose.compute.{m}") for m in ("own", "rows.near", "other")]

    own, near, other = digests()
    assert len({own, near, other}) == 3
    (room / "far.py").write_text("x = 1\n")
    changed = digests()
    assert changed[0] != own and changed[1] != near and changed[2] == other
    compiled._digest_of_sources.cache_clear()
    assert compiled._digest_of_sources("hypose.compute.absent") is None
    compiled._digest_of_sources.cache_clear()


def test_no_kernel_lets_the_processor_choose_the_order_of_sums():
    names = [m.name for m in pkgutil.walk_packages(compute.__path__, "hypose.compute.")]
    found = {v for name in names for v in vars(importlib.import_module(name)).values() if isinstance(v, Dispatcher)}
    assert len(found) > 100
    for kernel in found:
        assert not kernel.targetoptions.get("fastmath"), kernel
        assert isinstance(kernel._cache, compiled.KernelCache), kernel

"""Compiled code that comes with a wheel: found where there is no cache, and never in the way."""

import os
import platform
import subprocess
import sys

import pytest

from hypose import compute
from hypose.compute import ready_made
from hypose.compute.cache_place import VARIABLE, cache_folder

_START = """
import sys
from pathlib import Path
from hypose.compute import ready_made
ready_made.FILE = Path(sys.argv[1])
from hypose import compute
from hypose.compute import compiled

def compile_extra(self, function):
    raise AssertionError(f"{function} was compiled")

if sys.argv[2] == "must not compile":
    compiled._Compiler.compile_extra = compile_extra
assert compute.kept("outlines") == (sys.argv[2] == "must not compile")
compute.warm_up("outlines")
print(compute.kept("outlines"))
"""


def start(file, how, cache):
    """What a process with this file says that has another cache, or none (a file)."""
    environment = {**os.environ, VARIABLE: str(cache), "HOME": "/nonexistent", "TMPDIR": str(cache)}
    environment.pop("XDG_CACHE_HOME", None)
    command = [sys.executable, "-c", _START, str(file), how]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """The file that a wheel would have, of what the tests' own cache holds."""
    compute.warm_up("outlines", load=False)
    place, file = cache_folder(), tmp_path_factory.mktemp("packed") / "kernels.tar.xz"
    assert place is not None and ready_made.pack(place, file) > 5
    return file


def test_a_fresh_cache_is_not_compiled_for_and_stays_empty(packed, tmp_path):
    run = start(packed, "must not compile", tmp_path)
    assert (run.returncode, run.stdout, run.stderr) == (0, "True\n", "")
    assert not list(tmp_path.rglob("*.kernel"))


def test_a_damaged_file_costs_time_and_no_run(packed, tmp_path):
    bad, cache = tmp_path / "kernels.tar.xz", tmp_path / "cache"
    cache.mkdir(mode=0o700)
    bad.write_bytes(packed.read_bytes()[:-3000])
    run = start(bad, "may compile", cache)
    assert (run.returncode, run.stdout) == (0, "True\n"), run.stderr
    assert run.stderr.count("cannot be read") == 1 and list(cache.rglob("*.kernel"))


def test_of_other_sources_nothing_is_taken(packed, tmp_path, monkeypatch):
    from hypose.compute import compiled

    monkeypatch.setattr(ready_made, "FILE", packed)
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    ready_made.ready_made.cache_clear()
    try:
        assert compiled.is_ready("outlines")
        monkeypatch.setattr(compiled, "_digest_of_room", lambda _: "others")
        assert not compiled.is_ready("outlines")
    finally:
        ready_made.ready_made.cache_clear()


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="families of x86-64")
@pytest.mark.parametrize(
    ("before", "named"),
    [
        ("", "x86-64-v3"),
        ("os.environ['NUMBA_CPU_NAME'] = 'haswell'", "haswell"),
        ("import numba", None),
        ("binding.get_host_cpu_features = lambda: {'avx2': True}", None),
    ],
)
def test_a_processor_is_named_by_its_family_where_nobody_has_named_it(before, named):
    program = f"import os; from llvmlite import binding; {before}\nimport hypose.compute.compiled\n"
    program += "import numba; print(numba.config.CPU_NAME)"
    clean = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")}
    run = subprocess.run([sys.executable, "-c", program], env=clean, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == str(named)

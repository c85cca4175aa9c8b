"""A damaged or half-written .pyc never ends a command."""

import os
import subprocess
import sys
from importlib.util import cache_from_source
from pathlib import Path

import pytest

PROGRAM = """
import sys
from hypose.app.bytecode import check_bytecode
check_bytecode()
sys.path.insert(0, sys.argv[1])
if len(sys.argv) > 2:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
import patient
print(patient.VALUE)
"""


@pytest.fixture
def patient(tmp_path):
    """A module's folder, where its bytecode goes, and a function that imports it in a new process."""
    source = tmp_path / "patient.py"
    source.write_text("VALUE = 'whole'\n" + "\n".join(f"x{k} = {k}" for k in range(200)))
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX")}

    def load(*limit):
        command = [sys.executable, "-c", PROGRAM, str(tmp_path), *map(str, limit)]
        return subprocess.run(command, env=environment, capture_output=True, text=True)

    return Path(cache_from_source(str(source))), load


@pytest.mark.parametrize("keep", [0, 5, 16, 40, 0.5, 0.99], ids=str)
def test_damaged_bytecode_is_made_again(patient, keep):
    pyc, load = patient
    assert load().stdout == "whole\n"
    whole = pyc.read_bytes()
    pyc.write_bytes(whole[: keep if isinstance(keep, int) else int(len(whole) * keep)])
    for _ in range(3):
        run = load()
        assert (run.returncode, run.stdout, run.stderr) == (0, "whole\n", "")
    assert pyc.read_bytes() == whole


def test_garbage_behind_a_good_head_is_made_again(patient):
    pyc, load = patient
    load()
    whole = pyc.read_bytes()
    pyc.write_bytes(whole[:16] + b"\xff" * 300)
    assert load().stdout == "whole\n"


@pytest.mark.skipif(sys.platform == "win32", reason="limits as on POSIX")
@pytest.mark.parametrize("limit", [0, 10, 500])
def test_half_a_file_of_bytecode_is_never_left(patient, limit):
    pyc, load = patient
    run = load(limit)
    assert (run.returncode, run.stdout, run.stderr) == (0, "whole\n", "")
    assert not pyc.exists()
    assert load().stdout == "whole\n" and pyc.exists()

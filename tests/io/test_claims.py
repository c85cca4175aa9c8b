"""Two runs never write into one folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hypose.errors import InputError
from hypose.io.files import LOCK, claimed

HOLD = "import sys; from hypose.io.files import claimed\nwith claimed(sys.argv[1]): print('held', flush=True); input()"


@pytest.fixture
def holder(tmp_path):
    """A process that holds tmp_path/out until its input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path / "out"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_run_ends_at_once_and_says_who_is_first(holder, tmp_path):
    sentence = rf"out is being written to by another run of hypose .process {holder.pid} on .*--to"
    with pytest.raises(InputError, match=sentence), claimed(tmp_path / "out", "--to"):
        raise AssertionError
    holder.communicate("\n")
    assert list((tmp_path / "out").iterdir()) == []
    with claimed(tmp_path / "out"):
        assert (tmp_path / "out" / LOCK).read_text().startswith(f"process {os.getpid()} on ")


def test_a_killed_run_holds_nothing(holder, tmp_path):
    holder.kill()
    holder.wait()
    assert (tmp_path / "out" / LOCK).exists()
    with claimed(tmp_path / "out"):
        pass
    assert list((tmp_path / "out").iterdir()) == []


def test_what_a_run_leaves_behind_is_no_claim_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), claimed(tmp_path):
            raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: flock; run the tests on Linux")
def test_a_file_system_without_locks_costs_nothing(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    with claimed(tmp_path), claimed(tmp_path):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: links; run the tests on Linux")
def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / LOCK).symlink_to(victim)
    with claimed(tmp_path / "out"):
        pass
    assert victim.read_text() == "precious"


def test_a_folder_that_cannot_be_written_is_told_before_the_work(tmp_path):
    Path(tmp_path / "file").write_text("in the way")
    sentence = r"results cannot be written .*choose a folder .* with --out\."
    with pytest.raises(InputError, match=sentence), claimed(tmp_path / "file" / "results"):
        raise AssertionError

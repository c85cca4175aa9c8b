"""One folder for what can be made again: the variable, the user's cache, a temporary folder, none."""

import logging
import os
import subprocess
import sys

import pytest

from hypose.compute import compiled


@pytest.fixture
def choose(tmp_path, monkeypatch, caplog):
    """choose(variable) -> the folder chosen with a home and a temporary folder below tmp_path."""
    caplog.set_level(logging.WARNING, "hypose")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("home", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))

    def chosen(variable=None):
        if variable is None:
            monkeypatch.delenv(compiled.VARIABLE, raising=False)
        else:
            monkeypatch.setenv(compiled.VARIABLE, str(variable))
        compiled.log_cache.cache_clear()
        return compiled.cache_folder.__wrapped__()

    return chosen


def block(folder):
    """A file where a folder is wanted: also the superuser cannot write there."""
    folder.rmdir()
    folder.write_text("")


def test_the_order_is_the_variable_the_users_cache_a_temporary_folder_none(tmp_path, choose, caplog):
    assert choose(tmp_path / "own") == tmp_path / "own"
    assert choose() == tmp_path / "home" / ".cache" / "hypose"
    assert not caplog.records
    (tmp_path / "home" / ".cache" / "hypose").rmdir()
    (tmp_path / "home" / ".cache").rmdir()
    block(tmp_path / "home")
    temporary = choose()
    assert temporary.parent == tmp_path / "tmp" and temporary.stat().st_mode & 0o777 == 0o700
    assert not caplog.records
    temporary.rmdir()
    block(tmp_path / "tmp")
    assert choose() is None
    assert [r.message for r in caplog.records] == [
        "No folder can be written for the cache, so every start compiles again; name one with HYPOSE_CACHE_DIR."
    ]


def test_a_variable_that_cannot_be_used_is_told_and_passed_over(tmp_path, choose, caplog):
    (tmp_path / "file").write_text("")
    assert choose(tmp_path / "file" / "below") == tmp_path / "home" / ".cache" / "hypose"
    (message,) = [r.message for r in caplog.records]
    assert "HYPOSE_CACHE_DIR" in message and "not a directory" in message


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="rights as on POSIX")
def test_a_folder_that_others_may_write_to_is_not_trusted(tmp_path, choose, caplog):
    own = tmp_path / "own"
    own.mkdir()
    own.chmod(0o777)
    assert choose(own) == tmp_path / "home" / ".cache" / "hypose"
    assert "other users may write there" in caplog.text
    own.chmod(0o775)  # a group that shares a cache says so by name
    assert choose(own) == own
    assert choose(f"{own}/") == own
    users = tmp_path / "home" / ".cache" / "hypose"
    users.chmod(0o775)
    assert choose().parent == tmp_path / "tmp"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="rights as on POSIX")
def test_a_foreign_folder_is_taken_only_when_it_is_named(tmp_path, choose, monkeypatch):
    folder = choose()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    if folder.stat().st_uid != 0:  # what the superuser made is trusted
        other = choose()
        assert other is None or other.parent != folder.parent
    assert choose(folder) == folder


def test_a_filled_folder_serves_although_it_cannot_be_written(tmp_path, choose, monkeypatch):
    own = tmp_path / "own"
    own.mkdir()
    (own / "kernels").mkdir()

    def read_only(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", read_only)
    assert choose(own) == own


PROGRAM = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
import numpy as np
from hypose.compute.mask_distance import signed_distance
print(signed_distance(np.ones((1, 8), np.uint8)).shape[0])
from hypose.compute.compiled import kernel
print(kernel(lambda a: a + 1)(1))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits as on POSIX")
@pytest.mark.parametrize("user", [None, "/nonexistent", "/dev/null"])
def test_a_process_that_may_not_write_a_byte_runs_kernels(tmp_path, user):
    environment = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME", compiled.VARIABLE)}
    environment |= {"XDG_CACHE_HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    if user is not None:
        environment |= {"HOME": user}
        del environment["XDG_CACHE_HOME"]
    run = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["1", "2"]
    assert "Traceback" not in run.stderr
    assert len(run.stderr.splitlines()) <= 2, run.stderr

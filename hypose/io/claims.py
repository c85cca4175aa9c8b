"""A folder that one run writes to: looked at before the work, and held against other runs while it goes on."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

from hypose.errors import InputError
from hypose.io.files import check_writable

LOCK = ".hypose-lock"
"""The file in a folder that is being written to, which says by whom; what locks it is the system, which lets go of it
however the run ends."""
_TAKEN = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)


@contextlib.contextmanager
def claimed(folder: str | Path, option: str = "--out") -> Iterator[None]:
    """Within the block the folder is this run's alone. An InputError, before any work, when it cannot be written to or
    another run writes to it; `option` names another folder. Where the file system knows no locks there is none."""
    path = Path(folder)
    check_writable(path, option)
    held = _held(path / LOCK, option)
    try:
        yield
    finally:
        if held is not None:
            with contextlib.suppress(OSError):
                (path / LOCK).unlink()  # before it is let go of, so that nobody locks a file that is gone
            os.close(held)


def _held(path: Path, option: str) -> int | None:
    """The locked file; None where there are no locks."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    while True:
        try:
            file = os.open(path, flags, 0o644)
        except OSError:
            return None
        try:
            _lock(file)
            if os.path.samestat(os.fstat(file), os.stat(path)):
                os.ftruncate(file, 0)
                os.write(file, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
                return file
        except FileNotFoundError:
            pass  # another run has just ended and removed it: there is a new one to lock
        except OSError as error:
            who = _who(file) if error.errno in _TAKEN else None
            os.close(file)
            if who is None:
                return None
            raise InputError(
                f"{path.parent} is being written to by another run of hypose ({who}); wait for its end, or give "
                f"another folder with {option}."
            ) from None
        os.close(file)


def _lock(file: int) -> None:
    """An OSError when another process holds it, or there are no locks."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(file, 1 << 20, os.SEEK_SET)  # a locked byte cannot be read
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        os.lseek(file, 0, os.SEEK_SET)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _who(file: int) -> str:
    with contextlib.suppress(OSError):
        said = os.read(file, 200).decode(errors="replace").strip()
        if re.fullmatch(r"process \d{1,10} on [\w.-]{1,100}", said):
            return said
    return "its name is not known"

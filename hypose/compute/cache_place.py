"""Where hypose keeps what it can make again (compiled kernels, the list of fonts): one folder, chosen once per process.

The order is: the folder named by HYPOSE_CACHE_DIR; the user's cache (XDG_CACHE_HOME or ~/.cache, on macOS
~/Library/Caches, on Windows %LOCALAPPDATA%); a private folder among the temporary ones; none. Compiled code is run as
it is read, so a folder that others may write to is not taken.
"""

from __future__ import annotations

import contextlib
import logging
import os
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

VARIABLE = "HYPOSE_CACHE_DIR"
_UNUSED_DAYS = 60
_log = logging.getLogger("hypose")


@cache
def note(text: str) -> None:
    """Say something about the cache, each sentence once per process; without a handler it goes to stderr."""
    _log.warning("%s", text)


@cache
def cache_folder() -> Path | None:
    """The folder of this process, or None where no folder can be used; it may be read-only when it is filled."""
    for folder in _candidates():
        problem = _problem(folder)
        if not problem:
            return folder
        if folder == _named():
            note(f"{VARIABLE}={str(folder)!r} cannot be used ({problem}); another place is taken for the cache.")
    note(f"No folder can be written for the cache, so every start compiles again; name one with {VARIABLE}.")
    return None


@cache
def make_folder(folder: Path) -> None:
    """Make a folder in the cache, for the users that the cache is for, and remove what has not been used for long from
    it and from its kind of other versions (kernels, kernels-of-...)."""
    if not folder.is_dir():
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(OSError):  # another process has made it in this moment
            folder.chmod(stat.S_IMODE(folder.parent.stat().st_mode))
    oldest = time.time() - _UNUSED_DAYS * 86400
    for path in folder.parent.glob(f"{folder.name}*/*"):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < oldest:
                path.unlink()


def _named() -> Path | None:
    """The folder that the variable names; a ~ that no shell has read is the home."""
    name = os.environ.get(VARIABLE)
    return Path(os.path.expanduser(name)) if name else None


def _candidates() -> Iterator[Path]:
    if named := _named():
        yield named
    home = os.path.expanduser("~")
    if sys.platform == "win32":
        user = os.environ.get("LOCALAPPDATA", "")
    elif sys.platform == "darwin":
        user = os.path.join(home, "Library", "Caches")
    else:
        user = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
    # a home that is not there (/nonexistent) is not made, even by who may
    if os.path.isabs(user) and (os.path.isdir(home) or not user.startswith(home)):
        yield Path(user) / "hypose"
    try:
        temporary = tempfile.gettempdir()
    except OSError:  # not even the working folder can be written
        return
    yield Path(temporary) / f"hypose-cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def _problem(folder: Path) -> str:
    """Why a folder cannot be the cache; empty when it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "getuid"):
            named = folder == _named()
            if not named and status.st_uid not in (os.getuid(), 0):
                return "it belongs to another user"
            if status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not named):
                return "other users may write there"
        if any(folder.iterdir()):  # filled: good for reading, if for nothing else
            return ""
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return ""

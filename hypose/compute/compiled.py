"""Compile functions with numba (always with the same options), and cache the result on disk; a failing cache never
stops a run.

Why an own cache: numba's cache trusts its files. A damaged file ends the process, and after an edit of a kernel that
another file calls, the caller still runs the old one. Here files are named by the sources of the kernel and of all that
it imports, by the loaded bytecode, the version of numba and the processor, and are read only when their checksum is
right. A cache that cannot be written or read costs time, never a run.

The folder of the cache (compiled kernels, the list of fonts) is chosen once per process: the folder named by
HYPOSE_CACHE_DIR; the user's cache (XDG_CACHE_HOME or ~/.cache, on macOS ~/Library/Caches, on Windows %LOCALAPPDATA%); a
private folder in the temporary folder; none. Compiled code is executed when it is read, so that a folder in which other
users may write is not used.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import stat
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from pickle import loads
from types import CodeType
from typing import Any

# Intel's vector mathematics exists on some machines only, and its last digits differ from those of the C library
os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")

import llvmlite  # noqa: E402
import numba  # noqa: E402
from numba.core.caching import NullCache  # noqa: E402
from numba.core.compiler import CompileResult  # noqa: E402
from numba.core.dispatcher import Dispatcher  # noqa: E402
from numba.core.registry import cpu_target  # noqa: E402
from numba.core.runtime.nrt import rtsys  # noqa: E402
from numba.core.serialize import dumps  # noqa: E402

VARIABLE = "HYPOSE_CACHE_DIR"
_UNUSED_DAYS = 60
_log = logging.getLogger("hypose")


@cache
def log_cache(text: str) -> None:
    """Log a message about the cache of compiled kernels, each text once per process; without a log handler the
    message goes to stderr.
    """
    _log.warning("%s", text)


@cache
def cache_folder() -> Path | None:
    """Return the folder in which this process caches compiled kernels; None where no folder can be used. A folder
    that already holds the kernels may be read-only.
    """
    for folder in _candidates():
        problem = _problem(folder)
        if not problem:
            return folder
        if folder == _named():
            log_cache(f"{VARIABLE}={str(folder)!r} cannot be used ({problem}); another place is taken for the cache.")
    log_cache(f"No folder can be written for the cache, so every start compiles again; name one with {VARIABLE}.")
    return None


@cache
def make_folder(folder: Path) -> None:
    """Make a folder in the cache, and remove files that were not used for 60 days.

    Files are removed from this folder and from those of other versions with the same prefix (kernels,
    kernels-of-...).
    """
    if not folder.is_dir():
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(OSError):  # another process has just made it
            folder.chmod(stat.S_IMODE(folder.parent.stat().st_mode))
    oldest = time.time() - _UNUSED_DAYS * 86400
    for path in folder.parent.glob(f"{folder.name}*/*"):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < oldest:
                path.unlink()


def _named() -> Path | None:
    """Return the folder that HYPOSE_CACHE_DIR names, with ~ expanded; None where it is not set."""
    name = os.environ.get(VARIABLE)
    return Path(os.path.expanduser(name)) if name else None


def _candidates() -> Iterator[Path]:
    """Yield the folders that may be the cache, the best first."""
    if named := _named():
        yield named
    home = os.path.expanduser("~")
    if sys.platform == "win32":
        user = os.environ.get("LOCALAPPDATA", "")
    elif sys.platform == "darwin":
        user = os.path.join(home, "Library", "Caches")
    else:
        user = os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")
    # a home folder that does not exist (/nonexistent) is not created, even with the permission to do so
    if os.path.isabs(user) and (os.path.isdir(home) or not user.startswith(home)):
        yield Path(user) / "hypose"
    try:
        temporary = tempfile.gettempdir()
    except OSError:  # not even the working folder can be written
        return
    yield Path(temporary) / f"hypose-cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def _problem(folder: Path) -> str:
    """Return why a folder cannot be the cache; empty where it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "getuid"):
            named = folder == _named()
            if not named and status.st_uid not in (os.getuid(), 0):
                return "it belongs to another user"
            if status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not named):
                return "other users may write there"
        if any(folder.iterdir()):  # filled: it can be read at least
            return ""
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return ""


_IMPORT = re.compile(r"^ *(?:from|import) (hypose\.compute[\w.]*)", re.MULTILINE)
_ROOM = Path(__file__).parent
failures: list[OSError] = []
"""Errors because of which kernels compiled by this process are not in the cache."""


def kernel(function: Callable[..., Any] | None = None, *, inline: bool = False) -> Any:
    """Decorate a function to be compiled by numba at its first call, or loaded from the cache.

    inline: insert the code at the place of the call (for small functions called in loops).

    Fast-math is off: sums keep their order, so that one machine finds the same pose, bit by bit, for any number of
    threads.
    """
    if function is None:
        return partial(kernel, inline=inline)
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    made = numba.njit(**options, inline="always" if inline else "never")(function)
    made._cache = KernelCache(function)
    return made


class KernelCache(NullCache):
    """Cache of one kernel in numba's interface: one file per signature and processor.

    Its methods never raise: a kernel whose file cannot be read is compiled; one that cannot be written is compiled
        again in the next process.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the kernel compiled for a signature; None where it is not in the cache.

        sig: signature.
        target_context: numba's context of the processor.
        """
        path = self._path(sig)
        if path is None or not os.path.exists(path):
            return None
        try:
            data = path.read_bytes()
            if data[:32] != hashlib.sha256(data[32:]).digest():
                raise ValueError("The checksum is wrong.")
            rtsys.initialize(target_context)
            # numba stores kernels only as pickles; the private folder and the checksum make this one trustworthy
            found = CompileResult._rebuild(target_context, *loads(data[32:]))  # noqa: S301
        except Exception:  # of any kind: the kernel is compiled, and its file replaced
            log_cache(f"Damaged files of compiled code in {path.parent} are compiled again.")
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # in use: not to be removed
        return found

    def save_overload(self, sig: Any, cres: Any) -> None:
        """Save a compiled kernel, unless it holds values of this process only.

        sig: signature.
        cres: compiled kernel, numba's CompileResult.
        """
        path = self._path(sig)
        if cres.library.has_dynamic_globals or path is None:
            return
        temporary = path.with_name(f"{uuid.uuid4().hex[:16]}.tmp")
        try:
            make_folder(path.parent)
            data = dumps(cres._replace(type_annotation="")._reduce())
            temporary.write_bytes(hashlib.sha256(data).digest() + data)
            os.replace(temporary, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            failures.append(error)
            reason = (error.strerror or str(error)).lower()
            log_cache(f"Compiled code cannot be kept in {path.parent} ({reason}); the next start compiles it again.")

    def _path(self, sig: Any) -> Path | None:
        """Return the path of the file of a signature; None without a cache folder or without a source."""
        f = self._function
        sources = _digest_of_sources(f.__module__)
        name = f"{f.__module__.rpartition('.')[2]}.{f.__qualname__}"
        return cache_file(name, "kernel", f.__code__.co_firstlineno, sig, sources) if sources else None


def cache_file(name: str, kind: str, *key: Any) -> Path | None:
    """Return the path of a file of the cache, for this processor and these versions; None without a cache folder.

    name: start of the file name.
    kind: ending of the file name.
    key: values on which the name must depend.
    """
    folder, processor = cache_folder(), cpu_target.target_context.codegen().magic_tuple()
    text = repr((key, processor, numba.__version__, llvmlite.__version__, sys.implementation.cache_tag))
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    return None if folder is None else folder / "kernels" / f"{name}-{digest}.{kind}"


def _bytecode(module: str) -> bytes:
    """Return the loaded bytecode of a module's kernels: after two edits within one second, Python may run the older
    code.
    """
    values = vars(sys.modules[module]).values() if module in sys.modules else ()
    codes = [v.py_func.__code__ for v in values if isinstance(v, Dispatcher)]
    plain = [[c for c in code.co_consts if not isinstance(c, CodeType)] for code in codes]
    return b"".join(code.co_code + repr(consts).encode() for code, consts in zip(codes, plain, strict=True))


@cache
def _digest_of_sources(module: str) -> str | None:
    """Compute the digest of a kernel module and of all modules of this package that it imports; None
    without a source.
    """
    texts: dict[str, bytes] = {}
    left = [module]
    while left:
        name = left.pop()
        path = _ROOM.parents[1] / (name.replace(".", "/") + ".py")
        texts[name] = path.read_bytes() if path.exists() else b""  # a package, which holds no kernels
        left += [m for m in _IMPORT.findall(texts[name].decode()) if m not in texts]
    text = b"\0".join(name.encode() + b"\0" + texts[name] + _bytecode(name) for name in sorted(texts))
    return hashlib.sha256(text).hexdigest() if texts[module] else None

"""Files that others may have made are opened here, within bounds, and every file is written here, whole or not at all;
errors in one sentence."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, Any

from hypose.errors import InputError
from hypose.json_text import parse_json

# Half an hour at 100 Hz with 60 markers as text; longer recordings come in pieces or as C3D.
MAX_TEXT_BYTES = 256 * 2**20
MAX_JSON_BYTES = 4 * 2**20
FULL = (errno.ENOSPC, errno.EDQUOT)
"""The system's numbers for a disk that is full."""
# another program's FIFO or terminal must not hold us up
_READ = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)


# ---- reading -----------------------------------------------------------------------------------------------


def open_file(path: str | Path, kind: str, limit: int, least: int = 1) -> BufferedReader:
    """Open a regular file of `least` to `limit` bytes to read it. An InputError for anything else, which says with
    `kind` ("a TRC file") what was expected. A FIFO or a device is never waited for."""
    try:
        if not Path(path).is_file():
            what = "is not a file" if Path(path).exists() else "does not exist"
            raise InputError(f"{path} {what}; give the path of {kind}.")
        stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | _READ))
    except OSError as error:
        raise unreadable(path, error) from None
    state = os.fstat(stream.fileno())
    if stat.S_ISREG(state.st_mode) and least <= state.st_size <= limit:
        return stream
    stream.close()
    if not state.st_size:
        raise InputError(f"{path} is empty; give the path of {kind}.")
    raise InputError(
        f"{path} has {state.st_size / 2**20:.0f} MiB, at most {limit / 2**20:.0f} MiB are read; cut it into pieces."
    )


def readable_size(path: str | Path, kind: str, limit: int) -> int:
    """Size in bytes of a file that a library opens by its path; an InputError as of `open_file`."""
    with open_file(path, kind, limit) as stream:
        return os.fstat(stream.fileno()).st_size


def unreadable(path: str | Path, error: OSError) -> InputError:
    """The InputError for a file that the system does not let us read."""
    return InputError(f"{path} cannot be read ({(error.strerror or str(error)).lower()}); check its permissions.")


def read_bytes(path: str | Path, kind: str, limit: int, least: int = 1) -> bytes:
    """The content of a file; an InputError as of `open_file`."""
    try:
        with open_file(path, kind, limit, least) as stream:
            return stream.read(limit)
    except OSError as error:
        raise unreadable(path, error) from None


def read_text(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> str:
    """The text of a file, which may be empty, its lines ended by \\n; an InputError as of `open_file`, and for what is
    no UTF-8."""
    try:
        return read_bytes(path, kind, limit, 0).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file (UTF-8), as {kind} is; write it with a text editor.") from None


def text_lines(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> list[str]:
    """Lines of a text file, what is no UTF-8 as U+FFFD; an InputError as of `open_file`, and for a binary file."""
    data = read_bytes(path, kind, limit)
    if b"\0" in data[:65536]:
        raise InputError(f"{path} is a binary file, not {kind}.")
    return data.decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()


def read_json(path: str | Path, kind: str, limit: int = MAX_JSON_BYTES) -> Any:
    """The value of a JSON file; an InputError as of `open_file`, and for what is no JSON."""
    try:
        return parse_json(read_bytes(path, kind, limit))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); give the path of {kind}.") from None


# ---- writing -----------------------------------------------------------------------------------------------


@contextmanager
def atomic_path(path: str | Path, synced: bool = True) -> Iterator[Path]:
    """A new, empty file in the folder of `path` (same ending) to write to, renamed to `path` when the block ends well.

    synced: it is on the disk before, so that a power cut leaves the old file or the new one; without, it may leave an
    empty one, which is for the many pictures of a series.
    The folder is made if needed. If the block raises, the temporary file is removed and an existing `path`
    stays as it was; an OSError (disk full, read-only) becomes an InputError.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(temporary, _NEW, 0o666))
        yield temporary
        if synced:
            _onto_disk(temporary)
        os.replace(temporary, path)
        if synced:
            _onto_disk(path.parent)
    except OSError as error:
        raise InputError(cannot_write(path, error)) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _onto_disk(path: Path) -> None:
    """Have the system write a file or the names in a folder to the disk now; where it knows no such thing, nothing."""
    if os.name == "nt" and path.is_dir():
        return
    number = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # of a file system without
            raise
    finally:
        os.close(number)


def write_bytes(path: str | Path, data: bytes, synced: bool = True) -> None:
    """Write a binary file whole or not at all; synced as in `atomic_path`."""
    with atomic_path(path, synced) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically, with the same line ends on every system; names that are no UTF-8 as escapes."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def check_writable(folder: str | Path, option: str = "--out") -> None:
    """Fail now, with one sentence that names the option for another place, instead of after the work is done; the
    folder is made if needed."""
    folder = Path(folder)
    test = folder / f".write-test-{secrets.token_hex(8)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.close(os.open(test, _NEW, 0o666))
        test.unlink()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(
            f"{folder} cannot be written ({reason}); choose a folder that you may write to, with {option}."
        ) from None


def cannot_write(path: Path, error: OSError) -> str:
    """The sentence for a file that the system does not let us write."""
    if error.errno in FULL:
        try:
            free = f" ({shutil.disk_usage(path.parent).free / 1e6:.0f} MB free)"
        except OSError:
            free = ""
        return (
            f"{path} cannot be written because the disk is full{free}; what was written before is intact: "
            "free some space and run the same command again, with --resume where it knows that."
        )
    reason = (error.strerror or str(error)).lower()
    return (
        f"{path} cannot be written ({reason}); what was written before is intact: choose a folder that you "
        "may write to, or change its permissions."
    )


class RecordingFolder:
    """A new or empty folder that is written to while something is recorded; InputError when it is neither, and, within
    `writing`, when the system does not let us."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._tables: dict[str, os.stat_result] = {}
        with self.writing():
            if self.path.is_file():
                raise InputError(f"{self.path} is a file; give a new folder to record to.")
            if self.path.is_dir() and any(self.path.iterdir()):
                raise InputError(f"{self.path} is not empty; give a new folder to record to.")
            self.path.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """What is written within ends in a sentence when it fails."""
        try:
            yield
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError(f"{self.path} cannot be written ({reason}); choose another folder to record to.") from None

    def table(self, name: str, header: Sequence[str]) -> IO[str]:
        """A new CSV file, open for its rows."""
        with self.writing():
            stream = (self.path / name).open("x", encoding="utf-8", newline="\n")
            stream.write(",".join(header) + "\n")
            self._tables[name] = os.fstat(stream.fileno())
        return stream

    def check(self) -> None:
        """An InputError when a table was removed or replaced since it was opened, so that what is written is lost."""
        for name, opened in self._tables.items():
            try:
                there = os.path.samestat(opened, os.stat(self.path / name))
            except OSError:
                there = False
            if not there:
                raise InputError(
                    f"The recording is lost: {self.path / name} was removed or replaced while it was written; record "
                    "again, to another folder."
                )

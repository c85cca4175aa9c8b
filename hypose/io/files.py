"""Files that others may have made are opened here, within bounds, and every file is written here, whole or not at all;
errors in one sentence."""

from __future__ import annotations

import contextlib
import errno
import gzip
import json
import os
import re
import secrets
import shutil
import socket
import stat
import sys
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, BinaryIO

from hypose.errors import InputError
from hypose.json_text import parse_json

# Half an hour at 100 Hz with 60 markers as text; longer recordings come in pieces or as C3D.
MAX_TEXT_BYTES = 256 * 2**20
MAX_JSON_BYTES = 4 * 2**20
MAX_TOML_BYTES = 5_000_000
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
    return InputError(f"{path} cannot be read ({reason_of(error)}); check its permissions.")


def reason_of(error: OSError) -> str:
    """What the system says, in lower case."""
    return (error.strerror or str(error)).lower()


def read_bytes(path: str | Path, kind: str, limit: int, least: int = 1) -> bytes:
    """The content of a file; an InputError as of `open_file`."""
    try:
        with open_file(path, kind, limit, least) as stream:
            return stream.read(limit)
    except OSError as error:
        raise unreadable(path, error) from None


def read_text(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> str:
    """The text of a file, which may be empty, its lines ended by \\n; an InputError as of `open_file`, and for all that
    is no UTF-8."""
    try:
        return read_bytes(path, kind, limit, 0).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file (UTF-8), as {kind} is; write it with a text editor.") from None


def text_lines(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> list[str]:
    """Lines of a text file, invalid UTF-8 as U+FFFD; an InputError as of `open_file`, and for a binary file."""
    data = read_bytes(path, kind, limit)
    if b"\0" in data[:65536]:
        raise InputError(f"{path} is a binary file, not {kind}.")
    return data.decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()


def csv_rows(
    path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES
) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """The first line's names, and every other line's number, from 2, and cells; an InputError as of `bounded_lines`,
    and for a line of another number of cells."""
    lines = bounded_lines(path, kind, limit)
    names = _cells(next(lines, ""))

    def rows() -> Iterator[tuple[int, list[str]]]:
        for number, line in enumerate(lines, start=2):
            if not line.strip():
                continue
            cells = _cells(line)
            if len(cells) != len(names):
                raise InputError(
                    f"{path}: line {number} has {len(cells)} cells, the first line {len(names)}; the file may be cut "
                    "off."
                )
            yield number, cells

    return names, rows()


def _cells(line: str) -> list[str]:
    return [c.strip().strip('"') for c in line.split(",")]


@contextmanager
def numbers_of(where: str) -> Iterator[None]:
    """Within, cells become numbers; an InputError that begins with `where` for one that is none, or is missing."""
    try:
        yield
    except (ValueError, OverflowError, IndexError):
        raise InputError(
            f"{where} holds something that is not a number, or is cut off; export the file again."
        ) from None


def read_json(path: str | Path, kind: str, limit: int = MAX_JSON_BYTES) -> Any:
    """The value of a JSON file; an InputError as of `open_file`, and for invalid JSON."""
    try:
        return parse_json(read_bytes(path, kind, limit))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); give the path of {kind}.") from None


def read_toml(path: str | Path, kind: str = "a TOML file") -> dict[str, Any]:
    """The tables of a TOML file of at most 5 MB; an InputError names it, the cause and the next step."""
    text = read_text(path, kind, MAX_TOML_BYTES)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # integers of thousands of digits are ValueErrors, too
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{path} is not valid TOML: {reason}; correct it.") from None


def toml_value(value: Any) -> str:
    """A TOML literal of a string, bool, number, sequence or array; floats keep every bit (repr)."""
    value = value.tolist() if hasattr(value, "tolist") else value  # numpy's
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)  # nan, inf and 1e-07 are TOML as they are
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # JSON's escapes are TOML's
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise TypeError(f"no TOML literal for {type(value).__name__}")


def toml_key(key: str) -> str:
    """A TOML key, quoted where needed."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_lines(table: Mapping[str, Any]) -> list[str]:
    """The lines of a table; None values are left out."""
    return [f"{toml_key(key)} = {toml_value(value)}" for key, value in table.items() if value is not None]


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
        raise InputError(
            f"{folder} cannot be written ({reason_of(error)}); choose a folder that you may write to, with {option}."
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
    return (
        f"{path} cannot be written ({reason_of(error)}); what was written before is intact: choose a folder that you "
        "may write to, or change its permissions."
    )


class RecordingFolder:
    """A new or empty folder that is written to while something is recorded; InputError when it is neither, and, within
    `writing`, when the system does not let us."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._tables: dict[str, os.stat_result] = {}
        with self.writing():
            if self.path.is_file() or (self.path.is_dir() and any(self.path.iterdir())):
                what = "a file" if self.path.is_file() else "not empty"
                raise InputError(f"{self.path} is {what}; give a new folder to record to.")
            self.path.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Report a failed write within the block in one sentence."""
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self.path} cannot be written ({reason_of(error)}); choose another folder to record to."
            ) from None

    def table(self, name: str, header: Sequence[str]) -> IO[str]:
        """A new CSV file, open for its rows."""
        with self.writing():
            stream = (self.path / name).open("x", encoding="utf-8", newline="\n")
            stream.write(",".join(header) + "\n")
            self._tables[name] = os.fstat(stream.fileno())
        return stream

    def check(self) -> None:
        """An InputError when a table was removed or replaced since it was opened, so that all that is written is
        lost."""
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


# ---- text in -------------------------------------------------------------------------------------------------------
# Text from outside, line by line and within bounds, plain or gzipped.


_CHUNK = 1 << 20
MAX_LINE_BYTES = 1 << 20


def bounded_lines(
    path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES, line_limit: int = MAX_LINE_BYTES
) -> Iterator[str]:
    """Lines of a text file, gzipped when it ends in .gz, without line ends; undecodable bytes become U+FFFD.

    Never more than one line and one MiB is held, and reading stops with an InputError when the (unpacked) text exceeds
    `limit` or a line `line_limit` bytes, so that a gzip bomb costs no more than an honest file. `kind` ("a CSV of ...")
    says in the errors what was expected.
    """
    total, rest, first = 0, b"", True
    try:
        with open_file(path, kind, limit) as file, _unpacked(file, path) as stream:
            while chunk := stream.read(_CHUNK):
                total += len(chunk)
                if total > limit:
                    raise InputError(
                        f"{path} unpacks to more than {limit / 2**20:.0f} MiB, which is more than is read; cut it into "
                        "pieces."
                    )
                if first:
                    first = False
                    if b"\0" in chunk[:65536]:
                        raise InputError(f"{path} is a binary file, not {kind}.")
                    chunk = chunk.removeprefix(b"\xef\xbb\xbf")
                *lines, rest = (rest + chunk).split(b"\n")
                for line in lines:
                    yield _decoded(line, path, kind, line_limit)
                if len(rest) > line_limit:
                    _decoded(rest, path, kind, line_limit)
            if rest:
                yield _decoded(rest, path, kind, line_limit)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise InputError(f"{path} is a damaged or cut-off .gz file; fetch it again.") from None
    except OSError as error:
        raise unreadable(path, error) from None


def _unpacked(file: BinaryIO, path: str | Path) -> gzip.GzipFile | BinaryIO:
    return gzip.GzipFile(fileobj=file) if str(path).lower().endswith(".gz") else file


def _decoded(line: bytes, path: str | Path, kind: str, limit: int) -> str:
    if len(line) > limit:
        raise InputError(f"{path} has a line of more than {limit // 1024} KiB, so it is not {kind}.")
    return line.rstrip(b"\r").decode("utf-8", errors="replace").replace("\ufeff", "")


# ---- claims --------------------------------------------------------------------------------------------------------
# A folder that one run writes to: looked at before the work, and held against other runs while it goes on.


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
                (path / LOCK).unlink()  # before it is let go of, so that no process locks a file that is gone
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

"""Bounded reading of files from any source, atomic writing (a file is written whole or not at all), names of files.

Each error becomes an InputError of one sentence.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import hashlib
import json
import os
import re
import secrets
import shutil
import socket
import stat
import sys
import tempfile
import tomllib
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, Any

from hypose.errors import InputError, visible
from hypose.json_text import parse_json

# Half an hour at 100 Hz with 60 markers as text; longer recordings come in pieces or as C3D.
MAX_TEXT_BYTES = 256 * 2**20
MAX_JSON_BYTES = 4 * 2**20
MAX_TOML_BYTES = 5_000_000
FULL = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers of the operating system for a full disk."""
DAMAGED = (
    *(ValueError, TypeError, LookupError, ArithmeticError, AttributeError, RuntimeError, MemoryError, EOFError),
    *(zipfile.BadZipFile, zlib.error),
)
"""Errors of parsers at content that is damaged or is something else; RecursionError is one of them."""
# do not wait for a FIFO or terminal
_READ = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)


# ---- reading -----------------------------------------------------------------------------------------------


def open_file(path: str | Path, kind: str, limit: int, least: int = 1) -> BufferedReader:
    """Open a regular file to read its bytes.

    kind: the expected type of file in error messages, such as "a TRC file".
    limit: largest accepted size, bytes.
    least: smallest accepted size, bytes.
    Raises: InputError where the file does not exist, is not a regular file, cannot be read, or has another size.
    Why: it never waits for a FIFO or a device.
    """
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
    """Check a file as `open_file` does, for a library that opens it by its path.

    kind: the expected type of file in error messages.
    limit: largest accepted size, bytes.
    Returns: size of the file, bytes.
    Raises: InputError as `open_file`.
    """
    with open_file(path, kind, limit) as stream:
        return os.fstat(stream.fileno()).st_size


def unreadable(path: str | Path, error: OSError) -> InputError:
    """Make the InputError for a file that the system does not allow to be read."""
    return InputError(f"{path} cannot be read ({reason_of(error)}); check its permissions.")


def reason_of(error: OSError) -> str:
    """Format the system's reason of an error in lower case."""
    return (error.strerror or str(error)).lower()


def read_bytes(path: str | Path, kind: str, limit: int, least: int = 1) -> bytes:
    """Read the content of a file.

    kind: the expected type of file in error messages, such as "a TRC file".
    limit, least: largest and smallest accepted size, bytes.
    Raises: InputError as `open_file`.
    """
    try:
        with open_file(path, kind, limit, least) as stream:
            return stream.read(os.fstat(stream.fileno()).st_size)  # read(limit) would allocate the limit
    except OSError as error:
        raise unreadable(path, error) from None


def read_text(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> str:
    r"""Read a UTF-8 text file, which may be empty; line ends become \n.

    kind: the expected type of file in error messages.
    limit: largest accepted size, bytes.
    Raises: InputError as `open_file`, and where the file is not UTF-8.
    """
    try:
        return read_bytes(path, kind, limit, 0).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file (UTF-8), as {kind} is; write it with a text editor.") from None


def text_lines(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> list[str]:
    """Read all lines of a text file at once, unpacked where its name ends in .gz.

    kind: the expected type of file in error messages.
    limit: largest size of the unpacked text, bytes.
    Raises: InputError as `bounded_lines`.
    """
    return list(bounded_lines(path, kind, limit, limit))


def csv_rows(
    path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES
) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Read a CSV file row by row.

    kind: the expected type of file in error messages.
    limit: largest size of the unpacked text, bytes.
    Returns: the cells of the first line, and an iterator over the line number (from 2) and cells of each later line;
        empty lines are skipped.
    Raises: InputError as `bounded_lines`, and for a line with another number of cells than the first.
    """
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
    """Turn the errors of parsing within a with block into an InputError: a missing key or cell, or another type.

    where: start of the message, such as the file and its line.
    Raises: InputError where the content is not as the block expects.
    Why: a reader then uses what it needs without a test of each value. Blocks may be nested; the innermost one names
        the place.
    """
    try:
        yield
    except KeyError as error:
        raise InputError(f"{where} has no {str(error.args[0])[:60]!r}; export the file again.") from None
    except OSError as error:
        raise InputError(f"{where} cannot be read ({reason_of(error)[:100]}); export the file again.") from None
    except DAMAGED as error:
        reason = f" ({' '.join(str(error).split())[:100]})" if isinstance(error, ValueError) else ""
        raise InputError(
            f"{where} holds something that is not what is expected there{reason}, or is cut off; export the file again."
        ) from None


def read_json(path: str | Path, kind: str, limit: int = MAX_JSON_BYTES) -> Any:
    """Read the value of a JSON file.

    kind: the expected type of file in error messages.
    limit: largest accepted size, bytes.
    Raises: InputError as `open_file`, and for invalid JSON.
    """
    try:
        return parse_json(read_bytes(path, kind, limit))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON ({error}); give the path of {kind}.") from None


def read_toml(path: str | Path, kind: str = "a TOML file") -> dict[str, Any]:
    """Read the tables of a TOML file of at most 5 MB.

    Raises: InputError as `open_file`, and for invalid TOML.
    """
    text = read_text(path, kind, MAX_TOML_BYTES)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # integers of thousands of digits are ValueErrors, too
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{path} is not valid TOML: {reason}; correct it.") from None


def toml_value(value: Any) -> str:
    """Format a string, bool, number, sequence or array as a TOML literal; floats keep every bit."""
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
    """Format a key for TOML, in quotes where needed."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_lines(table: Mapping[str, Any]) -> list[str]:
    """Format a table as lines of TOML; values that are None are left out."""
    return [f"{toml_key(key)} = {toml_value(value)}" for key, value in table.items() if value is not None]


def toml_text(document: Mapping[str, Any]) -> str:
    """Format a document as TOML: its values, then each table as [key], and each list of tables as [[key]]s.

    Values that are None are left out.
    """
    blocks = [toml_lines({key: value for key, value in document.items() if not _tables_in(value)})]
    for key, value in document.items():
        heading = f"[[{key}]]" if isinstance(value, list) else f"[{toml_key(key)}]"
        blocks += [[heading, *toml_lines(table)] for table in _tables_in(value)]
    return "\n\n".join("\n".join(lines) for lines in blocks if lines) + "\n"


def _tables_in(value: Any) -> list[Mapping[str, Any]]:
    """List the tables of a list, or the one table that a value is; empty for other values."""
    return [table for table in (value if isinstance(value, list) else [value]) if isinstance(table, Mapping)]


# ---- writing -----------------------------------------------------------------------------------------------


@contextmanager
def atomic_path(path: str | Path, synced: bool = True) -> Iterator[Path]:
    """Provide a temporary file to write to, and rename it to `path` when the with block ends without an error.

    The temporary file is empty, in the same folder and has the same ending; the folder is made if needed. When the
    block raises, the temporary file is removed and an existing `path` stays as it was.

    synced: wait until the data are on the disk before the renaming, so that after a power cut either the old or the new
        file is there. Without it the file may be empty then, which is accepted for the many pictures of a series.
    Raises: InputError for any OSError, such as a full disk or a read-only folder.
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
    """Flush a file, or the names in a folder, to the disk; file systems that cannot do so are skipped."""
    if os.name == "nt" and path.is_dir():
        return
    number = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a file system that cannot do it
            raise
    finally:
        os.close(number)


def write_bytes(path: str | Path, data: bytes, synced: bool = True) -> None:
    """Write a binary file whole or not at all.

    data: the content.
    synced: wait until the data are on the disk before the file gets its name, so that a power cut cannot leave it
        empty.
    Raises: InputError where it cannot be written.
    """
    with atomic_path(path, synced) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file whole or not at all, with the same line ends on every system.

    Characters that UTF-8 cannot encode, as in some files' names, become escapes.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def check_writable(folder: str | Path, option: str = "--out") -> None:
    """Test before the work starts that a folder can be written to; it is made if needed.

    option: name of the command line's option for another folder, used in the error message.
    Raises: InputError where the folder cannot be made or written to.
    """
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
    """Format the message for a file that the system does not allow to be written, or a full disk."""
    if error.errno in FULL:
        free = ""
        with contextlib.suppress(OSError):
            free = f" ({shutil.disk_usage(path.parent).free / 1e6:.0f} MB free)"
        return (
            f"{path} cannot be written because the disk is full{free}; what was written before is intact: "
            "free some space and run the same command again, with --resume where it has that option."
        )
    return (
        f"{path} cannot be written ({reason_of(error)}); what was written before is intact: choose a folder that you "
        "may write to, or change its permissions."
    )


class RecordingFolder:
    """A new or empty folder for the files of a running recording.

    Raises: InputError where the path is a file, is a folder that is not empty, or cannot be written to.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._tables: list[IO[str]] = []
        with self.writing():
            if self.path.is_file() or (self.path.is_dir() and any(self.path.iterdir())):
                what = "a file" if self.path.is_file() else "not empty"
                raise InputError(f"{self.path} is {what}; give a new folder to record to.")
            self.path.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Turn failed writes within a with block into an InputError."""
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self.path} cannot be written ({reason_of(error)}); choose another folder to record to."
            ) from None

    def table(self, name: str, header: Sequence[str]) -> IO[str]:
        """Create a CSV file with its header and leave it open for the rows."""
        with self.writing():
            stream = (self.path / name).open("x", encoding="utf-8", newline="\n")
            stream.write(",".join(header) + "\n")
            self._tables.append(stream)
        return stream

    def flush(self) -> None:
        """Flush the CSV files to the system.

        Raises: InputError where they cannot be written, or one was removed or replaced after it was opened, because all
            rows written since then are lost.
        """
        for stream in self._tables:
            with self.writing():
                stream.flush()
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(stream.fileno()), os.stat(stream.name)):
                    continue
            raise InputError(
                f"The recording is lost: {stream.name} was removed or replaced while it was written; record again, to "
                "another folder."
            )

    def close(self) -> None:
        """Flush and close the CSV files; InputError as `flush`."""
        try:
            self.flush()
        finally:
            with self.writing(), contextlib.ExitStack() as stack:
                for stream in self._tables:
                    stack.callback(stream.close)


# ---- text in -------------------------------------------------------------------------------------------------------
# Text of any source, line by line and of limited size, plain or gzipped.


_CHUNK = 1 << 20
MAX_LINE_BYTES = 1 << 20


def bounded_lines(
    path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES, line_limit: int = MAX_LINE_BYTES
) -> Iterator[str]:
    """Read the lines of a text file, unpacked where its name ends in .gz; undecodable bytes become U+FFFD.

    kind: the expected type of file in error messages, such as "a CSV of markers".
    limit: largest size of the unpacked text, bytes.
    line_limit: largest size of a line, bytes.
    Returns: an iterator over lines without their line ends.
    Raises: InputError as `open_file`, for a binary or damaged file, and above one of the limits.
    Why: at most one line and 1 MiB are in memory, so a gzip bomb costs no more than an ordinary file.
    """
    total, rest, first = 0, b"", True
    try:
        packed = str(path).lower().endswith(".gz")
        with open_file(path, kind, limit) as file, gzip.GzipFile(fileobj=file) if packed else file as stream:
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


def _decoded(line: bytes, path: str | Path, kind: str, limit: int) -> str:
    """Decode a line without its line end; InputError where it has more than `limit` bytes."""
    if len(line) > limit:
        raise InputError(f"{path} has a line of more than {limit // 1024} KiB, so it is not {kind}.")
    return line.rstrip(b"\r").decode("utf-8", errors="replace").replace("\ufeff", "")


# ---- claims --------------------------------------------------------------------------------------------------------
# Lock of an output folder: tested before the work, and held against other runs until its end.


LOCK = ".hypose-lock"
"""Name of the lock file in a folder that a run writes to; its text names the process. The system releases the lock
however the run ends."""
_TAKEN = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)


@contextlib.contextmanager
def claimed(folder: str | Path, option: str = "--out") -> Iterator[None]:
    """Lock an output folder for this run within a with block.

    Where the file system has no locks, the folder is not locked.

    option: name of the command line's option for another folder, used in the error messages.
    Raises: InputError at the start of the block where the folder cannot be written to or another run writes to it.
    """
    path = Path(folder)
    check_writable(path, option)
    held = _held(path / LOCK, option)
    try:
        yield
    finally:
        if held is not None:
            with contextlib.suppress(OSError):
                (path / LOCK).unlink()  # before the lock is released, so that no process locks a deleted file
            os.close(held)


def _held(path: Path, option: str) -> int | None:
    """Open and lock the lock file; None where the file system has no locks."""
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
            said = os.read(file, 200).decode(errors="replace").strip()
            os.close(file)
            if error.errno not in _TAKEN:
                return None
            raise InputError(
                f"{path.parent} is being written to by another run of hypose ({said or 'its name is not known'}); wait "
                f"for its end, or give another folder with {option}."
            ) from None
        os.close(file)


def _lock(file: int) -> None:
    """Lock an open file; OSError where another process holds the lock or there are no locks."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(file, 1 << 20, os.SEEK_SET)  # a locked byte cannot be read
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        os.lseek(file, 0, os.SEEK_SET)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


# ---- names of files and cameras --------------------------------------------------------------------------------------
# Names of views, cameras, people and sensors come from files of other programs, and a file's name may contain any
# bytes. `file_name` makes a file's name of any text, `text_of` makes text of any file's name, and `match_names` finds
# the names that mean the same camera.


_MOST_BYTES = 100  # in UTF-8; with added parts (a frame's number, an ending) a name still fits into 255
# separators, characters that Windows forbids, ends that it drops, beginnings that hide a file or look like an option
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f-\x9f\\/:*?"<>|\u2028-\u202e\u2066-\u2069\ud800-\udfff]')
_ENDS = re.compile(r"^[\s.\-~]+|[\s.]+$")
_RESERVED = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?", re.IGNORECASE | re.DOTALL)
_MADE = re.compile(r".*~[0-9a-f]{10}", re.DOTALL)


def file_name(text: str) -> str:
    """Convert any text to a safe name for a file or folder.

    An ordinary name stays as it is. In any other, forbidden characters are replaced and a mark (~ and ten hexadecimal
    digits of a hash) is added, so that different texts get different names. The same text always gives the same name.

    Returns: at most 112 bytes in UTF-8, without separators, control characters, leading dots or dashes, or device names
        of Windows.
    """
    plain = _ENDS.sub("", _FORBIDDEN.sub("_", text))
    if plain == text and text and len(text.encode()) <= _MOST_BYTES and not _RESERVED.fullmatch(text):
        if not _MADE.fullmatch(text):  # otherwise it could equal the name made of another text
            return text
    short = plain.encode()[:_MOST_BYTES].decode(errors="ignore") or "_"
    mark = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:10]
    return f"{'_' if _RESERVED.fullmatch(short) else ''}{short}~{mark}"


def folder_for(folder: str | Path, text: str) -> Path:
    """Make the subfolder named after a text, where it does not exist yet.

    folder: the parent folder.
    text: any text; `file_name` makes the folder's name of it.
    Raises: InputError where the folder cannot be made or is a link that leads out of the parent folder.
    """
    path = Path(folder) / file_name(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
        inside = path.resolve().is_relative_to(path.parent.resolve())
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"The folder {path} cannot be made ({reason}); choose another folder with --out.") from None
    if not inside:
        raise InputError(
            f"{path} is a link that leads out of {path.parent}, and nothing is written there; remove it, or choose "
            "another folder with --out."
        )
    return path


def free_path(parent: Path, name: str, ending: str = "") -> Path:
    """Return parent/name with an ending, or the first free numbered name: walk, walk-2, walk-3."""
    numbered = re.fullmatch(r"(.+)-(\d{1,4})", name)
    stem, number = (numbered[1], int(numbered[2]) + 1) if numbered else (name, 2)
    path = parent / f"{name}{ending}"
    while path.exists():
        path, number = parent / f"{stem}-{number}{ending}", number + 1
    return path


def text_of(name: str | Path) -> str:
    """Convert a file's name to printable text; bytes that are not UTF-8 become escapes."""
    return visible(os.fspath(name))


@contextlib.contextmanager
def utf8_path(path: Path) -> Iterator[str]:
    """Provide a UTF-8 path of an existing file within a with block.

    It is the path itself or, where that is not UTF-8, a temporary link to the file.

    Raises: InputError where the link cannot be made.
    Why: OpenCV ends the whole process at a path that is not UTF-8.
    """
    if os.fsencode(path) == os.fspath(path).encode("utf-8", "surrogatepass"):
        yield os.fspath(path)
        return
    refusal = InputError(f"The name of {path} is not UTF-8; rename the file or the folder it lies in.")
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hypose-", ignore_cleanup_errors=True))
            link = os.path.join(folder, "file" + text_of(path.suffix))
            link.encode()
            os.symlink(path.absolute(), link)
        except (OSError, UnicodeEncodeError):
            raise refusal from None
        yield link


# ---- matching names ------------------------------------------------------------------------------------------------
# Names of views, cameras, files and folders that mean the same camera.


def match_names(wanted: Sequence[str], available: Sequence[str]) -> list[int | None]:
    """Find, for each wanted name, the available name of the same camera.

    Three rules are tried in this order: the same name; the same letters and digits without decoration (cam01_json,
    ext_cam01_img, Cam-01); the same last number.

    Returns: for each wanted name an index into `available`; None where no unique name fits.
    """

    def unique(key: Any) -> list[int | None]:
        keys = [key(a) for a in available]
        counts = [key(w) for w in wanted]
        return [
            keys.index(k) if k not in (None, "") and keys.count(k) == 1 and counts.count(k) == 1 else None
            for k in counts
        ]

    out: list[int | None] = [None] * len(wanted)
    for key in (lambda n: n, _bare, last_number):
        for i, found in enumerate(unique(key)):
            if out[i] is None and found is not None and found not in out:
                out[i] = found
    return out


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Make a sort key that puts cam2 before cam10."""
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p.lower()) for p in re.split(r"(\d+)", name) if p]


def _bare(name: str) -> str:
    return "".join(c for c in re.sub(r"(^(ext|int)_|_(json|img|imgs|ext)$)", "", name.lower()) if c.isalnum())


def last_number(name: str) -> int | None:
    """Extract the last number of a name (cam_01 -> 1, trial2_cam03 -> 3).

    Returns: None without a number, or where it has more than 15 digits.
    """
    digits = re.findall(r"[0-9]+", name)
    return int(digits[-1]) if digits and len(digits[-1]) <= 15 else None


def distinct_numbers(paths: Sequence[Path]) -> list[int] | None:
    """Read the last number in the name of each file; None where one is missing or repeated."""
    numbers = [n for p in paths if (n := last_number(p.stem)) is not None]
    return numbers if len(set(numbers)) == len(paths) else None

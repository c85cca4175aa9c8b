"""Text files: written whole or not at all, read within bounds, errors in one sentence."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from hypose.errors import InputError
from hypose.io.motions.results import atomic_path

# Half an hour at 100 Hz with 60 markers as text; longer recordings come in pieces or as C3D.
MAX_TEXT_BYTES = 256 * 2**20


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically, with the same line ends on every system; names that are no UTF-8 as escapes."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def readable_size(path: str | Path, kind: str, limit: int) -> int:
    """Size in bytes of a regular file of at most `limit` bytes; an InputError otherwise."""
    p = Path(path)
    if not p.exists():
        raise InputError(f"{p} does not exist; give the path of {kind}.")
    if not p.is_file():
        raise InputError(f"{p} is not a file; give the path of {kind}.")
    size = p.stat().st_size
    if size > limit:
        raise InputError(
            f"{p} has {size / 2**20:.0f} MiB, at most {limit / 2**20:.0f} MiB are read; cut it into pieces."
        )
    if size == 0:
        raise InputError(f"{p} is empty; give the path of {kind}.")
    return size


def unreadable(path: str | Path, error: OSError) -> InputError:
    """The InputError for a file that the system does not let us read."""
    return InputError(f"{path} cannot be read ({(error.strerror or str(error)).lower()}); check its permissions.")


def text_lines(path: str | Path, kind: str, limit: int = MAX_TEXT_BYTES) -> list[str]:
    """Lines of a text file; `kind` ("a TRC file") says in the InputError what was expected."""
    readable_size(path, kind, limit)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    if b"\0" in data[:65536]:
        raise InputError(f"{path} is a binary file, not {kind}.")
    return data.decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()


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
            stream = (self.path / name).open("w", encoding="utf-8", newline="\n")
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

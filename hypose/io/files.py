"""Text files: written whole or not at all, read within bounds, errors in one sentence."""

from __future__ import annotations

from pathlib import Path

from hypose.errors import InputError
from hypose.io.results import atomic_path

# Half an hour at 100 Hz with 60 markers as text; longer recordings come in pieces or as C3D.
MAX_TEXT_BYTES = 256 * 2**20


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically, with the same line ends on every system."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


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

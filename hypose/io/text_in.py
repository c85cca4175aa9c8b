"""Text from outside, line by line and within bounds, plain or gzipped."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from hypose.errors import InputError
from hypose.io.files import MAX_TEXT_BYTES, open_file, unreadable

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

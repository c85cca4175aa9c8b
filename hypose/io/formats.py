"""Tables of file formats: which files are read and written, and how the format of a file is found.

Calibrations, key points, motions and skeletons have one table each. A file or folder is read by the first format of the
table whose endings fit its name and whose test fits its content. The error messages about other files, the lists of
formats in the documentation and the tests are made from the tables.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hypose.errors import InputError
from hypose.io.files import csv_rows, natural_key, numbers_of


class Source:
    """A file or folder that is read. Its content is parsed when a format first asks for it, and only once.

    path: the file or folder.
    kind: the expected type of file in error messages, such as "a calibration".
    parse: parser of whole documents (JSON, TOML, YAML, XML).
    """

    def __init__(self, path: Path, kind: str, parse: Callable[[Path], Any]) -> None:
        self.path, self.kind, self._parse = path, kind, parse

    @cached_property
    def document(self) -> Any:
        """Value of a JSON, TOML, YAML or XML file."""
        return self._parse(self.path)

    @cached_property
    def header(self) -> list[str]:
        """Cells of the first line of a CSV file."""
        return csv_rows(self.path, self.kind)[0]

    def files(self, *endings: str) -> list[Path]:
        """List the files of a folder whose names have one of the endings, in natural order (cam2 before cam10).
        Where the source is a file, the list has this file alone.
        """
        if not self.path.is_dir():
            return [self.path]
        found = (p for p in self.path.iterdir() if p.name.lower().endswith(endings) and p.is_file())
        return sorted(found, key=lambda p: natural_key(p.name))


@dataclass(frozen=True)
class Format:
    """Description of a file format: names, and functions that recognise, read and write it.

    name: names of the programs that use it.
    suffixes: ends of its files' names, in lower case; "/" for a folder.
    read: reader of a source, which may take more arguments, the same in a whole table; None where it is only
        written.
    sniff: test whether a source with such a name has this format, by its content; None: the name decides.
    write: writer, with the same arguments in a whole table; None where it is only read.
    limits: what the format cannot hold, for the documentation.
    precision: largest difference between a value that is written and the same value read back, in the value's unit.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[..., Any] | None = None
    sniff: Callable[[Source], object] | None = None
    write: Callable[..., Any] | None = None
    limits: str = ""
    precision: float = 0.0

    def fits(self, path: Path) -> bool:
        """Test whether a name has one of the suffixes; folders must exist."""
        if path.is_dir():
            return "/" in self.suffixes
        return path.name.lower().endswith(self.suffixes)


@dataclass(frozen=True)
class FormatTable:
    """The formats of one kind of data.

    kind: a file of this kind in error messages, such as "a calibration".
    advice: last part of the error messages about files that no format reads.
    formats: in the order in which they are tried.
    parse: parser of whole documents, for `Source`.
    """

    kind: str
    advice: str
    formats: tuple[Format, ...]
    parse: Callable[[Path], Any] = Path.read_bytes

    def read(self, path: str | Path, *arguments: Any) -> Any:
        """Read a file or folder with the first format that fits it.

        arguments: further arguments of the reader.
        Raises: InputError where no format fits, or the file is damaged; it names the formats.
        """
        found, source = self.find(Path(path))
        assert found.read is not None  # `find` gives no other
        with numbers_of(str(path)):
            return found.read(source, *arguments)

    def find(self, path: Path) -> tuple[Format, Source]:
        """Find the first format that fits a file or folder.

        Raises: InputError where there is none.
        """
        if not path.exists():
            raise InputError(f"{path} does not exist; check the path, or {self.advice}.")
        source = Source(path, self.kind, self.parse)
        fitting = [f for f in self.formats if f.read is not None and f.fits(path)]
        with numbers_of(str(path)):
            found = next((f for f in fitting if f.sniff is None or f.sniff(source)), None)
        if found is not None:
            return found, source
        known = f"of {', '.join(dict.fromkeys(f.name for f in fitting))}" if fitting else f"({self.listing()})"
        raise InputError(f"{path} is not {self.kind} {known}{_looks_like(path)}; {self.advice}.")

    def listing(self) -> str:
        """Format the list of the endings of readable files as text, for error messages."""
        endings = dict.fromkeys(s for f in self.formats if f.read is not None for s in f.suffixes if s[:1] in "./")
        return ", ".join("a folder" if s == "/" else s for s in endings)


_TABLES = (
    "hypose.io.calibrations.calibration_formats:CALIBRATIONS",
    "hypose.io.keypoints.keypoint_files:KEYPOINTS",
    "hypose.io.motions.export:MOTION_FILES",
    "hypose.io.sensors.skeleton_files:SKELETONS",
)


def _looks_like(path: Path) -> str:
    """Name the format of another table that fits a file by its content, as part of an error message."""
    for place in _TABLES:
        module, _, name = place.partition(":")
        table: FormatTable = getattr(importlib.import_module(module), name)
        source = Source(path, table.kind, table.parse)
        with contextlib.suppress(InputError), numbers_of(str(path)):
            for one in table.formats:
                if one.fits(path) and one.sniff is not None and one.sniff(source):
                    return f", it looks like {table.kind} of {one.name}"
    return ""

"""The [[person]] tables of recording.toml: what is known beforehand of the people in a recording."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypose.errors import InputError
from hypose.io.file_names import file_name
from hypose.io.recordings.recording_keys import PERSON_KEYS, check_keys, numbers

_NAME = re.compile(r"[\w][\w .-]{0,59}")
_FILE = re.compile(r".*\.[a-z0-9]{2,5}")
"""what names a file, as those of everybody's results beside whom the folders lie"""


@dataclass(frozen=True)
class Person:
    """name: of the folder of their results; height m; body: of their own, a path as `hypose subject` writes it; place
    (2,) m: where they stand at `time`, s from the first frame."""

    name: str
    height: float | None = None
    body: Path | None = None
    place: tuple[float, float] | None = None
    time: float = 0.0


def people_of_tables(folder: Path, where: str, tables: Any) -> tuple[Person, ...]:
    """The people that the tables tell of; an InputError names what is wrong."""
    found = [_person(folder, where, table, k) for k, table in enumerate(tables)]
    names = [p.name for p in found]
    if len({_told_apart(n) for n in names}) < len(names):
        raise InputError(
            f"{where}: the names of people must differ, got {', '.join(names)}, by more than capitals, spaces, dots "
            "and hyphens, which not all systems and files tell apart; rename one."
        )
    return tuple(found)


def _told_apart(name: str) -> str:
    """What of a name every file system and every C3D file keeps."""
    return re.sub(r"[ .-]+", "-", unicodedata.normalize("NFKC", name).casefold())


def _person(folder: Path, where: str, table: Any, index: int) -> Person:
    if not isinstance(table, Mapping):
        raise InputError(
            f"{where}: person must be [[person]] tables, got {table!r}; write [[person]] before each person."
        )
    name = table.get("name", f"person-{index + 1}")
    here = f"{where}, person {name}"
    check_keys(here, table, PERSON_KEYS)
    plain = _NAME.fullmatch(name) and file_name(name) == name and not _FILE.fullmatch(name)
    if not plain or name in ("all",) or name.strip(" .") != name or name.isdigit():
        raise InputError(
            f"{here}: the name must begin with a letter and may have letters, digits, spaces, dots and hyphens, since "
            "it names a folder, and must not be that of a file (report.html); change it."
        )
    height, time = table.get("height"), float(table.get("time", 0.0))
    if height is not None and not 0.4 <= height <= 2.8:
        raise InputError(f"{here}: height = {height:g} is implausible; give it in metres (0.4 to 2.8).")
    if time < 0:
        raise InputError(f"{here}: time = {time:g} lies before the first frame; give seconds from there.")
    place = None
    if "place" in table:
        x, y = numbers(here, "place", table["place"], 2, whole=False)
        place = (float(x), float(y))
    body = folder / table["body"] if "body" in table else None
    return Person(name, None if height is None else float(height), body, place, time)

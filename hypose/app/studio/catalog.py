"""Catalog of the served folder: recordings, results, gesture sessions and models, recordings of live sensors, each with
an opaque id.

A page gives an id, or the path of a folder that becomes a recording; only items that lie inside the served folder, with
links resolved, are found.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hypose.errors import InputError
from hypose.io.files import open_file, text_of
from hypose.io.motions.results import open_archive
from hypose.io.recordings import pose2sim

Kind = Literal["recording", "result", "session", "model", "skeletons"]
_DEPTH, _MOST_RECORDINGS, _MOST_FOLDERS = 5, 2000, 20_000
_FRESH_S = 1.0
_DATA = (".npz", ".json", ".csv")
_HELD = ("motion.npz", "session.json", "frames.csv", "skeleton.csv")
_MODEL_BYTES = 4 << 30
_SKIPPED = frozenset({"node_modules", "__pycache__", "depth", "videos", "images", "masks", "site-packages"})


class NotFound(InputError):
    """Error: there is no item with this id."""


@dataclass(frozen=True)
class Item:
    """Recording, result, session, model or skeleton recording in the served folder.

    kind: kind of the item.
    id: opaque id.
    path: its path inside the root, with links resolved.
    changed: time of the last change, s.
    """

    kind: Kind
    id: str
    path: Path
    changed: float


class Catalog:
    """Items of a folder; the folder is searched again when items are requested, at most once a second."""

    def __init__(self, root: Path) -> None:
        self.root: Path = root.resolve()
        self._items: dict[str, Item] = {}
        self._looked = -_FRESH_S

    def items(self, kind: Kind | None = None, fresh: bool = False) -> list[Item]:
        """List all items of a kind (None: of all kinds), last changed first; fresh: search the folder now."""
        self._look(fresh)
        return sorted(
            (i for i in self._items.values() if kind in (None, i.kind)), key=lambda i: (-i.changed, str(i.path))
        )

    def find(self, kind: Kind, id: Any) -> Item:
        """Find an item by the id that a request gives.

        Raises: InputError where the id is no text; NotFound where the item does not exist, or no longer.
        """
        if not isinstance(id, str):
            raise InputError(f"Say which {kind} is meant.")
        item = self._items.get(id)
        if item is None or item.kind != kind or not item.path.exists():
            self._look(fresh=True)
            item = self._items.get(id)
        if item is None or item.kind != kind or not self.contains(item.path):
            raise NotFound(f"There is no {kind} {id[:40]!r} here (any more); go back to the list.")
        return item

    def id_of(self, kind: Kind, path: Path) -> str:
        """Compute the id of a path inside the root; the path need not exist."""
        text = f"{kind}:{path.resolve().relative_to(self.root).as_posix()}"
        return hashlib.blake2b(os.fsencode(text), digest_size=6).hexdigest()

    def contains(self, path: Path) -> bool:
        """Return whether a path lies inside the root, with all links resolved."""
        try:
            return path.resolve().is_relative_to(self.root)
        except OSError:
            return False

    def inside(self, where: str, base: Path | None = None) -> Path:
        """Resolve a path, absolute or relative to `base` (default: the root).

        Raises: InputError where it does not exist or lies outside the root, also through a link.
        """
        path = (base or self.root) / where
        try:
            found = path.resolve(strict=True)
        except (OSError, ValueError, RuntimeError):
            raise InputError(f"{where[:200]!r} is not there; choose something of the list.") from None
        if not found.is_relative_to(self.root):
            raise InputError(f"{where[:200]!r} lies outside of {self.root.name}; start `hypose view` in its folder.")
        return found

    def shown(self, path: Path) -> str:
        """Return a path as the page shows it: relative to the root; the root itself by its name."""
        relative = path.resolve().relative_to(self.root).as_posix()
        return text_of(self.root.name if relative == "." else relative)

    def recording_of(self, result: Path) -> Path | None:
        """Find the recording whose folder contains a result (results/RECIPE/ in it); None where it is outside the root
        or missing.
        """
        folder = recording_above(result)
        return folder if folder is not None and folder.is_relative_to(self.root) else None

    def _look(self, fresh: bool) -> None:
        """Search the folder where the last search is older than _FRESH_S seconds.

        fresh: search it in any case.
        """
        if not fresh and time.monotonic() - self._looked < _FRESH_S:
            return
        found: dict[str, Item] = {}
        for kind, path in _search(self):
            if len(found) < _MOST_RECORDINGS and self.contains(path):
                id = self.id_of(kind, path)
                at = changed(path / "motion.npz") or changed(path) or 0.0
                found[id] = Item(kind, id, path.resolve(), at)
        self._items, self._looked = found, time.monotonic()


def is_recording(folder: Path) -> bool:
    """Return whether a folder is a recording that `hypose track` accepts."""
    with contextlib.suppress(OSError):  # an unreadable folder is no recording
        return (folder / "recording.toml").is_file() or pose2sim.is_project(folder)
    return False


def recording_above(results: Path) -> Path | None:
    """Find the recording whose folder contains a result: results/RECIPE/ in it."""
    return next((f for f in list(results.resolve().parents)[:3] if is_recording(f)), None)


def changed(path: Path) -> float | None:
    """Return the time (s since 1970) at which a file or folder was last changed; None where it is not there."""
    with contextlib.suppress(OSError):
        return path.stat().st_mtime


def _search(catalog: Catalog) -> Iterator[tuple[Kind, Path]]:
    """Search the items of a folder breadth first, so that near ones are found in a huge folder. Links that lead out of
    the root are skipped.
    """
    waiting, seen = [(catalog.root, 0)], 0
    while waiting and seen < _MOST_FOLDERS:
        folder, depth = waiting.pop(0)
        seen += 1
        try:
            entries = sorted(folder.iterdir())
            if is_recording(folder) and catalog.contains(folder / "recording.toml"):
                yield "recording", folder
        except OSError:
            continue
        led_out = any(e.suffix in _DATA and e.is_symlink() and not catalog.contains(e) for e in entries)
        names = {e.name for e in entries if e.name in _HELD and not led_out and e.is_file()}
        if "motion.npz" in names:
            yield "result", folder
        if {"session.json", "frames.csv"} <= names:
            yield "skeletons" if "skeleton.csv" in names else "session", folder
        for entry in entries:
            if entry.suffix == ".npz" and _is_model(entry):
                yield "model", entry
            hidden = entry.name.startswith(".") or (entry.name in _SKIPPED and not is_recording(entry))
            if depth < _DEPTH and not hidden and not entry.is_symlink() and entry.is_dir():
                waiting.append((entry, depth + 1))


def _is_model(path: Path) -> bool:
    """Return whether a file is a gesture model, by the names of its arrays only."""
    if path.name in ("motion.npz", "body.npz", "checkpoint.npz", "truth.npz"):
        return False
    try:
        with open_file(path, "a gesture model", _MODEL_BYTES) as stream, open_archive(stream) as archive:
            names = set(archive.namelist())
    except (InputError, OSError, zipfile.BadZipFile, ValueError):
        return False
    return {"description.npy", "test.npy", "left.npy"} <= names

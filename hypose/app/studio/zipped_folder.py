"""All files of a result in one archive, made while it is sent: nothing of it is kept in memory or on the disk."""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.uploads import harmless
from hypose.io.files import open_file

_PIECE = 1 << 20


class _Outlet(io.RawIOBase):
    """What is written is taken away by whoever sends it."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        piece = bytes(data)  # type: ignore[call-overload]
        self._waiting += piece
        return len(piece)

    def take(self) -> bytes:
        """What has been written since."""
        out = bytes(self._waiting)
        self._waiting.clear()
        return out


def archive_name(folder: Path) -> str:
    """RECORDING-RESULT.zip."""
    parent = folder.parent.parent.name if folder.parent.name == "results" else folder.parent.name
    return f"{harmless(f'{parent}-{folder.name}')}.zip"


def zipped(folder: Path, catalog: Catalog) -> Iterator[bytes]:
    """The bytes of a ZIP archive of a results folder with the files below it; hidden ones, and links that lead out of
    the served folder, are left out."""
    outlet = _Outlet()
    with zipfile.ZipFile(outlet, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            if any(part.startswith(".") for part in inside.parts) or not path.is_file() or not catalog.contains(path):
                continue
            info = zipfile.ZipInfo.from_file(path, f"{folder.name}/{inside.as_posix()}", strict_timestamps=False)
            with (
                open_file(path, "a file", sys.maxsize, 0) as source,
                archive.open(info, "w", force_zip64=True) as target,
            ):
                while piece := source.read(_PIECE):
                    target.write(piece)
                    yield outlet.take()
    yield outlet.take()

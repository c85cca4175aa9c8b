"""Python's own cache of compiled modules (.pyc) costs time when it is damaged or cannot be kept, never a command.

Python renames a .pyc into place without looking whether all of it was written (before 3.13); on a full disk, or where
the size of files is limited, that leaves half of one, and every later start ends with "marshal data too short".
"""

from __future__ import annotations

import contextlib
import os
import sys
from importlib.machinery import (
    BYTECODE_SUFFIXES,
    EXTENSION_SUFFIXES,
    SOURCE_SUFFIXES,
    ExtensionFileLoader,
    FileFinder,
    SourceFileLoader,
    SourcelessFileLoader,
)
from importlib.util import cache_from_source
from types import CodeType
from typing import Any


class CheckedLoader(SourceFileLoader):
    """Loads a module from its source when its bytecode is damaged, and keeps no bytecode that is not whole."""

    def get_code(self, fullname: str) -> CodeType | None:
        """The module's code."""
        try:
            return super().get_code(fullname)
        except (EOFError, ValueError, TypeError):
            path = self.get_filename(fullname)
            with contextlib.suppress(OSError, NotImplementedError):
                os.unlink(cache_from_source(path))
            return self.source_to_code(self.get_data(path), path)

    def set_data(self, path: str, data: Any, **options: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write bytecode, whole or not at all."""
        super().set_data(path, data, **options)
        with contextlib.suppress(OSError):
            if os.path.getsize(path) != len(data):
                os.unlink(path)


def check_bytecode() -> None:
    """Have every module that is imported from now on go through the CheckedLoader: for the process of a command."""
    kinds = (
        (ExtensionFileLoader, EXTENSION_SUFFIXES),
        (CheckedLoader, SOURCE_SUFFIXES),
        (SourcelessFileLoader, BYTECODE_SUFFIXES),
    )
    sys.path_hooks.insert(0, FileFinder.path_hook(*kinds))
    sys.path_importer_cache.clear()

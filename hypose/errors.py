"""The errors a user can meet. Each message is one sentence: the given value, the allowed ones, the next step."""

from __future__ import annotations

import importlib
import re
from typing import Any

# C0 and C1 but tab and newline, line and paragraph separators, marks that turn the direction, halves of pairs
_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def visible(text: str) -> str:
    """The text as any terminal, page or log may show it: what would steer a terminal, turn the direction of writing or
    is no UTF-8 (in a file's name) becomes an escape: \\x1b, \\u202e, \\xff."""
    return _UNSEEN.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # how Python carries a byte that it could not decode
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"


class HyposeError(Exception):
    """Base of every error that hypose raises on purpose; the command line prints it and exits with code 2."""

    def __str__(self) -> str:
        # a damaged file may have a name or a number of many thousand letters
        text = visible(super().__str__()).replace("\n", "\\n")
        return text if len(text) <= 2000 else f"{text[:1000]} ... {text[-500:]}"


class InputError(HyposeError):
    """A file, recording or argument that cannot be used: names the file, camera or frame and the next step."""


class CalibrationError(InputError):
    """A camera calibration that is missing, malformed or contradicts the images."""


class EvidenceError(HyposeError):
    """Image evidence that carries no information (no usable silhouette in any view, no key points, NaN)."""


class SolverError(HyposeError):
    """A numerical search that was started from an unusable point (non-finite cost, wrong dimension)."""


def extra(module: str, needed_by: str, name: str, package: str = "", or_else: str = "") -> Any:  # noqa: ANN401 (a module)
    """A module of the optional dependencies called `name`; without it an InputError tells what needs its package (by
    default called like the module), how to install it or what it fails to load, and or_else: what does without it."""
    package, root = package or module.partition(".")[0], module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except Exception as error:  # noqa: BLE001 (of the system's libraries, of another numpy: each package has its own)
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == root:
            what, cure = "is not installed", f'run: pip install "hypose[{name}]"'
        else:
            reason = f"{type(error).__name__}: {error}".partition("\n")[0].rstrip(".: ")
            what, cure = f"cannot be loaded ({reason})", f"install what that names, or {package} again"
        raise InputError(
            f"{needed_by} needs {package}, which {what}; {cure}{or_else and f', or {or_else}'}."
        ) from error

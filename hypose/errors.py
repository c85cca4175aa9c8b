"""Exceptions that a user can meet. Each message is one sentence with the given value, the allowed values and the next
step.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import Any

# C0 and C1 except tab and newline, line and paragraph separators, marks of direction, single surrogates
_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def visible(text: str) -> str:
    r"""Escape the characters of a text that are unsafe to show in a terminal, a page or a log.

    These are control characters, marks that change the direction of writing and undecodable bytes of a file's name.
    They become escapes such as \x1b, \u202e and \xff.
    """
    return _UNSEEN.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # how Python carries a byte that it could not decode
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"


class HyposeError(Exception):
    """Base class of all errors that hypose raises on purpose; the command line prints the message and exits with code
    2.
    """

    def __str__(self) -> str:
        # a damaged file may have a name or a number of many thousand letters
        text = visible(super().__str__()).replace("\n", "\\n")
        return text if len(text) <= 2000 else f"{text[:1000]} ... {text[-500:]}"


class InputError(HyposeError):
    """An unusable file, recording or argument; the message names the file, camera or frame and the next step."""


class CalibrationError(InputError):
    """A camera calibration that is missing, malformed or contradicts the images."""


def refuse(where: str, faults: Mapping[str, Any], kind: type[HyposeError] = InputError) -> None:
    """Raise an error that names the first fault that is there.

    where: start of its sentence, such as the file.
    faults: for each fault the rest of the sentence without its full stop, and whether it is there.
    kind: class of the error.
    """
    for fault, there in faults.items():
        if there:
            raise kind(f"{where}{fault}.")


class EvidenceError(HyposeError):
    """Image evidence without information: no usable silhouette in any view, no key points, or NaN."""


class SolverError(HyposeError):
    """A numerical search that was started from an unusable point: the cost is not finite or the dimension is wrong."""


def extra(module: str, needed_by: str, name: str, package: str = "", or_else: str = "") -> Any:  # noqa: ANN401 (a module)
    """Import a module of an optional dependency.

    module: dotted name of the module.
    needed_by: what needs it, the subject of the error message.
    name: the extra to install, as in "hypose[name]".
    package: the package's name in the message; the module's first part by default.
    or_else: an alternative without the package, the last part of the error message.
    Returns: the module.
    Raises: InputError where the package is not installed or fails to load; it says how to install it.
    """
    package, root = package or module.partition(".")[0], module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except Exception as error:  # noqa: BLE001 (of the system's libraries, of another numpy: each package has its own)
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == root:
            what, cure = "is not installed", f'run: pip install "hypose[{name}]"'
        else:
            reason = f"{type(error).__name__}: {error}".partition("\n")[0].rstrip(".: ")
            what, cure = f"cannot be loaded ({reason})", f"install what the reason names, or {package} again"
        raise InputError(
            f"{needed_by} needs {package}, which {what}; {cure}{or_else and f', or {or_else}'}."
        ) from error

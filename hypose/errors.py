"""The errors a user can meet. Each message is one sentence: what was given, what is allowed, the next step."""

from __future__ import annotations

import re

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

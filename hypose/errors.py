"""The errors a user can meet. Each message is one sentence: what was given, what is allowed, the next step."""

from __future__ import annotations


class HyposeError(Exception):
    """Base of every error that hypose raises on purpose; the command line prints it and exits with code 2."""

    def __str__(self) -> str:
        # a damaged file may have a name or a number of many thousand letters
        text = super().__str__()
        return text if len(text) <= 2000 else f"{text[:1000]} ... {text[-500:]}"


class InputError(HyposeError):
    """A file, recording or argument that cannot be used: names the file, camera or frame and the next step."""


class CalibrationError(InputError):
    """A camera calibration that is missing, malformed or contradicts the images."""


class EvidenceError(HyposeError):
    """Image evidence that carries no information (no usable silhouette in any view, no key points, NaN)."""


class SolverError(HyposeError):
    """A numerical search that was started from an unusable point (non-finite cost, wrong dimension)."""

"""The errors a user can meet. Each message is one sentence: what was given, what is allowed, the next step."""

from __future__ import annotations


class HyposeError(Exception):
    """Base of every error that hypose raises on purpose; the command line prints it and exits with code 2."""


class InputError(HyposeError):
    """A file, recording or argument that cannot be used: names the file, camera or frame and the next step."""


class CalibrationError(InputError):
    """A camera calibration that is missing, malformed or contradicts the images."""


class EvidenceError(HyposeError):
    """Image evidence that carries no information (no usable silhouette in any view, no key points, NaN)."""


class SolverError(HyposeError):
    """A numerical search that was started from an unusable point (non-finite cost, wrong dimension)."""

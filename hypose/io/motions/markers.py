"""Markers: what every reader of marker files returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hypose.errors import InputError
from hypose.geometry import Array

# metres per unit of length, by the names that marker files use
METRES = {"m": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(frozen=True)
class Markers:
    """Marker trajectories: names (M), points (T, M, 3) m with NaN where a marker was not seen, frame_rate Hz,
    and the unit of length that the file was written in."""

    names: tuple[str, ...]
    points: Array
    frame_rate: float
    units: str

    def __post_init__(self) -> None:
        if self.points.ndim != 3 or self.points.shape[1:] != (len(self.names), 3):
            raise InputError(
                f"{len(self.names)} marker names need points of shape (frames, {len(self.names)}, 3), "
                f"got {self.points.shape}."
            )


def metres_per_unit(unit: str, where: str) -> float:
    """Metres per file unit; an InputError names the file (`where`) and the units that are known."""
    try:
        return METRES[unit.strip().lower()]
    except KeyError:
        raise InputError(f"{where} is in unit {unit!r}; known units are {', '.join(METRES)}.") from None


def checked(names: Sequence[str], points: ArrayLike, frame_rate: float, where: str) -> tuple[tuple[str, ...], Array]:
    """Names and points (T, M, 3) of a file to be written, or an InputError that says what is wrong with
    them."""
    p, n = np.asarray(points, dtype=np.float64), tuple(str(name) for name in names)
    if p.ndim != 3 or p.shape[1:] != (len(n), 3) or not p.size:
        raise InputError(
            f"{where}: {len(n)} names need points of shape (frames, {len(n)}, 3) with at least one frame, "
            f"got {p.shape}."
        )
    if len(set(n)) < len(n):
        twice = next(x for x in n if n.count(x) > 1)
        raise InputError(f"{where}: the marker name {twice!r} occurs twice; names must differ.")
    if any(not x or any(c in x for c in "\t\r\n") for x in n):
        raise InputError(f"{where}: a marker name is empty or holds a tab or line break; rename it.")
    if not np.isfinite(frame_rate) or frame_rate <= 0:
        raise InputError(f"{where}: the frame rate is {frame_rate}; it must be a positive number of frames/s.")
    if np.isinf(p).any():
        raise InputError(f"{where}: some points are infinite; use NaN for a marker that was not seen.")
    return n, p

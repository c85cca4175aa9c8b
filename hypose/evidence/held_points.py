"""Find key points that were held over gaps: a detector, or a program that filled its gaps, repeated the last known
place.

Real detections of a person who stands still differ in their last digits. A point with exactly the same value in several
frames, while most other points of the view move on, was not seen there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

_HELD = 3  # frames with the same place from which a point is held; the first of them is a detection
_MOVING = 0.7  # least share of the people's points in a frame that move
_COARSE = 0.1  # share of repeated places in a view from which they are rounded too much, or too still, to decide
_LEAST_POINTS = 6  # least points of a frame that show whether the others move


def without_held(column: Sequence[Array | None], first: int = 0) -> tuple[list[Array | None], int]:
    """Set held key points of one view to confidence 0.

    column: per frame the people (P, K, M), confidence in column 2; None where there are none.
    first: of the two columns with the places in px as they were given.
    Returns: the frames with held points removed; the number of held points.
    """
    out = [None if people is None else people.copy() for people in column]
    seen = repeated = count = 0
    before: tuple[Array, NDArray[np.int64]] | None = None  # the people of the frame before, and for how long
    for t, people in enumerate(out):
        if people is None or not len(people):
            before = None
            continue
        given = column[t]
        assert given is not None
        there, place = given[..., 2] > 0, given[..., first : first + 2]
        age = np.ones(there.shape, dtype=np.int64)
        if before is not None:
            places, ages = before
            same = (place[:, None] == places[None]).all(-1)  # (P, P', K)
            age = np.where(there, 1 + np.where(same, ages[None], 0).max(1), 1)
            moving = there.sum() >= _LEAST_POINTS and (age[there] == 1).mean() >= _MOVING
            seen, repeated = seen + int(there.sum()), repeated + int((age[there] > 1).sum())
            held = there & (age >= _HELD) & moving
            people[held, 2], count = 0.0, count + int(held.sum())
            last = out[t - 1]
            just = same & (held & (age == _HELD))[:, None]  # the previous frame was held too
            if last is not None and just.any():
                last[just.any(0), 2], count = 0.0, count + int(just.any(0).sum())
        before = np.where(there[..., None], place, np.nan), age
    return (out, count) if repeated <= _COARSE * max(seen, 1) else (list(column), 0)

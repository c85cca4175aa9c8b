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
    """Set the confidence of key points of one view to 0 where a program only repeated ("held") the last position.

    A point is held where its position is exactly the same in three or more frames in succession while most other points
    of the view move; the first of these frames is a detection and stays.
    column: per frame the people (P, K, M), with u, v, confidence in the columns 0 to 2; None where there are none.
    first: index of the first of the two columns with the positions (px) as the file gave them, which are compared; 0
        where u and v are those, 3 where u and v were undistorted and the given ones follow the confidence.
    Returns: the frames, copied and with confidence 0 at held points; and the number of held points. Where more than a
        tenth of all positions are repeated (rounded too much, or too still to decide), nothing changes and it is 0.
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

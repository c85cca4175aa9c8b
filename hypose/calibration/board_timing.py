"""Pictures that were not taken quite at the same instant: how far a moving board can be believed.

Webcams and phones without a trigger expose within a part of a frame of each other, differently in every frame, so
a corner is uncertain by the distance it moves in that time. Boards held still then decide, as they should.

Tried and dropped: leaving the fastest boards out (fewer boards, 1.7 instead of 0.4 degrees from an independent
calibration of four webcams). A time offset per picture as a further unknown: it explains the misfit (0.85 to 0.35 px
there) but the boards that were held still fit worse afterwards, so it explains away what the poses should explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hypose.calibration.boards import Board, Sighting
from hypose.cameras.camera import Camera
from hypose.geometry import Array, transform

OFFSET_SD = 0.1
"""Standard deviation of a picture's instant, frames."""
_REACH = 2  # frames: a neighbour farther away says nothing about the velocity


def motion_noise(
    cameras: Sequence[Camera],
    boards: Mapping[int, Array],
    sightings: Mapping[int, Mapping[int, Sighting]],
    board: Board,
) -> dict[tuple[int, int], float]:
    """Standard deviation (px) that a board's motion adds to its corners, by (camera, frame).

    boards: world_from_board (4, 4) by frame as fitted so far. Boards without a neighbour in time, whose motion is not
    known, are taken to move like the others' median."""
    out: dict[tuple[int, int], float] = {}
    unknown = []
    for f in sorted({f for seen in sightings.values() for f in seen}):
        who = [c for c, seen in sightings.items() if f in seen]
        near = [g for g in (*range(f - _REACH, f), *range(f + 1, f + _REACH + 1)) if g in boards]
        before, after = max((g for g in near if g < f), default=f), min((g for g in near if g > f), default=f)
        if f not in boards or before == after:
            unknown += [(c, f) for c in who]
            continue
        low, high = transform(boards[before], board.points), transform(boards[after], board.points)
        for c in who:
            moved = (cameras[c].project(high) - cameras[c].project(low)) / (after - before)
            speed = float(np.sqrt(np.nanmean(moved**2))) if np.isfinite(moved).any() else 0.0
            out[c, f] = OFFSET_SD * speed
    usual = float(np.median(list(out.values()))) if out else 0.0
    return out | dict.fromkeys(unknown, usual)

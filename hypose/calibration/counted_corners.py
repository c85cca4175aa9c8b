"""Which chessboard is it? Its corners, counted in the pictures, so that nobody has to count them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from hypose.calibration.boards import Gray
from hypose.calibration.views import Source, chessboard_seen
from hypose.errors import CalibrationError
from hypose.io.videos.video import open_video

_PICTURES = 8
"""Pictures of each camera that are looked at."""
_ENOUGH = 4
"""Pictures that must show the same number of corners before no further camera is looked at."""


def count_corners(sources: Sequence[Source]) -> tuple[int, int]:
    """Inner corners (columns, rows), the larger number first, of the chessboard in board videos or photos.

    A board that is partly hidden or partly found shows fewer corners than it has, so that number counts which most
    pictures agree on, and of those that as many agree on the larger. A CalibrationError when none is seen twice."""
    votes: dict[tuple[int, int], int] = {}
    for source in sources:
        for gray in _spread(source):
            seen = chessboard_seen([gray])
            if seen is not None:
                votes[seen] = votes.get(seen, 0) + 1
        if votes and max(votes.values()) >= _ENOUGH:
            break
    found = max(votes, key=lambda n: (votes[n], n[0] * n[1]), default=None)
    if found is None or votes[found] < 2:
        raise CalibrationError(
            f"No chessboard was seen in the pictures of {', '.join(s.name for s in sources)}, so its corners could not "
            "be counted; say which board it is: --chessboard COLUMNSxROWS (inner corners) or --charuco (squares)."
        )
    return found


def _spread(source: Source) -> Iterator[Gray]:
    with open_video(source.path) as reader:
        for frame in np.unique(np.linspace(0, reader.n_frames - 1, min(_PICTURES, reader.n_frames)).astype(int)):
            yield np.asarray(cv2.cvtColor(reader.read(int(frame)), cv2.COLOR_BGR2GRAY), dtype=np.uint8)

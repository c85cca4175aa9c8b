"""What every reader of 2D key points returns for one camera, and what all of them do with numbers from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.geometry import Array

MAX_BYTES = 512 * 2**20
MAX_POINTS = 1000
MAX_FRAMES = 5_000_000
SEEN = 0.3
"""Points of less score are not there for tracking."""
WEIGHED = 0.31
_SAMPLED = 60


@dataclass(frozen=True)
class KeypointTable:
    """Key points of one camera as a file gives them.

    layout: the file's kind, for sentences. people: frame by the file's own number -> (P, K, 3) = (u, v, score >= 0),
    score 0 where a point is missing; K is the same in all frames with people. first: the number that the video's first
    frame has; None when the layout does not say, so that the smallest of all views' numbers counts. names: of the
    points, where the file gives them. stated: the set that it states. shares: positions are shares of the picture's
    width and height. scored: the file has scores. spread: it has standard deviations of the points too, which are in
    the scores (`weighed`). frame_rate: where it tells.
    """

    layout: str
    people: Mapping[int, Array]
    first: int | None = None
    names: tuple[str, ...] | None = None
    stated: str | None = None
    shares: bool = False
    scored: bool = True
    spread: bool = False
    frame_rate: float | None = None

    def sample(self) -> Array:
        """People (N, K, 3) of at most 60 frames with somebody, evenly spread; (0, 0, 3) when nobody is there."""
        numbers = sorted(self.people)
        found: list[Array] = []
        # every 60th part of the file gives one frame, its first with somebody
        for part in np.array_split(np.array(numbers), min(_SAMPLED, max(1, len(numbers)))):
            somebody = next((p for n in part.tolist()[:200] if len(p := self.people[n])), None)
            if somebody is not None:
                found.append(somebody)
        if not found:
            return np.zeros((0, 0, 3))
        count = found[0].shape[1]
        if any(p.shape[1] != count for p in found):
            raise InputError("people have different numbers of key points; export one model's.")
        return np.concatenate(found)


def checked_people(values: Any, where: str) -> Array:
    """(P, K, 3) float64 of nested numbers; positions that are not finite, or (0, 0), or have no score, are missing
    (all 0). An InputError for anything else."""
    try:
        p = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: key points must be numbers, as many in each person; export them again.") from None
    if p.size == 0:
        return np.zeros((0, 0, 3))
    if p.ndim != 3 or p.shape[2] != 3 or not 1 <= p.shape[1] <= MAX_POINTS:
        raise InputError(f"{where}: key points have the shape {p.shape}, people x points x 3 is needed; export again.")
    if np.isinf(p).any():
        raise InputError(f"{where}: a key point is infinite; export it again.")
    missing = ~np.isfinite(p).all(-1) | ~(np.nan_to_num(p[..., 2]) > 0) | (p[..., :2] == 0).all(-1)
    return np.where(missing[..., None], 0.0, p)


def weighed(points: Array, variance: Array) -> Array:
    """Points (..., 3) with a variance (..., 2) px^2 of each as those of which the score says how much they weigh: 1 for
    a point as sure as the median one or surer, else its share of that one's information; not below WEIGHED, since what
    is less sure is told from what is not there by the score that it has. Points without a variance stay as they are."""
    given = np.isfinite(variance).all(-1) & (variance > 0).all(-1) & (points[..., 2] > SEEN)
    if not given.any():
        return points
    spread = variance.mean(-1)
    share = np.clip(np.median(spread[given]) / np.where(given, spread, 1.0), WEIGHED, 1.0)
    out = points.copy()
    out[..., 2] = np.where(given, share, points[..., 2])
    return out


def scored_points(positions: Any, scores: Any, where: str) -> Array:
    """(K, 3) of positions (K, 2 or more) and scores (K,) or None (all 1)."""
    try:
        xy = np.array(positions, dtype=np.float64)
        s = None if scores is None else np.array(scores, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: key points must be numbers; export them again.") from None
    if xy.ndim != 2 or not 2 <= xy.shape[1] <= 4 or not 1 <= len(xy) <= MAX_POINTS:
        raise InputError(f"{where}: key points have the shape {xy.shape}, points x 2 is needed; export them again.")
    if s is None:
        s = np.ones(len(xy))
    if len(s) != len(xy):
        raise InputError(f"{where}: {len(xy)} key points but {len(s)} scores; export them again.")
    return np.column_stack([xy[:, :2], s])


def grouped(rows: Sequence[tuple[int, Array]], where: str) -> dict[int, Array]:
    """People by frame number, from (number, (K, 3)) rows in any order."""
    if not rows:
        return {}
    counts = {len(points) for _, points in rows}
    if len(counts) > 1:
        raise InputError(
            f"{where}: people have {', '.join(map(str, sorted(counts)))} key points; export those of one model."
        )
    stacked = checked_people([points for _, points in rows], where)
    out: dict[int, list[Array]] = {}
    for (number, _), points in zip(rows, stacked, strict=True):
        out.setdefault(number, []).append(points)
    return {n: np.stack(p) for n, p in out.items()}


def whole_number(value: Any, where: str, what: str) -> int:
    """A frame's number; an InputError for anything that cannot be one."""
    fine = isinstance(value, int | float) and not isinstance(value, bool) and float(value).is_integer()
    if not fine or not 0 <= value < 2**40:
        raise InputError(f"{where}: {what} is {str(value)[:40]!r}, a whole number is needed; export it again.")
    return int(value)

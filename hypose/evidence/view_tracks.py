"""People followed in each view alone, and which of them is whom in another view, by how they move: for views that are
not calibrated, or wrongly.

Points of one moving body in two views obey one fundamental matrix, whatever the cameras are; points of two different
people do not. Neither poses nor lenses have to be right for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

_LEAST_CONFIDENCE = 0.1  # least confidence of a point that counts
_LEAST_POINTS = 4  # key points of a person
_JUMP = 0.35  # share of the person's size that its points move from frame to frame (median)
_MOST_PAIRS = 1500  # pairs of points that a fundamental matrix is made of
_FEWEST_PAIRS = 60  # with fewer nothing is known


@dataclass(frozen=True)
class ViewTrack:
    """One person in one view: the candidate's number at each frame of the clip (T,), -1 for none."""

    candidates: NDArray[np.int64]

    @property
    def frames(self) -> int:
        """In how many frames the person is there."""
        return int((self.candidates >= 0).sum())


def view_tracks(frames: Sequence[Array | None], patience: int) -> list[ViewTrack]:
    """People of one view: candidates (P, K, 3) per frame joined to whom they lie nearest to; those there longest first.

    patience: frames after which a person who is not seen is followed no more. In each frame candidates and people are
    assigned exactly, so that two do not take each other's place."""
    from scipy.optimize import linear_sum_assignment  # takes long to import

    tracks: list[NDArray[np.int64]] = []
    last: list[Array] = []
    at: list[int] = []
    alive: list[int] = []
    for t, people in enumerate(frames):
        alive = [i for i in alive if t - at[i] <= patience]
        if people is None:
            continue
        is_person = np.flatnonzero((people[..., 2] > _LEAST_CONFIDENCE).sum(-1) >= _LEAST_POINTS)
        if not len(is_person):
            continue
        free = set(is_person.tolist())
        if alive:
            cost = np.array([[_moved(last[i], people[p], t - at[i]) for p in is_person] for i in alive])
            for i, j in zip(*linear_sum_assignment(np.minimum(cost, 2.0)), strict=True):
                if cost[i, j] < 1.0:
                    n, p = alive[int(i)], int(is_person[j])
                    tracks[n][t], last[n], at[n] = p, people[p], t
                    free.discard(p)
        for p in sorted(free):
            new = np.full(len(frames), -1, dtype=np.int64)
            new[t] = p
            tracks.append(new)
            last.append(people[p])
            at.append(t)
            alive.append(len(tracks) - 1)
    return [ViewTrack(c) for c in sorted(tracks, key=lambda c: -int((c >= 0).sum()))]


def _moved(before: Array, now: Array, gap: int) -> float:
    """How far one candidate (K, 3) lies from another, 1 = as far as a person moves in `gap` frames."""
    both = (before[:, 2] > _LEAST_CONFIDENCE) & (now[:, 2] > _LEAST_CONFIDENCE)
    if both.sum() < 3:
        return 2.0
    size = max(float(np.ptp(p[p[:, 2] > _LEAST_CONFIDENCE, :2], axis=0).max()) for p in (before, now))
    apart = float(np.median(np.linalg.norm(before[both, :2] - now[both, :2], axis=1)))
    return apart / max(_JUMP * size * min(1.0 + 0.1 * (gap - 1), 2.0), 1e-6)


def taken(frames: Sequence[Array | None], candidates: NDArray[np.int64], count: int, columns: int = 3) -> Array:
    """Points (T, K, columns) of the candidates numbered (T,), zeros where there is none; count: K."""
    out = np.zeros((len(frames), count, columns))
    for t, (people, p) in enumerate(zip(frames, candidates, strict=True)):
        if p >= 0 and people is not None:
            out[t] = people[p]
    return out


def moves_as(one: Array, other: Array) -> float:
    """How badly points (T, K, 3) of two views can be one body's: median distance from the epipolar lines of the
    fundamental matrix that explains them best, in sizes of the person; NaN when they share too little.

    The normalised eight-point algorithm (Hartley 1997), weighted again by the rest (three rounds), as detections
    have outliers."""
    both = (one[..., 2] > _LEAST_CONFIDENCE) & (other[..., 2] > _LEAST_CONFIDENCE)
    a, b = one[both][:, :2], other[both][:, :2]
    if len(a) < _FEWEST_PAIRS:
        return float("nan")
    every = max(1, len(a) // _MOST_PAIRS)
    a, b = a[::every], b[::every]
    sizes = [_size(p) for p in (one, other)]
    (a, ta), (b, tb) = _normalised(a), _normalised(b)
    u, v, x, y = a[:, 0], a[:, 1], b[:, 0], b[:, 1]
    rows = np.stack([x * u, x * v, x, y * u, y * v, y, u, v, np.ones(len(u))], 1)
    w = np.ones(len(rows))
    distance = np.zeros((2, len(rows)))
    one_a, one_b = np.c_[a, np.ones(len(a))], np.c_[b, np.ones(len(b))]
    for _ in range(4):
        f = np.linalg.eigh(rows.T @ (w[:, None] * rows))[1][:, 0].reshape(3, 3)
        left, s, right = np.linalg.svd(f)
        f = left @ np.diag([s[0], s[1], 0.0]) @ right
        lines_b, lines_a = one_a @ f.T, one_b @ f
        e = np.abs((one_b * lines_b).sum(1))
        distance[0] = e / np.maximum(np.linalg.norm(lines_a[:, :2], axis=1), 1e-9) / (ta * sizes[0])
        distance[1] = e / np.maximum(np.linalg.norm(lines_b[:, :2], axis=1), 1e-9) / (tb * sizes[1])
        worse = distance.max(0)
        w = 1.0 / (1.0 + (worse / max(1.5 * float(np.median(worse)), 1e-6)) ** 2)
    return float(np.median(distance.max(0)))


def _normalised(points: Array) -> tuple[Array, float]:
    """Points (M, 2) around 0 with a mean distance of sqrt 2, and the factor."""
    p = points - points.mean(0)
    factor = np.sqrt(2.0) / max(float(np.linalg.norm(p, axis=1).mean()), 1e-9)
    return p * factor, factor


def _size(points: Array) -> float:
    """px: median over frames of the longer side of points (T, K, 3)."""
    seen = points[..., 2] > _LEAST_CONFIDENCE
    enough = seen.sum(1) >= _LEAST_POINTS
    p, s = points[enough], seen[enough][..., None]
    if not len(p):
        return 1.0
    extent = np.where(s, p[..., :2], -np.inf).max(1) - np.where(s, p[..., :2], np.inf).min(1)
    return max(float(np.median(extent.max(1))), 1.0)

"""Tracks of people through a clip by their key points, and the choice of the person that a recording is about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

_SEEN_POINTS = 4  # least key points in a view that sees the person
_BONES = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "hip"))
)
_WALK, _NEAR_M = 2.5, 0.5  # m/s and m: largest distance of a person after a gap
_ALIKE = 0.12  # largest mean difference of the logarithms of bones' lengths of the same body


@dataclass(frozen=True)
class PersonTrack:
    """Track of one person for T frames, from frame `first` of the clip on.

    first: index of the first frame, from 0.
    points: (T, C, K, 3 or more) key points in each view, px and confidence as they were given, with left and right
        corrected; confidence 0 where the person is not seen. Further columns are as they were given.
    world: (T, K, 3) where the rays meet, m; NaN where fewer than two do.
    candidates: (T, C) number of the view's candidate, -1 for none.
    """

    first: int
    points: Array
    world: Array
    candidates: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def last(self) -> int:
        """Last frame of the clip in the track."""
        return self.first + len(self) - 1

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each view sees the person (T, C)."""
        return (self.points[..., 2] > 0).sum(-1) >= _SEEN_POINTS

    @property
    def agreed(self) -> float:
        """Share of the points shown by two or more views whose rays meet.

        It is low for a track made of several people's detections, or where views are exchanged.
        """
        shown = (self.points[..., 2] > 0).sum(1) >= 2
        return float((shown & np.isfinite(self.world[..., 0])).sum() / max(int(shown.sum()), 1))

    @property
    def height_px(self) -> float:
        """Median over frames and views of the person's height in the picture, px."""
        shown = self.points[..., 2] > 0
        high = np.where(shown, self.points[..., 1], -np.inf).max(-1) - np.where(shown, self.points[..., 1], np.inf).min(
            -1
        )
        return float(np.median(high[self.seen])) if self.seen.any() else 0.0

    def place(self, frame: int) -> Array:
        """Compute the person's middle (3,), m, at a frame of the clip; NaN where unknown."""
        at = frame - self.first
        if not 0 <= at < len(self):
            return np.full(3, np.nan)
        known = np.isfinite(self.world[at]).all(-1)
        return np.median(self.world[at][known], axis=0) if known.any() else np.full(3, np.nan)


def choose(tracks: Sequence[PersonTrack]) -> int | None:
    """Choose the person that the recording is about; return the index, None where there is no person.

    It is the one seen in most frames and views by points whose rays meet; of those with nearly as many, the largest in
    the pictures.
    """
    if not tracks:
        return None
    seen = np.array([t.seen.sum() * t.agreed for t in tracks])
    large = np.array([t.height_px for t in tracks])
    return int(np.where(seen >= 0.85 * seen.max(), large, -1.0).argmax())


def joined(tracks: Sequence[PersonTrack], names: Sequence[str], frame_rate: float) -> list[PersonTrack]:
    """Join tracks that are one person before and after a gap; those seen most come first.

    Two tracks are joined where the bones have the same lengths, the place can be reached in the gap, and no other
    person fits.
    """
    left = sorted(tracks, key=lambda t: t.first)
    sizes = [_bones(t, names) for t in left]
    while True:
        fits: list[tuple[int, int, int]] = []
        for i, a in enumerate(left):
            for j, b in enumerate(left):
                gap = b.first - a.last
                if gap > 0 and _same_body(sizes[i], sizes[j]):
                    reach = _NEAR_M + _WALK * gap / frame_rate
                    away = float(np.linalg.norm(b.place(b.first) - a.place(a.last)))
                    if not away > reach:
                        fits.append((gap, i, j))
        sure = [
            (g, i, j)
            for g, i, j in fits
            if not any((k == i) != (m == j) and _at_once(left, i, j, k, m) for _, k, m in fits)
        ]
        if not sure:
            return sorted(left, key=lambda t: -int(t.seen.sum()))
        _, i, j = min(sure)
        one = _one(left[i], left[j])
        for n in sorted((i, j), reverse=True):
            del left[n], sizes[n]
        left.append(one)
        sizes.append(_bones(one, names))


def _at_once(tracks: Sequence[PersonTrack], i: int, j: int, k: int, m: int) -> bool:
    """Decide whether joining k with m excludes joining i with j, because two simultaneous tracks claim the same one."""
    a, b = (tracks[j], tracks[m]) if k == i else (tracks[i], tracks[k])
    return a.first <= b.last and b.first <= a.last


def _bones(track: PersonTrack, names: Sequence[str]) -> Array:
    """Compute the median lengths of bones (B,), m; NaN where seldom seen."""
    column = {n: i for i, n in enumerate(names)}
    out = np.full(len(_BONES), np.nan)
    for i, (a, b) in enumerate(_BONES):
        if a in column and b in column:
            d = np.linalg.norm(track.world[:, column[a]] - track.world[:, column[b]], axis=-1)
            if np.isfinite(d).sum() >= 3:
                out[i] = np.nanmedian(d)
    return out


def _same_body(a: Array, b: Array) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    return both.sum() < 4 or float(np.mean(np.abs(np.log(a[both] / b[both])))) < _ALIKE


def _one(a: PersonTrack, b: PersonTrack) -> PersonTrack:
    total, start = b.last - a.first + 1, b.first - a.first
    points = np.zeros((total, *a.points.shape[1:]))
    world = np.full((total, *a.world.shape[1:]), np.nan)
    candidates = np.full((total, a.candidates.shape[1]), -1)
    for t, at in ((a, 0), (b, start)):
        points[at : at + len(t)], world[at : at + len(t)] = t.points, t.world
        candidates[at : at + len(t)] = t.candidates
    return PersonTrack(a.first, points, world, candidates)

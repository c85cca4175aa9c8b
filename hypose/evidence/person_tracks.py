"""People followed through a clip by their key points (PersonTrack), and which of them is meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.geometry import Array

_SEEN_POINTS = 4  # key points in a view from which it sees the person
_BONES = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "hip"))
)
_WALK, _NEAR_M = 2.5, 0.5  # m/s and m that a person is away after not having been seen
_ALIKE = 0.12  # mean difference of the logarithms of bones' lengths up to which it may be the same body


@dataclass(frozen=True)
class PersonTrack:
    """One person from frame `first` (of the clip, from 0) on, T frames.

    points (T, C, K, 3 or more): key points in each view, px and confidence as they were given, left and right repaired,
    confidence 0 where the person is not seen; further columns as they were given. world (T, K, 3) m: where the rays
    meet, NaN where fewer than two do. candidates (T, C): which of the view's candidates it is, -1 for none."""

    first: int
    points: Array
    world: Array
    candidates: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def last(self) -> int:
        """The last frame of the clip in which the person is followed."""
        return self.first + len(self) - 1

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, C) whether a view sees the person."""
        return (self.points[..., 2] > 0).sum(-1) >= _SEEN_POINTS

    @property
    def agreed(self) -> float:
        """Share of the points that two views or more show whose rays meet: low for a person made of the detections of
        several, or of views that are exchanged."""
        shown = (self.points[..., 2] > 0).sum(1) >= 2
        return float((shown & np.isfinite(self.world[..., 0])).sum() / max(int(shown.sum()), 1))

    @property
    def height_px(self) -> float:
        """Median over frames and views of the person's extent from top to bottom, px."""
        shown = self.points[..., 2] > 0
        high = np.where(shown, self.points[..., 1], -np.inf).max(-1) - np.where(shown, self.points[..., 1], np.inf).min(
            -1
        )
        return float(np.median(high[self.seen])) if self.seen.any() else 0.0

    def place(self, frame: int) -> Array:
        """(3,) m: the middle of the person at a frame of the clip, NaN when the person is not placed then."""
        at = frame - self.first
        if not 0 <= at < len(self):
            return np.full(3, np.nan)
        known = np.isfinite(self.world[at]).all(-1)
        return np.median(self.world[at][known], axis=0) if known.any() else np.full(3, np.nan)


def choose(tracks: Sequence[PersonTrack]) -> int | None:
    """Which of the people is meant, None when there is no person: who is seen in most frames and views, by points whose
    rays meet; of those with nearly as much, who is largest in the pictures."""
    if not tracks:
        return None
    seen = np.array([t.seen.sum() * t.agreed for t in tracks])
    large = np.array([t.height_px for t in tracks])
    return int(np.where(seen >= 0.85 * seen.max(), large, -1.0).argmax())


def joined(tracks: Sequence[PersonTrack], names: Sequence[str], frame_rate: float) -> list[PersonTrack]:
    """The tracks with those made one that are one person before and after not having been seen: of a body as large, at
    a place that can be reached meanwhile, and no other person comes into question. Those seen most first."""
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
    """Whether joining k with m rivals joining i with j: two who are there at the same time want the same one."""
    a, b = (tracks[j], tracks[m]) if k == i else (tracks[i], tracks[k])
    return a.first <= b.last and b.first <= a.last


def _bones(track: PersonTrack, names: Sequence[str]) -> Array:
    """(B,) m: median lengths of bones, NaN where seldom seen."""
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

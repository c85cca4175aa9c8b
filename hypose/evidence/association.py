"""Associate the detections of all views with people through a whole clip: candidates -> people with 3D points.

In every frame, people who are already tracked take their detections first, view by view (an exactly solved assignment
problem on the distance in metres between detection and prediction). The remaining detections start a new person where
their rays meet in points whose bones have a body's lengths; one view alone never starts a person. A track ends after a
while with fewer than two views. Left and right of arms, legs or face are exchanged where only that explains a view.
The tracks of a person before and after a gap are joined by the lengths of bones (`joined`); `choose` finds the person
that a recording is about.
Source: the idea of tracking first is that of 4D Association, Zhang et al. 2020 (candidates of all views and the last
    frame in one problem); here with whole skeletons and distances of rays instead of graphs of limbs, without learning.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import other_sides
from hypose.geometry import Array

# ---- rays ----------------------------------------------------------------------------------------------------------
# Geometry of rays for several calibrated views and several people: distances of rays and points, robust triangulation.
#
# All distances are metres: the size of a pixel error at the person's depth, so that limits hold for any picture size
# and any distance.


NOT_COMPARABLE_M = 9.0
"""m: distance that stands for pairs that cannot be compared."""
LEAST_CONFIDENCE = 0.1  # least confidence of a point that counts
_NEAREST = 0.3  # m, least distance in front of a camera
_PARALLEL = 0.05  # least sine of the angle between two rays whose distance is used
_PRIOR = 0.7  # weight of a prediction, in views
_PRIOR_M = 0.35


class Views:
    """Pinhole cameras of a rig as arrays.

    projections: (C, 3, 4).
    centres: (C, 3) m.
    world_from_pixel: (C, 3, 3).
    pairs: (Q, 2) all pairs of views.
    """

    def __init__(self, rig: CameraRig) -> None:
        self.projections = rig.projections
        self.centres = rig.positions
        self._focal = np.array([0.5 * (c.K[0, 0] + c.K[1, 1]) for c in rig])
        self.world_from_pixel = np.stack([c.camera_from_world[:3, :3].T @ np.linalg.inv(c.K) for c in rig])
        self.pairs = np.array(list(itertools.combinations(range(len(rig)), 2)), dtype=np.int64).reshape(-1, 2)

    def __len__(self) -> int:
        return len(self.centres)

    def rays(self, pixels: Array, which: NDArray[np.int64] | slice = slice(None)) -> Array:
        """Compute the unit directions (M, ..., 3), in the world, of the rays of pixels (M, ..., 2).

        which: (M,) view of each row (default: one row per view).
        """
        shape = pixels.shape
        flat = pixels.reshape(shape[0], -1, 2)
        one = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], -1)
        d = one @ self.world_from_pixel[which].transpose(0, 2, 1)
        d /= np.sqrt((d * d).sum(-1, keepdims=True))
        return d.reshape(*shape[:-1], 3)

    def seen_at(self, points: Array) -> tuple[Array, Array]:
        """Project points (..., 3), m, into all views.

        Returns: pixels (C, ..., 2); metres per pixel (C, ...) at their depth; NaN behind a camera or nearly in it.
        """
        flat = points.reshape(-1, 3)
        h = flat @ self.projections[:, :, :3].transpose(0, 2, 1) + self.projections[:, None, :, 3]
        z = np.where(h[..., 2] > _NEAREST, h[..., 2], np.nan)
        shape = (len(self), *points.shape[:-1])
        return (h[..., :2] / z[..., None]).reshape(*shape, 2), (z / self._focal[:, None]).reshape(shape)


def distances(views: Views, expected: Array, found: Array, limit: float) -> Array:
    """Compute the distances of candidates' points from those of expected people.

    views: the cameras.
    expected: (N, K, 3) m.
    found: (C, P, K, 3) candidates of each view.
    limit: upper bound of a distance, m.
    Returns: (C, N, P, K) m, at most `limit`; NaN where one of the two is unknown.
    """
    uv, metres = views.seen_at(expected)
    e = uv[:, :, None] - found[:, None, :, :, :2]
    e = np.sqrt((e * e).sum(-1)) * metres[:, :, None]
    return np.where(found[:, None, ..., 2] > LEAST_CONFIDENCE, np.minimum(e, limit), np.nan)


def mean_of_known(values: Array, least: int) -> Array:
    """Average values (..., K) over the last axis without NaN; NOT_COMPARABLE_M where fewer than `least` are known."""
    known = np.isfinite(values)
    n, total = known.sum(-1), np.where(known, values, 0.0).sum(-1)
    return np.where(n >= least, total / np.maximum(n, 1e-9), NOT_COMPARABLE_M)


def between_rays(views: Views, which: NDArray[np.int64], found: Array, limit: float, least: int) -> Array:
    """Compute the distances between the rays of candidates, averaged over their common points.

    views: the cameras.
    least: number of common points that a comparison needs.
    which: (M,) view of each candidate.
    found: (M, K, 3).
    limit: m, at which single distances end.
    Returns: (M, M) m; NOT_COMPARABLE_M for candidates of one view, or with fewer than `least` common points.
    """
    d, centre = views.rays(found[..., :2], which), views.centres[which]
    normal = np.cross(d[:, None], d[None])
    size = np.sqrt((normal * normal).sum(-1))
    along = np.abs((normal * (centre[None, :] - centre[:, None])[:, :, None]).sum(-1))
    apart = np.where(size > _PARALLEL, along / np.maximum(size, 1e-9), 0.5 * limit)
    seen = found[..., 2] > LEAST_CONFIDENCE
    both = seen[:, None] & seen[None]
    out = mean_of_known(np.where(both, np.minimum(apart, limit), np.nan), least)
    return np.where(which[:, None] == which[None], NOT_COMPARABLE_M, out)


def meet(views: Views, found: Array, near: float, prior: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate points from rays, some of which may be wrong.

    Every pair of rays is tried (there are few views); the pair with most support wins, and all rays near it are solved
    by least squares, weighted by confidence and pixel size.
    found: (C, N, K, 3) px and confidence.
    near: largest distance of a ray from the point, m.
    prior: (N, K, 3) expected points, which decide between two places where rays meet.
    Returns: points (N, K, 3), m, NaN where fewer than two rays meet; rays used (C, N, K).
    """
    count, n, k = found.shape[:3]
    seen = found[..., 2] > LEAST_CONFIDENCE
    if count < 2 or n == 0:
        return np.full((n, k, 3), np.nan), np.zeros(seen.shape, dtype=np.bool_)
    d = views.rays(found[..., :2])
    a, b = views.pairs.T
    da, db, apart = d[a], d[b], (views.centres[a] - views.centres[b])[:, None, None]  # (Q, N, K, 3)
    cos = (da * db).sum(-1)
    sine2 = 1 - cos * cos
    ea, eb = (da * apart).sum(-1), (db * apart).sum(-1)
    safe = np.where(sine2 > 1e-5, sine2, np.inf)
    s, t = (cos * eb - ea) / safe, (eb - cos * ea) / safe
    one = views.centres[a][:, None, None] + s[..., None] * da
    middle = 0.5 * (one + views.centres[b][:, None, None] + t[..., None] * db)
    usable = seen[a] & seen[b] & (s > 0) & (t > 0) & (sine2 > 1e-5)
    with np.errstate(invalid="ignore"):
        uv, metres = views.seen_at(middle)  # (C, Q, N, K, ...)
        e = uv - found[:, None, ..., :2]
        e = np.sqrt((e * e).sum(-1)) * metres
        e = np.where(seen[:, None] & np.isfinite(e), np.minimum(e / near, 1.0), 1.0)  # shares of `near`
        score = (e < 1).sum(0) - e.sum(0) / np.maximum(seen.sum(0), 1)
        if prior is not None:
            off = middle - prior
            off = np.sqrt((off * off).sum(-1)) / _PRIOR_M
            score = score - _PRIOR * np.where(np.isfinite(off), np.minimum(off, 2.0), 0.0)
    score = np.where(usable, score, -np.inf)
    best = score.argmax(0)[None]  # (1, N, K)
    used = np.take_along_axis(e, best[None], 1)[:, 0] < 1
    used &= np.take_along_axis(usable, best, 0)
    found_any = used.sum(0) >= 2
    used &= found_any
    scale = np.take_along_axis(metres, best[None], 1)[:, 0]
    w = np.where(used, found[..., 2] / np.where(used, scale, 1.0) ** 2, 0.0)
    across = np.eye(3) - d[..., :, None] * d[..., None, :]  # (C, N, K, 3, 3)
    left = (w[..., None, None] * across).sum(0)
    right = (w[..., None] * (across @ views.centres[:, None, None, :, None])[..., 0]).sum(0)
    left = np.where(found_any[..., None, None], left, np.eye(3))
    points = np.linalg.solve(left, right[..., None])[..., 0]
    return np.where(found_any[..., None], points, np.nan), used


# ---- tracks of people ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class PersonTrack:
    """Track of one person for T frames, from frame `first` of the clip on.

    first: index of the first frame, from 0.
    points: (T, C, K, 3 or more) key points in each view, px and confidence as they were given, with left and right
        corrected; confidence 0 where the person is not seen. Further columns are as they were given.
    world: (T, K, 3) triangulated key points, m; NaN where fewer than two rays meet.
    candidates: (T, C) index of the person's detection among the detections of the view in the frame; -1 for none.
    """

    first: int
    points: Array
    world: Array
    candidates: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def last(self) -> int:
        """Index of the last frame of the clip that belongs to the track."""
        return self.first + len(self) - 1

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each view sees the person in each frame, (T, C)."""
        return (self.points[..., 2] > 0).sum(-1) >= LEAST_SEEN

    def place(self, frame: int) -> Array:
        """Compute the person's middle (3,), m, at a frame of the clip; NaN where unknown."""
        at = frame - self.first
        if not 0 <= at < len(self):
            return np.full(3, np.nan)
        known = np.isfinite(self.world[at]).all(-1)
        return np.median(self.world[at][known], axis=0) if known.any() else np.full(3, np.nan)


def choose(tracks: Sequence[PersonTrack]) -> int | None:
    """Choose the person that the recording is about; return the index, None where there is no person.

    The person seen in most frames and views by points whose rays meet is chosen; of several who are seen nearly as
    often, the one who is largest in the pictures.
    """
    if not tracks:
        return None
    often, large = np.zeros(len(tracks)), np.zeros(len(tracks))
    for k, t in enumerate(tracks):
        shown, by_two = t.points[..., 2] > 0, (t.points[..., 2] > 0).sum(1) >= 2
        # many rays do not meet in a track made of several people's detections, or where views are exchanged
        agreed = (by_two & np.isfinite(t.world[..., 0])).sum() / max(int(by_two.sum()), 1)
        often[k] = t.seen.sum() * agreed
        rows = np.where(shown, t.points[..., 1], np.nan)[t.seen]
        large[k] = np.median(np.nanmax(rows, -1) - np.nanmin(rows, -1)) if len(rows) else 0.0  # px
    return int(np.where(often >= 0.85 * often.max(), large, -1.0).argmax())


def joined(tracks: Sequence[PersonTrack], names: Sequence[str], frame_rate: float) -> list[PersonTrack]:
    """Join tracks that are one person before and after a gap; the tracks seen in most frames and views come first.

    tracks: all tracks of the clip.
    names: names of the K key points.
    frame_rate: frames per second, Hz.
    Two tracks are joined where the bones have the same lengths, the place can be reached in the gap, and no other
    person fits.
    """
    sizes = {id(t): _bones(t, names) for t in tracks}

    def follows(a: PersonTrack, b: PersonTrack) -> bool:
        gap = b.first - a.last
        reach = AssociationSettings.restart + AssociationSettings.walk * gap / frame_rate
        if gap <= 0 or np.linalg.norm(b.place(b.first) - a.place(a.last)) > reach:
            return False
        apart = np.abs(np.log(sizes[id(a)] / sizes[id(b)]))
        known = np.isfinite(apart)  # where fewer than four bones are known of both, any body may be the same
        return known.sum() < 4 or float(np.mean(apart[known])) < AssociationSettings.alike

    people: list[PersonTrack] = []
    for b in sorted(tracks, key=lambda t: t.first):
        before = [k for k, a in enumerate(people) if follows(a, b)]
        rivals = [c for c in tracks if c is not b and c.first <= b.last and b.first <= c.last]
        if len(before) == 1 and not any(follows(people[before[0]], c) for c in rivals):
            one = _one(people.pop(before[0]), b)
            sizes[id(one)] = _bones(one, names)
            people.append(one)
        else:
            people.append(b)
    return sorted(people, key=lambda t: -int(t.seen.sum()))


def _bones(track: PersonTrack, names: Sequence[str]) -> Array:
    """Compute the median lengths (B,), m, of the limbs' and the trunk's bones; NaN where seen in fewer than three.

    names: names of the K key points of the track.
    """
    column = {n: i for i, n in enumerate(names)}
    out = np.full(len(_BONES) - 1, np.nan)
    for i, (a, b, *_) in enumerate(_BONES[:-1]):  # without the width of the shoulders, which detectors vary
        if a in column and b in column:
            d = np.linalg.norm(track.world[:, column[a]] - track.world[:, column[b]], axis=-1)
            if np.isfinite(d).sum() >= 3:
                out[i] = np.nanmedian(d)
    return out


def _one(a: PersonTrack, b: PersonTrack) -> PersonTrack:
    """Join a track and a later one to one track; in the gap between them nothing is seen.

    a, b: the earlier and the later track.
    """

    def with_gap(before: NDArray[Any], after: NDArray[Any], nothing: float) -> NDArray[Any]:
        gap = np.full((b.first - a.last - 1, *before.shape[1:]), nothing, before.dtype)
        return np.concatenate([before, gap, after])

    points, world = with_gap(a.points, b.points, 0.0), with_gap(a.world, b.world, np.nan)
    return PersonTrack(a.first, points, world, with_gap(a.candidates, b.candidates, -1))


LEAST_SEEN = 4  # least key points of a candidate that is a person; fewer are parts that can complete one
_GROUPS = (
    ("shoulder", "elbow", "wrist"),
    ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"),
    ("eye", "ear"),
)
_BONES = (
    *(
        (f"{side}_{a}", f"{side}_{b}", low, high)
        for side in ("left", "right")
        for a, b, low, high in (
            ("shoulder", "elbow", 0.18, 0.45),
            ("elbow", "wrist", 0.15, 0.40),
            ("hip", "knee", 0.25, 0.60),
            ("knee", "ankle", 0.25, 0.60),
            ("shoulder", "hip", 0.35, 0.75),
        )
    ),
    ("left_shoulder", "right_shoulder", 0.20, 0.55),
)


@dataclass(frozen=True)
class AssociationSettings:
    """Settings of the association of detections with people.

    gate: m, largest mean distance between the predicted points of a person and a detection of this person.
    birth: m, largest mean distance of the rays of two detections of a new person; the other pairs of its detections may
        have 1.5 times as much.
    near: m, largest distance of a ray that counts for a point.
    complete: m, largest distance at which a single free point completes a person.
    limit: m, upper bound of a distance; larger distances are replaced by it.
    merge: m, two people nearer than this are one.
    apart: m, no new person starts nearer than this to another.
    patience: s without two views after which a track ends.
    stale: s for which a point that is not seen is predicted with the others.
    trial: s for which a person seen by two views must be tracked to be accepted; three views are accepted at once.
    exchanged: largest share of the distance that remains when left and right are exchanged.
    exchanged_m: m that the exchange must gain.
    plausible: least share of bones with a body's lengths.
    walk, restart: m/s and m, largest distance of a person after a gap.
    alike: largest mean difference of the logarithms of bones' lengths of the same body.
    motion: share of the last step of a point that predicts the next one.
    jump: m, after a step that is longer than this no motion is predicted.
    objects: m, largest mean distance of the rays of one person's objects; large, because outlines are no points.
    """

    gate: float = 0.22
    birth: float = 0.10
    near: float = 0.08
    complete: float = 0.10
    limit: float = 0.40
    merge: float = 0.20
    apart: float = 0.30
    patience: float = 0.6
    stale: float = 0.4
    trial: float = 0.2
    exchanged: float = 0.6
    exchanged_m: float = 0.03
    plausible: float = 0.7
    walk: float = 2.5
    restart: float = 0.5
    alike: float = 0.12
    motion: float = 0.6
    jump: float = 0.12
    objects: float = 0.35


def people_of(
    candidates: Sequence[Sequence[Array | None]],
    names: Sequence[str],
    rig: CameraRig,
    frame_rate: float = 25.0,
) -> list[PersonTrack]:
    """Find the people of a clip by matching the detections of all views; the people seen in most frames and views
    come first.

    frame_rate: frames per second, Hz.
    candidates: per frame and view the detections (P, K, 3 or more) = (u px, v px, confidence, ...) in undistorted
        pixels of the pinhole `rig`, confidence 0 where missing; None where a view has no detections. Further columns
        are kept. A candidate with fewer than four points is a part that may complete a person.
    names: names of the K points.
    There is no person with one view alone, or with two that do not agree: see `hypose.evidence.one_person`.
    """
    given = (view.shape[2] for frame in candidates for view in frame if view is not None and len(view))
    at = Association(names, rig, frame_rate, columns=max(given, default=3))
    for frame in candidates:
        at.step(frame)
    return at.people()


@dataclass(eq=False)  # compared by identity
class _Followed:
    """State of a person who is being tracked.

    points: (K, 3) last known points, m.
    motion: (K, 3) motion of each point, m per frame.
    stale: (K,) number of frames for which each point has not been seen.
    exchanged: (C, G + 1) groups of points whose sides were exchanged in a view of the last frame.
    votes: (G + 1,) how often views named the sides of a group of points as they are, less how often the other way.
    """

    first: int
    points: Array
    motion: Array
    stale: NDArray[np.int64]
    exchanged: NDArray[np.bool_]
    votes: NDArray[np.int64]
    needed: int
    hits: int = 0
    missed: int = 0
    seen: list[Array] = field(default_factory=list)
    world: list[Array] = field(default_factory=list)
    which: list[NDArray[np.int64]] = field(default_factory=list)


class Association:
    """Association of detections with people, frame by frame: call `step` for every frame, then `people`.

    names: names of the K key points.
    rig: pinhole cameras.
    frame_rate: frames per second, Hz.
    columns: number of columns of all candidates, at least 3 (u px, v px, confidence).
    """

    def __init__(
        self,
        names: Sequence[str],
        rig: CameraRig,
        frame_rate: float = 25.0,
        *,
        columns: int = 3,
    ) -> None:
        self.names, self.settings, self._columns = tuple(names), AssociationSettings(), columns
        self._views, self._k = Views(rig), len(names)
        column = {n: i for i, n in enumerate(names)}
        self._twin = other_sides(names)
        self._group = np.full(self._k, len(_GROUPS), dtype=np.int64)
        for i, n in enumerate(names):
            part = n.split("_", 1)[-1]
            for g, parts in enumerate(_GROUPS):
                if part in parts and self._twin[i] != i:
                    self._group[i] = g
        self._bones = [(column[a], column[b], lo, hi) for a, b, lo, hi in _BONES if a in column and b in column]
        o = self.settings
        self._patience = max(3, round(o.patience * frame_rate))
        self._stale = max(2, round(o.stale * frame_rate))
        self._trial = max(2, round(o.trial * frame_rate))
        self._frame = 0
        self._alive: list[_Followed] = []
        self._ended: list[_Followed] = []

    def step(self, views: Sequence[Array | None], /) -> None:
        """Process one frame.

        views: per camera of the rig the candidates (P, K, columns) of the frame; None where there are none.
        """
        found = self._stacked(views)
        count = np.count_nonzero(found[..., 2] > 0.1, axis=-1)
        is_person, free = count >= LEAST_SEEN, count > 0
        which = self._taken(found, is_person, free, self._expected())
        which = np.concatenate([which, self._born(found, is_person & free, free)], 1)
        if self._alive:
            expected = self._expected()
            seen = _chosen(found, which)
            self._complete(seen, found, free, free & ~is_person, which, expected)
            seen = self._right_sides(seen, expected)
            world, _ = meet(self._views, seen, self.settings.near, expected)
            self._update(seen, world, which)
        self._end()
        self._frame += 1

    def people(self) -> list[PersonTrack]:
        """List the tracks of all people found so far; the people seen in most frames and views come first."""
        out = []
        for t in [*self._ended, *self._alive]:
            kept = len(t.seen) - t.missed
            if t.hits < t.needed or kept < 1:
                continue
            # left and right of the whole track are those that most views and frames name
            columns = np.where((t.votes < 0)[self._group], self._twin, np.arange(self._k))
            points, world = np.stack(t.seen[:kept])[:, :, columns], np.stack(t.world[:kept])[:, columns]
            out.append(PersonTrack(t.first, points, world, np.stack(t.which[:kept])))
        return sorted(out, key=lambda p: -int(p.seen.sum()))

    def _stacked(self, views: Sequence[Array | None]) -> Array:
        """Stack the candidates of all views (C, P, K, columns), at least one per view; missing ones have confidence
        0.
        """
        some = [v for v in views if v is not None and len(v)]
        out = np.zeros((len(self._views), max((len(v) for v in some), default=1), self._k, self._columns))
        for c, v in enumerate(views):
            if v is not None and len(v):
                out[c, : len(v)] = v
        return out

    def _expected(self) -> Array:
        """Predict the points (N, K, 3) of the tracked people; NaN where unknown."""
        if not self._alive:
            return np.zeros((0, self._k, 3))
        return np.stack([np.where((t.stale < self._stale)[:, None], t.points + t.motion, np.nan) for t in self._alive])

    def _taken(
        self, found: Array, is_person: NDArray[np.bool_], free: NDArray[np.bool_], expected: Array
    ) -> NDArray[np.int64]:
        """Assign detected people to the tracked people, at most one to one in each view and within `settings.gate`.

        found: (C, P, K, columns) points of the P detected people of each view.
        is_person: (C, P) whether a detection has enough points for a person.
        free: (C, P) whether a detection is not assigned yet; assigned ones are set to False.
        expected: (N, K, 3) predicted points of the tracked people, m.
        Returns: (C, N) number of each person's detection, -1 for none.
        """
        from scipy.optimize import linear_sum_assignment  # takes long to import

        which = np.full((len(found), len(expected)), -1)
        if not len(expected):
            return which
        plain, turned = self._both(found, expected)
        each = np.where(self._better_exchanged(plain, turned)[..., self._group], turned, plain)
        cost = np.where(is_person[:, None], mean_of_known(each, LEAST_SEEN), NOT_COMPARABLE_M)
        gate = self.settings.gate
        for c in range(len(found)):
            rows, columns = linear_sum_assignment(np.minimum(cost[c], 2 * gate))
            near = cost[c, rows, columns] <= gate
            which[c, rows[near]], free[c, columns[near]] = columns[near], False
        return which

    def _both(self, found: Array, expected: Array) -> tuple[Array, Array]:
        """Compute the distances (C, N, P, K), m, of candidates (C, P, K, 3) as named, and with left and right
        exchanged.

        expected: (N, K, 3) predicted points of the people, m.
        found: (C, P, K, 3) px and confidence.
        Returns: two arrays; NaN where one of the two points is unknown.
        """
        limit = self.settings.limit
        return (
            distances(self._views, expected, found, limit),
            distances(self._views, expected, found[:, :, self._twin], limit),
        )

    def _better_exchanged(
        self, plain: Array, turned: Array, before: NDArray[np.bool_] | bool = False
    ) -> NDArray[np.bool_]:
        """Decide which groups' sides (..., G + 1) are exchanged in a candidate; the last group has no sides.

        plain, turned: (..., K) distances, m, as named and with left and right exchanged, see `_both`.
        before: (..., G + 1) groups that were exchanged in the last frame: there the slightest advantage is enough.
        """
        o = self.settings
        out, closer = np.zeros((2, *plain.shape[:-1], len(_GROUPS) + 1), dtype=np.bool_)
        for g in range(len(_GROUPS)):
            of = self._group == g
            if of.any():
                a, b = mean_of_known(plain[..., of], 2), mean_of_known(turned[..., of], 2)
                out[..., g] = (b < o.exchanged * a) & (a - b > o.exchanged_m) & (a < NOT_COMPARABLE_M)
                closer[..., g] = b < a
        return out | (closer & before)

    def _right_sides(self, seen: Array, expected: Array) -> Array:
        """Exchange left and right of a group of points in the views that contradict the person's prediction.

        Views also vote on the sides of the prediction, see `people`.

        seen: (C, N, K, columns) points of each person, confidence 0 where a view does not see the person.
        expected: (N, K, 3) predicted points, m.
        Returns: the corrected points.
        """
        each = np.arange(len(expected))
        plain, turned = (d[:, each, each] for d in self._both(seen, expected))
        before = np.stack([t.exchanged for t in self._alive], 1)
        exchange, kept = self._better_exchanged(plain, turned, before), self._better_exchanged(turned, plain)
        for n, person in enumerate(self._alive):
            person.exchanged = exchange[:, n]
            person.votes += kept[:, n].sum(0) - exchange[:, n].sum(0)
        return np.where(exchange[..., self._group][..., None], seen[:, :, self._twin], seen)

    def _born(self, found: Array, is_person: NDArray[np.bool_], free: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Start new people from the remaining candidates, and add them to the tracked ones.

        They start where rays meet in points whose bones have a body's lengths, away from all tracked people.

        found: (C, P, K, 3) candidates of each view.
        is_person: (C, P) free candidates with enough points for a person.
        free: (C, P) candidates that are not assigned to a person; those of the new people are set to False.
        Returns: (C, M) number of each new person's detection, -1 for none.
        """
        o, new = self.settings, list[NDArray[np.int64]]()
        view, number = np.nonzero(is_person)
        if len(np.unique(view)) < 2:
            return np.zeros((len(found), 0), dtype=np.int64)
        apart = between_rays(self._views, view, found[view, number], o.limit, LEAST_SEEN)
        for members in clusters(apart, o.birth):
            which = np.full(len(found), -1)
            which[view[members]] = number[members]
            points = meet(self._views, _chosen(found, which[:, None]), o.near)[0][0]
            length = [(float(np.linalg.norm(points[a] - points[b])), lo, hi) for a, b, lo, hi in self._bones]
            right = [lo <= x <= hi for x, lo, hi in length if np.isfinite(x)]
            if len(right) < LEAST_SEEN or float(np.mean(right)) < o.plausible:
                continue
            if any(_apart(t.points, points) < o.apart for t in self._alive):
                continue
            groups, stale = len(_GROUPS) + 1, np.where(np.isfinite(points[:, 0]), 0, self._stale + 1).astype(np.int64)
            sides = np.zeros((len(found), groups), dtype=np.bool_), np.zeros(groups, dtype=np.int64)
            needed = 1 if len(members) > 2 else self._trial
            self._alive.append(_Followed(self._frame, points, np.zeros((self._k, 3)), stale, *sides, needed))
            free[view[members], number[members]] = False
            new.append(which)
        return np.array(new, dtype=np.int64).reshape(-1, len(found)).T

    def _complete(
        self,
        seen: Array,
        found: Array,
        free: NDArray[np.bool_],
        parts: NDArray[np.bool_],
        which: NDArray[np.int64],
        expected: Array,
    ) -> None:
        """Fill missing points in `seen` with free detections near their expected places.

        seen: (C, N, K, 3) points of each person, changed in place; the confidence of a filled point is halved.
        found: (C, P, K, 3) candidates.
        free: (C, P) those not assigned.
        parts: (C, P) free ones that are too small for a person.
        which: (C, N) candidate of each person, -1 for none.
        expected: (N, K, 3) predicted points, m.
        A free detection with enough points for a person only completes a person whom that view already sees, because it
        was then detected in two pieces.
        """
        if not free.any():
            return
        left = np.where(free[..., None, None], found, 0.0)
        missing = seen[..., 2] <= 0.1  # (C, N, K)
        d = distances(self._views, expected, left, self.settings.limit)
        allowed = parts[:, None] | (which >= 0)[..., None]
        d = np.where(np.isfinite(d) & allowed[..., None], d, NOT_COMPARABLE_M)
        best = d.argmin(2)
        near = np.take_along_axis(d, best[:, :, None], 2)[:, :, 0] < self.settings.complete
        c, n, k = np.nonzero(near & missing)
        seen[c, n, k] = left[c, best[c, n, k], k]
        seen[c, n, k, 2] *= 0.5

    def _update(self, seen: Array, world: Array, which: NDArray[np.int64]) -> None:
        """Update the points, the motion and the history of all tracked people after a frame.

        seen: (C, N, K, 3) px and confidence.
        world: (N, K, 3) m, NaN where unknown.
        which: (C, N) candidate, -1 for none.
        """
        for n, t in enumerate(self._alive):
            got = np.isfinite(world[n, :, 0])
            fresh = len(t.seen) == 0
            followed = int((which[:, n] >= 0).sum()) >= 2 and int(got.sum()) >= LEAST_SEEN
            t.hits, t.missed = (t.hits + 1, 0) if followed else (t.hits, t.missed + 1)
            both = got & np.isfinite(t.points[:, 0]) & (t.stale == 0)
            step = world[n] - t.points
            motion = np.zeros_like(step)
            if not fresh:
                motion[both] = AssociationSettings.motion * step[both]
                jumped = np.sqrt((motion * motion).sum(1)) > AssociationSettings.jump
                motion[jumped] = 0.0
            common = np.median(step[both], axis=0) if both.sum() >= LEAST_SEEN and not fresh else np.zeros(3)
            motion[~both] = np.median(motion[both], axis=0) if both.any() else 0.5 * t.motion[~both]
            t.points = np.where(got[:, None], world[n], t.points + common)
            t.motion = motion
            t.stale = np.where(got, 0, t.stale + 1)
            t.seen.append(seen[:, n].copy())
            t.world.append(world[n].copy())
            t.which.append(which[:, n].copy())

    def _end(self) -> None:
        """End the tracks of people who are no longer seen, never were accepted, or are the same as another person."""
        lost = [t for t in self._alive if t.missed > self._patience or (len(t.seen) > 3 and t.hits < 2)]
        same = list[_Followed]()
        for a, b in itertools.combinations([t for t in self._alive if t not in lost], 2):
            if a not in same and b not in same and _apart(a.points, b.points) < self.settings.merge:
                same.append(a if a.hits < b.hits else b)
                same[-1].needed = self._trial
        self._ended += lost + same
        self._alive = [t for t in self._alive if t not in lost + same]


def _chosen(found: Array, which: NDArray[np.int64]) -> Array:
    """Collect the points (C, N, K, columns) of the candidates `which` (C, N) of each view; 0 where that is -1."""
    return np.where((which >= 0)[..., None, None], found[np.arange(len(found))[:, None], which], 0.0)


def _apart(a: Array, b: Array) -> float:
    """Compute the mean distance, m, of the points (K, 3) that both have; NOT_COMPARABLE_M where there is none.

    a, b: (K, 3) m; NaN where unknown.
    """
    d = np.sqrt(((a - b) ** 2).sum(-1))
    known = np.isfinite(d)
    return float(d[known].mean()) if known.any() else NOT_COMPARABLE_M


def clusters(apart: Array, birth: float) -> list[list[int]]:
    """Group candidates of different views by their distances: nearest pairs first, all members near to each other.

    apart: (M, M) m; at least NOT_COMPARABLE_M within a view.
    birth: largest distance of a pair, m; all pairs of a group are within 1.5 times this (cycle consistency).
    Returns: groups of two or more candidates, largest first.
    """
    m = len(apart)
    group = [[i] for i in range(m)]
    of = list(range(m))
    a, b = np.nonzero(np.triu(apart <= birth, 1))
    for k in np.argsort(apart[a, b], kind="stable"):
        i, j = of[a[k]], of[b[k]]
        if i == j or apart[np.ix_(group[i], group[j])].max() > 1.5 * birth:  # NOT_COMPARABLE_M within one view
            continue
        group[i] = group[i] + group[j]
        for member in group[j]:
            of[member] = i
        group[j] = []
    return sorted((g for g in group if len(g) > 1), key=len, reverse=True)


_LIMIT, _LEAST_COMMON = 1.0, 6


def object_points(mask: NDArray[np.uint8]) -> Array:
    """Compute three points of a mask (h, w): the middle of it, of its top tenth and of its bottom tenth.

    Returns: (3, 2) px; NaN where the mask is empty.
    """
    rows = np.flatnonzero(mask.any(1))
    if not len(rows):
        return np.full((3, 2), np.nan)
    tenth = max(1, (rows[-1] - rows[0] + 1) // 10)
    out, first, last = [], rows[0], rows[-1] + 1
    for part in (slice(first, last), slice(first, first + tenth), slice(last - tenth, last)):
        v, u = np.nonzero(mask[part])
        out.append([u.mean(), v.mean() + part.start])
    return np.array(out)


def people_of_objects(points: Sequence[Mapping[str, Array]], rig: CameraRig) -> list[dict[int, str]]:
    """Match the objects of all views to people; people seen in most views and frames come first.

    points: per view and object (S, 3, 2), undistorted px of the pinhole `rig` in S common frames (`object_points`); NaN
        where the object is missing.
    Returns: people as {view: object}; an object that no other view shows is a person of its own.
    """
    at = [(c, name) for c, view in enumerate(points) for name in view]
    if not at:
        return []
    found = np.stack([np.reshape(points[c][name], (-1, 2)) for c, name in at])
    known = np.isfinite(found[..., 0])
    found = np.concatenate([np.nan_to_num(found), known[..., None].astype(np.float64)], -1)
    which = np.array([c for c, _ in at], dtype=np.int64)
    apart = between_rays(Views(rig), which, found, _LIMIT, _LEAST_COMMON)
    groups = clusters(apart, AssociationSettings.objects)
    alone = [[i] for i in range(len(at)) if not any(i in g for g in groups)]
    there = known.sum(1)
    ordered = sorted([*groups, *alone], key=lambda g: (-len(g) * int(there[g].sum()), at[g[0]]))
    return [{at[i][0]: at[i][1] for i in sorted(g)} for g in ordered]

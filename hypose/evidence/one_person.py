"""Find the one person that a recording is about, among all people in its views' key points.

Where the cameras' rays agree, they separate the people (`hypose.evidence.association`). Where they do not, because
there is one camera or the calibration is wrong, people are tracked in each view separately and matched between views by
how they move. So a wrong calibration can still be examined, on one person. Points that a program only repeated
("held") are removed before (`without_held`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.evidence.association import (
    LEAST_CONFIDENCE,
    LEAST_SEEN,
    PersonTrack,
    Views,
    choose,
    joined,
    meet,
    people_of,
)
from hypose.evidence.keypoint_check import sizes
from hypose.evidence.keypoints import other_sides, person_size
from hypose.geometry import Array

_PATIENCE = 1.2  # s without detections after which a view's own track ends
_PART = 0.1  # least share of the clip in which a person must be present
_AGREED = 0.3  # least share of the frames with a person in two views in which the rays must agree
_FITS = 0.25  # least share of a view's frames with a person in which it is where the others see it
_NEAR_M, _HITS = 0.08, 0.75  # m from the person's points, and least share of a view's key points within it
_SAME = 0.06  # largest distance from the epipolar lines, in sizes of the person, of the same person
_COMPARED = 3  # people per view that are compared by their motion


@dataclass(frozen=True)
class OnePerson:
    """The person that a recording is about.

    points: (T, C, K, 3 or more) as they were given, confidence 0 where the person is not seen.
    several: another person is present in a good part of the clip.
    people: tracks of all people seen by two views or more, this person first; none where people were matched by
        motion instead of by rays.
    apart: views whose detections do not fit the person's place.
    notes: sentences for the user.
    """

    points: Array
    several: bool
    people: tuple[PersonTrack, ...]
    apart: tuple[int, ...]
    notes: tuple[str, ...]


def one_person(
    candidates: Sequence[Sequence[Array | None]],
    names: Sequence[str],
    rig: CameraRig,
    frame_rate: float = 25.0,
    *,
    keep_misfits: bool = False,
) -> OnePerson:
    """Find the person who is seen in most frames and views.

    frame_rate: frames per second, Hz.
    candidates: per frame and view the detections (P, K, 3 or more) = (u px, v px, confidence, ...) in undistorted
        pixels of `rig`, confidence 0 where missing; None where a view has none.
    names: names of the K points.
    rig: pinhole cameras.
    keep_misfits: the calibration itself is in doubt; a view that does not fit keeps the person who moves like the one
        in the other views. Otherwise such a view is left out.
    """
    frames, views = len(candidates), len(rig)
    columns = [[frame[c] for frame in candidates] for c in range(views)]
    count = np.array([[_how_many(people) for people in column] for column in columns]).T  # (T, C)
    shown, several = count > 0, bool((count > 1).any())

    @cache
    def of_view(c: int) -> list[NDArray[np.int64]]:
        found = view_tracks(columns[c], max(3, round(_PATIENCE * frame_rate)))
        return [t for t in found if (t >= 0).sum() >= max(3, _PART * frames)] or found[:1]

    width = max((p.shape[2] for column in columns for p in column if p is not None and len(p)), default=3)
    points, notes, tracks = np.zeros((frames, views, len(names), width)), list[str](), list[PersonTrack]()
    if views > 1 and (several or not keep_misfits):
        tracks = joined(people_of(candidates, names, rig, frame_rate), names, frame_rate)
    number, together = choose(tracks), int((shown.sum(1) > 1).sum())
    if number is None or (tracks[number].seen.sum(1) > 1).sum() < _AGREED * together:
        for c in sorted(range(views), key=lambda c: -max((int((t >= 0).sum()) for t in of_view(c)), default=0)):
            known = points[:, (points[..., 2] > 0).any((0, 2))]
            points[:, c] = _alike(columns[c], of_view(c), known, names)
        if several and together:
            notes.append("the views' key points agree on no place of a person: people were matched by motion alone")
        return OnePerson(points, bool(notes), (), (), tuple(notes))
    person = tracks[number]
    there = slice(person.first, person.last + 1)
    points[there] = person.points
    seen, offered = person.seen.sum(0), shown[there].sum(0)
    absent = (offered > _PART * frames) & (seen < _FITS * offered)
    nearby = absent if keep_misfits else absent | _passes_by(person, rig, absent)
    apart = tuple(int(c) for c in np.flatnonzero(nearby))
    others = [t for i, t in enumerate(tracks) if i != number and len(t) >= max(5, _PART * frames)]
    if others:
        notes.append(
            f"several people ({1 + len(others)}) are seen by two views or more: the one seen most is tracked, "
            f"in {int((person.seen.sum(1) > 1).sum())} of {frames} frames"
        )
    for c in apart:
        if keep_misfits:
            points[:, c] = _alike(columns[c], of_view(c), np.delete(points, [*apart], 1), names, mirrored=True)
            continue
        points[:, c] = 0.0  # what fits in some frames does so by chance
        notes.append(
            f"view {rig.names[c]}: its key points show no person where the other views see the person, and are "
            "left out; if it is the same person, run hypose check, which finds what is wrong with this camera"
        )
    for t in tracks:
        count[t.first : t.last + 1] -= t.candidates >= 0
    unknown = ((count > 0).sum(0) > 2 * _PART * frames) & ~nearby
    strangers = [name for name, one in zip(rig.names, unknown, strict=True) if one]
    if strangers and not others:
        notes.append(f"a person whom only one view sees is left out ({', '.join(strangers)})")
    return OnePerson(points, bool(others or strangers), (person, *others), apart, tuple(notes))


def _passes_by(person: PersonTrack, rig: CameraRig, absent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find views (C,) whose key points lie next to the place where the rays of the other views meet.

    person: the track.
    absent: (C,) views that are known to show someone else, and are not used.
    The worst view is removed first, as long as three or more are left to decide.
    """
    views = Views(rig)
    points = person.points.transpose(1, 0, 2, 3)[..., :3].copy()
    points[absent] = 0.0
    out = np.zeros(len(rig), dtype=np.bool_)
    world = person.world
    while (points[..., 2] > LEAST_CONFIDENCE).any((1, 2)).sum() > 2:
        uv, metres = views.seen_at(world)
        with np.errstate(invalid="ignore"):
            far = np.linalg.norm(uv - points[..., :2], axis=-1) * metres
        known = np.isfinite(far) & (points[..., 2] > LEAST_CONFIDENCE)
        hits = np.where(
            known.any((1, 2)), (known & (far < _NEAR_M)).sum((1, 2)) / np.maximum(known.sum((1, 2)), 1), 1.0
        )
        worst = int(hits.argmin())
        if hits[worst] >= _HITS:
            break
        out[worst], points[worst] = True, 0.0
        world, _ = meet(views, points, _NEAR_M)
    return out


def _how_many(people: Array | None) -> int:
    """Count the people (P, K, 3) of one view and frame who have enough confident points; None: 0."""
    return 0 if people is None else int(np.count_nonzero((people[..., 2] > LEAST_CONFIDENCE).sum(-1) >= LEAST_SEEN))


def _alike(
    column: Sequence[Array | None],
    tracks: Sequence[NDArray[np.int64]],
    others: Array,
    names: Sequence[str],
    mirrored: bool = False,
) -> Array:
    """Find the points (T, K, columns) of the person in one view who moves like the person (T, C, K, columns) in the
    other views.

    column: candidates of the view in each frame.
    tracks: the people of the view, see `view_tracks`.
    names: names of the K points.
    mirrored: the view's pictures may be mirrored.
    Of a view with one person at a time, and of the first view, it is the person present longest. All zero where no one
    of several moves like the person.
    """
    size, best = (len(names), others.shape[3]), next(iter(tracks), np.full(len(column), -1))
    rivals = [t for t in tracks[1:_COMPARED] if ((t >= 0) & (best >= 0)).sum() > 0.3 * (t >= 0).sum()]
    if rivals and others.shape[1]:
        twin, scored = other_sides(names), [(_SAME, np.full(len(column), -1))]
        for t in (best, *rivals):
            p = taken(column, t, *size)
            for named in (p, p[:, twin]) if mirrored else (p,):
                found = [x for c in range(others.shape[1]) if np.isfinite(x := moves_as(named, others[:, c]))]
                scored += [(float(np.mean(found)), t)] if found else []
        best = min(scored, key=lambda s: s[0])[1]
    return taken(column, _continued(best, tracks) if (best >= 0).any() else best, *size)


def _continued(track: NDArray[np.int64], tracks: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Extend a person's candidates (T,) by those of others who are alone in the view while the person is missing.

    track: candidates of the person, -1 where missing.
    tracks: those of all people of the view.
    """
    out = track.copy()
    count = np.sum([t >= 0 for t in tracks], axis=0)
    for t in tracks:
        there = t >= 0
        if t is not track and not (there & (out >= 0)).any() and (count[there] == 1).mean() > 0.9:
            out[there] = t[there]
    return out


# ---- people followed in each view ----
# People followed in each view alone, and which of them is whom in another view, by how they move: for views that are
# not calibrated, or wrongly.
# Points of one moving body in two views obey one fundamental matrix, whatever the cameras are; points of two
# different people do not. Neither poses nor lenses have to be right for that.


_JUMP = 0.35  # largest motion of a person's points between frames (median), in sizes of the person
_MOST_PAIRS = 1500  # most pairs of points from which a fundamental matrix is computed
_FEWEST_PAIRS = 60  # with fewer nothing is known


def view_tracks(frames: Sequence[Array | None], patience: int) -> list[NDArray[np.int64]]:
    """Track the people of one view by joining each candidate to the nearest person.

    frames: T frames with the candidates (P, K, 3) of each: u px, v px, confidence; None where there are none.
    patience: number of frames after which an unseen person's track ends.
    Returns: (T,) number of the candidate in each frame, -1 for none, of each person; those present longest come first.
    Candidates and people of a frame are assigned exactly, so that two people do not take each other's place.
    """
    from scipy.optimize import linear_sum_assignment  # takes long to import

    tracks: list[NDArray[np.int64]] = []
    for t, people in enumerate(frames):
        if people is None:
            continue
        free = np.flatnonzero((people[..., 2] > LEAST_CONFIDENCE).sum(-1) >= LEAST_SEEN).tolist()
        begin = max(0, t - patience)
        seen = [(track, begin + np.flatnonzero(track[begin:t] >= 0)) for track in tracks]
        alive = [(track, int(at[-1])) for track, at in seen if len(at)]
        if alive and free:
            last = [np.asarray(frames[at])[track[at]] for track, at in alive]
            cost = [[_moved(q, people[p], t - at) for p in free] for q, (_, at) in zip(last, alive, strict=True)]
            for i, j in zip(*linear_sum_assignment(np.minimum(cost, 2.0)), strict=True):
                if cost[i][j] < 1.0:
                    alive[i][0][t] = free[j]
        for p in free:
            if not any(track[t] == p for track in tracks):
                tracks.append(np.full(len(frames), -1, dtype=np.int64))
                tracks[-1][t] = p
    return sorted(tracks, key=lambda c: -int((c >= 0).sum()))


def _moved(before: Array, now: Array, gap: int) -> float:
    """Compute the distance of two candidates (K, 3) in units of the distance that a person moves in `gap` frames.

    before, now: px and confidence.
    Returns: the distance, 1 at the largest plausible one; 2 where fewer than three points are common.
    """
    both = (before[:, 2] > LEAST_CONFIDENCE) & (now[:, 2] > LEAST_CONFIDENCE)
    if both.sum() < 3:
        return 2.0
    size = max(person_size(p, LEAST_CONFIDENCE) for p in (before, now))
    apart = float(np.median(np.linalg.norm(before[both, :2] - now[both, :2], axis=1)))
    return apart / max(_JUMP * size * min(1.0 + 0.1 * (gap - 1), 2.0), 1e-6)


def taken(frames: Sequence[Array | None], candidates: NDArray[np.int64], count: int, columns: int = 3) -> Array:
    """Collect the points of one person from the candidates of each frame of a view.

    frames: T arrays (P, K, columns), None where there are no candidates.
    candidates: (T,) index of the person's candidate in each frame, -1 for none.
    count: number K of key points.
    Returns: (T, K, columns) points; 0 where the person has no candidate.
    """
    out = np.zeros((len(frames), count, columns))
    for t, (people, p) in enumerate(zip(frames, candidates, strict=True)):
        if p >= 0 and people is not None:
            out[t] = people[p]
    return out


def moves_as(one: Array, other: Array) -> float:
    """Compute how badly the points (T, K, 3) of two views fit one body.

    one, other: px and confidence, in the same T frames.
    Points of one moving body in two views obey one fundamental matrix, whatever the cameras are. It is the one of least
    median distance (OpenCV), because detections have outliers.
    Returns: median distance from the epipolar lines, in sizes of the person; NaN where too few points are common.
    """
    both = (one[..., 2] > LEAST_CONFIDENCE) & (other[..., 2] > LEAST_CONFIDENCE)
    a, b = one[both][:, :2], other[both][:, :2]
    if len(a) < _FEWEST_PAIRS:
        return float("nan")
    every = max(1, len(a) // _MOST_PAIRS)
    pairs = a[::every], b[::every]
    cv2.setRNGSeed(0)
    found, _ = cv2.findFundamentalMat(*pairs, cv2.FM_LMEDS)
    if found is None:
        return float("nan")
    distance = []
    for k, points in enumerate((one, other)):
        lines = cv2.computeCorrespondEpilines(pairs[1 - k], 2 - k, found[:3])[:, 0]  # in this view, of unit normals
        distance.append(
            np.abs((lines[:, :2] * pairs[k]).sum(1) + lines[:, 2]) / max(float(sizes(points[None])[0]), 1.0)
        )
    return float(np.median(np.max(distance, axis=0)))


# ---- held points ---------------------------------------------------------------------------------------------------
# Find key points that were held over gaps: a detector, or a program that filled its gaps, repeated the last known
# place.
#
# Real detections of a person who stands still differ in their last digits. A point with exactly the same value in
# several frames, while most other points of the view move on, was not seen there.


_HELD = 3  # frames with the same place from which a point is held; the first of them is a detection
_MOVING = 0.7  # least share of the people's points in a frame that move
_COARSE = 0.1  # share of repeated places in a view from which they are rounded too much, or too still, to decide
_LEAST_SEEN = 6  # least points of a frame that show whether the others move


def without_held(column: Sequence[Array | None]) -> tuple[list[Array | None], int]:
    """Set the confidence of key points of one view to 0 where a program only repeated ("held") the last position.

    A point is held where its position is exactly the same in three or more frames in succession while most other points
    of the view move; the first of these frames is a detection and stays.
    column: per frame the people (P, K, 5): undistorted u, v, confidence, and the position as the file gave it, px,
        which is compared; None where there are none.
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
        there, place = people[..., 2] > 0, people[..., 3:5]
        age = np.ones(there.shape, dtype=np.int64)
        if before is not None:
            places, ages = before
            same = (place[:, None] == places[None]).all(-1)  # (P, P', K)
            age = np.where(there, 1 + np.where(same, ages[None], 0).max(1), 1)
            moving = there.sum() >= _LEAST_SEEN and (age[there] == 1).mean() >= _MOVING
            seen, repeated = seen + int(there.sum()), repeated + int((age[there] > 1).sum())
            held = there & (age >= _HELD) & moving
            people[held, 2], count = 0.0, count + int(held.sum())
            last = out[t - 1]
            just = same & (held & (age == _HELD))[:, None]  # the previous frame was held too
            if last is not None and just.any():
                last[just.any(0), 2], count = 0.0, count + int(just.any(0).sum())
        before = np.where(there[..., None], place, np.nan), age
    return (out, count) if repeated <= _COARSE * max(seen, 1) else (list(column), 0)

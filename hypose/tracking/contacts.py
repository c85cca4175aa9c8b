"""Find foot contacts with the ground, and build the terms that hold the feet while a clip is solved.

Contacts are found on a motion that is already smooth: a point of the sole that is slow for a while and, where there is
a common floor, near it. The ground need not be flat (a beam, a step): without a common height each contact has its own.
Source: foot-plant clean-up as in Kovar, Schreiner & Gleicher 2002, here as weighted points of the clip's solve, so that
    the legs give in where their evidence is weak and strong evidence can override the contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks
from hypose.evidence.terms import PointTerm
from hypose.geometry import Array


@dataclass(frozen=True)
class ContactSettings:
    """Settings for finding and holding foot contacts; each field begins with its unit.

    slow, fast: m/s, a contact begins below slow and ends above fast.
    shortest: s, shortest contact.
    near: m above the floor that still counts as on it.
    common: share of the contact frames within `near` of one height that makes it a floor.
    drift: m, a point that moves further away begins a new contact.
    hold: m, standard deviation with which a point in contact is held.
    """

    slow: float = 0.25
    fast: float = 0.5
    shortest: float = 0.12
    near: float = 0.05
    common: float = 0.6
    drift: float = 0.025
    hold: float = 0.01


_SOLES = ("left_heel", "left_ball", "right_heel", "right_ball")


def soles_of(body: Body) -> Landmarks:
    """Locate heel and ball of the left foot, then of the right foot, as 4 points fixed to the ankles.

    They are the middle of the hindmost fifth and of the foremost 30 % of the sole: the skin of the foot in the lowest
    2 cm at rest.
    """
    joint, offset = [], []
    for side in ("left", "right"):
        j = body.skeleton.joint(f"{side}_ankle")
        skin = body.fine.vertices[body.fine.main_joint == j]
        sole = skin[skin[:, 2] < skin[:, 2].min() + 0.02]
        y = sole[:, 1]  # backward
        hind, fore = y > np.quantile(y, 0.8), y < np.quantile(y, 0.3)
        for part in (hind, fore):
            joint.append(j)
            offset.append(sole[part].mean(0) - body.skeleton.rest_joints[j])
    return Landmarks(_SOLES, np.array(joint), np.array(offset))


@dataclass(frozen=True)
class Contacts:
    """Foot contacts of a motion.

    touching: (T, 4) true where a point of the soles stands on the ground; the points are left heel, left ball, right
        heel and right ball.
    place: (T, 4, 3) where the point stands, m, world; NaN where it is not in contact.
    floor: common height of the contacts, m; NaN where they have none.
    """

    touching: NDArray[np.bool_]
    place: Array
    floor: float


def find_contacts(
    positions: Array, known: NDArray[np.bool_], frame_rate: float, settings: ContactSettings | None = None
) -> Contacts:
    """Find the contacts of the soles' points in a smooth motion.

    frame_rate: Hz; settings: limits of a contact (default: ContactSettings()).
    positions: (T, 4, 3) m.
    known: (T,) false for frames without evidence, which have no contacts.
    """
    o = settings or ContactSettings()
    t = len(positions)
    speed = np.linalg.norm(np.gradient(positions, 1 / frame_rate, axis=0), axis=-1) if t > 1 else np.zeros((t, 4))
    touching = np.stack([_hysteresis(s, known, o.slow, o.fast) for s in speed.T], 1)
    shortest = max(2, round(o.shortest * frame_rate))
    touching = np.stack([_only_long(c, shortest) for c in touching.T], 1)
    floor = _common_height(positions[..., 2][touching], o)
    if np.isfinite(floor):
        high = positions[..., 2] > floor + o.near
        touching = np.stack([_only_long(c, shortest) for c in (touching & ~high).T], 1)
    place = np.full(positions.shape, np.nan)
    for k in range(positions.shape[1]):
        for run in runs(touching[:, k]):
            for a, b in _standing(positions[:, k], run.start, run.stop, o.drift):
                if b - a < shortest:
                    touching[a:b, k] = False
                    continue
                middle = np.median(positions[a:b, k], axis=0)
                if np.isfinite(floor):
                    middle[2] = max(middle[2], floor)  # a heel may be raised, but nothing sinks
                place[a:b, k] = middle
    return Contacts(touching, place, floor)


def contact_terms(
    contacts: Contacts, soles: Landmarks, settings: ContactSettings | None = None
) -> list[list[PointTerm]]:
    """Build the solver terms that hold the soles at their contacts.

    soles: the four points on the body (`soles_of`).
    Returns: one list of terms per frame; empty where no point is in contact.
    """
    o = settings or ContactSettings()
    return [
        [PointTerm(place[on], np.ones(int(on.sum())), soles.joint[on], soles.offset[on], o.hold)]
        for on, place in zip(contacts.touching, contacts.place, strict=True)
    ]


@dataclass(frozen=True)
class FootMotion:
    """Faults of the feet in a motion.

    sliding: mean horizontal speed of points in contact, mm/s.
    contacts: share of the frames with any contact.
    """

    sliding: float
    contacts: float


def foot_motion(positions: Array, contacts: Contacts, frame_rate: float) -> FootMotion:
    """Measure the sliding of the soles' points (T, 4, 3), m, over given contacts.

    positions: positions of the soles; frame_rate: Hz. The sliding is 0 where there is no contact.
    Use the same contacts for all motions that are compared.
    """
    both = contacts.touching[1:] & contacts.touching[:-1]
    speed = np.linalg.norm(np.diff(positions[..., :2], axis=0), axis=-1) * frame_rate
    return FootMotion(
        1e3 * float(speed[both].mean()) if both.any() else 0.0,
        float(contacts.touching.any(1).mean()),
    )


def _hysteresis(speed: Array, known: NDArray[np.bool_], slow: float, fast: float) -> NDArray[np.bool_]:
    """Mark the frames (T,) of stretches below `fast` that fall below `slow` somewhere.

    speed: (T,) m/s; known: (T,) frames outside are never marked; slow, fast: m/s.
    """
    out = np.zeros(len(speed), dtype=bool)
    for run in runs((speed < fast) & known):
        out[run.start : run.stop] = (speed[run.start : run.stop] < slow).any()
    return out


def _standing(points: Array, first: int, last: int, drift: float) -> list[tuple[int, int]]:
    """Split the frames first to last where a point (T, 3) has moved further than drift from its mean so far."""
    out, begin = [], first
    for t in range(first + 1, last):
        if np.linalg.norm(points[t] - points[begin:t].mean(0)) > drift:
            out.append((begin, t))
            begin = t
    return [*out, (begin, last)]


def _only_long(flags: NDArray[np.bool_], shortest: int) -> NDArray[np.bool_]:
    """Unmark runs of marked frames (T,) that are shorter than `shortest` frames."""
    out = np.zeros(len(flags), dtype=bool)
    for run in runs(flags):
        out[run.start : run.stop] = len(run) >= shortest
    return out


def runs(flags: NDArray[np.bool_]) -> list[range]:
    """Find the consecutive marked frames in flags (T,), as ranges."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [range(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _common_height(heights: Array, settings: ContactSettings) -> float:
    """Estimate the low height that most contacts share; NaN where they share none, for example because a foot is held
    up.

    heights: (N,) m, of all points in contact.
    """
    if len(heights) == 0:
        return float("nan")
    near = np.abs(heights - np.quantile(heights, 0.1)) < settings.near
    return float(np.quantile(heights[near], 0.25)) if near.mean() >= settings.common else float("nan")

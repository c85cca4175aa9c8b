"""Where a sensor stands, found from the persons that it shares with others, when nobody knows who is who."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hypose.compute import lorentzian_weight
from hypose.fusion.joints import MIRROR, TRUNK_JOINTS
from hypose.geometry import Array, procrustes

_SensorInstant = tuple[Mapping[int, Array], Mapping[int, Array]]
"""One instant: skeletons (15, 3) of a sensor by its numbers, in its frame; ours by our numbers, in the common frame."""
_TRUNK = np.array(TRUNK_JOINTS)
_LOOK = 4
"""Instants of a pairing in the quick look."""


def find_place(
    shots: Sequence[_SensorInstant], fewest: int, residual: float, distinct: float
) -> tuple[Array, float] | None:
    """common_from_sensor (4, 4) and its median distance m, or None: every pairing of one of its persons with one of
    ours gives a place, and the best one puts all on persons. fewest: shared instants of a pairing; residual: largest
    distance m; distinct: the next best pairing must be worse by this ratio.

    All pairings are looked at in one batch, so that with many persons no frame is late."""
    some = list(shots)[:: max(1, len(shots) // 12)]
    pairs, skeletons = [], []
    for b, p in sorted({(b, p) for bodies, people in some for b in bodies for p in people}):
        both = [(bodies[b], people[p]) for bodies, people in some if b in bodies and p in people]
        if len(both) >= min(fewest, len(some)):
            pairs.append((b, p))
            skeletons.append((np.stack([x for x, _ in both]), np.stack([y for _, y in both])))
    if not pairs:
        return None
    places = _centres(some)
    looked = np.full((2, len(pairs), 2 * _LOOK, 15, 3), np.nan)
    for i, (theirs, ours) in enumerate(skeletons):
        few = slice(None, None, max(1, len(theirs) // _LOOK))
        n = len(theirs[few][: 2 * _LOOK])
        looked[0, i, :n], looked[1, i, :n] = theirs[few][:n], ours[few][:n]
    # also with its sides exchanged; an honest sensor is the rule, so those must fit clearly better
    sources = np.concatenate([looked[0], looked[0][:, :, MIRROR]]).reshape(2 * len(pairs), -1, 3)
    targets = np.concatenate([looked[1], looked[1]]).reshape(2 * len(pairs), -1, 3)
    motions, distance = _plain_fits(sources, targets)
    scores = distance * np.repeat([1.0, 1.4], len(pairs)) + _misplaced(motions, *places)
    found: list[tuple[float, int, int, Array]] = []
    for n in np.argsort(scores, kind="stable")[:6].tolist():
        (b, p), (theirs, ours) = pairs[n % len(pairs)], skeletons[n % len(pairs)]
        best = _fit(theirs[:, MIRROR] if n >= len(pairs) else theirs, ours, 4) if np.isfinite(scores[n]) else None
        if best is not None:
            found.append((best[1] + float(_misplaced(best[0][None], *places)[0]), b, p, best[0]))
    if not found:
        return None
    found.sort(key=lambda f: f[0])
    score, b, p, motion = found[0]
    # another pairing that says the same is no rival
    rivals = [f for f in found[1:] if (f[1] == b) != (f[2] == p)]
    if score > residual or (rivals and score > distinct * rivals[0][0]):
        return None
    return motion, score


def place_score(motion: Array, shots: Sequence[_SensorInstant]) -> float:
    """Median distance (m) of the joints of a sensor's persons to those of ours at a place (4, 4) that is believed
    already, infinite when they share no instant. Persons that only one side sees do not count."""
    scores = []
    for bodies, people in shots:
        if not bodies or not people:
            continue
        there = transform_points(motion, np.stack(list(bodies.values())))
        d = np.linalg.norm(there[:, None] - np.stack(list(people.values()))[None], axis=-1)
        known = np.isfinite(d)
        middle = np.ma.median(np.ma.masked_array(np.where(known, d, 0.0), ~known), axis=-1).filled(np.inf)
        scores.append(float(np.sort(middle.min(1))[: min(len(bodies), len(people))].mean()))
    return float(np.median(scores)) if scores else np.inf


def transform_points(motion: Array, points: Array) -> Array:
    """`geometry.transform` for one motion, without its generality."""
    return points @ motion[:3, :3].T + motion[:3, 3]


def trunk_centre(joints: Array) -> Array | None:
    """Mean (3,) of a skeleton's trunk, None when fewer than three of its joints are known."""
    trunk = joints[_TRUNK]
    mean = trunk.sum(0) / len(_TRUNK)
    if mean[0] == mean[0]:
        return mean
    known = np.isfinite(trunk[:, 0])
    if int(known.sum()) < 3:
        return None
    # each joint missing would move a plain mean by some centimetres, which the gate takes
    return trunk[known].mean(0)


def _fit(body: Array, ours: Array, iterations: int) -> tuple[Array, float] | None:
    """common_from_sensor and the median distance (m) from skeletons (T, 15, 3) of both."""
    source, target = body.reshape(-1, 3), ours.reshape(-1, 3)
    use = np.isfinite(source[:, 0]) & np.isfinite(target[:, 0])
    if int(use.sum()) < 20:
        return None
    a, b = source[use], target[use]
    motion, distance, weight = np.eye(4), np.zeros(len(a)), None
    for _ in range(iterations):
        motion = procrustes(a, b, weight)[0]
        distance = np.linalg.norm(transform_points(motion, a) - b, axis=-1)
        weight = lorentzian_weight((distance / 0.06) ** 2)
    return motion, float(np.median(distance))


def _centres(shots: Sequence[_SensorInstant]) -> tuple[Array, Array]:
    """Trunks of the sensor's persons (S, B, 3) in its frame and of ours (S, P, 3), of at most five instants."""
    some = shots[:: max(1, len(shots) // 5)]
    out = []
    for skeletons in ([shot[0] for shot in some], [shot[1] for shot in some]):
        found = [[c for j in one.values() if (c := trunk_centre(j)) is not None] for one in skeletons]
        padded = np.full((len(some), max(1, *(len(f) for f in found)), 3), np.nan)
        for n, centres in enumerate(found):
            padded[n, : len(centres)] = np.array(centres).reshape(-1, 3)
        out.append(padded)
    return out[0], out[1]


def _misplaced(motions: Array, theirs: Array, ours: Array) -> Array:
    """(P,) for motions (P, 4, 4): mean distance (m, each at most 0.5) of the sensor's persons to the nearest of ours,
    less what is noise."""
    # whom only one side sees says nothing: as many as both can share
    both = np.minimum(np.isfinite(theirs[..., 0]).sum(1), np.isfinite(ours[..., 0]).sum(1))
    counted = np.arange(theirs.shape[1]) < both[:, None]
    if not counted.any():
        return np.zeros(len(motions))
    there = theirs @ motions[:, None, :3, :3].swapaxes(-1, -2) + motions[:, None, None, :3, 3]
    d = np.sqrt(((there[:, :, :, None] - ours[:, None]) ** 2).sum(-1))
    nearest = np.sort(np.where(np.isfinite(d), d, np.inf).min(3), axis=2)
    return np.maximum(0.0, np.minimum(nearest[:, counted], 0.5).mean(1) - 0.1)


def _plain_fits(sources: Array, targets: Array) -> tuple[Array, Array]:
    """Rigid motions (P, 4, 4) of many pairs of point sets (P, N, 3) at once by least squares, NaN rows left out, and
    the median distances (P,); infinite where fewer than 20 points are left."""
    use = np.isfinite(sources[..., 0]) & np.isfinite(targets[..., 0])
    w = use / np.maximum(use.sum(1), 1)[:, None]
    a, b = np.where(use[..., None], sources, 0.0), np.where(use[..., None], targets, 0.0)
    ca, cb = np.einsum("pn,pnk->pk", w, a), np.einsum("pn,pnk->pk", w, b)
    h = np.einsum("pn,pni,pnj->pij", w, b - cb[:, None], a - ca[:, None])
    u, _, vt = np.linalg.svd(h)
    guard = np.ones((len(h), 1, 3))  # as in geometry.procrustes: never a reflection
    guard[:, 0, 2] = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
    motions = np.tile(np.eye(4), (len(h), 1, 1))
    motions[:, :3, :3] = (u * guard) @ vt
    motions[:, :3, 3] = cb - np.einsum("pij,pj->pi", motions[:, :3, :3], ca)
    off = np.linalg.norm(a @ motions[:, :3, :3].swapaxes(1, 2) + motions[:, None, :3, 3] - b, axis=-1)
    # the median of the used ones: the others are put beyond all of them
    count = use.sum(1)
    off = np.sort(np.where(use, off, np.inf), axis=1)
    rows = np.arange(len(off))
    middle = (off[rows, np.maximum(count - 1, 0) // 2] + off[rows, np.minimum(count // 2, off.shape[1] - 1)]) / 2
    return motions, np.where(count >= 20, middle, np.inf)

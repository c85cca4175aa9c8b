"""How far cameras that were found from a moving person may be off: a sandwich covariance.

The errors of a detector are far from independent: a joint is set too high in one view all the time, and a whole arm is
misplaced for some frames. Scores are therefore summed over clusters, (view, key point) and (view, limb, block of time),
before they are squared; a plain Hessian is several times too sure.
Source: Huber 1967; White 1980; Cameron, Gelbach & Miller 2011, "Robust inference with multiway clustering" (here the
two clusterings are added, which is the cautious side)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hypose.calibration.refine_points import PointBundle
from hypose.cameras.camera import Camera
from hypose.geometry import Array, skew

_BLOCK = 12  # moments that err together
_PARTS = (
    ("nose", "eye", "ear", "head", "mouth"),
    ("elbow", "wrist", "pinky", "index", "thumb", "hand"),
    ("knee", "ankle", "toe", "heel", "foot"),
)


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of C cameras when the rig is laid onto the truth by a similarity.

    turn_deg, place_m, focal (share; 0 where it is given), late (frames).
    later (C,): frames by which the offsets should still be changed, which the bundle adjustment takes as given.
    """

    turn_deg: Array
    place_m: Array
    focal: Array
    late: Array
    later: Array


def limbs_of(names: Sequence[str]) -> Array:
    """Return (K,) which part of the body each key point belongs to: head, arms, legs, or the trunk."""
    return np.array([next((k for k, words in enumerate(_PARTS) if any(w in n for w in words)), 3) for n in names])


def uncertainty(
    bundle: PointBundle, cameras: Sequence[Camera], radial: Array, points: Array, velocity: Array, labels: Array
) -> Uncertainty:
    """Uncertainty at a solution of `adjust`.

    points (N, 3) m.
    velocity (C, N, 2) px per frame of the detections, for the offsets are unknown as well.
    labels (N, 3): moment, key point and limb of each point.
    """
    r, weight, jc, jp = bundle.rows(list(cameras), radial, points)
    count, n = weight.shape
    jc = np.concatenate([jc, -velocity[..., None]], -1)
    size = jc.shape[-1]
    wjc = weight[..., None, None] * jc
    own = np.einsum("cn,cnxi,cnxj->nij", weight, jp, jp) + 1e-3 * np.eye(3)
    cross = np.einsum("cnxp,cnxi->nicp", wjc, jp).reshape(n, 3, -1)
    eliminated = np.linalg.solve(own, cross)
    each = np.arange(count)
    hessian = np.zeros((count, size, count, size))
    hessian[each, :, each] = np.einsum("cnxp,cnxq->cpq", wjc, jc) + np.diag(np.r_[bundle.unknowns.hold, 1e-3])
    hessian = hessian.reshape(count * size, -1)
    pull = np.einsum("cnxi,cn,cnx->cni", jp, weight, r)
    score = -np.einsum("cni,nis->cns", pull, eliminated).reshape(count, n, count, size)
    score[each, :, each] += np.einsum("cnxp,cnx->cnp", wjc, r)
    score = score.reshape(count, n, -1)
    moment, kind, limb = labels.T
    middle = np.zeros_like(hessian)
    for ids in (kind, limb + 4 * (moment // _BLOCK)):
        sums = np.zeros((count, int(ids.max()) + 1, count * size))
        np.add.at(sums.transpose(1, 0, 2), ids, score.transpose(1, 0, 2))
        rows = sums.reshape(-1, count * size)
        used = int(np.any(rows != 0, axis=1).sum())
        middle += rows.T @ rows * used / max(used - count * size, used / 4)
    inverse = np.linalg.inv(hessian - np.einsum("nis,nit->st", cross, eliminated) + 1e-6 * np.diag(np.diag(hessian)))
    free = _without_gauge(cameras, points, size)
    sd = np.sqrt(np.maximum(np.diag(free @ inverse @ middle @ inverse @ free.T), 0)).reshape(count, size)
    focal = sd[:, 6] if bundle.unknowns.focal else np.zeros(count)
    turn, place = (np.linalg.norm(sd[:, k : k + 3], axis=1) for k in (0, 3))
    later = -(free @ inverse @ score.sum((0, 1))).reshape(count, size)[:, -1]
    return Uncertainty(np.degrees(turn), place, focal, np.hypot(sd[:, -1], later), later)


def _without_gauge(cameras: Sequence[Camera], points: Array, size: int) -> Array:
    """Return (S, S) the projection of the cameras' unknowns that takes out what no picture tells: a motion and the
    scale of the whole world, and the start of the common clock."""
    count = len(cameras)
    middle = np.median(points, axis=0)
    reach = float(np.median([np.linalg.norm(c.position - middle) for c in cameras]))
    marks = reach * np.array([[0.0, 0, 0], [0, 0, 1.0], [0.3, 0, 1.0], [0, 0.3, 1.0]])  # as `gauge` compares cameras
    j = np.concatenate([np.concatenate([-skew(mark), np.eye(3)], 1) for mark in marks])
    free = np.zeros((count, size, 8))
    metric = np.zeros((count, size, count, size))
    for c, camera in enumerate(cameras):
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        free[c, :3, :3], free[c, 3:6, :3], free[c, 3:6, 3:6] = -turn, -skew(shift) @ turn, -turn
        free[c, 3:6, 6], free[c, -1, 7] = shift, 1.0
        metric[c, :6, c, :6], metric[c, -1, c, -1] = j.T @ j, 1.0
    free, metric = free.reshape(count * size, 8), metric.reshape(count * size, -1)
    return np.eye(count * size) - free @ np.linalg.solve(free.T @ metric @ free, free.T @ metric)

"""Fit one frame of fused skeletons, and compute its uncertainty.

Missing joints are marked by a weight of 0, never by NaN alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hypose.compute.compiled import kernel
from hypose.compute.losses import lorentzian_weight
from hypose.geometry import Array


def fit_frame(
    points: Array,
    weights: Array,
    predicted: Array,
    prior_weight: Array,
    bones: NDArray[np.int64],
    lengths: Array,
    bone_weight: Array,
    data_weight: float,
    scale: float,
    coarse: float,
    iterations: int,
) -> tuple[Array, Array, Array]:
    """Fit the 3D joints of one frame to the joints of K sensors, constant bone lengths and a prediction, by graduated
    Gauss-Newton from the prediction.

    It minimises 1/2 sum_kj w_kj d c^2 log(1 + |s_kj - x_j|^2 / c^2) + 1/2 sum_b b_b (|x_i - x_j| - l_b)^2 + 1/2 sum_j
    p_j |x_j - predicted_j|^2.

    points: (K, J, 3) m, joints s of the sensors.
    weights: (K, J) w, 0 = missing.
    predicted: (J, 3) m.
    prior_weight: (J,) p, 1/m^2.
    bones: (B, 2) joints i, j of each bone.
    lengths: (B,) l, m (0 = unknown).
    bone_weight: (B,) b, 1/m^2.
    data_weight: d, 1/m^2.
    scale: c, m, multiplied by coarse, coarse / 2, ... down to 1.
    iterations: number of steps.
    Returns: joints (J, 3) m; share of each sensor in each joint (K, J); variance (J,) m^2 per axis, of the quadratic at
        the result.
    """
    x, ends, stiff = predicted.copy(), np.eye(len(predicted))[bones], np.where(lengths > 0, bone_weight, 0.0)
    between = ends[:, 0] - ends[:, 1]  # (B, J) 1 and -1 at the ends of each bone
    full, alone = weights * data_weight, np.repeat(prior_weight, 3)
    for step in range(iterations + 1):
        off, c = points - x, scale * max(1.0, coarse / 2.0**step)
        pull = lorentzian_weight(np.einsum("kja,kja->kj", off, off) / c**2, full)
        along = between @ x
        length = np.sqrt(np.einsum("ba,ba->b", along, along) + 1e-12)
        rows = np.einsum("bj,ba,b->bja", between, along, 1 / length).reshape(len(bones), x.size)
        matrix = (stiff * rows.T) @ rows
        matrix.ravel()[:: x.size + 1] += alone + np.repeat(pull.sum(0), 3)
        if step < iterations:
            force = prior_weight[:, None] * (predicted - x) + np.einsum("kj,kja->ja", pull, off)
            x += np.linalg.solve(matrix, force.ravel() + (stiff * (lengths - length)) @ rows).reshape(x.shape)
    variance = np.linalg.inv(matrix).diagonal().reshape(x.shape).mean(1)  # of the result
    return x, pull / (pull.sum(0) + 1e-12), variance


@kernel
def judge_claims(off, apart, alike, weights, order, variance, own, elsewhere, jitter, limit, systematic, wrong):
    """Compute the remaining uncertainty of fused joints from the disagreement of the sensors.

    off: (K, J, 3) m, from the fused joints to the sensors'.
    apart: (K, K, J) m^2, squared distances between the sensors' joints.
    alike: (K, K) share of the error sd `own` that two sensors have in common.
    weights: (K, J) probability that a sensor sees the joint.
    order: (K, J) sensors by falling weight.
    variance: (J,) m^2 per axis, of the fused joints themselves.
    own: (J,) m per axis, sd of the error of a joint that a sensor sees.
    elsewhere: m per axis, sd of a guessed joint.
    jitter: m per axis, sd of the noise between frames.
    limit: m, least size of a large error.
    systematic: (J,) gets m^2 per axis, the variance about the fused joints over all cases.
    wrong: (J,) gets the probability of an error above limit.

    The cases are: the first sensor in the order is right, and those after it are right or guess; or it guesses and the
    next one is right, ...; or all guess. The distances between the sensors' joints weigh the cases.
    """
    centre = np.empty(3)
    for j in range(own.shape[0]):
        n, seen, guess = int((weights[:, j] > 0).sum()), own[j] ** 2, elsewhere**2
        total, systematic[j], wrong[j] = 0.0, 0.0, 0.0
        for first in range(max(n, 1) + (n > 0)):
            likely, rights, far = 1.0, 0.0, 0.0
            centre[:] = 0.0
            for i in range(n):
                k, anchor = order[i, j], order[first % n, j]
                w, d, share = weights[k, j], apart[k, anchor, j], 0.0
                if i == first:
                    likely, share = likely * w, 1.0
                elif i > first:
                    near = w * _normal(d, seen * (1 - alike[k, anchor]) + 2 * jitter**2)
                    both = near + (1 - w) * _normal(d, seen + guess)
                    likely, share = likely * both, near / max(both, 1e-300)
                elif k == anchor:
                    likely *= 1 - w
                else:
                    likely *= (1 - w) * _normal(d, seen + guess * (1 if first < n else 2))
                rights += share
                centre += share * off[k, j]
            for a in range(3):
                far += (centre[a] / max(rights, 1.0)) ** 2
            likely, around = max(likely, 1e-300), guess if first == n and n > 0 else seen
            total += likely
            systematic[j] += likely * (around + far / 3)
            wrong[j] += likely * _beyond(math.sqrt(far), math.sqrt(around + variance[j]), limit)
        systematic[j] /= total
        wrong[j] /= total


@kernel
def _normal(squared, variance):
    """Compute the density of a 3D normal distribution at a squared distance, up to a constant factor."""
    return math.exp(-squared / (2 * variance)) / variance**1.5


@kernel
def _beyond(off, sd, limit):
    """Compute the probability that a point of sd per axis, about a centre at distance off, lies farther than limit
    away.
    """
    off = max(off, 1e-6)
    near, far = (limit - off) / sd, (limit + off) / sd
    inside = (math.erf(near / math.sqrt(2)) + math.erf(far / math.sqrt(2))) / 2
    return 1 - inside + sd / off * (math.exp(-near * near / 2) - math.exp(-far * far / 2)) / math.sqrt(2 * math.pi)

"""Fit one frame of fused skeletons, and compute its uncertainty (kernels).

Missing joints are marked by a weight of 0, never by NaN alone.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.losses import lorentzian_kernel as lorentzian


@kernel
def fit_frame(
    points, weights, predicted, prior_weight, bones, lengths, bone_weight, data_weight, scale, coarse, iterations, x,
    share, variance,
):  # fmt: skip
    """Fit the 3D joints of one frame to the joints of K sensors, constant bone lengths and a prediction, by graduated
    Gauss-Newton.

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
    x: (J, 3) m, start; gets the result.
    share: (K, J) gets the share of each sensor in each joint.
    variance: (J,) gets m^2 per axis, of the quadratic at the result.
    """
    sensors, joints = weights.shape
    n = 3 * joints
    h, g, u = np.empty((n, n)), np.empty(n), np.empty(3)
    for it in range(iterations + 1):
        c = scale * max(1.0, coarse / 2.0**it)
        h[:] = 0.0
        for j in range(joints):
            total = prior_weight[j]
            for a in range(3):
                g[3 * j + a] = prior_weight[j] * (predicted[j, a] - x[j, a])
            for k in range(sensors):
                share[k, j] = 0.0
                if weights[k, j] > 0:
                    dx = points[k, j, 0] - x[j, 0]
                    dy = points[k, j, 1] - x[j, 1]
                    dz = points[k, j, 2] - x[j, 2]
                    w = lorentzian((dx * dx + dy * dy + dz * dz) / (c * c), weights[k, j] * data_weight)[1]
                    share[k, j] = w
                    g[3 * j] += w * dx
                    g[3 * j + 1] += w * dy
                    g[3 * j + 2] += w * dz
                    total += w
            for a in range(3):
                h[3 * j + a, 3 * j + a] = total
        for b in range(bones.shape[0]):
            i, j = bones[b, 0], bones[b, 1]
            d = 1e-12
            for a in range(3):
                u[a] = x[i, a] - x[j, a]
                d += u[a] * u[a]
            d = math.sqrt(d)
            stiff = bone_weight[b] if lengths[b] > 0 else 0.0
            for a in range(3):
                u[a] /= d
                g[3 * i + a] += stiff * (lengths[b] - d) * u[a]
                g[3 * j + a] -= stiff * (lengths[b] - d) * u[a]
            for a in range(3):
                for r in range(3):
                    q = stiff * u[a] * u[r]
                    h[3 * i + a, 3 * i + r] += q
                    h[3 * j + a, 3 * j + r] += q
                    h[3 * i + a, 3 * j + r] -= q
                    h[3 * j + a, 3 * i + r] -= q
        if it < iterations:
            x += np.linalg.solve(h, g).reshape(joints, 3)
    covariance = np.linalg.inv(h)  # of the result
    for j in range(joints):
        variance[j], total = 0.0, 1e-12
        for a in range(3):
            variance[j] += covariance[3 * j + a, 3 * j + a] / 3
        for k in range(sensors):
            total += share[k, j]
        for k in range(sensors):
            share[k, j] /= total


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

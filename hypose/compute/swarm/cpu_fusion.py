"""numba: the fit of one frame of fused skeletons and what prepares it, and the fuzzy rules.

Arrays in, arrays out; definitions are in the docstrings and, as plain numpy, in the tests and in fusion.fuzzy. Missing
joints are told by a weight of 0, never by NaN alone, so that no compiler option can lose them.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.solver.cpu_cholesky import backward, backward_all, dot, factorise, forward, forward_all
from hypose.compute.solver.cpu_losses import lorentzian

LEAST = 1e-12
"""1/m^2: of a joint that nothing holds"""


@kernel
def mamdani(f, d, a, low_centre, high_centre, slope, medium_centre, medium_sd, sets, out):
    """The five rules of Asteriadis 2013 (defined by fusion.fuzzy.NoiseRules): inputs (N,), consequents sets (4, P) =
    output values, low, high, medium -> out (N,)."""
    for i in range(f.shape[0]):
        fl = 1 / (1 + math.exp(slope * (f[i] - low_centre)))
        dl = 1 / (1 + math.exp(slope * (d[i] - low_centre)))
        al = 1 / (1 + math.exp(slope * (a[i] - low_centre)))
        fh = 1 / (1 + math.exp(-slope * (f[i] - high_centre)))
        dh = 1 / (1 + math.exp(-slope * (d[i] - high_centre)))
        ah = 1 / (1 + math.exp(-slope * (a[i] - high_centre)))
        fm = math.exp(-0.5 * ((f[i] - medium_centre) / medium_sd) ** 2)
        dm = math.exp(-0.5 * ((d[i] - medium_centre) / medium_sd) ** 2)
        am = math.exp(-0.5 * ((a[i] - medium_centre) / medium_sd) ** 2)
        both = min(fl, al)
        w1, w2, w3 = min(dl, both), max(dh, min(fh, ah)), min(dm, both)
        w4, w5 = min(dl, fm, al), min(dl, fl, am)
        total, moment = 0.0, 0.0
        for p in range(sets.shape[1]):
            z = sets[3, p]
            g = 1 - (1 - w1 * sets[1, p]) * (1 - w2 * sets[2, p]) * (1 - w3 * z) * (1 - w4 * z) * (1 - w5 * z)
            total += g
            moment += g * sets[0, p]
        out[i] = moment / total if total > 1e-12 else 0.5


@kernel
def fluidity(activations, frames, out):
    """F (K, J): standard deviation of the activations (T, K, J), a ring in which `frames` entries are filled."""
    filled = min(frames, activations.shape[0])
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            mean, square = 0.0, 0.0
            for t in range(filled):
                mean += activations[t, k, j]
            mean /= filled
            for t in range(filled):
                square += (activations[t, k, j] - mean) ** 2
            out[k, j] = math.sqrt(square / filled)


@kernel
def fit_frame(
    points, weights, predicted, prior_weight, bones, lengths, bone_weight, leaves, core, data_weight, scale, coarse,
    iterations, x, share, variance,
):  # fmt: skip
    """The 3D joints of one frame: robust data, constant distances, and a prediction; graduated Gauss-Newton.

    Minimises 1/2 sum_kj w_kj d c^2 log(1 + |s_kj - x_j|^2 / c^2) + 1/2 sum_b b_b (|x_i - x_j| - l_b)^2 +
    1/2 sum_j p_j |x_j - predicted_j|^2. points (K, J, 3) m, weights (K, J) 0 = missing; predicted (J, 3); prior_weight
    (J,) 1/m^2; bones (B, 2), lengths (B,) m (0 = unknown), bone_weight (B,) 1/m^2; data_weight d 1/m^2; scale c m,
    multiplied by coarse, coarse / 2, ... down to 1. leaves (L, 3): joint, its only neighbour left, their bone, in an
    order that prunes the limbs; core (J,): number of a joint among the rest, -1 for leaves. Limbs are eliminated one by
    one, so that only the trunk needs a dense solve. x (J, 3): start and result. share (K, J): the sensors' part in each
    joint; variance (J,) m^2 per axis, of the quadratic at the result."""
    sensors, joints = weights.shape
    m = 0
    for j in range(joints):
        m = max(m, core[j] + 1)
    n = 3 * m
    h = np.zeros((n, n))
    right = np.empty(n)
    diagonal = np.empty((joints, 3, 3))
    off = np.zeros((leaves.shape[0], 3, 3))
    solved = np.empty((leaves.shape[0], 3, 4))
    g = np.empty((joints, 3))
    u = np.empty(3)
    leaf_of_bone = np.full(bones.shape[0], -1)
    for e in range(leaves.shape[0]):
        leaf_of_bone[leaves[e, 2]] = e
    for it in range(iterations + 1):
        c = scale * max(1.0, coarse / 2.0**it)
        h[:] = 0.0
        diagonal[:] = 0.0
        for j in range(joints):
            total = prior_weight[j]
            for a in range(3):
                g[j, a] = prior_weight[j] * (predicted[j, a] - x[j, a])
            for k in range(sensors):
                share[k, j] = 0.0
                if weights[k, j] > 0:
                    dx = points[k, j, 0] - x[j, 0]
                    dy = points[k, j, 1] - x[j, 1]
                    dz = points[k, j, 2] - x[j, 2]
                    w = lorentzian((dx * dx + dy * dy + dz * dz) / (c * c), weights[k, j] * data_weight)[1]
                    share[k, j] = w
                    g[j, 0] += w * dx
                    g[j, 1] += w * dy
                    g[j, 2] += w * dz
                    total += w
            for a in range(3):
                diagonal[j, a, a] = total
        for b in range(bones.shape[0]):
            i, j, e = bones[b, 0], bones[b, 1], leaf_of_bone[b]
            d = 1e-12
            for a in range(3):
                u[a] = x[i, a] - x[j, a]
                d += u[a] * u[a]
            d = math.sqrt(d)
            stiff = bone_weight[b] if lengths[b] > 0 else 0.0
            pull = stiff * (lengths[b] - d)
            for a in range(3):
                u[a] /= d
                g[i, a] += pull * u[a]
                g[j, a] -= pull * u[a]
            for a in range(3):
                for r in range(3):
                    q = stiff * u[a] * u[r]
                    diagonal[i, a, r] += q
                    diagonal[j, a, r] += q
                    if e >= 0:
                        off[e, a, r] = -q
                    else:
                        h[3 * core[i] + a, 3 * core[j] + r] -= q
                        h[3 * core[j] + a, 3 * core[i] + r] -= q
        for e in range(leaves.shape[0]):  # Schur complement of each leaf in turn
            j, p = leaves[e, 0], leaves[e, 1]
            for a in range(3):
                for r in range(3):
                    solved[e, a, r] = off[e, a, r]
                solved[e, a, 3] = g[j, a]
            factorise(diagonal[j], 3, LEAST)
            forward_all(diagonal[j], 3, solved[e])
            backward_all(diagonal[j], 3, solved[e])
            for a in range(3):
                for r in range(3):
                    s = 0.0
                    for q in range(3):
                        s += off[e, q, a] * solved[e, q, r]
                    diagonal[p, a, r] -= s
                s = 0.0
                for q in range(3):
                    s += off[e, q, a] * solved[e, q, 3]
                g[p, a] -= s
        for j in range(joints):
            if core[j] >= 0:
                for a in range(3):
                    right[3 * core[j] + a] = g[j, a]
                    for r in range(3):
                        h[3 * core[j] + a, 3 * core[j] + r] += diagonal[j, a, r]
        if not factorise(h, n, 0.0):
            for j in range(joints):
                variance[j] = np.inf
            return False
        if it == iterations:
            break  # this matrix is the one of the result, for its variance
        forward(h, n, right)
        backward(h, n, right)
        for j in range(joints):
            if core[j] >= 0:
                for a in range(3):
                    g[j, a] = right[3 * core[j] + a]
        for e in range(leaves.shape[0] - 1, -1, -1):
            j, p = leaves[e, 0], leaves[e, 1]
            for a in range(3):
                s = solved[e, a, 3]
                for r in range(3):
                    s -= solved[e, a, r] * g[p, r]
                g[j, a] = s
        for j in range(joints):
            for a in range(3):
                x[j, a] += g[j, a]
    covariance = np.zeros((joints, 3, 3))
    block = np.eye(n)  # row i becomes column i of L^-1
    for i in range(n):
        forward(h[i:, i:], n - i, block[i, i:])
    for j in range(joints):
        if core[j] >= 0:
            for a in range(3):
                for r in range(3):
                    covariance[j, a, r] = dot(block[3 * core[j] + a], block[3 * core[j] + r], n)
    half = np.empty((3, 3))
    for e in range(leaves.shape[0] - 1, -1, -1):
        # cov_jj = A^-1 + (A^-1 B) cov_pp (A^-1 B)^T
        j, p = leaves[e, 0], leaves[e, 1]
        for a in range(3):
            for r in range(3):
                covariance[j, a, r] = 1.0 if a == r else 0.0
                s = 0.0
                for q in range(3):
                    s += solved[e, a, q] * covariance[p, q, r]
                half[a, r] = s
        forward_all(diagonal[j], 3, covariance[j])
        backward_all(diagonal[j], 3, covariance[j])
        for a in range(3):
            for r in range(3):
                for q in range(3):
                    covariance[j, a, r] += half[a, q] * solved[e, r, q]
    for j in range(joints):
        variance[j] = (covariance[j, 0, 0] + covariance[j, 1, 1] + covariance[j, 2, 2]) / 3
        total = 0.0
        for k in range(sensors):
            total += share[k, j]
        for k in range(sensors):
            share[k, j] /= max(total, LEAST)
    return True


@kernel
def exchange_sides(positions, states, side, mirror, pairs, swapped):
    """Exchanges left and right, in place, of sensors whose sides contradict the others and the memory.

    positions (K, J, 3) registered, NaN missing; states (K, J); side (3,): remembered direction to the person's left,
    updated; mirror (J,); pairs (P, 2): left and right joint; swapped (K,) bool, written. A sensor is exchanged when its
    direction lies more than 107 degrees from the consensus of all and the memory."""
    sensors, joints = states.shape
    u = np.zeros((sensors, 3))
    consensus = 2 * side
    for k in range(sensors):
        swapped[k] = False
        for p in range(pairs.shape[0]):
            i, j = pairs[p, 0], pairs[p, 1]
            if states[k, i] > 0 and states[k, j] > 0:
                for a in range(3):
                    u[k, a] += positions[k, i, a] - positions[k, j, a]
        norm = math.sqrt(u[k, 0] ** 2 + u[k, 1] ** 2 + u[k, 2] ** 2)
        for a in range(3):
            u[k, a] /= max(norm, 1e-3)
            consensus[a] += u[k, a]
    limit = -0.3 * math.sqrt(consensus[0] ** 2 + consensus[1] ** 2 + consensus[2] ** 2)
    total = np.zeros(3)
    for k in range(sensors):
        along = u[k, 0] * consensus[0] + u[k, 1] * consensus[1] + u[k, 2] * consensus[2]
        sign = 1.0
        if along < limit and limit < 0:
            swapped[k] = True
            sign = -1.0
            for j in range(joints):
                m = mirror[j]
                if m > j:
                    states[k, j], states[k, m] = states[k, m], states[k, j]
                    for a in range(3):
                        positions[k, j, a], positions[k, m, a] = positions[k, m, a], positions[k, j, a]
        for a in range(3):
            total[a] += sign * u[k, a]
    fresh = side[0] == 0 and side[1] == 0 and side[2] == 0
    for a in range(3):
        side[a] = total[a] if fresh else 0.8 * side[a] + 0.2 * total[a]


@kernel
def weigh_joints(positions, states, inferred, weights, points, evidence):
    """Weights (K, J) of joints by state (2 tracked: 1, 1 inferred: `inferred`, else 0), their positions with 0 for
    missing, and evidence (J,): somebody sees the joint. Returns whether there is any."""
    found = False
    for j in range(states.shape[1]):
        evidence[j] = False
    for k in range(states.shape[0]):
        for j in range(states.shape[1]):
            ok = states[k, j] > 0 and math.isfinite(positions[k, j, 0])
            weights[k, j] = 0.0
            for a in range(3):
                points[k, j, a] = positions[k, j, a] if ok else 0.0
            if ok:
                weights[k, j] = 1.0 if states[k, j] == 2 else inferred
                evidence[j] = evidence[j] or weights[k, j] > 0
                found = found or weights[k, j] > 0
    return found


@kernel
def judge_claims(off, apart, alike, weights, order, variance, own, elsewhere, jitter, limit, systematic, wrong):
    """What is left open of joints that were fused of those of sensors, seen with probability weights (K, J).

    Either the first sensor in order (K, J) is right, and those that follow are right or guess; or it guesses and the
    next one is right, ...; or all guess. How far they are apart (K, K, J) m^2 tells which. What a sensor sees is off by
    sd own (J,) m per axis, of which two sensors share alike (K, K), and by `jitter`; a guess by `elsewhere`. off
    (K, J, 3) m: from the fused joints to the sensors'; variance (J,) m^2 per axis: what the fused ones have of their
    own. Written are systematic (J,) m^2 per axis, the variance about them of all these cases, and wrong (J,), how
    likely they are off by more than limit m."""
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
    """Density of a normal distribution in three dimensions at a squared distance, but for a factor."""
    return math.exp(-squared / (2 * variance)) / variance**1.5


@kernel
def _beyond(off, sd, limit):
    """How likely a point of sd per axis about a centre at distance off lies further than limit away."""
    off = max(off, 1e-6)
    near, far = (limit - off) / sd, (limit + off) / sd
    inside = (math.erf(near / math.sqrt(2)) + math.erf(far / math.sqrt(2))) / 2
    return 1 - inside + sd / off * (math.exp(-near * near / 2) - math.exp(-far * far / 2)) / math.sqrt(2 * math.pi)

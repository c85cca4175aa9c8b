"""numba: the hot loops of skeleton fusion. Energies of a swarm, its roulette wheel, the fit of one frame, and rays
against capsules for simulated sensors.

Arrays in, arrays out; definitions are in the docstrings and, as plain numpy, in the tests. Missing joints are told by
a weight of 0, never by NaN alone, so that no compiler option can lose them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hypose.compute.cpu_kinematics import OPTIONS

FAR = 1e9
"""Distance along a ray that meets nothing."""
NEGLIGIBLE = 7.0
"""Scales h beyond which exp(-d / h) < 0.001 is taken as 0."""


@njit(**OPTIONS)
def swarm_energy(values, label, positions, weights, h, out):
    """E_jn = sum_k w_kj exp(-|s_kj - p_jn| / h): values (J, M, 3), label (J, M), positions (K, J, 3), weights (K, J)
    (0 = missing) -> out (J, M). Asteriadis 2013, eq. 7, with the length scale h."""
    sensors = positions.shape[0]
    reach = (NEGLIGIBLE * h) ** 2
    for j in range(values.shape[0]):
        for n in range(values.shape[1]):
            e = 0.0
            if label[j, n] >= 0:
                for k in range(sensors):
                    if weights[k, j] > 0:
                        dx = values[j, n, 0] - positions[k, j, 0]
                        dy = values[j, n, 1] - positions[k, j, 1]
                        dz = values[j, n, 2] - positions[k, j, 2]
                        d2 = dx * dx + dy * dy + dz * dz
                        if d2 < reach:
                            e += weights[k, j] * math.exp(-math.sqrt(d2) / h)
            out[j, n] = e


@njit(**OPTIONS)
def wheel_counts(shares, spacings, counts):
    """N spins of a roulette wheel per row: shares (J, M) >= 0, spacings (J, N + 1) exponential variates -> counts
    (J, M) int64, how often each was drawn.

    Sums of exponential variates over their total are N sorted uniform variates, so that one pass along the wheel does
    what N independent spins do. Rows without any share keep count 0."""
    for j in range(shares.shape[0]):
        total, around = 0.0, 0.0
        for n in range(shares.shape[1]):
            total += shares[j, n]
            counts[j, n] = 0
        if total <= 0:
            continue
        last = spacings.shape[1] - 1
        for s in range(last + 1):
            around += spacings[j, s]
        at, spin, edge = spacings[j, 0] / around * total, 0, 0.0
        final = 0
        for n in range(shares.shape[1]):
            if shares[j, n] <= 0:
                continue
            final = n
            edge += shares[j, n]
            while spin < last and at <= edge:
                counts[j, n] += 1
                spin += 1
                at += spacings[j, spin] / around * total
        counts[j, final] += last - spin  # rounding of the sums


@njit(**OPTIONS)
def universal_counts(shares, start, total_count, counts):
    """Baker's stochastic universal sampling: shares (J, M), start (J,) in [0, 1), N -> counts (J, M) int64."""
    for j in range(shares.shape[0]):
        total = 0.0
        for n in range(shares.shape[1]):
            total += shares[j, n]
            counts[j, n] = 0
        if total <= 0:
            continue
        edge, spin, final = 0.0, 0, 0
        for n in range(shares.shape[1]):
            if shares[j, n] <= 0:
                continue
            final = n
            edge += shares[j, n] / total * total_count
            while spin < total_count and spin + start[j] < edge:
                counts[j, n] += 1
                spin += 1
        counts[j, final] += total_count - spin


@njit(**OPTIONS)
def _cholesky(a, n):
    """Lower factor of a (n, n) in place (its upper part is not touched); False when not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                if s <= 0:
                    return False
                a[i, i] = math.sqrt(s)
            else:
                a[i, j] = s / a[j, j]
    return True


@njit(**OPTIONS)
def fit_frame(
    points, weights, predicted, prior_weight, bones, lengths, bone_weight, data_weight, scale, coarse, iterations, x,
    share, variance,
):  # fmt: skip
    """The 3D joints of one frame: robust data, constant distances, and a prediction; graduated Gauss-Newton.

    Minimises 1/2 sum_kj w_kj d c^2 log(1 + |s_kj - x_j|^2 / c^2) + 1/2 sum_b b_b (|x_i - x_j| - l_b)^2 +
    1/2 sum_j p_j |x_j - predicted_j|^2. points (K, J, 3) m, weights (K, J) 0 = missing; predicted (J, 3); prior_weight
    (J,) 1/m^2; bones (B, 2), lengths (B,) m, bone_weight (B,) 1/m^2; data_weight d 1/m^2; scale c m, multiplied by
    coarse, coarse / 2, ... down to 1. x (J, 3): start and result. share (K, J): the sensors' part in each joint;
    variance (J,) m^2 per axis, of the quadratic at the result. Returns False when the matrix is not positive definite
    (x is then the last good iterate)."""
    sensors, joints = weights.shape
    n = 3 * joints
    h = np.empty((n, n))
    g = np.empty(n)
    ok = True
    for it in range(iterations + 1):
        h[:] = 0.0
        g[:] = 0.0
        c = scale * max(1.0, coarse / 2.0**it)
        for j in range(joints):
            for a in range(3):
                h[3 * j + a, 3 * j + a] = prior_weight[j]
                g[3 * j + a] = prior_weight[j] * (predicted[j, a] - x[j, a])
            for k in range(sensors):
                share[k, j] = 0.0
                if weights[k, j] > 0:
                    dx = points[k, j, 0] - x[j, 0]
                    dy = points[k, j, 1] - x[j, 1]
                    dz = points[k, j, 2] - x[j, 2]
                    w = weights[k, j] * data_weight / (1 + (dx * dx + dy * dy + dz * dz) / (c * c))
                    share[k, j] = w
                    g[3 * j] += w * dx
                    g[3 * j + 1] += w * dy
                    g[3 * j + 2] += w * dz
                    for a in range(3):
                        h[3 * j + a, 3 * j + a] += w
        u = np.empty(3)
        for b in range(bones.shape[0]):
            if lengths[b] <= 0:
                continue
            i, j = bones[b, 0], bones[b, 1]
            d = 1e-12
            for a in range(3):
                u[a] = x[i, a] - x[j, a]
                d += u[a] * u[a]
            d = math.sqrt(d)
            pull = bone_weight[b] * (lengths[b] - d)
            for a in range(3):
                u[a] /= d
                g[3 * i + a] += pull * u[a]
                g[3 * j + a] -= pull * u[a]
            for a in range(3):
                for e in range(3):
                    q = bone_weight[b] * u[a] * u[e]
                    h[3 * i + a, 3 * i + e] += q
                    h[3 * j + a, 3 * j + e] += q
                    h[3 * i + a, 3 * j + e] -= q
                    h[3 * j + a, 3 * i + e] -= q
        if not _cholesky(h, n):
            ok = False
            break
        if it == iterations:
            break  # this matrix is the one of the result, for its variance
        for i in range(n):
            s = g[i]
            for k in range(i):
                s -= h[i, k] * g[k]
            g[i] = s / h[i, i]
        for i in range(n - 1, -1, -1):
            s = g[i]
            for k in range(i + 1, n):
                s -= h[k, i] * g[k]
            g[i] = s / h[i, i]
        for j in range(joints):
            for a in range(3):
                x[j, a] += g[3 * j + a]
    for j in range(joints):
        s = 0.0
        for k in range(sensors):
            s += share[k, j]
        if s > 0:
            for k in range(sensors):
                share[k, j] /= s
    if not ok:
        for j in range(joints):
            variance[j] = np.inf
        return False
    # rows of L^-1: the variance of unknown i is the squared length of column i of L^-1
    for j in range(joints):
        variance[j] = 0.0
    column = np.empty(n)
    for i in range(n):
        total = 0.0
        for r in range(i, n):
            s = 1.0 if r == i else 0.0
            for k in range(i, r):
                s -= h[r, k] * column[k]
            column[r] = s / h[r, r]
            total += column[r] * column[r]
        variance[i // 3] += total / 3
    return True


@njit(**OPTIONS)
def _capsule(origin, dx, dy, dz, capsule, c):
    """Distance along a unit ray to capsule c (a, b, radius), FAR when it misses. After I. Quilez's closed form."""
    ax, ay, az = capsule[c, 0], capsule[c, 1], capsule[c, 2]
    bx, by, bz = capsule[c, 3] - ax, capsule[c, 4] - ay, capsule[c, 5] - az
    ox, oy, oz = origin[0] - ax, origin[1] - ay, origin[2] - az
    r2 = capsule[c, 6] * capsule[c, 6]
    length = bx * bx + by * by + bz * bz
    if length > 1e-12:
        bd = bx * dx + by * dy + bz * dz
        bo = bx * ox + by * oy + bz * oz
        rd = dx * ox + dy * oy + dz * oz
        oo = ox * ox + oy * oy + oz * oz
        a = length - bd * bd
        q = length * rd - bo * bd
        s = q * q - a * (length * oo - bo * bo - r2 * length)
        if a > 1e-12:
            if s < 0:
                return FAR
            t = (-q - math.sqrt(s)) / a
            y = bo + t * bd
            if 0 < y < length and t > 0:
                return t
            if y > 0:
                ox, oy, oz = ox - bx, oy - by, oz - bz
    rd = dx * ox + dy * oy + dz * oz
    s = rd * rd - (ox * ox + oy * oy + oz * oz - r2)
    if s > 0:
        t = -rd - math.sqrt(s)
        if t > 0:
            return t
    return FAR


@njit(**OPTIONS)
def cast_rays(origin, directions, capsules, out):
    """Unit directions (N, 3) from origin (3,) against capsules (C, 7) = a, b, radius in m -> out (N,) distance along
    the ray to the first surface, FAR when there is none."""
    for n in range(directions.shape[0]):
        nearest = FAR
        for c in range(capsules.shape[0]):
            t = _capsule(origin, directions[n, 0], directions[n, 1], directions[n, 2], capsules, c)
            if t < nearest:
                nearest = t
        out[n] = nearest


@njit(**OPTIONS)
def seen_share(origin, joints, offsets, capsules, own, margin, out):
    """Share of the points joint + offset (offsets (Q, 3) m) that a sensor at origin sees: joints (J, 3), capsules
    (C, 7), own (J, C): capsules that hold the joint and never hide it -> out (J,)."""
    for j in range(joints.shape[0]):
        seen = 0
        for q in range(offsets.shape[0]):
            dx = joints[j, 0] + offsets[q, 0] - origin[0]
            dy = joints[j, 1] + offsets[q, 1] - origin[1]
            dz = joints[j, 2] + offsets[q, 2] - origin[2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            hidden = False
            for c in range(capsules.shape[0]):
                if not own[j, c] and _capsule(origin, dx / d, dy / d, dz / d, capsules, c) < d - margin:
                    hidden = True
                    break
            if not hidden:
                seen += 1
        out[j] = seen / offsets.shape[0]

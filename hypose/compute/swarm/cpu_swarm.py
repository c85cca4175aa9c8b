"""numba: a swarm of candidates per joint: placing, riding, energies, roulette wheels, and what a population says.

The definitions are in the docstrings and, as plain numpy, in the tests.
"""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel

NEGLIGIBLE = 7.0
"""Scales h beyond which exp(-d / h) < 0.001 is taken as 0."""


@kernel
def _decay(x):
    """exp(-x) for 0 <= x < 40, to 1e-8 of its value: a table of powers of two and a polynomial."""
    y = x * 1.4426950408889634
    k = int(y)
    f = (k - y) * 0.6931471805599453
    p = 1 + f * (1 + f * (0.5 + f * (1 / 6 + f * (1 / 24 + f * (1 / 120 + f * (1 / 720 + f / 5040))))))
    return p / (1 << k)


@kernel
def place_candidates(bits, base, usable, renew, radius, values, log_weights, label):
    """Candidates uniform in balls of `radius` m around base (K, J, 3), spread evenly over the usable (K, J) sensors,
    for the joints with renew (J,): values (J, N, 3), log_weights (J, N), label (J, N) are written. bits (J, R) uint64:
    each holds the three coordinates (21 bits each) of a point of a cube; those outside the ball are passed over, so
    that R = 2.2 N is more than enough."""
    count = values.shape[1]
    each = -math.log(count)
    cell = 1.0 / (1 << 20)
    sensor_of = np.empty(count, dtype=np.int32)
    for j in range(values.shape[0]):
        if not renew[j]:
            continue
        sensors = 0
        for k in range(usable.shape[0]):
            sensors += usable[k, j]
        k = -1
        for n in range(count):
            log_weights[j, n] = each if sensors > 0 else -np.inf
            label[j, n] = -1
            if sensors > 0:
                k = k + 1 if k + 1 < usable.shape[0] else 0
                while not usable[k, j]:
                    k = k + 1 if k + 1 < usable.shape[0] else 0
                label[j, n] = k
            sensor_of[n] = max(label[j, n], 0)
            for a in range(3):
                values[j, n, a] = 0.0
        if sensors == 0:
            continue
        n = 0
        for at in range(bits.shape[1]):
            # written first and kept if inside: no branch to guess
            b = bits[j, at]
            x = np.int64(b & np.uint64(0x1FFFFF)) * cell - 1.0
            y = np.int64((b >> np.uint64(21)) & np.uint64(0x1FFFFF)) * cell - 1.0
            z = np.int64((b >> np.uint64(42)) & np.uint64(0x1FFFFF)) * cell - 1.0
            k = sensor_of[n]
            values[j, n, 0] = base[k, j, 0] + radius * x
            values[j, n, 1] = base[k, j, 1] + radius * y
            values[j, n, 2] = base[k, j, 2] + radius * z
            n += x * x + y * y + z * z <= 1.0
            if n == count:
                break


@kernel
def ride(values, label, moved, out):
    """Candidates (J, M, 3) moved by their sensor's movement (K, J, 3) of the joint, into the first M columns of out."""
    for j in range(values.shape[0]):
        for n in range(values.shape[1]):
            k = max(label[j, n], 0)
            for a in range(3):
                out[j, n, a] = values[j, n, a] + moved[k, j, a]


@kernel
def swarm_energy(values, label, log_weights, positions, weights, h, out):
    """log of E_jn = sum_k w_kj exp(-|s_kj - p_jn| / h): values (J, M, 3), label (J, M) (-1 = padding), positions
    (K, J, 3), weights (K, J) (0 = missing) -> out (J, M), -inf where E = 0. Joints of which no candidate with a weight
    (log_weights (J, M) > -inf) has any energy get 0 everywhere. Asteriadis 2013, eq. 7, with the length scale h."""
    sensors = positions.shape[0]
    reach = (NEGLIGIBLE * h) ** 2
    for j in range(values.shape[0]):
        explained = False
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
                            e += weights[k, j] * _decay(math.sqrt(d2) / h)
            out[j, n] = e
            if e > 0 and log_weights[j, n] > -np.inf:
                explained = True
        for n in range(values.shape[1]):
            if not explained:
                out[j, n] = 0.0
            elif out[j, n] > 0:
                out[j, n] = math.log(out[j, n])
            else:
                out[j, n] = -np.inf


@kernel
def shares_and_mean(log_weights, values, shares, mean):
    """Normalised weights (J, M) of log_weights (J, M) (all 0 where every one is -inf) and the weighted mean (J, 3)."""
    for j in range(log_weights.shape[0]):
        peak, total = -np.inf, 0.0
        for n in range(log_weights.shape[1]):
            peak = max(peak, log_weights[j, n])
        for a in range(3):
            mean[j, a] = 0.0
        for n in range(log_weights.shape[1]):
            shares[j, n] = 0.0
            d = peak - log_weights[j, n]
            if d < 30.0:
                w = _decay(d)
                shares[j, n] = w
                total += w
                for a in range(3):
                    mean[j, a] += w * values[j, n, a]
        if total > 0:
            for n in range(log_weights.shape[1]):
                shares[j, n] /= total
            for a in range(3):
                mean[j, a] /= total


@kernel
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
        turn = total / around
        at, spin, edge, final = spacings[j, 0] * turn, 0, 0.0, 0
        for n in range(shares.shape[1]):
            if shares[j, n] <= 0:
                continue
            final = n
            edge += shares[j, n]
            drawn = 0
            while spin < last and at <= edge:
                drawn += 1
                spin += 1
                at += spacings[j, spin] * turn
            counts[j, n] = drawn
        counts[j, final] += last - spin  # rounding of the sums


@kernel
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


@kernel
def keep_drawn(counts, values, label, count, new_values, new_log, new_label):
    """The candidates with counts (J, M) > 0, moved together: values (J, M, 3), label (J, M) -> new_values (J, W, 3),
    new_log (J, W) = log(copies / count), new_label (J, W); what is left over has weight 0 (log -inf) and label -1."""
    for j in range(counts.shape[0]):
        w = 0
        for n in range(counts.shape[1]):
            if counts[j, n] > 0:
                for a in range(3):
                    new_values[j, w, a] = values[j, n, a]
                new_log[j, w] = math.log(counts[j, n] / count)
                new_label[j, w] = label[j, n]
                w += 1
        for n in range(w, new_log.shape[1]):
            for a in range(3):
                new_values[j, n, a] = 0.0
            new_log[j, n] = -np.inf
            new_label[j, n] = -1


@kernel
def swarm_summary(values, log_weights, label, spread, shares, distinct):
    """Of a merged population (J, W) with log_weights that sum to 1 as weights: root mean square distance from its mean
    (J,), the shares by label (J, K) and the number of distinct candidates (J,)."""
    for j in range(values.shape[0]):
        total, square, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(shares.shape[1]):
            shares[j, k] = 0.0
        distinct[j] = 0
        # distances from one candidate, so that nothing is lost to cancellation far from the origin
        for n in range(values.shape[1]):
            if label[j, n] >= 0 and log_weights[j, n] > -np.inf:
                w = math.exp(log_weights[j, n])
                dx = values[j, n, 0] - values[j, 0, 0]
                dy = values[j, n, 1] - values[j, 0, 1]
                dz = values[j, n, 2] - values[j, 0, 2]
                total += w
                x += w * dx
                y += w * dy
                z += w * dz
                square += w * (dx * dx + dy * dy + dz * dz)
                shares[j, label[j, n]] += w
                distinct[j] += 1
        spread[j] = 0.0
        if total > 0:
            v = square / total - (x * x + y * y + z * z) / (total * total)
            spread[j] = math.sqrt(max(v, 0.0))
            for k in range(shares.shape[1]):
                shares[j, k] /= total

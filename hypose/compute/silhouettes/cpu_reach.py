"""numba: limbs as a few points against the masks and the standing rest of the body. Definition in reach.py."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel

_BLOCK = 128
"""poses that are looked at together, in vector lanes"""


@kernel
def pixels(m, x, y, z, n, width, height, line, place):
    """place (n,) i4: line x row + column of the pixels in which points x, y, z (n,) lie under a projection m (3, 4); -1
    outside the image, and nearer than 0.05 m."""
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    w, h = np.float64(width), np.float64(height)
    for i in range(n):
        depth = m20 * x[i] + m21 * y[i] + m22 * z[i] + m23
        u = (m00 * x[i] + m01 * y[i] + m02 * z[i] + m03) / depth + 0.5
        v = (m10 * x[i] + m11 * y[i] + m12 * z[i] + m13) / depth + 0.5
        u = u if depth >= 0.05 else -1.0  # one choice after the other is what the compiler makes vectors of
        u = u if u < w else -1.0
        u = u if v >= 0 else -1.0
        u = u if v < h else -1.0
        v = v if u >= 0 else 0.0
        u = u if u >= 0 else -1.0
        place[i] = np.int32(v) * np.int32(line) + np.int32(u)


@kernel
def score_points(points, weights, rotation, centre, prepared, bits, cutoff, out):
    """out (N,): scores of points (N, P, 3) of weights (P,), seen from a joint with rotation (3, 3) and centre (3,); see
    reach.py. The last points are looked at first: ends of limbs tell most."""
    views = prepared.projections.shape[0]
    m = np.empty((views, 3, 4))
    seen = 0
    for c in range(views):
        seen += prepared.usable[c]
        for i in range(3):
            for j in range(3):
                a = 0.0
                for k in range(3):
                    a += prepared.projections[c, i, k] * rotation[k, j]
                m[c, i, j] = a
            a = prepared.projections[c, i, 3]
            for k in range(3):
                a += prepared.projections[c, i, k] * centre[k]
            m[c, i, 3] = a
    worth = 0.0
    for p in range(weights.shape[0]):
        worth += weights[p] * seen
    x, y, z = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    place, total, alive = np.empty(_BLOCK, np.int32), np.empty(_BLOCK), np.empty(_BLOCK, np.int64)
    worth_of, hidden, line = np.zeros(3), prepared.hidden.size > 0, 8 * bits.shape[2]
    for first in range(0, points.shape[0], _BLOCK):
        n_alive = min(_BLOCK, points.shape[0] - first)
        for n in range(n_alive):
            alive[n], total[n] = n, 0.0
        n_block, left = n_alive, worth
        for p in range(points.shape[1] - 1, -1, -1):
            n = 0
            for i in range(n_alive):
                alive[n] = alive[i]
                n += not total[alive[i]] - left > cutoff  # else what is left cannot make up for it
            n_alive = n
            left -= weights[p] * seen
            worth_of[0], worth_of[1] = weights[p], -weights[p]  # no mask; a mask alone; what stands, or nothing
            for i in range(n_alive):
                point = points[first + alive[i], p]
                x[i], y[i], z[i] = point[0], point[1], point[2]
            for c in range(views):
                if prepared.usable[c]:
                    pixels(m[c], x, y, z, n_alive, prepared.sizes[c, 0], prepared.sizes[c, 1], line, place)
                    mask, drawn = prepared.bits[c, 0], bits[c, 0]  # and on, as if the view were one row
                    for i in range(n_alive):  # without branches, which nobody could foretell
                        at = place[i]
                        byte, bit = np.uint32(max(at, np.int32(0))) >> np.uint32(3), np.uint8(at & 7)
                        told = mask[byte]
                        if hidden:
                            told |= prepared.hidden[c, 0, byte]
                        kind = ((told >> bit) & 1) + (((told & drawn[byte]) >> bit) & 1)
                        total[alive[i]] += worth_of[np.uint8(kind) if at >= 0 else np.uint8(2)]
        for n in range(n_block):
            out[first + n] = total[n]

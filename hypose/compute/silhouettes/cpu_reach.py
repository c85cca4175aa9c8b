"""numba: limbs as a few points against the masks and the standing rest of the body. Definition in reach.py."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel


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
    for n in range(points.shape[0]):
        total, left = 0.0, worth
        for p in range(points.shape[1] - 1, -1, -1):
            if total - left > cutoff:  # what is left cannot make up for it
                break
            left -= weights[p] * seen
            x, y, z = points[n, p, 0], points[n, p, 1], points[n, p, 2]
            for c in range(views):
                if not prepared.usable[c]:
                    continue
                depth = m[c, 2, 0] * x + m[c, 2, 1] * y + m[c, 2, 2] * z + m[c, 2, 3]
                if depth < 0.05:
                    continue
                u = math.floor((m[c, 0, 0] * x + m[c, 0, 1] * y + m[c, 0, 2] * z + m[c, 0, 3]) / depth + 0.5)
                v = math.floor((m[c, 1, 0] * x + m[c, 1, 1] * y + m[c, 1, 2] * z + m[c, 1, 3]) / depth + 0.5)
                if not (0 <= u < prepared.sizes[c, 0] and 0 <= v < prepared.sizes[c, 1]):
                    continue
                column, row = int(u), int(v)
                if prepared.open_masks[c, row, column] == 0:
                    total += weights[p]
                elif not (bits[c, row, column >> 3] >> np.uint8(column & 7)) & np.uint8(1):
                    total -= weights[p]
        out[n] = total

"""numba: Cholesky in band storage. The definition is in compute.banded.

a (n, b + 1): row i holds the matrix's row i from column i - b to the diagonal, which is last. Both rows of an inner
product are contiguous, so it runs in vector lanes; plain loops, since LAPACK's threads get into each other's way on a
busy machine and may change the last bits."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.solver.cpu_cholesky import dot


@kernel
def fill(own, bands, a):
    """Writes the matrix of coupled frames, own (T, D, D) and bands (3, T, D), as rows a (T D, 2 D + 1)."""
    n_frames, d = own.shape[0], own.shape[1]
    b = 2 * d
    a[:] = 0.0
    for t in range(n_frames):
        for r in range(d):
            i = t * d + r
            for c in range(r + 1):
                a[i, b - r + c] = own[t, r, c]
            a[i, b] += bands[0, t, r]
            if t >= 1:
                a[i, b - d] = bands[1, t - 1, r]
            if t >= 2:
                a[i, 0] = bands[2, t - 2, r]


@kernel
def factorise(a):
    """a becomes its lower Cholesky factor; False when it is not positive definite."""
    n, b = a.shape[0], a.shape[1] - 1
    for i in range(n):
        first = max(0, i - b)
        for j in range(first, i):
            s = a[i, b - (i - j)]
            start = max(first, j - b)
            mine, other = a[i, b - (i - start) : b - (i - j)], a[j, b - (j - start) : b]
            a[i, b - (i - j)] = (s - dot(mine, other, mine.shape[0])) / a[j, b]
        mine = a[i, b - (i - first) : b]
        s = a[i, b] - dot(mine, mine, mine.shape[0])
        if not s > 0:
            return False
        a[i, b] = math.sqrt(s)
    return True


@kernel
def solve_factored(a, x):
    """x (n,) becomes the solution for the right side x, a being the factor."""
    n, b = a.shape[0], a.shape[1] - 1
    for i in range(n):
        m = min(i, b)
        x[i] = (x[i] - dot(a[i, b - m : b], x[i - m : i], m)) / a[i, b]
    for i in range(n - 1, -1, -1):
        x[i] /= a[i, b]
        for j in range(max(0, i - b), i):
            x[j] -= a[i, b - (i - j)] * x[i]


@kernel
def inverse_in_band(a, z):
    """z (n, b + 1): the inverse's entries inside the band, stored as a is, from the factor a.

    Source: Takahashi, Fagan & Chen 1973: from the last row upwards each entry follows from those below it."""
    n, b = a.shape[0], a.shape[1] - 1
    column, near = np.empty(b), np.empty(b)
    for i in range(n - 1, -1, -1):
        m = min(b, n - 1 - i)
        for k in range(m):  # column i of the factor below the diagonal
            column[k] = a[i + 1 + k, b - 1 - k] / a[i, b]
        for j in range(m - 1, -1, -1):
            row = i + 1 + j
            for k in range(m):  # entries (row, i + 1 + k) of the inverse, which is symmetric
                low, high = min(row, i + 1 + k), max(row, i + 1 + k)
                near[k] = z[high, b - (high - low)]
            z[row, b - (row - i)] = -dot(near, column, m)
        s = 1.0 / (a[i, b] * a[i, b])
        for k in range(m):
            s -= column[k] * z[i + 1 + k, b - 1 - k]
        z[i, b] = s

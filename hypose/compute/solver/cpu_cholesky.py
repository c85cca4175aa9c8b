"""numba: the one Cholesky factorisation of dense matrices, in plain loops: sums of a fixed order are the same on every
processor and for any number of threads, which those of LAPACK are not."""

from __future__ import annotations

import math

from hypose.compute.compiled import kernel


@kernel(inline=True)
def dot(a, b, n):
    """Sum of a[k] b[k] over k < n, in eight partial sums of a fixed order: as fast as letting the compiler choose the
    order, and the same on every processor."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    whole = n - n % 8
    for k in range(0, whole, 8):
        s0 += a[k] * b[k]
        s1 += a[k + 1] * b[k + 1]
        s2 += a[k + 2] * b[k + 2]
        s3 += a[k + 3] * b[k + 3]
        s4 += a[k + 4] * b[k + 4]
        s5 += a[k + 5] * b[k + 5]
        s6 += a[k + 6] * b[k + 6]
        s7 += a[k + 7] * b[k + 7]
    s = ((s0 + s4) + (s1 + s5)) + ((s2 + s6) + (s3 + s7))
    for k in range(whole, n):
        s += a[k] * b[k]
    return s


@kernel
def factorise(a, n, least):
    """The lower triangle of a (n, n) becomes its Cholesky factor L; nothing else of a is looked at. Pivots below
    `least` are taken for it; with least 0 they end it, and it is False."""
    for i in range(n):
        for j in range(i):
            a[i, j] = (a[i, j] - dot(a[i], a[j], j)) / a[j, j]
        s = a[i, i] - dot(a[i], a[i], i)
        if not s > least:
            if not least > 0:
                return False
            s = least
        a[i, i] = math.sqrt(s)
    return True


@kernel
def forward(a, n, x):
    """x (n,) <- L^-1 x, L being the lower triangle of a."""
    for i in range(n):
        x[i] = (x[i] - dot(a[i], x, i)) / a[i, i]


@kernel
def backward(a, n, x):
    """x (n,) <- L^-T x."""
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= a[k, i] * x[k]
        x[i] = s / a[i, i]


@kernel
def forward_all(a, n, x):
    """x (n, M) <- L^-1 x, column by column in vector lanes."""
    for i in range(n):
        for j in range(i):
            for c in range(x.shape[1]):
                x[i, c] -= a[i, j] * x[j, c]
        for c in range(x.shape[1]):
            x[i, c] /= a[i, i]


@kernel
def backward_all(a, n, x):
    """x (n, M) <- L^-T x."""
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            for c in range(x.shape[1]):
                x[i, c] -= a[j, i] * x[j, c]
        for c in range(x.shape[1]):
            x[i, c] /= a[i, i]

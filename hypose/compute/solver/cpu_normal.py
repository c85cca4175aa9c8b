"""numba: rows -> normal equations, and groups of unknowns eliminated from them (Schur complement).

Source: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1. Plain loops over contiguous rows
run in vector lanes and add up in a fixed order, which threaded libraries do not."""

from __future__ import annotations

from hypose.compute.compiled import kernel
from hypose.compute.solver.cpu_cholesky import backward, factorise, forward, forward_all

LEAST = 1e-12
"""pivot of an unknown that nothing is known of"""


@kernel
def weighted_squares(jacobian, weight, residual, hessian, gradient):
    """hessian (D, D) += J^T w J, gradient (D,) += J^T w r of rows jacobian (R, D), weight (R,), residual (R,)."""
    rows, n = jacobian.shape
    whole = rows - rows % 4
    for r in range(0, whole, 4):  # four at once: the matrix is read and written a quarter as often
        a, b, c, d = jacobian[r], jacobian[r + 1], jacobian[r + 2], jacobian[r + 3]
        u, v, x, y = weight[r], weight[r + 1], weight[r + 2], weight[r + 3]
        for i in range(n):
            p, q, s, t = u * a[i], v * b[i], x * c[i], y * d[i]
            line = hessian[i]
            for k in range(i + 1):
                line[k] += (p * a[k] + q * b[k]) + (s * c[k] + t * d[k])
            gradient[i] += (p * residual[r] + q * residual[r + 1]) + (s * residual[r + 2] + t * residual[r + 3])
    for r in range(whole, rows):
        a = jacobian[r]
        for i in range(n):
            p = weight[r] * a[i]
            line = hessian[i]
            for k in range(i + 1):
                line[k] += p * a[k]
            gradient[i] += p * residual[r]
    for i in range(n):
        for k in range(i):
            hessian[k, i] = hessian[i, k]


@kernel
def eliminate(own, own_gradient, cross, hessian, gradient):
    """hessian (S, S), gradient (S,) of the shared unknowns -= what N groups of n take of them.

    own (N, n, n) becomes the groups' Cholesky factors L, cross (N, n, S) becomes W = L^-1 cross, own_gradient (N, n)
    becomes y = L^-1 own_gradient."""
    n, shared = cross.shape[1], cross.shape[2]
    for k in range(own.shape[0]):
        factorise(own[k], n, LEAST)
        forward_all(own[k], n, cross[k])
        forward(own[k], n, own_gradient[k])
        for i in range(n):
            line, pull = cross[k, i], own_gradient[k, i]
            for s in range(shared):
                w = line[s]
                if w != 0:
                    row = hessian[s]
                    for t in range(s + 1):
                        row[t] -= w * line[t]
                    gradient[s] -= w * pull
    for s in range(shared):
        for t in range(s):
            hessian[t, s] = hessian[s, t]


@kernel
def substitute(own, own_gradient, cross, x, step):
    """step (N, n) of the groups after `eliminate`, the shared unknowns stepping by x (S,): -L^-T (y + W x)."""
    n = own.shape[1]
    for k in range(own.shape[0]):
        for i in range(n):
            s = own_gradient[k, i]
            for t in range(x.shape[0]):
                s += cross[k, i, t] * x[t]
            step[k, i] = -s
        backward(own[k], n, step[k])


@kernel
def solve_scaled(a, x):
    """x (n,) <- a^-1 x of a (n, n), which is overwritten; scaled to a diagonal of 1 first, because unknowns have units.
    False when a is not positive definite."""
    n = a.shape[0]
    for i in range(n):
        if not a[i, i] > 0:
            return False
    for i in range(n):
        for k in range(i):
            a[i, k] /= (a[i, i] * a[k, k]) ** 0.5
        x[i] /= a[i, i] ** 0.5
    scale = x.copy()
    for i in range(n):
        scale[i] = a[i, i] ** 0.5
        a[i, i] = 1 + LEAST
    if not factorise(a, n, 0.0):
        return False
    forward(a, n, x)
    backward(a, n, x)
    for i in range(n):
        x[i] /= scale[i]
    return True

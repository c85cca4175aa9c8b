"""Rows of the solver, summed in vector lanes: the bits of a sum in the order that it promises."""

import numpy as np
import pytest

from hypose.compute.rows import sum_rows


def in_order(a, b):
    """The sum of a b in eight partial sums, in the order that the kernel promises."""
    whole = len(a) // 8 * 8
    s = np.zeros(8)
    for k in range(0, whole, 8):
        s = s + a[k : k + 8] * b[k : k + 8]
    total = ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]))
    for k in range(whole, len(a)):
        total = total + a[k] * b[k]
    return total


@pytest.mark.parametrize("n", [0, 1, 7, 8, 9, 40, 611])
def test_sums_of_rows_have_the_bits_of_the_plain_order(n):
    rng = np.random.default_rng(n)
    n_joints = 5
    rows, joints = rng.normal(size=(700, 8)) * 10, rng.integers(0, n_joints - 1, 700).astype(np.int32)
    lanes, place = np.empty((9, 700)), np.empty(n_joints + 1, np.int64)
    hessian, gradient = np.ones((n_joints, 21)), np.ones((n_joints, 6))
    sum_rows(n, rows, joints, lanes, place, hessian, gradient)
    for j in range(n_joints):
        own = rows[:n][joints[:n] == j]
        k = 0
        for x in range(6):
            weighted = own[:, 6] * own[:, x]
            assert gradient[j, x] == 1 + in_order(weighted, own[:, 7])
            for y in range(x + 1):
                assert hessian[j, k] == 1 + in_order(weighted, own[:, y])
                k += 1

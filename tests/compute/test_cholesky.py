"""Dense Cholesky in plain loops against numpy."""

import numpy as np
import pytest

from hypose.compute.solver import cpu_cholesky as kernels


@pytest.mark.parametrize("n", [1, 3, 8, 36, 41])
def test_factor_and_substitutions_are_those_of_numpy(rng, n):
    x = rng.normal(size=(n, n))
    a = x @ x.T + 0.1 * np.eye(n)
    factor = a + np.triu(np.full((n, n), 99.0), 1)  # only the lower triangle is looked at
    assert kernels.factorise(factor, n, 0.0)
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(a), rtol=1e-9, atol=1e-12)
    b, many = rng.normal(size=n), rng.normal(size=(n, 5))
    y, all_y = b.copy(), many.copy()
    kernels.forward(factor, n, y)
    kernels.forward_all(factor, n, all_y)
    np.testing.assert_allclose(np.tril(factor) @ y, b, atol=1e-10)
    kernels.backward(factor, n, y)
    kernels.backward_all(factor, n, all_y)
    np.testing.assert_allclose(a @ y, b, atol=1e-8)
    np.testing.assert_allclose(a @ all_y, many, atol=1e-8)


def test_a_matrix_that_is_not_positive_is_refused_or_made_so(rng):
    a = np.diag([1.0, -1.0, 2.0])
    assert not kernels.factorise(a.copy(), 3, 0.0)
    assert not kernels.factorise(np.full((2, 2), np.nan), 2, 0.0)
    assert kernels.factorise(a, 3, 1e-12) and np.diag(a).tolist() == [1.0, 1e-6, np.sqrt(2.0)]

"""Normal equations against dense algebra: sums of rows, bounded steps, groups eliminated and given back."""

import numpy as np
import pytest

from hypose.compute.linear import SharedEquations, weighted_squares


@pytest.mark.parametrize("rows", [0, 1, 4, 7, 203])
def test_sums_are_those_of_the_products(rng, rows):
    j, w, r = rng.normal(size=(rows, 9)), rng.random(rows), rng.normal(size=rows)
    hessian, gradient = weighted_squares(j, w, r)
    np.testing.assert_allclose(hessian, (j * w[:, None]).T @ j, atol=1e-12)
    np.testing.assert_allclose(gradient, j.T @ (w * r), atol=1e-12)


def test_groups_are_eliminated_and_given_back(rng):
    groups, n, shared = 5, 3, 4
    size = shared + groups * n
    x = rng.normal(size=(groups, n + shared, n + shared))
    blocks = x @ x.swapaxes(1, 2) + np.eye(n + shared)
    full, gradient = np.zeros((size, size)), rng.normal(size=size)
    for k, block in enumerate(blocks):
        at = np.r_[np.arange(shared), shared + k * n + np.arange(n)]
        order = np.r_[np.arange(n, n + shared), np.arange(n)]
        full[np.ix_(at, at)] += block[np.ix_(order, order)]
    equations = SharedEquations(
        full[:shared, :shared].copy(),
        gradient[:shared].copy(),
        blocks[:, :n, :n].copy(),
        gradient[shared:].reshape(groups, n).copy(),
        blocks[:, :n, n:].copy(),
    )
    kept = [a.copy() for a in vars(equations).values()]
    reduced = equations.reduced()
    step = reduced.step()
    assert step is not None
    whole = np.r_[step, reduced.own_steps(step).ravel()]
    np.testing.assert_allclose(whole, -np.linalg.solve(full, gradient), rtol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(reduced.hessian), np.linalg.inv(full)[:shared, :shared], rtol=1e-8)
    for before, after in zip(kept, vars(equations).values(), strict=True):
        np.testing.assert_array_equal(before, after)
    # damping shortens the step, and what is not free stays
    damped = equations.reduced(10.0)
    assert np.linalg.norm(damped.step()) < np.linalg.norm(step)
    held = damped.step(np.array([True, False, True, False]))
    assert held is not None and held[1] == held[3] == 0 and (held[[0, 2]] != 0).all()


def test_unknowns_of_different_units_and_a_group_of_which_nothing_is_known():
    own = np.stack([np.eye(2) * 1e8, np.zeros((2, 2))])
    equations = SharedEquations(np.diag([1e-6, 1e9]), np.array([1e-6, 1e9]), own, np.zeros((2, 2)), np.zeros((2, 2, 2)))
    reduced = equations.reduced()
    step = reduced.step()
    assert step is not None
    np.testing.assert_allclose(step, [-1, -1], rtol=1e-9)
    assert (reduced.own_steps(step) == 0).all()
    assert (
        SharedEquations(-np.eye(1), np.ones(1), own[:1], np.zeros((1, 2)), np.zeros((1, 2, 1))).reduced().step() is None
    )

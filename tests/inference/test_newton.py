"""The bounded damped Newton search against known minima and against scipy."""

import numpy as np
import pytest
import scipy.optimize

from hypose.errors import SolverError
from hypose.inference.newton import least_squares, minimise
from hypose.inference.robust import GemanMcClure, Leclerc, Lorentzian, Quadratic


def rosenbrock_residuals(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10], [-1, 0]])


def exponential(t, y):
    def residuals(x):
        e = np.exp(-x[1] * t)
        return x[0] * e + x[2] - y, np.stack([e, -x[0] * t * e, np.ones_like(t)], axis=1)

    return residuals


def random_problem(seed, d=6, m=20):
    """Mildly non-linear residuals with correlated unknowns and a box that holds some of them."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(m, d)) @ rng.normal(size=(d, d)), rng.normal(size=m)
    lower, upper = -rng.random(d), rng.random(d)

    def residuals(x):
        s = a @ x
        return s + 0.1 * np.sin(s) - b, (1 + 0.1 * np.cos(s))[:, None] * a

    return residuals, lower, upper


def scipy_solution(residuals, start, lower, upper):
    return scipy.optimize.least_squares(
        lambda x: residuals(x)[0],
        start,
        lambda x: residuals(x)[1],
        (lower, upper),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=3000,
    )


def test_quadratic_in_one_step():
    h = np.array([[4.0, 1.0], [1.0, 3.0]])
    found = minimise(lambda x: (float(0.5 * x @ h @ x - x.sum()), h @ x - 1, h), np.zeros(2), damping=0.0)
    np.testing.assert_allclose(found.x, np.linalg.solve(h, np.ones(2)), rtol=1e-12)
    assert found.converged and found.iterations <= 2 and not found.active.any()


def test_rosenbrock():
    found = minimise(least_squares(rosenbrock_residuals), np.array([-1.2, 1.0]))
    np.testing.assert_allclose(found.x, [1, 1], rtol=1e-8)
    assert found.converged and found.iterations < 40


@pytest.mark.parametrize("bounds", [([-2, -2], [0.5, 2]), ([1.5, -2], [2, 2]), ([-2, -2], [2, 0.3])])
def test_bounded_rosenbrock_equals_scipy(bounds):
    lower, upper = map(np.array, bounds)
    start = 0.5 * (lower + upper)
    theirs = scipy_solution(rosenbrock_residuals, start, lower, upper)
    ours = minimise(least_squares(rosenbrock_residuals), start, lower, upper)
    assert ours.converged and ours.active.any()
    assert (ours.x >= lower).all() and (ours.x <= upper).all()
    np.testing.assert_allclose(ours.cost, theirs.cost, rtol=1e-6)
    np.testing.assert_allclose(ours.x, theirs.x, atol=1e-4)
    assert ours.cost <= theirs.cost * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(25))
def test_random_bounded_problems_equal_scipy(seed):
    residuals, lower, upper = random_problem(seed)
    start = np.random.default_rng(seed + 100).uniform(lower, upper)
    theirs = scipy_solution(residuals, start, lower, upper)
    ours = minimise(least_squares(residuals), start, lower, upper)
    assert ours.converged and (ours.x >= lower).all() and (ours.x <= upper).all()
    assert ours.cost <= theirs.cost * (1 + 1e-7)
    np.testing.assert_allclose(ours.cost, theirs.cost, rtol=1e-5)
    free = ~ours.active  # the conditions of a bounded minimum
    assert np.abs(ours.gradient[free]).max(initial=0) < 1e-4
    assert (ours.gradient[ours.active & (ours.x == lower)] >= 0).all()
    assert (ours.gradient[ours.active & (ours.x == upper)] <= 0).all()


def test_curve_fit():
    t = np.linspace(0, 4, 40)
    y = 2.5 * np.exp(-1.3 * t) + 0.5
    found = minimise(least_squares(exponential(t, y)), np.array([1.0, 0.2, 0.0]))
    np.testing.assert_allclose(found.x, [2.5, 1.3, 0.5], rtol=1e-6)


@pytest.mark.parametrize("loss", [Lorentzian(0.1), Leclerc(0.3), GemanMcClure(0.2)])
def test_robust_costs_ignore_outliers(loss):
    rng = np.random.default_rng(0)
    t = np.linspace(0, 4, 60)
    y = 2.5 * np.exp(-1.3 * t) + 0.5 + 0.01 * rng.normal(size=60)
    y[::6] += 2.0
    start = np.array([2.0, 1.0, 0.4])
    plain = minimise(least_squares(exponential(t, y), Quadratic()), start).x
    found = minimise(least_squares(exponential(t, y), loss), start)
    assert found.converged
    np.testing.assert_allclose(found.x, [2.5, 1.3, 0.5], atol=0.1)
    assert np.abs(plain - [2.5, 1.3, 0.5]).max() > 0.2


def test_indefinite_hessian_still_descends():
    def cost(x):  # a saddle at the origin, minima at x = +-1, y = 0
        f = 0.25 * x[0] ** 4 - 0.5 * x[0] ** 2 + x[1] ** 2
        return float(f), np.array([x[0] ** 3 - x[0], 2 * x[1]]), np.diag([3 * x[0] ** 2 - 1, 2.0])

    found = minimise(cost, np.array([0.05, 0.7]))
    np.testing.assert_allclose(found.x, [1, 0], atol=1e-6)
    assert found.converged


def test_non_finite_trials_are_refused():
    def cost(x):  # log has no value beyond the pole at 0, towards which the first Newton steps overshoot
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(x[0] - np.log(x[0])), 1 - 1 / x, np.array([[1 / x[0] ** 2]])

    found = minimise(cost, np.array([3.0]))
    np.testing.assert_allclose(found.x, [1.0], rtol=1e-6)
    assert found.converged


def test_a_coordinate_without_influence_stays():
    found = minimise(lambda x: (float((x[0] - 1) ** 2), np.array([2 * x[0] - 2, 0]), np.diag([2.0, 0.0])), [0.0, 5.0])
    np.testing.assert_allclose(found.x, [1.0, 5.0], atol=1e-6)
    assert found.converged


def test_start_outside_is_brought_in_and_fixed_unknowns_stay():
    residuals, lower, upper = random_problem(3)
    lower[2] = upper[2] = 0.1
    found = minimise(least_squares(residuals), np.full(6, 50.0), lower, upper)
    assert (found.x >= lower).all() and (found.x <= upper).all() and found.x[2] == 0.1


def test_never_worse_than_the_start_even_with_a_wrong_gradient():
    def wrong(x):
        return float(x @ x), -2 * x, 2 * np.eye(3)

    found = minimise(wrong, np.ones(3))
    assert found.cost <= 3.0 and not found.converged and found.reason == "stalled"


def test_iterations_run_out():
    found = minimise(least_squares(rosenbrock_residuals), np.array([-1.2, 1.0]), max_iterations=3)
    assert (found.reason, found.converged, found.iterations) == ("iterations", False, 3)


@pytest.mark.parametrize(
    ("cost", "start", "bounds", "sentence"),
    [
        (lambda x: (np.nan, x, np.eye(2)), [0, 0], (None, None), "cost there is nan"),
        (lambda x: (np.inf, x, np.eye(2)), [0, 0], (None, None), "cost there is inf"),
        (lambda x: (0.0, x * np.nan, np.eye(2)), [0, 0], (None, None), "gradient or Hessian"),
        (lambda x: (0.0, x[:1], np.eye(2)), [0, 0], (None, None), r"gradient \(2,\)"),
        (lambda x: (0.0, x, np.eye(2)), [0, np.nan], (None, None), "unknown 1 is not finite"),
        (lambda x: (0.0, x, np.eye(2)), [0, 0], ([0, 2], [1, 1]), "unknown 1 leave no room"),
        (lambda x: (0.0, x, np.eye(2)), [0, 0], ([0, np.nan], [1, 1]), "unknown 1 leave no room"),
        (lambda x: (0.0, x, np.eye(2)), [0, 0], ([0, 0, 0], None), "shape of the start"),
        (lambda x: (0.0, x, np.eye(2)), [], (None, None), "at least one unknown"),
    ],
)
def test_unusable_starts_are_named(cost, start, bounds, sentence):
    with pytest.raises(SolverError, match=sentence):
        minimise(cost, start, *bounds)

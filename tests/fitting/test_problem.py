"""The loop: it descends, refuses what is worse or no number, and ends for the reasons it gives."""

import numpy as np
import pytest

from hypose.compute.solver import bounded_step
from hypose.errors import SolverError
from hypose.fitting.problem import Problem, Rule


class Bounded(Problem):
    """A cost with gradient and Hessian, bounded."""

    def __init__(self, cost, lower, upper):
        self.cost, self.lower, self.upper = cost, lower, upper

    def evaluate(self, state):
        value, gradient, hessian = self.cost(state)
        return value, lambda: (gradient, hessian)

    def propose(self, state, equations, damping):
        step = bounded_step(equations[1], equations[0], state, self.lower, self.upper, damping)
        return None if step is None else (np.clip(state + step, self.lower, self.upper), float(np.abs(step).max()))


def minimise(cost, start, lower=-np.inf, upper=np.inf, iterations=200, rule=None):
    problem = Bounded(cost, *(np.broadcast_to(limit, len(start)) for limit in (lower, upper)))
    return problem.solve(np.array(start, dtype=np.float64), iterations, rule or Rule(moved=1e-12, least=1e-9))


def squares(residuals):
    def cost(x):
        r, j = residuals(x)
        return 0.5 * float(r @ r), j.T @ r, j.T @ j

    return cost


rosenbrock = squares(lambda x: (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10], [-1, 0]])))


def test_rosenbrock():
    found = minimise(rosenbrock, [-1.2, 1.0])
    np.testing.assert_allclose(found.state, [1, 1], rtol=1e-8)
    assert found.converged and found.iterations < 60


@pytest.mark.parametrize("seed", range(25))
def test_random_bounded_problems_equal_scipy(seed):
    from scipy.optimize import least_squares

    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(20, 6)) @ rng.normal(size=(6, 6)), rng.normal(size=20)
    lower, upper = -rng.random(6), rng.random(6)

    def residuals(x):
        s = a @ x
        return s + 0.1 * np.sin(s) - b, (1 + 0.1 * np.cos(s))[:, None] * a

    start = np.random.default_rng(seed + 100).uniform(lower, upper)
    best = least_squares(
        lambda x: residuals(x)[0], start, bounds=(lower, upper), xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=3000
    )
    found = minimise(squares(residuals), start, lower, upper, iterations=1000)
    assert found.cost <= best.cost * (1 + 1e-6)


def test_what_is_no_number_or_not_better_is_refused():
    def pole(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(x[0] - np.log(x[0])), 1 - 1 / x, np.array([[1 / x[0] ** 2]])

    np.testing.assert_allclose(minimise(pole, [3.0]).state, [1.0], rtol=1e-6)
    asked = []
    wrong = minimise(lambda x: asked.append(x) or (float(x @ x), -2 * x, 2 * np.eye(3)), np.ones(3))
    assert wrong.cost == 3.0 and len(asked) == 5  # the start and four tries


def test_iterations_run_out_and_unusable_starts():
    found = minimise(rosenbrock, [-1.2, 1.0], iterations=3)
    assert (found.converged, found.iterations) == (False, 3)
    with pytest.raises(SolverError, match="not finite"):
        minimise(lambda x: (np.nan, x, np.eye(2)), [0, 0])

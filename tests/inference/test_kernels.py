"""Kernels move what they should, by as much as they should."""

import numpy as np
import pytest

from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import (
    AdaptiveDiffusion,
    GaussianDiffusion,
    RejectionSampling,
    reflect,
)

INF = np.inf


def zeros(n, d=3):
    return Hypotheses.uniform(np.zeros((n, d)))


def test_diffusion_has_the_asked_spread_and_freezes():
    sigma = np.array([0.5, 0.0, 2.0])
    moved = GaussianDiffusion(sigma)(zeros(40000), None, np.random.default_rng(0)).values
    np.testing.assert_allclose(moved.std(0), sigma, rtol=0.02)
    np.testing.assert_array_equal(moved[:, 1], 0)
    assert np.abs(np.corrcoef(moved[:, 0], moved[:, 2])[0, 1]) < 0.02


def test_reflect_mirrors_once_and_then_clamps():
    x = np.array([[-0.25, 0.5, 1.25, 3.5, -9.0]]).T
    np.testing.assert_allclose(reflect(x, [0.0], [1.0])[:, 0], [0.25, 0.5, 0.75, 0.0, 1.0])
    np.testing.assert_allclose(reflect(x, [-INF], [1.0])[:, 0], [-0.25, 0.5, 0.75, -1.5, -9.0])
    np.testing.assert_array_equal(reflect(x, None, None), x)
    np.testing.assert_array_equal(reflect(x, [0.3], [0.3]), np.full((5, 1), 0.3))


def test_rows_do_not_depend_on_the_size_of_the_set():
    kernel = GaussianDiffusion(np.ones(3))
    small = kernel(zeros(20), None, np.random.default_rng(5)).values
    np.testing.assert_array_equal(kernel(zeros(90), None, np.random.default_rng(5)).values[:20], small)


def test_adaptive_diffusion_follows_the_covariance_of_the_set():
    rng = np.random.default_rng(0)
    shape = np.array([[2.0, 0.0, 0.0], [1.5, 0.3, 0.0], [0.0, 0.0, 0.0]])
    h = Hypotheses.uniform(rng.normal(size=(50000, 3)) @ shape.T)
    step = AdaptiveDiffusion(0.5)(h, None, rng).values - h.values
    np.testing.assert_allclose(np.cov(step.T), 0.25 * shape @ shape.T, atol=0.03)
    np.testing.assert_array_equal(step[:, 2], 0)  # a collapsed coordinate stays so


def test_rejection_refuses_what_the_prior_dislikes():
    def inside(x):
        return np.where(np.abs(x[..., 0]) <= 1, 0.0, -INF)

    h = zeros(3000, 1)
    kernel = RejectionSampling(GaussianDiffusion(np.array([1.0])), inside, tau=0.7, trials=50)
    moved = kernel(h, None, np.random.default_rng(0)).values[:, 0]
    assert np.abs(moved).max() <= 1 and (moved != 0).all()
    once = RejectionSampling(GaussianDiffusion(np.array([1.0])), inside, trials=1)
    stayed = once(h, None, np.random.default_rng(0)).values[:, 0] == 0
    np.testing.assert_allclose(stayed.mean(), 1 - 0.6827, atol=0.03)


@pytest.mark.parametrize(
    "make",
    [
        lambda: GaussianDiffusion(np.array([-1.0])),
        lambda: GaussianDiffusion(np.array([np.nan])),
        lambda: GaussianDiffusion(np.ones((2, 2))),
    ],
)
def test_settings_are_checked(make):
    with pytest.raises(ValueError, match="got"):
        make()

"""Means and covariances that know rotations."""

from functools import partial

import numpy as np
import pytest

from hypose.geometry import so3_exp, so3_log
from hypose.inference.estimates import tangent_mean
from hypose.inference.hypotheses import Hypotheses


def weighted(values, seed=0):
    log_weights = np.random.default_rng(seed).normal(size=values.shape[:-1])
    return Hypotheses(values, log_weights, np.zeros(values.shape[:-1], np.int32))


def scattered(centre, spread, n, seed=0):
    """Rotation vectors around a centre, in [0, pi]: they jump branch around pi."""
    steps = np.random.default_rng(seed).normal(size=(n, 3)) * spread
    return so3_log(so3_exp(steps) @ so3_exp(centre))


@pytest.mark.parametrize("angle", [0.0, 0.5, 3.1, np.pi])
def test_rotations_are_averaged_across_the_branch(angle):
    centre = angle * np.array([0.0, 0.6, 0.8])
    values = np.concatenate([np.random.default_rng(3).normal(size=(4000, 2)), scattered(centre, 0.2, 4000)], axis=1)
    estimate = partial(tangent_mean, rotations=(2,))
    h = weighted(values)
    mean = estimate(h)
    np.testing.assert_allclose(mean[:2], h.mean()[:2])
    assert np.linalg.norm(so3_log(so3_exp(mean[2:]) @ so3_exp(centre).T)) < 0.02
    away = so3_log(so3_exp(h.values[:, 2:]) @ so3_exp(mean[2:]).T)
    np.testing.assert_allclose(h.weights @ away, 0, atol=1e-9)  # what makes it the mean
    if angle > 3:  # plain averaging gives a rotation far from all of them
        assert np.linalg.norm(so3_log(so3_exp(h.mean()[2:]) @ so3_exp(centre).T)) > 1


def test_result_stays_on_the_branch_of_the_best():
    centre = np.array([0.0, 0.0, np.pi + 0.3])  # beyond pi on purpose: a tracked root may be there
    values = np.concatenate([centre + 0.05 * np.random.default_rng(0).normal(size=(100, 3))])
    np.testing.assert_allclose(tangent_mean(weighted(values), rotations=(0,)), centre, atol=0.05)

"""The measures of doubt have their known values, and the fits find what was put in."""

import numpy as np
import pytest

from benchmarks.multiview.doubt_fit import auroc, ece
from benchmarks.multiview.spread_fit import UNSEEN, covered, fit_angle, fit_joint, level_error, squares


def test_area_under_the_curve():
    assert auroc([0.1, 0.2, 0.9, 0.8], [0, 0, 1, 1]) == 1.0
    assert auroc([0.9, 0.8, 0.1, 0.2], [0, 0, 1, 1]) == 0.0
    assert auroc([0.5] * 4, [0, 1, 0, 1]) == 0.5
    assert np.isnan(auroc([0.1, 0.2], [0, 0]))


def test_probabilities_that_hold_have_no_error():
    rng = np.random.default_rng(0)
    p = rng.random(40_000)
    wrong = rng.random(40_000) < p
    assert ece(p, wrong) < 0.02
    assert ece(np.full(1000, 0.5), np.zeros(1000)) == pytest.approx(0.5)


def test_a_spread_of_two_parts_is_found():
    rng = np.random.default_rng(1)
    sd = rng.uniform(0.005, 0.03, 4000)
    covariance = sd[:, None, None] ** 2 * np.eye(3)
    away = rng.standard_normal((4000, 3)) * np.sqrt((0.7 * sd) ** 2 + 0.012**2)[:, None]
    a, b = fit_joint(away, covariance)
    m2 = squares(away, covariance, a / UNSEEN, b / UNSEEN)
    assert covered(m2, 3) == pytest.approx(0.9, abs=0.02) and level_error(m2, 3) < 0.03


def test_an_angle_that_is_always_off_by_as_much_is_a_matter_of_its_definition():
    rng = np.random.default_rng(2)
    off, sd = np.radians(5) * rng.standard_normal(3000), np.full(3000, np.radians(0.5))
    a, b = fit_angle(off, sd)
    assert np.hypot(a * sd[0], b) == pytest.approx(UNSEEN * np.radians(5), rel=0.12)

"""Regions of other levels than 90 %: their law is Student's t, and agrees with a normal one there."""

import numpy as np
import pytest
from scipy.stats import norm, t

from hypose.body.motion import TAILS, region_reach
from tests.tailed import tailed


def test_of_one_number_it_is_the_quantile_of_students_t():
    levels = np.array([0.1, 0.5, 0.8, 0.95])
    scale = norm.ppf(0.95) / t.ppf(0.95, TAILS)
    np.testing.assert_allclose(region_reach(levels, 1), scale * t.ppf(0.5 + levels / 2, TAILS), rtol=1e-9)


@pytest.mark.parametrize("dimensions", [1, 3])
def test_errors_of_clips_that_fit_differently_well_lie_in_it(rng, dimensions):
    away = np.linalg.norm(tailed(rng, (20_000, dimensions)), axis=1)
    for level in (0.2, 0.5, 0.9, 0.95):
        assert (away <= region_reach(level, dimensions)).mean() == pytest.approx(level, abs=0.012)

"""Maxima of series are those that scipy.signal finds."""

import numpy as np
import pytest
from scipy.signal import find_peaks, peak_prominences

from hypose.pipeline.summits import lowest_beside, summits


@pytest.mark.parametrize("distance", [1, 4, 15])
@pytest.mark.parametrize("kind", ["noise", "plateaus", "waves", "flat", "short"])
def test_as_scipy_has_them(kind, distance):
    rng = np.random.default_rng(7)
    noise = rng.normal(size=2000)
    series = {
        "noise": noise,
        "plateaus": np.repeat(rng.integers(0, 9, 500) + np.arange(500) * 1e-3, rng.integers(1, 5, 500)).astype(float),
        "waves": np.sin(np.arange(2000) / 7.3) * np.linspace(1, 3, 2000) + 0.02 * noise,
        "flat": np.zeros(50),
        "short": np.array([0.0, 1.0]),
    }[kind]
    expected, _ = find_peaks(series, distance=distance)
    found = summits(series, distance)
    np.testing.assert_array_equal(found, expected)
    _, left, right = peak_prominences(series, expected)
    for values, bases in zip(lowest_beside(series, found), (left, right), strict=True):
        np.testing.assert_array_equal(values, series[bases])

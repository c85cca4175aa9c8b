"""Superquadric parts: tapers and bends."""

import numpy as np
import pytest

from benchmarks.papers.superquadrics import grid, nodes


def test_taper_is_a_ratio_of_widths_and_a_bend_keeps_the_axis_length():
    angles, _ = grid(5, 24)  # rings at -60, -30, ... degrees: two of them at half the length
    x = nodes([0.05, 0.05, 0.2, 1, 1, 0.5, 0.5, 0, 0], angles)
    width = [np.abs(x[np.abs(x[:, 2] - z) < 1e-9][:, 0]).max() for z in (-0.1, 0.1)]
    assert width[1] / width[0] == pytest.approx(1.25 / 0.75, abs=1e-9)
    bent = nodes([0.05, 0.05, 0.2, 1, 1, 0, 0, 2.0, 0], angles)
    poles = bent[[0, -1]]
    # an arc of length 0.4 and curvature 2: its chord
    assert np.linalg.norm(poles[1] - poles[0]) == pytest.approx(2 / 2.0 * np.sin(0.4 * 2.0 / 2), abs=1e-9)

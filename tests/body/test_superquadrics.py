"""Superquadric parts: derivatives, limiting shapes, and a body made of them."""

import numpy as np
import pytest

from benchmarks.papers.superquadrics import PARAMETERS, grid, nodes

PART = np.array([0.06, 0.05, 0.20, 0.7, 0.9, -0.3, 0.2, 1.5, 0.4])


@pytest.mark.parametrize("curvature", [1.5, 1e-3, 0.0, -2.0])
def test_derivatives_of_the_nodes_agree_with_finite_differences(curvature):
    angles, _ = grid()
    part = np.array([*PART[:7], curvature, PART[8]])
    _, jacobian = nodes(part, angles)
    for k, name in enumerate(PARAMETERS):
        h = 1e-6
        up, down = part.copy(), part.copy()
        up[k] += h
        down[k] -= h
        numeric = (nodes(up, angles)[0] - nodes(down, angles)[0]) / (2 * h)
        np.testing.assert_allclose(jacobian[:, :, k], numeric, atol=2e-8, err_msg=name)


def test_taper_is_a_ratio_of_widths_and_a_bend_keeps_the_axis_length():
    angles, _ = grid(5, 24)  # rings at -60, -30, ... degrees: two of them at half the length
    x, _ = nodes([0.05, 0.05, 0.2, 1, 1, 0.5, 0.5, 0, 0], angles)
    width = [np.abs(x[np.abs(x[:, 2] - z) < 1e-9][:, 0]).max() for z in (-0.1, 0.1)]
    assert width[1] / width[0] == pytest.approx(1.25 / 0.75, abs=1e-9)
    bent, _ = nodes([0.05, 0.05, 0.2, 1, 1, 0, 0, 2.0, 0], angles)
    poles = bent[[0, -1]]
    # an arc of length 0.4 and curvature 2: its chord
    assert np.linalg.norm(poles[1] - poles[0]) == pytest.approx(2 / 2.0 * np.sin(0.4 * 2.0 / 2), abs=1e-9)

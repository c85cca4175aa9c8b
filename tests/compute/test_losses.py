"""Robust losses: derivatives, what makes them robust, and kernels that are the same functions."""

import numpy as np
import pytest

from hypose.compute import losses

S = np.geomspace(1e-6, 50, 41)
SQUARE_NEAR_ZERO = [losses.quadratic, losses.lorentzian, losses.leclerc, losses.geman_mcclure, losses.huber]


@pytest.mark.parametrize("loss", SQUARE_NEAR_ZERO)
@pytest.mark.parametrize("gain", [1.0, 2.7])
def test_derivatives_are_those_of_finite_differences(loss, gain):
    s = S[np.abs(S - 1) > 1e-3]  # Huber's bends there
    h = 1e-5 * s
    rho, first, second = loss(s, gain)
    assert rho.shape == first.shape == second.shape == s.shape
    np.testing.assert_allclose(first, gain * (loss(s + h)[0] - loss(s - h)[0]) / (2 * h), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(second, (loss(s + h, gain)[1] - loss(s - h, gain)[1]) / (2 * h), rtol=1e-5, atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("loss", SQUARE_NEAR_ZERO)
def test_a_loss_is_the_square_near_zero_and_never_pulls_more(loss):
    rho, first, _ = loss(S)
    assert rho[0] == pytest.approx(S[0], rel=1e-5) and loss(0.0)[0] == 0 and loss(0.0)[1] == 1
    assert (np.diff(rho) >= 0).all() and (np.diff(first) <= 0).all() and (first >= 0).all() and (first <= 1).all()
    assert np.isfinite(loss(1e300)).all()


@pytest.mark.parametrize("name", ["lorentzian", "geman_mcclure"])
def test_kernels_are_the_same_functions(name):
    compiled = getattr(losses, f"{name}_kernel")
    for s in S:
        np.testing.assert_allclose(compiled(s, 1.3), getattr(losses, name)(s, 1.3), rtol=1e-14)

"""The exponent that lets a set share survive."""

import numpy as np
import pytest

from hypose.inference.annealing import SmoothedWeight, solve_annealing_rate


def survival_rate(energies, beta):
    """(sum w)^2 / (N sum w^2) with w = exp(-beta E) of the finite energies (Deutscher & Reid 2005)."""
    best = np.nanmin(energies, -1, keepdims=True)
    w = np.nan_to_num(np.exp(-np.asarray(beta)[..., None] * (energies - best)))
    return w.sum(-1) ** 2 / (w.shape[-1] * (w**2).sum(-1))


@pytest.mark.parametrize("target", [0.01, 0.15, 0.3, 0.9, 0.999])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_the_target_is_met_at_any_scale(target, scale):
    energies = scale * (1e3 * (scale == 1) + np.random.default_rng(0).random((5, 400)))
    beta = solve_annealing_rate(energies, target)
    np.testing.assert_allclose(survival_rate(energies, beta), target, rtol=1e-8)


def test_out_of_reach():
    ties = np.repeat([1.0, 2.0, 3.0], 10)  # a third cannot be told apart: no beta goes below 1/3
    np.testing.assert_allclose(survival_rate(ties, solve_annealing_rate(ties, 0.1)), 1 / 3, rtol=1e-9)
    few = np.where(np.arange(30) < 3, np.arange(30.0), np.nan)  # a tenth is usable: none goes above it
    assert solve_annealing_rate(few, 0.5) == 0
    np.testing.assert_allclose(survival_rate(few, 0.0), 0.1)
    np.testing.assert_allclose(survival_rate(few, solve_annealing_rate(few, 0.05)), 0.05, rtol=1e-8)
    assert solve_annealing_rate(np.full(7, 2.5), 0.2) == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: SmoothedWeight(lambda h, frame: 0.0, survival=0.0),
        lambda: SmoothedWeight(lambda h, frame: 0.0, survival=1.1),
        lambda: SmoothedWeight(lambda h, frame: 0.0, survival=np.nan),
    ],
)
def test_settings_are_checked(make):
    with pytest.raises(ValueError, match="got"):
        make()

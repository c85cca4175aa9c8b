"""One test per printed equation and algorithm of the search (Alcoverro 2014, section 2.2), misprints
included.
"""

from functools import partial

import numpy as np
import pytest

from hypose.inference.annealing import SmoothedWeight, solve_annealing_rate
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import GaussianDiffusion, RejectionSampling, annealed_sigma, layered_sigma, stay
from hypose.inference.layer import Layer, Recipe, search, stream
from hypose.inference.resampling import LayeredResampling, systematic, systematic_indices


def test_equation_2_5_weighted_set_stands_for_a_distribution():
    # the weighted set of a uniform proposal reproduces the moments of the target it is weighted by
    x = np.linspace(-8, 8, 4001)[:, None]
    h = Hypotheses.uniform(x).reweighted(-0.5 * np.square((x[:, 0] - 1.0) / 0.6))
    np.testing.assert_allclose(h.mean(), [1.0], atol=1e-9)
    np.testing.assert_allclose(h.spread(), [0.6], rtol=1e-9)


def test_equation_2_6_weights_multiply():
    first, second = np.array([0.2, 0.5, 0.3]), np.array([0.1, 0.9, 0.4])
    h = Hypotheses.uniform(np.zeros((3, 1))).reweighted(np.log(first)).reweighted(np.log(second))
    np.testing.assert_allclose(h.weights, first * second / (first * second).sum())


def test_algorithm_1_generic_run():
    # propagate, update, resample: the draw follows the normalised weights
    states = np.tile(np.arange(4.0)[:, None], (4000, 1, 1))  # 4000 populations of four
    weights = np.array([0.1, 0.4, 0.0, 0.5])
    with np.errstate(divide="ignore"):
        layer = Layer(stay, lambda h, z: np.log(np.broadcast_to(7 * weights, (4000, 4))), systematic)
        after = search(Hypotheses.uniform(states), Recipe("gpf", (layer,)), None, partial(stream, 0, 0)).resampled
    np.testing.assert_allclose(np.bincount(after.values.astype(int).ravel()) / 16000, weights, atol=0.01)
    np.testing.assert_allclose(after.weights, 0.25)


@pytest.mark.parametrize("beta", [0.1, 0.3, 0.8, 1.0])
def test_equation_2_9_smoothed_weight(beta):
    cost = np.array([0.3, 1.1, 0.7, 2.4])
    h = Hypotheses.uniform(np.zeros((4, 1)))
    smoothed = h.reweighted(SmoothedWeight(lambda h, z: cost, beta=beta)(h, None)).weights
    expected = np.exp(-cost) ** beta
    np.testing.assert_allclose(smoothed, expected / expected.sum())


def test_equation_2_10_annealed_covariance():
    sigma, alphas = np.array([0.1, 0.5]), [0.5, 0.4, 0.9]
    covariance = np.diag(sigma**2)
    for k in range(4):
        np.testing.assert_allclose(np.diag(annealed_sigma(sigma, alphas, k) ** 2), covariance)
        if k < 3:
            covariance = alphas[k] * covariance  # the alphas shrink the variance, not sigma


def test_algorithm_2_annealed_run_concentrates_the_set():
    # more layers at growing beta and shrinking Sigma: as many evaluations end nearer to the maximum
    def error(layers, count):
        total = []
        for seed in range(20):
            h = Hypotheses.uniform(stream(seed, -1, 0).normal(size=(count, 3)))
            recipe = Recipe(
                "apf",
                tuple(
                    Layer(
                        GaussianDiffusion(annealed_sigma(np.full(3, 0.3), [0.4] * layers, k)),
                        SmoothedWeight(
                            lambda h, z: 20 * np.square(h.values - z).sum(-1),
                            beta=(k + 1) / layers,
                        ),
                        systematic,
                    )
                    for k in range(layers)
                ),
            )
            result = search(h, recipe, np.array([1.0, -1.0, 0.5]), partial(stream, seed, 0))
            total.append(np.square(result.weighted.values - np.array([1.0, -1.0, 0.5])).sum(-1).mean())
        return np.mean(total)

    assert error(6, 50) < 0.5 * error(1, 300)


PARTITIONS = [[0, 1], [2], [1, 3], [4]]
SIGMA = np.array([1.0, 2.0, 3.0, 4.0, 5.0])


def test_algorithm_3_corrected():
    nu = 0.8
    expected = [
        [1, 2, 0, 0, 0],
        [nu * 1, nu * 2, 3, 0, 0],
        [nu**2 * 1, nu**2 * 2, nu * 3, 4, 0],  # coordinate 1 is filtered again: its first layer counts
        [nu**3 * 1, nu**3 * 2, nu**2 * 3, nu * 4, 5],
    ]
    for layer, row in enumerate(expected):
        np.testing.assert_allclose(layered_sigma(SIGMA, PARTITIONS, nu, layer), row)


def test_algorithm_3_with_all_coordinates_is_equation_2_10():
    everything = [range(5)] * 6
    for layer in range(6):
        np.testing.assert_allclose(
            layered_sigma(SIGMA, everything, 0.8, layer), annealed_sigma(SIGMA, [0.8**2] * 6, layer)
        )


def algorithm_4(values, weights, u0, filtered, advance):
    """Lines 1-11 with the loop test given; u0 is drawn from [0, 1/N]."""
    n = len(values)
    cdf = np.r_[0.0, np.cumsum(weights)]
    i, out, ancestors = 1, values.copy(), []
    for j in range(1, n + 1):
        u = u0 + (j - 1) / n
        while i < n and advance(u, cdf[i]):
            i += 1
        out[j - 1, filtered] = values[i - 1, filtered]
        ancestors.append(i - 1)
    return out, ancestors


def test_algorithm_4_corrected():
    rng = np.random.default_rng(0)
    filtered = np.array([True, False, True])
    for _ in range(50):
        values, weights, u = rng.normal(size=(40, 3)), rng.random(40) ** 3, rng.random()
        weights /= weights.sum()
        expected, ancestors = algorithm_4(values, weights, u / 40, filtered, lambda u, c: u > c)
        np.testing.assert_array_equal(systematic_indices(weights, u), ancestors)
        h = Hypotheses(values, np.log(weights), np.zeros(40))

        class Fixed:  # a generator that draws this u
            def random(self, shape, u=u):
                return np.full(shape, u)

        np.testing.assert_array_equal(LayeredResampling(filtered)(h, Fixed()).values, expected)


def test_algorithm_5_keeps_the_diversity_of_what_was_not_filtered():
    parts, sigma = [[0], [1]], np.full(2, 0.1)
    h = Hypotheses.uniform(stream(0, -1, 0).normal(size=(200, 2)))
    layer = Layer(
        GaussianDiffusion(layered_sigma(sigma, parts, 0.8, 0)),
        SmoothedWeight(lambda h, z: 50 * np.square(h.values[:, 0]), beta=1.0),
        LayeredResampling(np.array([True, False])),
    )
    after = search(h, Recipe("lpf", (layer,)), None, partial(stream, 0, 0)).resampled
    np.testing.assert_array_equal(after.values[:, 1], h.values[:, 1])
    assert after.values[:, 0].std() < 0.2 * h.values[:, 0].std()


def test_rejection_sampling_compares_candidate_with_current():
    # step 3 prints P(candidate) > tau P(candidate), always true for tau < 1; meant: against the current state
    def log_prior(x):  # equation (2.13) with one entity, mean 0, variance 1
        return -0.5 * np.square(x[..., 0])

    def jump(h, frame, rng):
        return Hypotheses(np.full_like(h.values, 2.0), h.log_weights, h.origin)

    kernel = RejectionSampling(jump, log_prior, tau=0.7, trials=3)
    limit = np.sqrt(4 + 2 * np.log(0.7))  # P(2) = 0.7 P(x)
    start = np.array([[0.0], [limit - 1e-6], [limit + 1e-6], [3.0]])
    moved = kernel(Hypotheses.uniform(start), None, np.random.default_rng(0)).values[:, 0]
    np.testing.assert_allclose(moved, [0.0, limit - 1e-6, 2.0, 2.0])


def test_survival_rate_of_deutscher_and_reid():
    energies, beta = np.array([0.1, 0.4, 0.9, 1.0]), 2.0
    w = np.exp(-beta * energies)
    p = w / w.sum()
    rate = 1 / (4 * (p**2).sum())
    np.testing.assert_allclose(rate, w.sum() ** 2 / (4 * (w**2).sum()))
    np.testing.assert_allclose(solve_annealing_rate(energies, rate), beta, rtol=1e-9)

"""The loop against filters written out step by step, and against the Kalman filter."""

from functools import partial

import numpy as np

from hypose.inference.annealing import SmoothedWeight
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import (
    GaussianDiffusion,
    annealed_sigma,
    filtered_mask,
    layered_sigma,
)
from hypose.inference.layer import Layer, Recipe, search, stream
from hypose.inference.resampling import LayeredResampling, keep, systematic

N, D, FRAMES = 80, 4, 6
SIGMA = np.array([0.3, 0.2, 0.25, 0.15])
TRUTH = np.cumsum(np.random.default_rng(0).normal(size=(FRAMES, D)) * SIGMA, axis=0)
START = np.random.default_rng(1).normal(size=(N, D)) * SIGMA


def energy_one(x, z):
    """A cost with side valleys, of one state."""
    return float(np.sum((x - z) ** 2) / 0.05 + 0.3 * np.sum(1 - np.cos(6 * (x - z))))


def energy(h, z):
    return np.array([energy_one(x, z) for x in h.values])


def partition_energy(part, h, z):
    return np.array([energy_one(x[part], z[part]) for x in h.values])


def run(recipe, seed=3):
    h, estimates = Hypotheses.uniform(START), []
    for t in range(FRAMES):
        result = search(h, recipe, TRUTH[t], partial(stream, seed, t))
        h = result.resampled
        estimates.append(result.estimate)
    return np.array(estimates), h


# ---------------------------------------------------------- the references, one loop per printed line
def normalised(costs, beta):
    w = [np.exp(-beta * c) for c in costs]
    return [x / sum(w) for x in w]


def draw_ancestors(weights, u0):
    ancestors, i, cumulated = [], 0, weights[0]
    for j in range(len(weights)):
        while (u0 + j) / len(weights) > cumulated:
            i += 1
            cumulated += weights[i]
        ancestors.append(i)
    return ancestors


def reference(layers, seed=3):
    """layers: (sigma, cost of a state and a frame, beta, coordinates to resample)."""
    states, estimates = [list(x) for x in START], []
    for t in range(FRAMES):
        estimate = [0.0] * D
        for number, (sigma, cost, beta, resampled) in enumerate(layers):
            rng = stream(seed, t, number)
            moved = [d for d in range(D) if sigma[d] > 0]
            noise = rng.standard_normal((N, len(moved)))
            states = [list(x) for x in states]
            for i in range(N):
                for k, d in enumerate(moved):
                    states[i][d] += noise[i][k] * sigma[d]
            weights = normalised([cost(np.array(x), TRUTH[t]) for x in states], beta)
            estimate = [sum(weights[i] * states[i][d] for i in range(N)) for d in range(D)]
            a = draw_ancestors(weights, rng.random())
            states = [[states[a[i]][d] if d in resampled else states[i][d] for d in range(D)] for i in range(N)]
        estimates.append(estimate)
    return np.array(estimates), np.array(states)


def same(recipe, layers):
    estimates, h = run(recipe)
    expected, states = reference(layers)
    np.testing.assert_allclose(estimates, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(h.values, states, rtol=0, atol=1e-12)
    assert np.sqrt(np.mean((estimates - TRUTH) ** 2)) < 0.2  # and it does follow the truth


EVERYTHING = range(D)


def test_plain_particle_filter():
    recipe = Recipe("sir", (Layer(GaussianDiffusion(SIGMA), SmoothedWeight(energy, beta=0.4), systematic),))
    same(recipe, [(SIGMA, energy_one, 0.4, EVERYTHING)])


def test_annealed_particle_filter():
    betas, alphas = [0.1, 0.3, 1.0], [0.5, 0.6]
    recipe = Recipe(
        "apf",
        tuple(
            Layer(
                GaussianDiffusion(annealed_sigma(SIGMA, alphas, k)),
                SmoothedWeight(energy, beta=b),
                systematic,
            )
            for k, b in enumerate(betas)
        ),
    )
    sigmas = [SIGMA, SIGMA * 0.5**0.5, SIGMA * (0.5 * 0.6) ** 0.5]
    same(recipe, [(s, energy_one, b, EVERYTHING) for s, b in zip(sigmas, betas, strict=True)])


def test_partitioned_sampling():
    # MacCormick & Isard: dynamics on one partition, a weight peaked on it, resampling of the whole state
    parts = [[0, 1], [2, 3]]
    layers, expected = [], []
    for part in parts:
        sigma = np.where(np.isin(np.arange(D), part), SIGMA, 0.0)
        cost = partial(partition_energy, part)
        layers.append(Layer(GaussianDiffusion(sigma), SmoothedWeight(cost, beta=0.5), systematic))
        expected.append((sigma, lambda x, z, p=part: energy_one(x[p], z[p]), 0.5, EVERYTHING))
    same(Recipe("partitioned", tuple(layers)), expected)


def test_layered_particle_filter():
    parts = [[0, 2], [1], [3]]
    layers, expected, done = [], [], []
    for number, part in enumerate(parts):
        sigma = layered_sigma(SIGMA, parts, 0.8, number)
        done = sorted([*done, *part])
        select = LayeredResampling(filtered_mask(parts, D, number))
        layers.append(Layer(GaussianDiffusion(sigma), SmoothedWeight(energy, beta=0.3), select))
        by_hand = [SIGMA[d] * 0.8 ** (number - [0, 1, 0, 2][d]) if d in done else 0.0 for d in range(D)]
        expected.append((by_hand, energy_one, 0.3, done))
    same(Recipe("hpf", tuple(layers)), expected)


# ------------------------------------------------------------------ the loop's own promises


def test_same_seed_is_bit_identical_and_a_resumed_run_too():
    layer = Layer(GaussianDiffusion(SIGMA), SmoothedWeight(energy), systematic)
    recipe = Recipe("sir", (layer, layer))
    estimates, h = run(recipe)
    again, h_again = run(recipe)
    assert estimates.tobytes() == again.tobytes() and h.values.tobytes() == h_again.values.tobytes()
    assert run(recipe, seed=4)[0].tobytes() != estimates.tobytes()
    middle = Hypotheses.uniform(START)
    for t in range(3):
        middle = search(middle, recipe, TRUTH[t], partial(stream, 3, t)).resampled
    resumed = Hypotheses(middle.values.copy(), middle.log_weights.copy(), middle.origin.copy())
    for t in range(3, FRAMES):
        resumed = search(resumed, recipe, TRUTH[t], partial(stream, 3, t)).resampled
    assert resumed.values.tobytes() == h.values.tobytes()


# ------------------------------------------------------------------ a model whose answer is known
def test_particle_filter_converges_to_the_kalman_filter():
    rng = np.random.default_rng(8)
    a, c = np.array([[1.0, 0.3], [-0.1, 0.9]]), np.array([[1.0, 0.5]])
    q, r = np.diag([0.2, 0.1]) ** 2, np.array([[0.3**2]])
    mean, covariance = np.zeros(2), np.diag([0.3, 0.4]) ** 2
    frames, x, seen = 4, np.array([0.2, -0.3]), []
    for _ in range(frames):
        x = a @ x + rng.normal(size=2) * np.sqrt(np.diag(q))
        seen.append(c @ x + rng.normal(size=1) * np.sqrt(r[0]))
    for z in seen:
        mean, covariance = a @ mean, a @ covariance @ a.T + q
        gain = covariance @ c.T @ np.linalg.inv(c @ covariance @ c.T + r)
        mean, covariance = mean + gain @ (z - c @ mean), (np.eye(2) - gain @ c) @ covariance

    def dynamics(h, z, rng):
        return Hypotheses(h.values @ a.T, h.log_weights, h.origin)

    def likelihood(h, z):
        return -0.5 * np.square(z[0] - h.values @ c[0]) / r[0, 0]

    noise = GaussianDiffusion(np.sqrt(np.diag(q)))
    recipe = Recipe("kalman", (Layer(dynamics, None, keep), Layer(noise, likelihood, systematic)))
    sizes, repeats = np.array([50, 200, 800, 3200]), 200
    errors = []
    for n in sizes:
        start = stream(1, -1, int(n)).standard_normal((repeats, n, 2)) * [0.3, 0.4]
        h, weighted = Hypotheses.uniform(start), None
        for t, z in enumerate(seen):
            result = search(h, recipe, z, partial(stream, 2, t + 100 * int(n)))
            h, weighted = result.resampled, result.weighted
        error_mean = np.sqrt(np.mean((result.estimate - mean) ** 2))
        error_covariance = np.sqrt(np.mean((weighted.scatter() - covariance) ** 2))
        errors.append((error_mean, error_covariance))
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, -0.5, atol=0.06)
    assert errors[-1][0] < 0.03 * np.sqrt(np.trace(covariance))

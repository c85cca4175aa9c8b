"""No human at all: a ship that is only heard, found from its bearings with the same search.

A state is x, y (m), vx, vy (m/s). The listener zigzags: from a straight course the distance would stay unknown."""

import numpy as np

from hypose import Hypotheses, Layer, Recipe, follow, kernels, resampling

STEP, NOISE, N = 10.0, np.radians(0.5), 5000  # s between two bearings, rad, hypotheses
rng, drift = np.random.default_rng(1), np.eye(4) + STEP * np.eye(4, k=2)
times = STEP * np.arange(90)
listener = np.stack([4 * times, 3000 * np.abs((times / 300) % 2 - 1)], 1)
ship = np.array([6000.0, 4000.0]) + times[:, None] * [-4.0, 3.0]
heard = np.arctan2(*(ship - listener).T[::-1]) + NOISE * rng.normal(size=len(ship))

sail = lambda h, frame, rng: h.equal(np.einsum("ij,nj->ni", drift, h.values))  # noqa: E731
off = lambda h, frame: np.arctan2(*(h.values[:, :2] - frame[0]).T[::-1]) - frame[1]  # noqa: E731
weigh = lambda h, frame: -0.5 * (np.angle(np.exp(1j * off(h, frame))) / NOISE) ** 2  # noqa: E731
noise = kernels.GaussianDiffusion(np.array([3.0, 3.0, 0.02, 0.02]))
layers = [Layer(sail, None, resampling.keep), Layer(noise, weigh, resampling.systematic)]
recipe = Recipe("bearings", layers)

away, at = rng.uniform(1000, 15000, N), heard[0] + NOISE * rng.normal(size=N)
start = np.stack([away * np.cos(at), away * np.sin(at), *rng.normal(0, 4, (2, N))], 1) + [*listener[0], 0, 0]
found = follow(recipe, Hypotheses.uniform(start), zip(listener, heard, strict=True))
for t, result in enumerate(found):
    sd = result.resampled.spread()[:2].max()
    print(f"{t} bearings: {np.linalg.norm(result.estimate[:2] - ship[t]):.0f} m off, sd {sd:.0f} m")

"""No camera: the layered particle filter (Alcoverro 2014, Algorithms 3 to 5) on an arm of three links in the plane, and
a plain filter with as many evaluations. layered_filter_on_a_toy.py [PICTURE.svg]

A state is three joint angles (rad); each frame gives the noisy places of elbow, wrist and tip."""

import sys

import numpy as np

from hypose import Hypotheses, Layer, Recipe, SmoothedWeight, follow, kernels, resampling

NOISE, NU, N = 0.01, 0.3, 20  # m, decay of the steps from layer to layer, particles of a layer
sigma, links = np.full(3, 0.3), np.array([0.35, 0.3, 0.2])  # rad per frame (Sigma_0), m
rng, psi = np.random.default_rng(0), [[0], [1], [2]]  # the coordinates of each layer


def places(angles):
    """Places (..., 3, 2) of elbow, wrist and tip for angles (..., 3)."""
    turn = np.cumsum(angles, -1)[..., None]
    return np.cumsum(links[:, None] * np.concatenate([np.cos(turn), np.sin(turn)], -1), -2)


def cost(last):
    """The energy of the points up to link `last`."""
    off = lambda h, seen: (places(h.values) - seen)[:, : last + 1] / NOISE  # noqa: E731
    return SmoothedWeight(lambda h, seen: 0.5 * np.square(off(h, seen)).sum((1, 2)), beta=1.0)


t = np.arange(80) / 25
truth = np.stack([np.sin(2.5 * t), 1 + 0.8 * np.sin(4 * t), 0.6 * np.sin(6 * t)], 1)
seen = places(truth) + NOISE * rng.normal(size=(len(t), 3, 2))

between = Layer(kernels.GaussianDiffusion(sigma), None, resampling.keep)  # K_t
layers = [between]
for n in range(3):
    step = kernels.GaussianDiffusion(kernels.layered_sigma(sigma, psi, NU, n))
    layers.append(Layer(step, cost(n), resampling.LayeredResampling(kernels.filtered_mask(psi, 3, n))))
plain = [Layer(kernels.GaussianDiffusion(sigma), cost(2), resampling.systematic)]
tips = {}
for name, rows, count in (("layered", layers, N), ("plain", plain, 3 * N)):
    start = Hypotheses.uniform(np.repeat(truth[:1], count, 0))
    found = np.stack([r.estimate for r in follow(Recipe(name, rows), start, seen)])
    tips[name] = places(found)[:, 2]
    error = np.linalg.norm(places(found) - places(truth), axis=-1).mean()
    print(f"{name}: {1e3 * error:.0f} mm from {1e3 * NOISE * np.sqrt(np.pi / 2):.0f} mm of noise")

colours = {"black": places(truth)[:, 2], "crimson": tips["layered"], "steelblue": tips["plain"]}
lines = [
    f'<polyline fill="none" stroke="{c}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in 300 - 280 * p * (-1, 1))}"/>'
    for c, p in colours.items()
]
if len(sys.argv) > 1:  # the path of the tip: truth black, layered red, plain blue
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        file.write(f'<svg xmlns="http://www.w3.org/2000/svg" width="600" height="600">{"".join(lines)}</svg>\n')

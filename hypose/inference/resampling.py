"""Resampling: draw the hypotheses that go on, by their weights. Every function but `keep` returns equal weights;
origins, roles and covariances are inherited. All work on any batch axes (*B, N).

Sources: Alcoverro 2014, Algorithms 1 and 4; systematic resampling after Kitagawa 1996; keeping the k best:
    Sminchisescu & Triggs 2001, Fig. 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses

IndexArray = NDArray[np.intp]


def systematic_indices(weights: FloatArray, u: ArrayLike) -> IndexArray:
    """Draw ancestors by systematic resampling: hypothesis i gets floor or ceil of N w_i copies, N w_i on average.

    weights: (*B, N), summing to 1.
    u: (*B,) one random number in [0, 1) per population.
    Returns: (*B, N) indices of the ancestors, sorted.
    Source: Alcoverro 2014, Algorithm 4 lines 1-9, whose loop test is printed reversed (`while u_j < cdf_i`). Deviation:
        on an exact tie the index advances, so that a weight of 0 is never drawn.
    """
    count = weights.shape[-1]
    cumulated = np.cumsum(weights.reshape(-1, count), axis=-1)
    cumulated /= cumulated[:, -1:]
    start = np.broadcast_to(np.asarray(u, dtype=np.float64), weights.shape[:-1]).reshape(-1, 1)
    # points below each cumulated weight: (u + j) / N < c  <=>  j < N c - u
    below = np.clip(np.ceil(count * cumulated - start), 0, count).astype(np.intp)
    below[cumulated >= 1.0] = count  # whatever the rounding of N - u: the trailing zero weights are never drawn
    rows = np.arange(len(below))[:, None]
    # one exact integer search for all populations at once, each in its own range of keys
    keys, points = below + rows * (count + 1), np.arange(count) + rows * (count + 1)
    found = np.searchsorted(keys.ravel(), points.ravel(), side="right").reshape(points.shape) - rows * count
    return found.reshape(weights.shape)


def systematic(h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
    """Resample systematically: one random number per population, low variance."""
    return h.take(systematic_indices(h.weights, rng.random(h.values.shape[:-2]))).equal()


def keep(h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
    """Return the set unchanged, with its weights (for a refinement layer, or where evidence accumulates
    over layers).
    """
    return h


def distinct(places: FloatArray, count: int, apart: float, over: Callable[..., Any] = np.max) -> list[int]:
    """Select the best hypotheses that differ from all better ones; at most count.

    places: (M, L, 3) points by which hypotheses are compared, m, those of the best one first.
    apart: hypotheses differ where the distances of their points are larger than this, m.
    over: makes one number of the L distances: the largest, or np.mean.
    Returns: their indices, best first.
    """
    keep: list[int] = []
    for n in range(len(places)):
        if all(over(np.linalg.norm(places[n] - places[k], axis=1)) > apart for k in keep):
            keep.append(n)
        if len(keep) == count:
            break
    return keep


@dataclass(frozen=True)
class LayeredResampling:
    """Systematic resampling of the coordinates filtered so far; the others keep their own values.

    filtered: (D,) bool, the union of the coordinates of all layers up to this one.
    Source: Alcoverro 2014, Algorithm 4 (corrected).
    Why: coordinates that neither dynamics nor evidence has changed yet keep their diversity.
    """

    filtered: NDArray[np.bool_]

    def __call__(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """Resample the filtered coordinates."""
        drawn = h.take(systematic_indices(h.weights, rng.random(h.values.shape[:-2])))
        return drawn.equal(np.where(self.filtered, drawn.values, h.values))

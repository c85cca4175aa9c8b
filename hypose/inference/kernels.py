"""Kernels: functions that move hypotheses. Values (*B, N, D) go in, new values of the same shape come out; origins and
roles stay, unless a mixture of kernels sets the origins.

Every kernel draws its random numbers as one block with a row per hypothesis and a column per moved coordinate, filled
in row order; hypothesis i uses row i (see `layer.stream`). Products are formed with einsum and plain loops, never with
a threaded BLAS, so that the numbers do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses
from hypose.inference.layer import Kernel

LogPrior = Callable[[FloatArray], FloatArray]
"""Function that computes the log-probability (*B, N) of states (*B, N, D), up to a constant."""


def reflect(values: FloatArray, lower: ArrayLike | None, upper: ArrayLike | None) -> FloatArray:
    """Bring values into a box: mirror them once at the bound that they violate, then clamp them.

    values: (..., D).
    lower, upper: (D,) bounds; None or an infinite bound has no effect.
    Returns: (..., D) values within the bounds.
    Why: clamping alone would collect a population at a joint limit. A step longer than the width of the box would need
    several reflections and is clamped.
    """
    low = -np.inf if lower is None else np.asarray(lower, np.float64)
    high = np.inf if upper is None else np.asarray(upper, np.float64)
    mirrored = np.maximum(np.minimum(values, 2 * high - values), 2 * low - values)
    return np.minimum(np.maximum(mirrored, low), high)


def stay(h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
    """Leave the hypotheses where they are (kernel of a refinement layer that does not move them)."""
    return h


@dataclass(frozen=True)
class GaussianDiffusion:
    """Kernel that adds an independent Gaussian step to each coordinate.

    sigma: (D,) standard deviation per coordinate, in its unit; 0 leaves the coordinate unchanged to the last bit.
    lower, upper: (D,) bounds of the moved coordinates, applied by `reflect`.
    Raises: ValueError where sigma is negative, not finite or not (D,).
    Source: Alcoverro 2014, section 2.2.1 (kernel K) and 2.2.4.
    """

    sigma: FloatArray
    lower: FloatArray | None = None
    upper: FloatArray | None = None

    def __post_init__(self) -> None:
        sigma = np.asarray(self.sigma, dtype=np.float64)
        if sigma.ndim != 1 or not np.all(np.isfinite(sigma) & (sigma >= 0)):
            raise ValueError(f"sigma must be (D,), finite and not negative, got {sigma}")
        object.__setattr__(self, "sigma", sigma)

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Move every hypothesis by one Gaussian step."""
        own = np.flatnonzero(self.sigma > 0)
        step = rng.standard_normal((*h.values.shape[:-1], own.size)) * self.sigma[own]
        values = h.values.copy()
        lower, upper = (None if b is None else np.asarray(b)[own] for b in (self.lower, self.upper))
        values[..., own] = reflect(values[..., own] + step, lower, upper)
        return replace(h, values=values)


@dataclass(frozen=True)
class AdaptiveDiffusion:
    """Kernel that adds Gaussian steps whose covariance is scale^2 times the covariance of the current set.

    scale: factor of the standard deviation, not negative.
    lower, upper: (D,) bounds, applied by `reflect`.
    largest: (D,) largest standard deviation of a step; None: no limit.
    Source: Deutscher & Reid 2005, adaptive diffusion.
    Why: coordinates that the layers have already determined are moved little, so that no schedule of step sizes is
    needed. A limit keeps coordinates finite that no evidence selects: their spread would grow with every layer.
    """

    scale: float
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    largest: FloatArray | None = None

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Move every hypothesis by one step drawn from the covariance of the set."""
        factor = semidefinite_cholesky(self.scale**2 * h.scatter())
        if self.largest is not None:
            sd = np.linalg.norm(factor, axis=-1)
            factor *= np.minimum(1.0, self.largest / np.maximum(sd, 1e-12))[..., None]
        step = np.einsum("...nk,...dk->...nd", rng.standard_normal(h.values.shape), factor)
        return replace(h, values=reflect(h.values + step, self.lower, self.upper))


@dataclass(frozen=True)
class RejectionSampling:
    """Kernel that accepts a step of another kernel only where a prior allows it: P(x') > tau P(x).

    propagate: kernel that proposes the candidates x'.
    log_prior: log-probability of a state.
    tau: threshold; 0.7 in the thesis.
    trials: largest number of proposals; a hypothesis refused every time stays at x.
    Source: Alcoverro 2014, section 2.3.3. Deviations: the test is printed with the candidate on both sides; the number
        of trials is not printed.

    A state of probability 0 accepts any candidate of probability above 0.
    """

    propagate: Kernel
    log_prior: LogPrior
    tau: float = 0.7
    trials: int = 10

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Move the hypotheses to the accepted candidates."""
        threshold = np.log(self.tau) + self.log_prior(h.values)
        values, waiting = h.values, np.ones(h.log_weights.shape, bool)
        for _ in range(self.trials):
            candidate = self.propagate(h, frame, rng).values
            accepted = waiting & (self.log_prior(candidate) > threshold)
            values = np.where(accepted[..., None], candidate, values)
            waiting = waiting & ~accepted
            if not waiting.any():
                break
        return replace(h, values=values)


def layered_sigma(sigma: ArrayLike, partitions: Sequence[ArrayLike], nu: float, layer: int) -> FloatArray:
    """Compute the step sizes (D,) of one layer of a layered filter.

    sigma: (D,) step size per frame.
    partitions: coordinates (indices or a (D,) bool mask) of each layer.
    nu: decay of the step size per layer.
    layer: number l of the layer, from 0.
    Returns: sigma for coordinates first filtered in this layer, nu^(l - m) sigma for those first filtered in an earlier
        layer m, 0 for those not filtered yet. Where every partition holds all coordinates, this is the annealed
        schedule (2.10).
    Source: Alcoverro 2014, Algorithm 3. Deviation: the printed loop over m overwrites a match with 0 at the next m, and
        checks only Psi_(l-1) for the first visit; this follows the text around it.
    """
    sigma_frame = np.asarray(sigma, dtype=np.float64)
    first = first_layer(partitions, sigma_frame.size)
    return np.where(first <= layer, sigma_frame * float(nu) ** np.maximum(layer - first, 0), 0.0)


def first_layer(partitions: Sequence[ArrayLike], dimension: int) -> NDArray[np.intp]:
    """Find the first layer whose partition holds each coordinate.

    partitions: coordinates (indices or a (D,) bool mask) of each layer.
    dimension: number D of coordinates.
    Returns: (D,) numbers of layers; len(partitions) for coordinates in no partition.
    """
    first = np.full(dimension, len(partitions), dtype=np.intp)
    for number in range(len(partitions) - 1, -1, -1):
        first[np.asarray(partitions[number])] = number
    return first


def filtered_mask(partitions: Sequence[ArrayLike], dimension: int, layer: int) -> NDArray[np.bool_]:
    """Mark the coordinates (D,) in the partitions of layers 0..layer, which Algorithm 4 of Alcoverro 2014 resamples."""
    return first_layer(partitions, dimension) <= min(layer, len(partitions) - 1)


def annealed_sigma(sigma: ArrayLike, variance_decays: Sequence[float], layer: int) -> FloatArray:
    """Compute the step sizes (D,) of one layer of the annealed filter: Sigma^k = alpha_0 ... alpha_(k-1) Sigma_0.

    sigma: (D,) step sizes of the first layer.
    variance_decays: alphas of the layers. They are rates of the variance, so that sigma shrinks by their square roots.
    layer: number k of the layer, from 0.
    Source: Alcoverro 2014, eq. (2.10).
    """
    return np.asarray(sigma, dtype=np.float64) * np.sqrt(np.prod(np.asarray(variance_decays[:layer], np.float64)))


def semidefinite_cholesky(covariance: ArrayLike) -> FloatArray:
    """Factor positive semidefinite matrices (..., D, D) as L L^T, with L lower triangular.

    Returns: (..., D, D) factors L; columns without rank are exactly 0.
    Why: the covariance of a set is singular as soon as one coordinate is frozen, where LAPACK's Cholesky factorisation
    fails.
    """
    remainder = np.array(covariance, dtype=np.float64)
    size = remainder.shape[-1]
    floor = 1e-12 * np.diagonal(remainder, axis1=-2, axis2=-1)
    factor = np.zeros_like(remainder)
    for k in range(size):
        pivot = remainder[..., k, k]
        usable = pivot > floor[..., k]
        scale = np.sqrt(np.where(usable, pivot, 1.0))
        column = np.where(usable[..., None], remainder[..., k:, k] / scale[..., None], 0.0)
        factor[..., k:, k] = column
        remainder[..., k:, k:] -= column[..., :, None] * column[..., None, :]
    return factor


@lru_cache(64)
def every(share: float, count: int) -> NDArray[np.intp]:
    """Choose a share of `count` rows, spread evenly.

    Returns: indices of the chosen rows. Whether a row is chosen is the same for every `count`.
    """
    return np.flatnonzero(np.diff(np.floor(np.arange(count + 1) * share)) > 0)

"""Kernels: how hypotheses move. Values (*B, N, D) in, new values of the same shape out; origins and roles stay unless
a mixture sets the origins.

Every kernel draws its numbers as one block with a row per hypothesis (and a column per coordinate that it moves),
filled in row order, and hypothesis i reads row i (see ``layer.stream``). Products are formed with einsum and plain
loops, never with a threaded BLAS, so the numbers do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses
from hypose.inference.layer import Kernel


class LogPrior(Protocol):
    """Log-probability (*B, N) of states (*B, N, D), up to a constant."""

    def __call__(self, values: FloatArray, /) -> FloatArray:
        """Return one number per state."""
        ...


def reflect(values: FloatArray, lower: ArrayLike | None, upper: ArrayLike | None) -> FloatArray:
    """Brings values (..., D) into the box [lower, upper] (D,): mirrored once at the violated bound, then
    clamped.

    Mirroring keeps a population from piling up on a joint limit, as clamping alone would do; a step longer
    than the box is wide would need several mirrors and is clamped. A missing or infinite bound does
    nothing.
    """
    low = -np.inf if lower is None else np.asarray(lower, np.float64)
    high = np.inf if upper is None else np.asarray(upper, np.float64)
    mirrored = np.maximum(np.minimum(values, 2 * high - values), 2 * low - values)
    return np.minimum(np.maximum(mirrored, low), high)


def stay(h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
    """No movement (a refinement layer without propagation)."""
    return h


@dataclass(frozen=True)
class HeavyTail:
    """A share of the hypotheses takes steps ``factor`` times longer on the chosen coordinates (D,) bool.

    Resampling cannot bring back a lost limb: a few long steps can, while the others keep the small sigma
    that the mean needs. The far-stepping rows are spread evenly over the set, for resampled sets are sorted
    by ancestor.
    """

    share: float
    factor: float
    coordinates: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1 or not self.factor >= 0:
            raise ValueError(f"a heavy tail needs a share in [0, 1] and a factor >= 0, got {self.share}, {self.factor}")

    def gain(self, count: int, dimension: int) -> FloatArray:
        """Return (N, D) factors on the steps."""
        gain = np.ones((count, dimension))
        gain[np.ix_(every(self.share, count), _mask(self.coordinates, dimension))] = self.factor
        return gain

    def stretch(self, steps: FloatArray, own: NDArray[np.intp], dimension: int) -> None:
        """`gain` of the coordinates own (d,) times steps (*B, N, d), in place."""
        chosen = _mask(self.coordinates, dimension)[own]
        count = steps.shape[-2]
        if chosen.all():
            steps *= _stretch(self.share, self.factor, count)
        else:
            steps[..., every(self.share, count)[:, None], np.flatnonzero(chosen)] *= self.factor


@dataclass(frozen=True)
class GaussianDiffusion:
    """Independent Gaussian steps, sigma (D,) in the units of the coordinates; a sigma of 0 leaves a
    coordinate alone.

    lower, upper (D,): bounds by ``reflect``, applied to the moved coordinates only, so that a frozen one
    keeps its value to the last bit. Source: Alcoverro 2014, section 2.2.1 (kernel K) and 2.2.4.
    """

    sigma: FloatArray
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    heavy_tail: HeavyTail | None = None

    def __post_init__(self) -> None:
        sigma = np.asarray(self.sigma, dtype=np.float64)
        if sigma.ndim != 1 or not np.all(np.isfinite(sigma) & (sigma >= 0)):
            raise ValueError(f"sigma must be (D,), finite and not negative, got {sigma}")
        object.__setattr__(self, "sigma", sigma)

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return one Gaussian step for every hypothesis."""
        own = np.flatnonzero(self.sigma > 0)
        step = rng.standard_normal((*h.values.shape[:-1], own.size)) * self.sigma[own]
        if self.heavy_tail is not None:
            self.heavy_tail.stretch(step, own, h.dimension)
        values = h.values.copy()
        lower, upper = (None if b is None else np.asarray(b)[own] for b in (self.lower, self.upper))
        values[..., own] = reflect(values[..., own] + step, lower, upper)
        return replace(h, values=values)


@dataclass(frozen=True)
class AdaptiveDiffusion:
    """Gaussian steps whose covariance is scale^2 times the sample covariance of the current set.

    The steps follow the shape of the set, so coordinates that the layers have already pinned down are
    disturbed no more; no schedule is needed. Source: Deutscher & Reid 2005, adaptive diffusion (covariance
    proportional to that of the set).
    """

    scale: float
    lower: FloatArray | None = None
    upper: FloatArray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"the scale of an adaptive diffusion must be finite and not negative, got {self.scale}")

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return one step in the shape of the current set."""
        factor = semidefinite_cholesky(self.scale**2 * h.scatter())
        step = np.einsum("...nk,...dk->...nd", rng.standard_normal(h.values.shape), factor)
        return replace(h, values=reflect(h.values + step, self.lower, self.upper))


@dataclass(frozen=True)
class ConstantVelocity:
    """The step between two frames: gain * velocity (D,), per frame, then ``reflect`` into the bounds.

    A gain of 0 is constant position. A velocity from unrefined means mostly adds noise: use refined
    estimates.
    """

    velocity: FloatArray
    gain: float = 1.0
    lower: FloatArray | None = None
    upper: FloatArray | None = None

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return the same step for every hypothesis."""
        step = self.gain * np.asarray(self.velocity, np.float64)
        moved = reflect(h.values + step, self.lower, self.upper)
        return replace(h, values=np.where(step != 0, moved, h.values))


@dataclass(frozen=True)
class Compose:
    """Kernels one after the other, drawing from the same stream."""

    kernels: tuple[Kernel, ...]

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return the last kernel's result."""
        for kernel in self.kernels:
            h = kernel(h, frame, rng)
        return h


@dataclass(frozen=True)
class RejectionSampling:
    """Steps that a prior may refuse: a candidate x' from ``propagate`` is accepted if P(x') > tau P(x).

    Refused hypotheses try again, ``trials`` times at most, and then stay where they are (the thesis says
    only that the trials are limited). A state of probability 0 accepts any candidate that is possible at
    all. Source: Alcoverro 2014, section 2.3.3, where the test is printed with the candidate on both sides;
    tau = 0.7 there.
    """

    propagate: Kernel
    log_prior: LogPrior
    tau: float = 0.7
    trials: int = 10

    def __post_init__(self) -> None:
        if not self.tau > 0 or self.trials < 1:
            raise ValueError(f"rejection sampling needs tau > 0 and at least one trial, got {self.tau}, {self.trials}")

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return the accepted steps."""
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
    """Step sizes (D,) of one layer of a layered filter.

    sigma (D,) per frame.
    partitions: the coordinate indices (or (D,) bool mask) of each layer; layer counts from 0. A coordinate first
        filtered at this layer gets sigma, one first filtered at layer m < l gets nu^(l - m) sigma, one not filtered
        yet gets 0. With every partition = all coordinates this is the annealed schedule (2.10).

    Source: Alcoverro 2014, Algorithm 3. As printed, its loop over m overwrites a hit with 0 at the next m, and only
    Psi_(l-1) is asked for the first visit; this is the meaning of the text around it.
    """
    sigma_frame = np.asarray(sigma, dtype=np.float64)
    first = first_layer(partitions, sigma_frame.size)
    return np.where(first <= layer, sigma_frame * float(nu) ** np.maximum(layer - first, 0), 0.0)


def first_layer(partitions: Sequence[ArrayLike], dimension: int) -> NDArray[np.intp]:
    """Return (D,) the first layer whose partition holds each coordinate; len(partitions) where none does."""
    first = np.full(dimension, len(partitions), dtype=np.intp)
    for number in range(len(partitions) - 1, -1, -1):
        first[_mask(partitions[number], dimension)] = number
    return first


def filtered_mask(partitions: Sequence[ArrayLike], dimension: int, layer: int) -> NDArray[np.bool_]:
    """Return (D,) True for the coordinates in the union of the partitions of layers 0..layer: what Algorithm 4
    resamples."""
    return first_layer(partitions, dimension) <= min(layer, len(partitions) - 1)


def annealed_sigma(sigma: ArrayLike, variance_decays: Sequence[float], layer: int) -> FloatArray:
    """Step sizes (D,) of layer k of the annealed filter: Sigma^k = alpha_0 ... alpha_(k-1) Sigma_0.

    The alphas are rates of *variance*, so sigma shrinks by their square roots. Source: Alcoverro 2014, eq.
    (2.10).
    """
    return np.asarray(sigma, dtype=np.float64) * np.sqrt(np.prod(np.asarray(variance_decays[:layer], np.float64)))


def semidefinite_cholesky(covariance: ArrayLike) -> FloatArray:
    """Lower factor L (..., D, D) with L L^T = covariance, positive semidefinite: exact zeros where it has
    no rank.

    A plain column loop: a sample covariance is singular as soon as a coordinate is frozen, where LAPACK's
    refuses.
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
    """Return the numbers of a share of `count` rows, spread evenly; which of the first rows does not depend on
    count."""
    return np.flatnonzero(np.diff(np.floor(np.arange(count + 1) * share)) > 0)


@lru_cache(64)
def _stretch(share: float, factor: float, count: int) -> FloatArray:
    """Return (N, 1) the factor in the rows of `every`, else 1."""
    out = np.ones((count, 1))
    out[every(share, count)] = factor
    return out


def _mask(coordinates: ArrayLike, dimension: int) -> NDArray[np.bool_]:
    chosen = np.asarray(coordinates)
    if chosen.dtype == np.bool_:
        if chosen.shape != (dimension,):
            raise ValueError(f"a mask of coordinates must have the shape ({dimension},), got {chosen.shape}")
        return chosen
    mask = np.zeros(dimension, bool)
    index = chosen.astype(np.intp).ravel()
    if index.size and (index.min() < 0 or index.max() >= dimension):
        raise ValueError(f"coordinates must lie in 0..{dimension - 1}, got {index.tolist()}")
    mask[index] = True
    return mask

"""Errors by the law of `hypose.body.motion`, drawn by another way than its quantiles."""

import numpy as np
from scipy.stats import chi2, f

from hypose.body.motion import TAILS


def tailed(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Of a standard deviation of 1 (last axis: dimensions): normal errors of clips that fit differently well, whose
    90 % regions are those of one that does not."""
    d = shape[-1]
    fit = np.sqrt(TAILS / rng.chisquare(TAILS, shape[:-1]))[..., None]
    return rng.standard_normal(shape) * fit * np.sqrt(chi2.ppf(0.9, d) / (d * f.ppf(0.9, d, TAILS)))

"""A particle filter's layers as arrays, for a device that runs them all without asking in between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SearchLayers(NamedTuple):
    """L layers, each of which moves a set by Gaussian steps, weighs it by eq. 2.8 and selects systematically."""

    sigma: Array
    """(L, D) steps; 0: the coordinate stays"""
    noise: tuple[Array, ...]
    """L times (N, d): standard normal numbers for the d coordinates that move"""
    lower: Array
    """(D,) limits, mirrored at once, then clamped; infinite: none"""
    upper: Array
    filtered: NDArray[np.bool_]
    """(L, D) the coordinates that selection takes from the ancestor"""
    survival: Array
    """(L,) share of the set that is to live on; NaN: betas is given"""
    betas: Array
    """(L,) exponents"""
    u: Array
    """(L,) where systematic selection begins, in [0, 1)"""


class WeightedSets(NamedTuple):
    """What the layers leave behind."""

    values: Array
    """(L, N, D) after the steps of each layer"""
    log_weights: Array
    """(L, N) -beta (E - min E)"""
    betas: Array
    """(L,)"""
    ancestors: NDArray[np.intp]
    """(L, N)"""

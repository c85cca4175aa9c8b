"""How far the regions reach that hold a joint, or an angle, with a given probability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hypose.geometry import Array

TAILS = 7.0
"""Degrees of freedom of the law of errors: clips differ in how well they fit, so that most errors are smaller, and some
larger, than a normal distribution with the same 90 % regions has them. Chosen on scenes (docs/notebook/doubt.md)."""


def region_reach(level: ArrayLike, dimensions: int = 3) -> Array:
    """Standard deviations (Mahalanobis distance) to which the region of a level, 0 to 1, reaches: of a joint's position
    (3 dimensions), or of one of its coordinates or an angle (1).

    At 0.9 that of a normal distribution, 2.50 and 1.64, which is what covariances are fitted for; at the other levels
    that of a Student t distribution with TAILS degrees of freedom which agrees with it there."""
    from scipy.special import betaincinv, gammaincinv  # takes long to import

    def squared(at: ArrayLike) -> Array:  # quantile of the F distribution, but for a factor
        x = betaincinv(dimensions / 2, TAILS / 2, at)
        return np.asarray(x / (1 - x))

    return np.sqrt(2 * gammaincinv(dimensions / 2, 0.9) * squared(level) / squared(0.9))

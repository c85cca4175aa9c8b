"""Fuzzy inference of a sensor's noise: a Mamdani engine with the five rules of Asteriadis et al. 2013, section 2.4.

AND = min, OR = max, implication = product, aggregation = algebraic sum, defuzzification = centroid. Rule 2 is printed
"D high OR F high AND A high" without precedence; AND binds tighter here. The paper gives the Gaussian's (and every
set's) sigma as 0.3 and no centres or slopes; the defaults put the noise of all-low and all-high inputs as the text has
it. With these rules the noise only lies between 0.42 and 0.74, and "F high" or "A high" alone give what no fired rule
gives, 0.5: as a weight it is worth little, as a preference repeated every frame it selects.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hypose import compute
from hypose.geometry import Array

LOW, MEDIUM, HIGH = "low", "medium", "high"


@dataclass(frozen=True)
class NoiseRules:
    """low_centre, high_centre, slope of the sigmoids; medium_centre, medium_sd of the Gaussian, on inputs and output
    in [0, 1]; points: samples of the output for the centroid."""

    low_centre: float = 0.25
    high_centre: float = 0.75
    slope: float = 6.0
    medium_centre: float = 0.5
    medium_sd: float = 0.3
    points: int = 51

    def membership(self, x: ArrayLike, name: str) -> Array:
        """Degree (...) to which values x (...) are low, medium or high."""
        v = np.asarray(x, dtype=np.float64)
        if name == MEDIUM:
            return np.exp(-0.5 * ((v - self.medium_centre) / self.medium_sd) ** 2)
        centre, sign = (self.low_centre, 1.0) if name == LOW else (self.high_centre, -1.0)
        return 1 / (1 + np.exp(sign * self.slope * (v - centre)))

    def firing(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """Strengths (5, ...) of the rules for normalised inverse fluidity f, depth error d and posture a (...).

        Deviation: rule 2 is printed without precedence; AND binds tighter than OR here."""
        v = np.stack(np.broadcast_arrays(np.asarray(f, np.float64), d, a))
        (fl, dl, al), (fm, dm, am), (fh, dh, ah) = (self.membership(v, n) for n in (LOW, MEDIUM, HIGH))
        both_low = np.minimum(fl, al)
        return np.stack(
            [
                np.minimum(dl, both_low),
                np.maximum(dh, np.minimum(fh, ah)),
                np.minimum(dm, both_low),
                np.minimum(np.minimum(dl, fm), al),
                np.minimum(np.minimum(dl, fl), am),
            ]
        )

    @cached_property
    def _consequents(self) -> tuple[Array, Array]:
        out = np.linspace(0, 1, self.points)
        low, medium, high = (self.membership(out, n) for n in (LOW, MEDIUM, HIGH))
        return out, np.stack([low, high, medium, medium, medium])

    def aggregate(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """(..., points): the output set over [0, 1], algebraic sum of the scaled consequents."""
        strength = self.firing(f, d, a)
        sets = self._consequents[1]
        rest = 1 - strength[0][..., None] * sets[0]
        for w, s in zip(strength[1:], sets[1:], strict=True):
            rest *= 1 - w[..., None] * s
        return 1 - rest

    def noise(self, f: ArrayLike, d: ArrayLike, a: ArrayLike) -> Array:
        """lambda (...) in (0, 1): centre of gravity of the aggregate; 0.5 where no rule fires at all.

        Deviation: the sigmoids' centres and slopes, which the paper does not give, are chosen."""
        g = self.aggregate(f, d, a)
        total = g.sum(-1)
        return np.where(total > 1e-12, g @ self._consequents[0] / np.maximum(total, 1e-12), 0.5)

    def noise_fast(self, inputs: Array) -> Array:
        """`noise` of inputs (3, ...) = f, d, a, compiled."""
        f, d, a = np.ascontiguousarray(inputs, dtype=np.float64).reshape(3, -1)
        out = np.empty(len(f))
        compute.fusion.mamdani(
            f, d, a, self.low_centre, self.high_centre, self.slope, self.medium_centre, self.medium_sd, self._sets, out
        )
        return out.reshape(inputs.shape[1:])

    @cached_property
    def _sets(self) -> Array:
        out, sets = self._consequents
        return np.stack([out, sets[0], sets[1], sets[2]])


PUBLISHED_RULES = NoiseRules()
SHARP_RULES = NoiseRules(low_centre=0.3, high_centre=0.7, slope=15.0)
"""Steeper sigmoids: the noise spans a ratio of 2.2 instead of 1.7."""

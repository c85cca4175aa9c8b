"""Body proportions as unknowns: the entities of anthropometry, without clothes, with prior intervals.

Source: Sminchisescu & Triggs 2001, section 5: x_i (internal proportions), x_d (sizes). Deviation: entities and their
    spread are those of Alcoverro 2014, section 2.3.3 (hypose.body.anthropometry), so left and right are equal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.anthropometry import SHAPE_FACTORS, entity
from hypose.body.body import Body
from hypose.errors import InputError
from hypose.geometry import Array

_ENDS = ("head", "hands", "feet")
INTERNAL: NDArray[np.int64] = np.flatnonzero(
    [e.kind in ("scale", "length") and e.name not in _ENDS for e in SHAPE_FACTORS]
)
"""Indices of the entities that move joints."""
VOLUMETRIC: NDArray[np.int64] = np.flatnonzero([e.kind == "girth" or e.name in _ENDS for e in SHAPE_FACTORS])
"""Indices of the entities of the parts' volumes."""
ADULT_HEIGHT_M, ADULT_SPREAD = 1.71, 0.055
"""Height of an unknown adult, and its relative sd. One view cannot tell a small person from a distant one."""
KNOWN_SPREAD = 0.01
INTERVAL = 2.0
"""Half width of the prior intervals, in standard deviations."""


@dataclass(frozen=True)
class Proportions:
    """Normal prior of the log factors (SHAPE_FACTORS) of a body relative to the template.

    centre, sd: (K,) means and standard deviations.
    """

    centre: Array
    sd: Array

    @property
    def interval(self) -> Array:
        """Compute the lower and the upper end (2, K) of the prior intervals."""
        return self.centre + np.array([[-INTERVAL], [INTERVAL]]) * self.sd


def proportions(template: Body, height: float | None) -> Proportions:
    """Build the prior of the proportions for a person of a given height, m (None: an adult of unknown height).

    Raises: InputError where the height is not between 0.4 and 2.8 m.
    """
    if height is not None and not 0.4 <= height <= 2.8:
        raise InputError(f"A height of {height:g} m is implausible; give it in metres (0.4 to 2.8).")
    centre, sd, scale = np.zeros(len(SHAPE_FACTORS)), np.array([e.sd for e in SHAPE_FACTORS]), entity("scale")
    centre[scale] = np.log((height or ADULT_HEIGHT_M) / template.stature)
    sd[scale] = KNOWN_SPREAD if height is not None else ADULT_SPREAD
    return Proportions(centre, sd)


def search_factors(
    cost: Callable[[Array], float], start: Array, which: NDArray[np.int64], prior: Proportions, rounds: int = 2
) -> Array:
    """Search for factors near the start that lower cost + prior, one factor after the other, within the prior
    intervals.

    cost: function of the factors (K,).
    start: (K,).
    which: indices of the factors that change.
    rounds: number of passes; the step is halved in each.
    Returns: (K,) factors.
    Why: the contour's cost jumps where parts begin to hide each other, so no derivatives are used.
    """

    def total(x: Array) -> float:
        away = (x - prior.centre) / prior.sd
        return cost(x) + 0.5 * float(away @ away)

    x, best = start.copy(), total(start)
    for k in range(rounds):
        for i in which:
            step = 0.5**k * 0.4 * prior.sd[i]
            for signed in (step, -step):
                moved = False
                while True:
                    trial = x.copy()
                    trial[i] = np.clip(x[i] + signed, *prior.interval[:, i])
                    value = total(trial) if trial[i] != x[i] else np.inf
                    if value >= best:
                        break
                    x, best, moved = trial, value, True
                if moved:
                    break
    return x

"""Body proportions as unknowns: logarithms of the template's factors, mirrored left and right, with prior intervals.

The factors are those of body.fit_skeleton: lengths and widths of the skeleton (scale, segments), and volumes of the
parts (girths, hands, feet, head). Source: Sminchisescu & Triggs 2001, section 5: x_i (internal proportions) and x_d
(sizes), left and right mirrored, within prior intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body, Mesh, deform
from hypose.body.fit_skeleton import FACTORS, shape_from_factors
from hypose.errors import InputError
from hypose.geometry import Array

PROPORTION_NAMES = tuple(f.name for f in FACTORS)
INTERNAL: NDArray[np.int64] = np.flatnonzero([f.kind in ("scale", "length", "offset") for f in FACTORS])
"""The factors that move joints."""
VOLUMETRIC: NDArray[np.int64] = np.flatnonzero([f.kind in ("girth", "size") for f in FACTORS])
"""The factors of the parts' volumes."""
ADULT_HEIGHT_M, ADULT_SPREAD = 1.71, 0.055
"""Height of an unknown adult, and the relative sd of it. One view cannot tell a small person from a far one."""
KNOWN_SPREAD = 0.01
INTERVAL = 2.0
"""Half width of the prior intervals, in sd."""


@dataclass(frozen=True)
class Proportions:
    """The prior: centre, sd, lower, upper (K,) of the logarithms of the factors of a template."""

    centre: Array
    sd: Array

    @property
    def lower(self) -> Array:
        """(K,) lower ends of the prior intervals."""
        return self.centre - INTERVAL * self.sd

    @property
    def upper(self) -> Array:
        """(K,) upper ends of the prior intervals."""
        return self.centre + INTERVAL * self.sd


def proportions(template: Body, height: float | None) -> Proportions:
    """The prior for a person of this height in m (None: an adult)."""
    if height is not None and not 0.4 <= height <= 2.8:
        raise InputError(f"A height of {height:g} m is implausible; give it in metres (0.4 to 2.8).")
    centre, sd = np.zeros(len(FACTORS)), np.array([f.sd for f in FACTORS])
    scale = PROPORTION_NAMES.index("scale")
    centre[scale] = np.log((height or ADULT_HEIGHT_M) / template.stature)
    sd[scale] = KNOWN_SPREAD if height is not None else ADULT_SPREAD
    return Proportions(centre, sd)


def shaped(template: Body, factors: ArrayLike) -> Body:
    """The template with the proportions (K,)."""
    return deform(template, shape_from_factors(factors), template.name)


def skeleton_only(body: Body) -> Body:
    """The body without its meshes, to be shaped often."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4)))
    return replace(body, coarse=nothing, fine=nothing)


def without_display(body: Body) -> Body:
    """The body without its display mesh, to be shaped often: contours need the coarse one only."""
    body.coarse.arrays  # noqa: B018 - builds the edges once, before the copies
    return replace(body, fine=body.coarse)


def search_factors(
    cost: Callable[[Array], float], start: Array, which: NDArray[np.int64], prior: Proportions, rounds: int = 2
) -> Array:
    """The factors (K,) near start that lower cost(factors) + prior, the ones in `which` one after the other, within the
    prior intervals. The contour's cost jumps where parts begin to hide each other, so it is searched, not derived."""

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
                    trial[i] = np.clip(x[i] + signed, prior.lower[i], prior.upper[i])
                    value = total(trial) if trial[i] != x[i] else np.inf
                    if value >= best:
                        break
                    x, best, moved = trial, value, True
                if moved:
                    break
    return x

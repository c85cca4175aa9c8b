"""Body proportions as unknowns: logarithms of the template's factors, the same left and right, with prior intervals.

The factors are lengths and widths of the skeleton (scale, segments), and volumes of the
parts (girths, hands, feet, head). Source: Sminchisescu & Triggs 2001, section 5: x_i (internal proportions), x_d
(sizes).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body, Mesh, Shape, deform
from hypose.errors import InputError
from hypose.geometry import Array

_TRUNK = ("pelvis", "spine", "chest")
_SIDES = ("left", "right")


@dataclass(frozen=True)
class _Factor:
    """One proportion of a body; a person has a value for it, a logarithm, and exp(value) is the factor on the template.

    name: name in PROPORTION_NAMES.
    kind: part that is multiplied: "scale" (the whole body), "length" (of the bones), "girth", "size" (length and girth)
        or "offset" (sideways distance of the joints from their parents).
    joints: names of the joints whose part is multiplied.
    axes: axes (0: x, 1: y, 2: z of the model) of a girth.
    sd: standard deviation of the logarithm between people of one stature.
    """

    name: str
    kind: str
    joints: tuple[str, ...]
    sd: float
    axes: tuple[int, ...] = (0, 1, 2)


def _pair(joint: str) -> tuple[str, ...]:
    return tuple(f"{s}_{joint}" for s in _SIDES)


FACTORS: tuple[_Factor, ...] = (
    _Factor("scale", "scale", (), 1.0),
    _Factor("torso", "length", _TRUNK, 0.05),
    _Factor("neck", "length", ("neck",), 0.10),
    _Factor("head", "size", ("head",), 0.07),
    _Factor("shoulder width", "offset", _pair("shoulder"), 0.10),
    _Factor("hip width", "offset", _pair("hip"), 0.06),
    _Factor("upper arm", "length", _pair("shoulder"), 0.06),
    _Factor("forearm", "length", _pair("elbow"), 0.06),
    _Factor("hand", "size", _pair("wrist"), 0.08),
    _Factor("thigh", "length", _pair("hip"), 0.06),
    _Factor("shank", "length", _pair("knee"), 0.06),
    _Factor("foot", "size", _pair("ankle"), 0.08),
    *(_Factor(f"{j} width", "girth", (j,), 0.15, (0,)) for j in _TRUNK),
    *(_Factor(f"{j} depth", "girth", (j,), 0.20, (1,)) for j in _TRUNK),
    *(_Factor(f"{j} girth", "girth", _pair(j), 0.20) for j in ("shoulder", "elbow", "hip", "knee")),
    _Factor("neck girth", "girth", ("neck",), 0.15),
)


PROPORTION_NAMES = tuple(f.name for f in FACTORS)
INTERNAL: NDArray[np.int64] = np.flatnonzero([f.kind in ("scale", "length", "offset") for f in FACTORS])
"""Indices of the factors that move joints."""
VOLUMETRIC: NDArray[np.int64] = np.flatnonzero([f.kind in ("girth", "size") for f in FACTORS])
"""Indices of the factors of the parts' volumes."""
ADULT_HEIGHT_M, ADULT_SPREAD = 1.71, 0.055
"""Height of an unknown adult, and its relative sd. One view cannot tell a small person from a distant one."""
KNOWN_SPREAD = 0.01
INTERVAL = 2.0
"""Half width of the prior intervals, in standard deviations."""


@dataclass(frozen=True)
class Proportions:
    """Normal prior of the logarithms of the proportions of a body relative to the template, in the order of FACTORS.

    centre, sd: (K,) means and standard deviations.
    """

    centre: Array
    sd: Array

    @property
    def lower(self) -> Array:
        """Compute the lower ends (K,) of the prior intervals."""
        return self.centre - INTERVAL * self.sd

    @property
    def upper(self) -> Array:
        """Compute the upper ends (K,) of the prior intervals."""
        return self.centre + INTERVAL * self.sd


def proportions(template: Body, height: float | None) -> Proportions:
    """Build the prior of the proportions for a person of a given height, m (None: an adult of unknown height).

    Raises: InputError where the height is not between 0.4 and 2.8 m.
    """
    if height is not None and not 0.4 <= height <= 2.8:
        raise InputError(f"A height of {height:g} m is implausible; give it in metres (0.4 to 2.8).")
    centre, sd = np.zeros(len(FACTORS)), np.array([f.sd for f in FACTORS])
    scale = PROPORTION_NAMES.index("scale")
    centre[scale] = np.log((height or ADULT_HEIGHT_M) / template.stature)
    sd[scale] = KNOWN_SPREAD if height is not None else ADULT_SPREAD
    return Proportions(centre, sd)


def shaped(template: Body, factors: ArrayLike) -> Body:
    """Deform a template body by proportions.

    factors: (K,) natural logarithms of the proportions, in the order of FACTORS.
    Returns: the deformed body.
    """
    return deform(template, shape_from_factors(factors), template.name)


def skeleton_only(body: Body) -> Body:
    """Copy the body with two empty meshes (no vertices), so that it is fast to deform."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4)))
    return replace(body, coarse=nothing, fine=nothing)


def without_display(body: Body) -> Body:
    """Copy the body with its coarse mesh in place of the fine one, so that it is fast to deform.

    Why: contours need the coarse mesh only.
    """
    body.coarse.arrays  # noqa: B018 - builds the edges once, before the copies
    return replace(body, fine=body.coarse)


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
                    trial[i] = np.clip(x[i] + signed, prior.lower[i], prior.upper[i])
                    value = total(trial) if trial[i] != x[i] else np.inf
                    if value >= best:
                        break
                    x, best, moved = trial, value, True
                if moved:
                    break
    return x


def shape_from_factors(factors: ArrayLike) -> Shape:
    """Convert the logarithms (K,) of FACTORS into the Shape that `deform` applies."""
    length: dict[str, float] = {}
    girth: dict[str, list[float]] = {}
    offset: dict[str, tuple[float, float, float]] = {}
    scale = 1.0
    for factor, value in zip(FACTORS, np.exp(np.asarray(factors, dtype=np.float64)).tolist(), strict=True):
        if factor.kind == "scale":
            scale = value
        for joint in factor.joints:
            if factor.kind in ("length", "size"):
                length[joint] = length.get(joint, 1.0) * value
            if factor.kind in ("girth", "size"):
                row = girth.setdefault(joint, [1.0, 1.0, 1.0])
                for axis in factor.axes:
                    row[axis] *= value
            if factor.kind == "offset":
                offset[joint] = (value, 1.0, 1.0)
    return Shape(scale, length, {j: (g[0], g[1], g[2]) for j, g in girth.items()}, offset)

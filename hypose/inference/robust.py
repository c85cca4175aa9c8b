"""Robust costs of a residual: near zero like a square, far away almost flat, so that an outlier stops
pulling.

All are functions of the length x >= 0 (or sign) of a residual in units of its own choosing, with the same
``scale`` sigma. The printed forms are functions of s = x^2; a cost here is half of them (spec: rho / 2 per
node): Lorentzian nu log(1 + s / sigma^2), Leclerc nu (1 - exp(-s / sigma^2)) (Sminchisescu & Triggs 2001,
section 3.1), Geman-McClure nu s / (s + sigma^2). ``height`` is nu; left out it is sigma^2, which makes the
cost x^2 / 2 near 0. For a vector residual r of length x, the Hessian of the cost is w I + (second - w) r
r^T / x^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hypose.inference.hypotheses import FloatArray


class Robust(Protocol):
    """A robust cost: any shape in, the same shape out."""

    def rho(self, x: ArrayLike, /) -> FloatArray:
        """The cost of residuals x."""
        ...

    def weight(self, x: ArrayLike, /) -> FloatArray:
        """rho'(x) / x, the weight of x in a least-squares step; finite at 0, never negative."""
        ...

    def second(self, x: ArrayLike, /) -> FloatArray:
        """rho''(x); negative for outliers, so a Newton step must be damped or use the weight instead."""
        ...


@dataclass(frozen=True)
class Quadratic:
    """x^2 / 2 times height / sigma^2: the non-robust cost, for comparison."""

    scale: float = 1.0
    height: float | None = None

    def __post_init__(self) -> None:
        _check(self.scale, self.height)

    def rho(self, x: ArrayLike, /) -> FloatArray:
        """The cost."""
        return 0.5 * _gain(self.scale, self.height) * np.square(np.asarray(x, np.float64))

    def weight(self, x: ArrayLike, /) -> FloatArray:
        """rho'(x) / x."""
        return np.full(np.shape(x), _gain(self.scale, self.height))

    def second(self, x: ArrayLike, /) -> FloatArray:
        """rho''(x)."""
        return self.weight(x)


@dataclass(frozen=True)
class Lorentzian:
    """rho = nu/2 log(1 + x^2 / sigma^2): the influence falls off as 1/x, no outlier is ever fully ignored."""

    scale: float
    height: float | None = None

    def __post_init__(self) -> None:
        _check(self.scale, self.height)

    def rho(self, x: ArrayLike, /) -> FloatArray:
        """The cost."""
        return 0.5 * _gain(self.scale, self.height) * self.scale**2 * np.log1p(_ratio(x, self.scale))

    def weight(self, x: ArrayLike, /) -> FloatArray:
        """rho'(x) / x."""
        return _gain(self.scale, self.height) / (1 + _ratio(x, self.scale))

    def second(self, x: ArrayLike, /) -> FloatArray:
        """rho''(x)."""
        t = _ratio(x, self.scale)
        near = 1 / (1 + t)  # no power of t: it overflows before its quotient does
        return _gain(self.scale, self.height) * (1 - t) * near * near


@dataclass(frozen=True)
class Leclerc:
    """rho = nu/2 (1 - exp(-x^2 / sigma^2)): beyond about 2 sigma a residual has no influence at all."""

    scale: float
    height: float | None = None

    def __post_init__(self) -> None:
        _check(self.scale, self.height)

    def rho(self, x: ArrayLike, /) -> FloatArray:
        """The cost."""
        return -0.5 * _gain(self.scale, self.height) * self.scale**2 * np.expm1(-_ratio(x, self.scale))

    def weight(self, x: ArrayLike, /) -> FloatArray:
        """rho'(x) / x."""
        return _gain(self.scale, self.height) * np.exp(-_ratio(x, self.scale))

    def second(self, x: ArrayLike, /) -> FloatArray:
        """rho''(x)."""
        t = _ratio(x, self.scale)
        return _gain(self.scale, self.height) * np.exp(-t) * (1 - 2 * t)


@dataclass(frozen=True)
class GemanMcClure:
    """rho = nu/2 x^2 / (x^2 + sigma^2): between the two, the influence falls off as 1/x^3."""

    scale: float
    height: float | None = None

    def __post_init__(self) -> None:
        _check(self.scale, self.height)

    def rho(self, x: ArrayLike, /) -> FloatArray:
        """The cost."""
        t = _ratio(x, self.scale)
        return 0.5 * _gain(self.scale, self.height) * self.scale**2 * (t / (1 + t))

    def weight(self, x: ArrayLike, /) -> FloatArray:
        """rho'(x) / x."""
        near = 1 / (1 + _ratio(x, self.scale))
        return _gain(self.scale, self.height) * near * near

    def second(self, x: ArrayLike, /) -> FloatArray:
        """rho''(x)."""
        t = _ratio(x, self.scale)
        near = 1 / (1 + t)
        return _gain(self.scale, self.height) * (1 - 3 * t) * near * near * near


def _check(scale: float, height: float | None) -> None:
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"the scale of a robust cost must be positive and finite, got {scale}")
    if height is not None and not (np.isfinite(height) and height > 0):
        raise ValueError(f"the height of a robust cost must be positive and finite, got {height}")


def _gain(scale: float, height: float | None) -> float:
    """The weight at residual 0, nu / sigma^2."""
    return 1.0 if height is None else height / scale**2


def _ratio(x: ArrayLike, scale: float) -> FloatArray:
    return np.square(np.asarray(x, np.float64) / scale)

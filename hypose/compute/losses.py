"""Robust losses: one definition for arrays, and compiled (..._kernel) for kernels.

A loss is a function of s, the squared length of a residual in squared scales: near 0 like s, far away almost flat, so
that an outlier loses its influence. Each function takes
s: float or array.
gain: factor of the derivatives.
one: 1 in the wanted precision (single precision in kernels only).
Returns: rho(s), gain rho'(s), gain rho''(s).
A term 1/2 w rho(r^2 / sigma^2) has the weight rho' in the normal equations, with gain w / sigma^2. For a residual
vector r the second derivative of rho(|r|^2 / sigma^2) / 2 is rho' across r, and `along` in its direction.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hypose.compute.compiled import kernel


def quadratic(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """Compute the quadratic loss rho = s of a squared residual s, and its derivatives; it is not robust, and serves
    for comparison.

    Arguments and result: see the module.
    """
    return s, gain + 0 * s, 0 * s


def lorentzian(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """Compute the Lorentzian (Cauchy) loss rho = log(1 + s) of a squared residual s (in squared scales), and its
    derivatives.

    An outlier is never fully ignored. Arguments and result: see the module.
    Source: Sminchisescu & Triggs 2001, eq. 2.
    """
    slope = gain / (one + s)
    return np.log1p(s), slope, -slope / (one + s)


def lorentzian_weight(s: Any, gain: Any = 1.0) -> Any:
    """Compute the weight gain / (1 + s) of a squared residual s under the Lorentzian loss, for sums whose cost is not
    needed.
    """
    return gain / (1.0 + s)


def leclerc(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """Compute the Leclerc loss rho = 1 - exp(-s) of a squared residual s (in squared scales), and its derivatives.

    Beyond about 2 scales a residual has no influence at all. Arguments and result: see the module.
    Source: Sminchisescu & Triggs 2001, eq. 3.
    """
    fall = np.exp(-s)
    return -np.expm1(-s), gain * fall, -gain * fall


def geman_mcclure(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """Compute the Geman-McClure loss rho = s / (1 + s) of a squared residual s (in squared scales), and its
    derivatives.

    Outliers lose more influence than with `lorentzian`, less than with `leclerc`. Arguments and result: see the module.
    Source: Geman & McClure 1985.
    """
    near = one / (one + s)  # no power of s: it overflows before its quotient does
    slope = gain * near * near
    return s * near, slope, -2 * slope * near


def huber(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """Compute the Huber loss of a squared residual s (in squared scales), and its derivatives: rho = s up to 1, 2
    sqrt(s) - 1 beyond; convex.

    Arguments and result: see the module.
    Source: Huber 1964.
    """
    length = np.sqrt(np.maximum(s, one))
    far = length - one > 0
    return np.minimum(s, one) + 2 * (length - one), gain / length, -0.5 * far * gain / length / np.maximum(s, one)


def along(first: Any, second: Any, s: Any) -> Any:
    """Compute the second derivative of a loss along the residual, rho' + 2 rho'' s, from rho' (first) and rho''
    (second).

    It is negative for outliers, so that a Newton step must be damped or use rho' alone.
    Source: Sminchisescu & Triggs 2001, eq. 9.
    """
    return first + 2 * second * s


geman_mcclure_kernel = kernel(geman_mcclure)
lorentzian_kernel = kernel(lorentzian)

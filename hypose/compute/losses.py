"""Robust losses: one definition for arrays, and compiled (..._kernel) for kernels.

A loss is a function of s, the squared length of a residual in squared scales: near 0 like s, far away almost flat, so
that an outlier stops pulling. Each returns rho(s), gain rho'(s) and gain rho''(s); a term 1/2 w rho(r^2 / sigma^2) has
the weight rho' in the normal equations with gain w / sigma^2. For a residual vector r the second derivative of
rho(|r|^2 / sigma^2) / 2 is rho' across r and `along` in its direction. Floats or arrays; one: 1 in the precision wanted
(single precision in kernels only).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hypose.compute.compiled import kernel


def quadratic(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """rho = s: not robust, for comparison."""
    return s, gain + 0 * s, 0 * s


def lorentzian(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """rho = log(1 + s), also called Cauchy's: no outlier is ever fully ignored.

    Source: Sminchisescu & Triggs 2001, eq. 2."""
    slope = gain / (one + s)
    return np.log1p(s), slope, -slope / (one + s)


def lorentzian_weight(s: Any, gain: Any = 1.0) -> Any:
    """Return the weight alone, for reweighted sums whose cost is not needed."""
    return gain / (1.0 + s)


def leclerc(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """rho = 1 - exp(-s): beyond about 2 scales a residual has no influence at all.

    Source: Sminchisescu & Triggs 2001, eq. 3."""
    fall = np.exp(-s)
    return -np.expm1(-s), gain * fall, -gain * fall


def geman_mcclure(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """rho = s / (1 + s): between the two. Source: Geman & McClure 1985."""
    near = one / (one + s)  # no power of s: it overflows before its quotient does
    slope = gain * near * near
    return s * near, slope, -2 * slope * near


def huber(s: Any, gain: Any = 1.0, one: Any = 1.0) -> tuple[Any, Any, Any]:
    """rho = s up to 1, 2 sqrt(s) - 1 beyond: convex. Source: Huber 1964."""
    length = np.sqrt(np.maximum(s, one))
    far = length - one > 0
    return np.minimum(s, one) + 2 * (length - one), gain / length, -0.5 * far * gain / length / np.maximum(s, one)


def along(first: Any, second: Any, s: Any) -> Any:
    """Second derivative along the residual, rho' + 2 rho'' s: negative for outliers, so that a Newton step must be
    damped or do with rho'. Source: Sminchisescu & Triggs 2001, eq. 9."""
    return first + 2 * second * s


along_kernel = kernel(along)
geman_mcclure_kernel = kernel(geman_mcclure)
leclerc_kernel = kernel(leclerc)
lorentzian_kernel = kernel(lorentzian)
quadratic_kernel = kernel(quadratic)

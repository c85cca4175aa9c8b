"""Linear algebra of a clip: frames with a block of their own, each coupled to the next two by diagonal weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native

Array = NDArray[np.float64]


def solve_coupled(own: ArrayLike, bands: ArrayLike, right: ArrayLike) -> Array | None:
    """x (T, D) with M x = right (T, D), in time linear in T; None when M is not positive definite.

    own (T, D, D): the frames' symmetric blocks; bands (3, T, D): diagonal weights of every frame with itself and with
    the frames one and two later (what would reach beyond the last frame is ignored)."""
    o, w, b = (np.require(x, np.float64, ["C", "W", "A"]) for x in (own, bands, right))
    if selection.backend() == "numpy":
        try:
            np.linalg.cholesky(_dense(o, w))
        except np.linalg.LinAlgError:
            return None
        return np.linalg.solve(_dense(o, w), b.ravel()).reshape(b.shape)
    kernels = native("solver.banded")
    a = np.empty((b.size, 2 * o.shape[1] + 1))
    kernels.fill(o, w, a)
    if not kernels.factorise(a):
        return None
    x = b.ravel().copy()
    kernels.solve_factored(a, x)
    return x.reshape(b.shape)


def frame_covariances(own: ArrayLike, bands: ArrayLike) -> Array | None:
    """(T, D, D) the diagonal blocks of the inverse of the same matrix; None when it is not positive definite.

    When own is what is known of each frame and bands couple them, these are the covariances of the frames: one of which
    nothing is known is known through its neighbours alone, the less the farther those are."""
    o, w = (np.require(x, np.float64, ["C", "W", "A"]) for x in (own, bands))
    t, d = o.shape[:2]
    if selection.backend() == "numpy":
        inverse = np.linalg.inv(_dense(o, w)).reshape(t, d, t, d)
        return np.ascontiguousarray(np.einsum("tdte->tde", inverse))
    kernels = native("solver.banded")
    a = np.empty((t * d, 2 * d + 1))
    kernels.fill(o, w, a)
    if not kernels.factorise(a):
        return None
    z = np.zeros_like(a)
    kernels.inverse_in_band(a, z)
    out = np.empty((t, d, d))
    for r in range(d):
        out[:, r, : r + 1] = z.reshape(t, d, -1)[:, r, 2 * d - r : 2 * d + 1]
        out[:, : r + 1, r] = out[:, r, : r + 1]
    return out


def _dense(own: Array, bands: Array) -> Array:
    t, d = own.shape[:2]
    m = np.zeros((t, d, t, d))
    on = np.arange(d)
    for k in range(t):
        m[k, :, k] += own[k]
        for s in range(3):
            if k + s < t:
                m[k, on, k + s, on] += bands[s, k]
                if s:
                    m[k + s, on, k, on] += bands[s, k]
    return m.reshape(t * d, t * d)

"""How well each frame of a coupled clip is known: the diagonal blocks of the inverse of the clip's matrix."""

from __future__ import annotations

import numpy as np

from hypose.fitting.clip import Coupling
from hypose.geometry import Array


def frame_covariances(information: Array, coupling: Coupling) -> Array:
    """(T, D, D) covariance of every frame's pose, given the information (T, D, D) of each frame and their coupling.

    With two frames to a block the matrix is block-tridiagonal; elimination forward and substitution backward give the
    inverse's diagonal blocks in time linear in T (the smoother of Rauch, Tung & Striebel 1965 in information form).
    Frames without information are known through their neighbours alone, the less the farther those are."""
    t, d = information.shape[:2]
    if t % 2:  # a last frame that nothing is coupled to
        information = np.concatenate([information, np.eye(d)[None]])
    bands = np.zeros((3, len(information), d))
    bands[:, :t] = coupling.bands
    diagonal, beside = _blocks(information, bands)
    inverse, gains = [], []
    left = diagonal[0]
    for k in range(len(diagonal)):
        inverse.append(np.linalg.inv(left))
        if k + 1 < len(diagonal):
            gains.append(inverse[k] @ beside[k])
            left = diagonal[k + 1] - beside[k].T @ gains[k]
    out = np.empty((len(diagonal), 2 * d, 2 * d))
    out[-1] = inverse[-1]
    for k in range(len(diagonal) - 2, -1, -1):
        out[k] = inverse[k] + gains[k] @ out[k + 1] @ gains[k].T
    frames = np.stack([out[:, :d, :d], out[:, d:, d:]], 1).reshape(-1, d, d)
    return frames[:t]


def _blocks(information: Array, bands: Array) -> tuple[Array, Array]:
    """Diagonal (K, 2D, 2D) and next-to-diagonal (K - 1, 2D, 2D) blocks of two frames each."""
    t, d = information.shape[:2]
    k = t // 2
    first, second = slice(0, d), slice(d, 2 * d)
    on = np.arange(d)
    diagonal = np.zeros((k, 2 * d, 2 * d))
    diagonal[:, first, first] = information[0::2]
    diagonal[:, second, second] = information[1::2]
    diagonal[:, on, on] += bands[0, 0::2]
    diagonal[:, d + on, d + on] += bands[0, 1::2]
    diagonal[:, on, d + on] = diagonal[:, d + on, on] = bands[1, 0::2]
    beside = np.zeros((k - 1, 2 * d, 2 * d))
    beside[:, on, on] = bands[2, 0:-2:2]
    beside[:, d + on, on] = bands[1, 1:-2:2]
    beside[:, d + on, d + on] = bands[2, 1:-2:2]
    return diagonal, beside

"""Run a gesture forest in plain numpy: the definition that the compiled kernels are tested against.

model: test (T, N, 5) int16, left (T, N) int16, share (T, N, C) uint16; T trees of N nodes, C classes, class 0 is the
background; clip_mm.

A pixel with depth d walks down every tree from node 0. At a node with test (uy, ux, vy, vx, t) it goes to node `left`
when c(u) - c(v) < t and to `left` + 1 otherwise; left = -1 is a leaf, whose share / 10000 are the class probabilities.
c(u) is the depth, in mm, floor(u f / d + 0.5) pixels away (f = focal length, in pixels; y down, x right), clamped to
d - clip_mm .. d + clip_mm; a hole, the outside of the picture and everything beyond 10 m count as 10 m. Probabilities
are averaged over the trees. (Alcoverro 2014, eq. 3.1, 3.3, 3.6.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FAR = 10000


def shares(
    model: dict[str, Any], depth: NDArray[np.uint16], rows: NDArray, columns: NDArray, focal_px: float
) -> NDArray[np.float64]:
    """(S, C) mean class probabilities at the pixels (rows, columns) of a depth picture (h, w) in mm."""
    d = depth[rows, columns].astype(np.int32)
    # the same order of single-precision operations as the compiled version, so that the same pixels are read
    scale = (float(focal_px) / np.maximum(d, 1)).astype(np.float32)
    clip = model["clip_mm"]

    def clipped(dy: NDArray, dx: NDArray) -> NDArray:
        r = rows + (dy.astype(np.float32) * scale + np.float32(4096.5)).astype(np.int32) - 4096
        c = columns + (dx.astype(np.float32) * scale + np.float32(4096.5)).astype(np.int32) - 4096
        inside = (r >= 0) & (c >= 0) & (r < depth.shape[0]) & (c < depth.shape[1])
        value = np.full(len(d), FAR, np.int32)
        value[inside] = depth[r[inside], c[inside]]
        value[(value == 0) | (value > FAR)] = FAR
        return np.clip(value, d - clip, d + clip)

    total = np.zeros((len(d), model["share"].shape[2]))
    for test, left, share in zip(model["test"], model["left"], model["share"], strict=True):
        node = np.zeros(len(d), np.int64)
        while (left[node] >= 0).any():
            e = test[node].astype(np.int32)
            right = clipped(e[:, 0], e[:, 1]) - clipped(e[:, 2], e[:, 3]) >= e[:, 4]
            node = np.where(left[node] >= 0, left[node] + right, node)
        total += share[node]
    return total / (10000.0 * len(model["left"]))

"""numba: a few pixels of a picture against the room. The definition is in glance.py."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel

u8 = np.uint64  # an index of this type needs no test for "counted from the end"


@kernel
def differ_sparsely(image, at, low, high, out):
    """out (m, n) u1: 1 where the mean of the 2 x 2 pixels of image (H, W, 3) u1 from pixel number at (m, n) i4 on lies
    in some channel outside low..high (m, n, 3) u1; 0 where at is negative."""
    flat = image.reshape(-1)
    below = u8(3 * image.shape[1])
    for y in range(at.shape[0]):
        for x in range(at.shape[1]):
            out[y, x] = 0
            if at[y, x] < 0:
                continue
            first = u8(3 * at[y, x])
            for c in range(3):
                k = first + u8(c)
                total = np.uint32(flat[k]) + np.uint32(flat[k + u8(3)])
                total += np.uint32(flat[k + below]) + np.uint32(flat[k + below + u8(3)])
                value = (total + np.uint32(2)) >> np.uint32(2)
                out[y, x] |= (value < low[y, x, c]) | (value > high[y, x, c])

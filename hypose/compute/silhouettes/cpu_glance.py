"""numba: a few pixels of a picture against the room. The definition is in glance.py."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel
from hypose.compute.pictures.cpu_pixels import mean_outside


@kernel
def differing_box(image, at, low, high, among, box):
    """Fills box (4,): y0, y1, x0, x1 of the pixels looked at, at (m, n) i4, that differ in company; zeros without any.

    One differs where the mean of the 2 x 2 pixels of image (H, W, 3) u1 from pixel number `at` on lies in some colour
    outside low..high (m, n, 4) u1, and `at` is not negative; and does so in company where `among` of the nine around
    it, itself included, differ."""
    m, n = at.shape
    picture, least, most, below = image.reshape(-1), low.reshape(-1), high.reshape(-1), 3 * image.shape[1]
    found = np.zeros((m + 2, n + 2), np.uint8)
    for y in range(m):
        row, line = at[y], found[y + 1]
        for x in range(n):
            if row[x] >= 0:
                line[x + 1] = mean_outside(picture, 3 * row[x], below, least, most, 4 * (y * n + x))
    box[:] = m, 0, n, 0
    for y in range(m):
        line = found[y + 1]
        for x in range(n):
            if line[x + 1] != 0:
                count = 0
                for i in range(3):
                    for j in range(3):
                        count += found[y + i, x + j]
                if count >= among:
                    box[0], box[1] = min(box[0], y), y + 1
                    box[2], box[3] = min(box[2], x), max(box[3], x + 1)
    if box[1] == 0:
        box[:] = 0

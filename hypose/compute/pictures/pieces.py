"""Connected pieces of masks, and which of them are touched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.compute.native import native, plain


def touched_area(
    bits: NDArray[np.uint8], others: NDArray[np.uint8], size: tuple[int, int], step: int, at: NDArray[np.float64]
) -> tuple[int, int]:
    """Pixels of the pieces, corners connect, that points touch, and of the largest of the others, of every step-th row
    and column of what is set in both of two masks of size (width, height), packed as `prepare_masks` does (H, B). at
    (N, 2) px of the masks; what lies outside them touches nothing."""
    w, h = size
    small = -(-w // step), -(-h // step)
    kernels, made = native("pictures.pieces"), np.zeros((small[1] + 2, small[0] + 2), np.uint8)
    kernels.thin_both(plain(bits, np.uint8), plain(others, np.uint8), step, made)
    with np.errstate(invalid="ignore"):
        inside = at[((at >= 0) & (at <= (w - 1, h - 1))).all(1)]
    cells = np.minimum(np.rint(inside / step).astype(np.int64), np.array(small) - 1)
    found = np.zeros(2, np.int64)
    kernels.areas_of_pieces(made, plain(cells, np.int64), np.empty(made.size, np.int64), found)
    return int(found[0]), int(found[1])

"""The masks of a frame as the silhouette scorer takes them: packed, counted, without what says nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import plain
from hypose.compute.solver.terms import PreparedMasks


def prepare_masks(
    masks: ArrayLike,
    usable: ArrayLike,
    sizes: ArrayLike,
    projections: ArrayLike,
    ignored: NDArray[np.uint8] | None = None,
    norm: ArrayLike | None = None,
) -> PreparedMasks:
    """Masks (C, h, w) non-zero = person, usable (C,), sizes (C, 2) width and height, pinhole projections (C, 3, 4).

    ignored (C, h, w) 0 and 1: pixels that say nothing, neither for nor against a body there; norm (C,) px: what counts
    as the whole person (default, and where NaN: the masks' areas)."""
    m = np.ascontiguousarray(masks)
    if m.dtype != np.uint8:
        m = (m != 0).view(np.uint8)
    seen, hidden = m, _NO_BITS
    if ignored is not None:
        m, seen, hidden = np.greater(m, ignored).view(np.uint8), m | ignored, _packed(ignored)
    areas = np.array([np.count_nonzero(view) for view in m], dtype=np.int64)
    whole = areas.astype(np.float64)
    if norm is not None:
        whole = np.where(np.isnan(norm), whole, norm)
    return PreparedMasks(
        m,
        areas,
        plain(usable, np.bool_),
        plain(sizes, np.int64),
        plain(projections, np.float64),
        _packed(m),
        whole,
        hidden,
        seen,
    )


_NO_BITS = np.zeros((0, 0, 0), dtype=np.uint8)


def _packed(masks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    packed = np.packbits(masks, axis=2, bitorder="little")
    bits = np.zeros((*packed.shape[:2], packed.shape[2] + 16), dtype=np.uint8)
    bits[:, :, : packed.shape[2]] = packed
    return bits

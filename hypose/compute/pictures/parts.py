"""Which parts of a body a picture shows, small and fast: every pixel knows all the parts that cover it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native, plain

_CROSS = np.ones((3, 3), np.uint8)


class PartView(NamedTuple):
    """A body's parts against one mask, in pixels: area, exposed (covered by no other part) and outside (of the mask,
    less its rim) of each part (P,); bare (N,): pixels of the mask without body within a radius of each point; body
    (h, w): 1 where it is drawn."""

    area: NDArray[np.int64]
    exposed: NDArray[np.int64]
    outside: NDArray[np.int64]
    bare: NDArray[np.int64]
    body: NDArray[np.uint8]


def parts_against_mask(
    mask: NDArray[np.uint8],
    uv: ArrayLike,
    z: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint16],
    n_parts: int,
    points: ArrayLike,
    radius: ArrayLike,
    ignored: NDArray[np.uint8] | None = None,
) -> PartView:
    """A mesh with vertices at uv (V, 2) px and depths z (V,) m against a mask (h, w) of 0 and 1.

    part (F,): each face's part, below n_parts (16 at most); points (N, 2) px, radius (N,) px: around which bare mask is
    counted. ignored (h, w): 1 = a pixel that says nothing: neither bare nor outside, and nothing is exposed there. Rims
    of one pixel count neither as bare nor as outside, nor does what is thinner than three pixels.
    """
    drawn = np.zeros(mask.shape, np.uint16)
    bit = (np.uint16(1) << part.astype(np.uint16)).astype(np.uint16)
    kernels = native("pictures.parts")
    kernels.draw(plain(uv, np.float64), plain(z, np.float64), faces, bit, drawn)
    body = (drawn > 0).astype(np.uint8)
    open_mask = mask
    if ignored is not None:
        mask, open_mask = mask & (1 - ignored), mask | ignored
    outside = cv2.morphologyEx(1 - cv2.dilate(open_mask, _CROSS), cv2.MORPH_OPEN, _CROSS)
    bare = cv2.morphologyEx(mask & (1 - cv2.dilate(body, _CROSS)), cv2.MORPH_OPEN, _CROSS)
    out = PartView(*(np.zeros(n_parts, np.int64) for _ in range(3)), np.zeros(len(np.asarray(points)), np.int64), body)
    kernels.tally(drawn, outside, out.area, out.exposed, out.outside)
    if ignored is not None:  # what is seen of the parts; their areas stay the whole ones
        out.exposed[:] = 0
        kernels.tally(
            np.where(ignored > 0, np.uint16(0), drawn),
            outside,
            np.zeros_like(out.area),
            out.exposed,
            np.zeros_like(out.area),
        )
    kernels.near(bare, plain(points, np.float64), np.asarray(radius, np.float64) ** 2, out.bare)
    return out

"""Which parts of a body a picture shows, small and fast: every pixel knows all the parts that cover it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native, plain
from hypose.compute.pictures.mask_runs import Bits, mask_of

Array = NDArray[np.float64]
_NONE = np.zeros((0, 0), np.uint8)


class PartView(NamedTuple):
    """A body's parts against one mask, in pixels: area, exposed (covered by no other part) and outside (of the mask,
    less its rim) of each part (P,); bare (N,): pixels of the mask without body within a radius of each point; bits (W,
    h): where it is drawn."""

    area: NDArray[np.int64]
    exposed: NDArray[np.int64]
    outside: NDArray[np.int64]
    bare: NDArray[np.int64]
    bits: Bits


def projected(points_world: ArrayLike, projection: ArrayLike) -> tuple[Array, Array, Array]:
    """(N, 2) px, NaN behind the camera, (N,) m along its axis, and (2, 2) px, the least and the most across and down,
    infinite where nothing is before it, of points (N, 3) m through a projection (3, 4)."""
    points = plain(points_world, np.float64)
    uv, z, reach = np.empty((len(points), 2)), np.empty(len(points)), np.empty((2, 2))
    native("pictures.parts").place(points, plain(projection, np.float64), uv, z, reach)
    return uv, z, reach


def draw_parts(
    uv: ArrayLike,
    z: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    n_parts: int,
    shape: tuple[int, int],
) -> Bits:
    """(n_parts, W, h) bits of what faces (F, 3) of the part (F,) cover of a picture of shape (h, w); uv (V, 2) px, z
    (V,) m."""
    (h, w), kernels = shape, native("pictures.parts")
    size = n_parts * h * -(-w // 64)
    flat = np.zeros(size + kernels.ROWS - 1, np.uint64)
    kernels.draw(plain(uv, np.float64), plain(z, np.float64), faces, part, w, h, flat)
    return flat[:size].reshape(n_parts, -1, h)


def covered(
    uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], shape: tuple[int, int], closed: bool = False
) -> NDArray[np.uint8]:
    """(h, w) = shape: 1 where faces (F, 3) cover a pixel's centre, else 0; uv (V, 2) px, z (V,) m. closed: those of a
    mesh without holes, of which the ones that turn to the camera, drawn alone, cover what all of them cover."""
    f = plain(faces, np.int32)
    if closed:
        front = np.empty_like(f)
        f = front[: native("pictures.parts").turned(plain(uv, np.float64), f, front)]
    return mask_of(draw_parts(uv, z, f, np.zeros(len(f), np.uint8), 1, shape)[0], shape[1])


def parts_against_mask(
    bits: NDArray[np.uint8],
    drawn: Bits,
    box: tuple[int, int, int, int],
    step: int,
    points: ArrayLike,
    radius: ArrayLike,
    hidden: NDArray[np.uint8] | None = None,
) -> PartView:
    """Parts of a body against every step-th row and column of a mask in a box of it, packed as `prepare_masks` does (H,
    B).

    drawn (P, W, h): each part in that small picture, as `draw_parts` gives it; it is used up. box: columns, rows, half
    open, of the mask; points (N, 2) px, radius (N,) px of the small picture: around which bare mask is counted. hidden
    (H, B): what says nothing: it is neither bare nor outside, and nothing is exposed there. Rims of one pixel count
    neither as bare nor as outside, nor does what is thinner than three pixels.
    """
    x0, x1, y0, _ = box
    uv, r, width = plain(points, np.float64), plain(radius, np.float64), -(-(x1 - x0) // step)
    counts, bare = np.zeros((3, len(drawn)), np.int64), np.zeros(len(uv), np.int64)
    shown = plain(bits, np.uint8), _NONE if hidden is None else plain(hidden, np.uint8)
    native("pictures.parts").against_mask(*shown, y0, x0, step, width, drawn, uv, r, counts, bare)
    return PartView(*counts, bare, drawn[0])

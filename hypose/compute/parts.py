"""Find which parts of a body a picture shows, and compare them with a mask; and connected pieces of masks (OpenCV).

The picture of a part has one bit per pixel, (h, bytes), lowest bit first, as `arrays.PreparedMasks.bits`.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.coverage import NEAR, STRIP, cover_faces, row_stride, sum_strip
from hypose.geometry import Array, Mask

Bits = NDArray[np.uint8]
_NINE = np.ones((3, 3), np.uint8)


class PartView(NamedTuple):
    """Parts of a body compared with one mask, in pixels.

    area: (P,) pixels of each part.
    exposed: (P,) pixels covered by no other part.
    outside: (P,) pixels outside the mask, without its rim.
    bare: (N,) pixels of the mask without body within a radius of each point.
    body: (h, w) 1 at the pixels where the body is drawn.
    """

    area: NDArray[np.int64]
    exposed: NDArray[np.int64]
    outside: NDArray[np.int64]
    bare: NDArray[np.int64]
    body: Mask


def projected(points_world: ArrayLike, projection: ArrayLike) -> tuple[Array, Array, Array]:
    """Project points (N, 3) m with a projection (3, 4).

    Returns: (N, 2) px, NaN behind the camera; (N,) m along the optical axis; (2, 2) px, smallest and largest u and v,
        infinite where nothing is in front of the camera.
    """
    p = np.asarray(projection, dtype=np.float64)
    seen = np.einsum("rc,nc->rn", p[:, :3], np.asarray(points_world, dtype=np.float64)) + p[:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = np.where(seen[2] > NEAR, seen[:2] / seen[2], np.nan)
    reach = np.fmin.reduce(uv, 1, initial=np.inf), np.fmax.reduce(uv, 1, initial=-np.inf)
    return np.ascontiguousarray(uv.T), seen[2], np.stack(reach, 1)


def draw_parts(
    uv: ArrayLike,
    z: ArrayLike,
    faces: NDArray[np.int32],
    part: NDArray[np.uint8],
    n_parts: int,
    shape: tuple[int, ...],
    closed: bool = False,
) -> Bits:
    """Draw which pixels the faces of each part cover.

    uv, z: (V, 2) px and (V,) m of the vertices.
    faces, part: (F, 3), and (F,) part of each.
    n_parts: number of parts.
    shape: (h, w) shape of the picture.
    closed: the faces of a part have no holes, so that those facing the camera cover what all of them cover.
    Returns: (n_parts, h, bytes) bits, at least as many as columns.
    """
    h, w = shape
    bits = np.zeros((n_parts, h, row_stride(w) // 8), np.uint8)
    _draw_parts(plain(uv, np.float64), plain(z, np.float64), faces, part, closed, w, h, bits)
    return bits


def covered(
    uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], shape: tuple[int, ...], closed: bool = False
) -> NDArray[np.uint8]:
    """Draw a mask (h, w) = shape: 1 where faces of any orientation cover a pixel's centre.

    uv, z: (V, 2) px and (V,) m of the vertices.
    faces: (F, 3).
    closed: the faces have no holes, so that those facing the camera cover what all of them cover.
    """
    f = plain(faces, np.int32)
    return _mask_of(draw_parts(uv, z, f, np.zeros(len(f), np.uint8), 1, shape, closed)[0], shape[1])


def _mask_of(bits: Bits, width: int) -> Mask:
    """Convert packed bits (h, bytes) to a mask (h, width) of 0 and 1."""
    return np.unpackbits(bits, axis=1, count=width, bitorder="little")


def parts_against_mask(mask: Mask, hidden: Mask | None, drawn: Bits, points: ArrayLike, radius: ArrayLike) -> PartView:
    """Compare the parts of a body with a mask.

    mask: (h, w) 0 or 1.
    hidden: (h, w) 1 at ignored pixels: they are neither bare nor outside, and nothing is exposed there; None: none.
    drawn: (P, h, bytes) pixels of each part, from `draw_parts`.
    points, radius: (N, 2) and (N,) px: around these, bare mask is counted.
    Returns: the counts. Rims of one pixel and pieces thinner than three pixels count neither as bare nor as outside.
    """
    once, twice = np.zeros_like(drawn[0]), np.zeros_like(drawn[0])
    for part in drawn:
        twice |= once & part
        once |= part
    body = _mask_of(once, mask.shape[1])
    known, own = (mask, mask) if hidden is None else (mask | hidden, mask & ~hidden)
    outside = cv2.morphologyEx(1 - cv2.dilate(known, _NINE), cv2.MORPH_OPEN, _NINE)
    bare = cv2.morphologyEx(own & (1 - cv2.dilate(body, _NINE)), cv2.MORPH_OPEN, _NINE)
    alone, out = ~twice, np.zeros_like(once)
    lines = np.packbits(outside, axis=1, bitorder="little")
    out[:, : lines.shape[1]] = lines
    if hidden is not None:
        alone[:, : lines.shape[1]] &= ~np.packbits(hidden, axis=1, bitorder="little")
    counts = (np.bitwise_count(d).sum((1, 2), dtype=np.int64) for d in (drawn, drawn & alone, drawn & out))
    row, column = np.nonzero(bare)
    (u, v), r = np.asarray(points, dtype=np.float64).T, np.asarray(radius, dtype=np.float64)
    near = (column[:, None] - u) ** 2 + (row[:, None] - v) ** 2 < r * r
    return PartView(*counts, near.sum(0), body)


def touched_area(
    bits: NDArray[np.uint8], others: NDArray[np.uint8], size: tuple[int, int], step: int, at: NDArray[np.float64]
) -> tuple[int, int]:
    """Measure the connected pieces of the overlap of two masks.

    bits, others: (H, B) masks, packed as by `prepare_masks`.
    size: (width, height) size of the masks.
    step: distance between the rows and columns that are read, px.
    at: (N, 2) px of the masks; points outside touch nothing.
    Returns: pixels of the pieces (connected over corners too) that the points touch, and of the largest of the other
        pieces.
    """
    w, h = size
    both = np.unpackbits(bits & others, axis=1, count=w, bitorder="little")[:h:step, ::step]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(both), connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    areas[0] = 0  # outside
    with np.errstate(invalid="ignore"):
        inside = at[((at >= 0) & (at <= (w - 1, h - 1))).all(1)]
    column, row = np.minimum(np.rint(inside / step).astype(np.int64), np.array(both.shape[::-1]) - 1).T
    touched = np.zeros(len(areas), np.bool_)
    touched[np.asarray(labels)[row, column]] = True
    return int(areas[touched].sum()), int(areas[~touched].max(initial=0))


@kernel
def _draw_parts(uv, z, faces, part, closed, width, height, bits):
    """Draw the pixels that the faces of each part cover, into bits (P, h, bytes) u1.

    uv, z: (V, 2) px and (V,) m of the vertices.
    faces, part, closed: as in `draw_parts`.
    width, height: width and height of the picture, px.
    """
    stride = row_stride(width)
    difference = np.zeros((bits.shape[0], height + 1, stride), np.int8)
    cover_faces(uv, z, faces, part, closed, width, height, difference)
    for p in range(bits.shape[0]):
        for s in range(0, width, STRIP):
            sum_strip(difference[p], s, stride, height, s >> 3, stride >> 3, None, None, bits[p], None)

"""Find which parts of a body a picture shows: every pixel has a bit for each part that covers it (mask_runs.py); and
connected pieces of masks (OpenCV).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.compute.coverage import NEAR, cover_faces, fill_strip, row_stride
from hypose.compute.mask_runs import Bits, element_spans, grown, mask_of, opened, u8
from hypose.compute.simd import lowest_bit, popcount
from hypose.geometry import Array

_NONE = np.zeros((0, 0), np.uint8)


class PartView(NamedTuple):
    """Parts of a body compared with one mask, in pixels.

    area: (P,) pixels of each part.
    exposed: (P,) pixels covered by no other part.
    outside: (P,) pixels outside the mask, without its rim.
    bare: (N,) pixels of the mask without body within a radius of each point.
    bits: (W, h) packed picture of the pixels where the body is drawn.
    """

    area: NDArray[np.int64]
    exposed: NDArray[np.int64]
    outside: NDArray[np.int64]
    bare: NDArray[np.int64]
    bits: Bits


def projected(points_world: ArrayLike, projection: ArrayLike) -> tuple[Array, Array, Array]:
    """Project points (N, 3) m with a projection (3, 4).

    Returns: (N, 2) px, NaN behind the camera; (N,) m along the optical axis; (2, 2) px, smallest and largest u and v,
        infinite where nothing is in front of the camera.
    """
    points = plain(points_world, np.float64)
    uv, z, reach = np.empty((len(points), 2)), np.empty(len(points)), np.empty((2, 2))
    _place(points, plain(projection, np.float64), uv, z, reach)
    return uv, z, reach


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
    Returns: (n_parts, W, h) bits.
    """
    h, w = shape
    bits = np.zeros((n_parts, -(-w // 64), h), np.uint64)
    _draw_parts(plain(uv, np.float64), plain(z, np.float64), faces, part, closed, w, h, bits.view(np.uint8))
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
    return mask_of(draw_parts(uv, z, f, np.zeros(len(f), np.uint8), 1, shape, closed)[0], shape[1])


def parts_against_mask(
    bits: NDArray[np.uint8],
    drawn: Bits,
    box: tuple[int, int, int, int],
    step: int,
    points: ArrayLike,
    radius: ArrayLike,
    hidden: NDArray[np.uint8] | None = None,
) -> PartView:
    """Compare the parts of a body with a mask, at every step-th row and column of a box.

    bits: (H, B) mask, packed as by `prepare_masks`.
    drawn: (P, W, h) packed picture of each part at these rows and columns (the small picture), from `draw_parts`; it
        is overwritten.
    box: columns and rows of the mask, half open.
    step: distance between the rows and columns that are read, px.
    points, radius: (N, 2) and (N,) px of the small picture: around these, bare mask is counted.
    hidden: (H, B) ignored pixels: they are neither bare nor outside, and nothing is exposed there.
    Returns: the counts. Rims of one pixel and pieces thinner than three pixels count neither as bare nor as outside.
    """
    x0, x1, y0, _ = box
    uv, r, width = plain(points, np.float64), plain(radius, np.float64), -(-(x1 - x0) // step)
    counts, bare = np.zeros((3, len(drawn)), np.int64), np.zeros(len(uv), np.int64)
    shown = plain(bits, np.uint8), _NONE if hidden is None else plain(hidden, np.uint8)
    _against_mask(*shown, y0, x0, step, width, element_spans(3), drawn, uv, r, counts, bare)
    return PartView(*counts, bare, drawn[0])


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
def _place(points, projection, uv, z, reach):
    """Project points (N, 3) m with a projection (3, 4).

    uv, z: (N, 2) px, NaN behind the camera, and (N,) m along its axis.
    reach: (2, 2) gets the smallest and largest u and v, infinite without any.
    """
    p = projection
    for k in range(2):
        reach[k, 0], reach[k, 1] = np.inf, -np.inf
    for i in range(points.shape[0]):
        x, y, t = points[i, 0], points[i, 1], points[i, 2]
        far = p[2, 0] * x + p[2, 1] * y + p[2, 2] * t + p[2, 3]
        z[i] = far
        uv[i, 0] = uv[i, 1] = np.nan
        if far > NEAR:
            uv[i, 0] = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * t + p[0, 3]) / far
            uv[i, 1] = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * t + p[1, 3]) / far
            for k in range(2):
                reach[k, 0], reach[k, 1] = min(reach[k, 0], uv[i, k]), max(reach[k, 1], uv[i, k])


@kernel
def _draw_parts(uv, z, faces, part, closed, width, height, bits):
    """Draw the pixels that the faces of each part cover, into bits (P, W, 8 h) u1: 64 columns of a row
    in eight bytes.

    uv, z: (V, 2) px and (V,) m of the vertices.
    faces, part, closed: as in `draw_parts`.
    width, height: width and height of the picture, px.
    """
    stride, unread = row_stride(width), np.zeros(2, np.int64)
    difference = np.zeros((bits.shape[0], height + 1, stride), np.int8)
    cover_faces(uv, z, faces, part, closed, width, height, difference)
    for p in range(bits.shape[0]):
        for k in range(bits.shape[1]):
            fill_strip(difference[p], 64 * k, stride, height, bits[p], bits[p], 8 * height * k, 8, unread)


@kernel
def _thin(packed, top, left, step, width, out):
    """Take every step-th pixel of a packed mask (H, B) from row top and column left on, as bits out (W, h); bits beyond
    the width are undefined.
    """
    words, h = out.shape
    size, shift = packed.shape[1], u8(left & 7)
    for k in range(words):
        begin = (left >> 3) + 8 * k
        for r in range(h):
            word, y = u8(0), top + r * step
            if step == 1:  # then bits only move
                for i in range(min(8, size - begin)):
                    word |= u8(packed[y, begin + i]) << u8(8 * i)
                word >>= shift
                if begin + 8 < size:
                    word |= (u8(packed[y, begin + 8]) << u8(1)) << (u8(63) - shift)
            else:
                x = u8(left + 64 * k * step)
                for i in range(min(width - 64 * k, 64)):
                    word |= u8((packed[y, x >> u8(3)] >> np.uint8(x & u8(7))) & np.uint8(1)) << u8(i)
                    x += u8(step)
            out[k, r] = word


@kernel
def _against_mask(mask, hidden, top, left, step, width, square, parts, points, radius, counts, bare):
    """Count the pixels of `PartView` for parts (P, W, h), drawn at every step-th pixel of a packed mask (H, B) from row
    top and column left on.

    hidden: (H, B) ignored pixels, (0, 0): none.
    square: spans of 3 x 3 pixels.
    points, radius: (N, 2) and (N,) in the drawn pixels.
    counts: (3, P) gets area, exposed and outside.
    bare: (N,) gets the bare pixels.
    parts: parts[0] holds all parts afterwards.
    """
    n, words, h = parts.shape
    room, box = np.zeros((5, words, h), np.uint64), np.zeros(4, np.int64)
    no, shut, made, close, found = room[0], room[1], room[2], room[3], room[4]
    box[1], box[3] = h, width
    for k in range(2):
        packed = hidden if k else mask
        if packed.shape[0]:
            _thin(packed, top, left, step, width, room[k])
    for k in range(words):
        for r in range(h):
            made[k, r] = no[k, r] | shut[k, r]
            no[k, r] = ~no[k, r] | shut[k, r]  # where no mask may be bare
    for last in range(2):  # pixels far from the mask; then, of the mask, those far from the body
        grown(made, square, box, u8(0), close)
        for k in range(words):
            for r in range(h):
                near = close[k, r] | no[k, r] if last else close[k, r]
                made[k, r] = ~near
        opened(made, square, box, found)
        if last:
            break
        for k in range(words):
            for r in range(h):
                once, twice = u8(0), u8(0)
                for p in range(n):
                    twice |= once & parts[p, k, r]
                    once |= parts[p, k, r]
                made[k, r] = once
                if once == u8(0):
                    continue
                alone, out = ~(shut[k, r] | twice), found[k, r]
                for p in range(n):
                    word = parts[p, k, r]
                    if word:
                        counts[0, p] += popcount(word)
                        counts[1, p] += popcount(word & alone)
                        counts[2, p] += popcount(word & out)
                parts[0, k, r] = once
    for k in range(words):
        for r in range(h):
            word = found[k, r]
            while word:
                x = 64 * k + lowest_bit(word)
                word &= word - u8(1)
                for i in range(points.shape[0]):
                    dx, dy = x - points[i, 0], r - points[i, 1]
                    bare[i] += dx * dx + dy * dy < radius[i] * radius[i]

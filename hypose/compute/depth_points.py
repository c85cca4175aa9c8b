"""Extract from a depth map the points of a person's surface, medians of its parts, and fill its holes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.geometry import Array

Box = tuple[int, int, int, int]
f4 = np.float32
_AROUND = 2
"""px around a point that are read."""
_LEAST_COSINE = 0.05
_NINE = np.ones((3, 3), np.uint8)
_CROSS = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]])
"""Rows and columns from a pixel to itself and to those right of it, left, below and above."""


def points_of_surface(
    depth: NDArray[np.float32], person: NDArray[np.uint8], box: Box, k: ArrayLike, jump_m: float, count: int
) -> tuple[Array, Array, Array]:
    """Sample points of a person's surface from a depth map, evenly over the person.

    depth: (h, w) m, 0 = hole.
    person: (h, w) 0/1.
    box: x0, y0, x1, y1 around the person (half open).
    k: (3, 3) intrinsic matrix of a pinhole camera, px.
    jump_m: least difference between neighbouring pixels of two surfaces, m.
    count: largest number of points.
    Returns: points (N, 3) m and unit outward normals (N, 3) in the camera's frame, and the cosine (N,) between normal
        and ray; N is at most count, 0 where nothing is found. A point is the median of 3 x 3 px without a hole or a
        jump, so that values between both sides of an edge are excluded; its normal is that of the neighbouring medians,
        which must lie on the surface too.
    """
    h, w = depth.shape
    x0, y0 = max(box[0], _AROUND), max(box[1], _AROUND)
    x1, y1 = min(box[2], w - _AROUND), min(box[3], h - _AROUND)
    if x0 >= x1 or y0 >= y1:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    # with two more pixels around the box, so that nothing depends on how OpenCV extends a picture
    part = np.ascontiguousarray(depth[y0 - _AROUND : y1 + _AROUND, x0 - _AROUND : x1 + _AROUND])
    low, high = cv2.erode(part, _NINE), cv2.dilate(part, _NINE)
    of_person = person[y0 - _AROUND : y1 + _AROUND, x0 - _AROUND : x1 + _AROUND] != 0
    sound = (low > 0) & (high - low < f4(jump_m)) & of_person
    y, x = np.nonzero(sound[_AROUND:-_AROUND, _AROUND:-_AROUND])
    y, x = y + _AROUND, x + _AROUND
    middle, lens = cv2.medianBlur(part, 3), np.asarray(k, dtype=np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]
    # the pixels in equal parts, in row order: of each part the first one is taken whose surface is smooth
    count = min(len(y), count)
    ends = np.arange(count + 1) * len(y) // max(count, 1)
    at, last = ends[:-1].copy(), ends[1:]
    points, normals, cosines = np.empty((count, 3)), np.empty((count, 3)), np.full(count, -np.inf)
    left = np.arange(count)
    while len(left):
        v, u = y[at[left]] + _CROSS[:, :1], x[at[left]] + _CROSS[:, 1:]
        z = middle[v, u]
        smooth = ((z > 0) & (np.abs(z - z[0]) < f4(jump_m))).all(0)
        across, down = (u + (x0 - _AROUND) - lens[2]) / lens[0] * z, (v + (y0 - _AROUND) - lens[3]) / lens[1] * z
        place = np.stack([across, down, z], -1)
        normal = np.cross(place[3] - place[4], place[1] - place[2])  # x right, y down: it points to the camera
        length = np.linalg.norm(normal, axis=1)
        cosine = -(normal * place[0]).sum(1) / np.maximum(length * np.linalg.norm(place[0], axis=1), 1e-12)
        good = smooth & (cosine > _LEAST_COSINE)
        found = left[good]
        points[found], cosines[found] = place[0, good], cosine[good]
        normals[found] = normal[good] / length[good, None]
        at[left] += 1
        left = left[~good & (at[left] < last[left])]
    made = cosines > 0
    return points[made], normals[made], cosines[made]


def middle_of_piece(labels: NDArray[np.integer], label: int, depth: NDArray[np.float32]) -> float:
    """Compute the median of a depth map (h, w) m over the pixels of a label (h, w); NaN where all are holes."""
    return middle(depth[(labels == label) & (depth > 0)])


def middle(values: NDArray[np.float32]) -> float:
    """Compute the median of finite values (N,), faster than np.median; NaN for none."""
    n = len(values)
    if not n:
        return float("nan")
    ordered = np.partition(values, n // 2)  # partitioning at two places takes twice as long
    upper = ordered[n // 2]
    return float(upper) if n % 2 else float((ordered[: n // 2].max() + upper) / np.float32(2))


def holes_filled(mask: NDArray[np.uint8], depth: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Fill the holes of a mask where the depth map has no value.

    mask: (h, w) 0/1.
    depth: (h, w) m, 0 = no value.
    solid: (h, w) True where a hole is filled if a closing of 5 px covers it; elsewhere a closing of 3 px.
    Returns: the mask (h, w).
    """
    own = (mask != 0).view(np.uint8)
    five, three = (cv2.morphologyEx(own, cv2.MORPH_CLOSE, np.ones((n, n), np.uint8)) for n in (5, 3))
    return own | (np.where(solid, five, three) & (depth <= 0))

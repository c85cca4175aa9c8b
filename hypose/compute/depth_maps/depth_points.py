"""What a depth map shows of a person's surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.native import native, plain

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]


def points_of_surface(
    depth: NDArray[np.float32], person: NDArray[np.uint8], box: Box, k: ArrayLike, jump_m: float, count: int
) -> tuple[Array, Array, Array]:
    """At most `count` points (N, 3) m of the person's surface, evenly over the person, unit outward normals (N, 3),
    both in the camera's frame, and the cosine (N,) between normal and ray.

    depth (h, w) m, 0 = hole; person (h, w) 0/1 and the box x0, y0, x1, y1 around it (half open); k (3, 3) of a pinhole
    camera. A point is the median of 3 x 3 px without a hole or a jump of jump_m, so values between both sides of an
    edge are none."""
    lens = np.asarray(k, dtype=np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]
    points, normals, cosines = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    at = np.array(box, dtype=np.int64)
    find = native("depth_maps.depth_points").surface_points
    n = find(plain(depth, np.float32), plain(person, np.uint8), at, lens, float(jump_m), points, normals, cosines)
    return points[:n], normals[:n], cosines[:n]


def before_room(
    depth: NDArray[np.float32], room: NDArray[np.float32], sd: NDArray[np.float32], sds: float, least_m: float
) -> NDArray[np.uint8]:
    """(h, w) 1 where a depth map (h, w) m lies before the empty room (h, w), 0 = not known, by more than `sds` of its
    standard deviations (h, w) and least_m."""
    out = np.empty(depth.shape, np.uint8)
    given = plain(depth, np.float32), plain(room, np.float32), plain(sd, np.float32)
    native("depth_maps.depth_points").before_room(*given, np.float32(sds), np.float32(least_m), out)
    return out

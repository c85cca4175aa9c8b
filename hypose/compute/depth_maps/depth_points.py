"""What a depth map shows of a person's surface."""

from __future__ import annotations

from collections.abc import Callable

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


def things_before(
    room: NDArray[np.float32],
    person: NDArray[np.uint8],
    corner: tuple[int, int],
    camera: tuple[ArrayLike, ArrayLike],
    limit_m: float,
    floor_m: float,
    calm: Callable[[NDArray[np.uint8]], NDArray[np.uint8]],
) -> tuple[NDArray[np.uint8], int]:
    """(h, w) 1 where a room (h, w) m is known and nearer than limit_m, higher than floor_m and not the person's (h, w),
    and how many pixels these are. corner: px x, y of the map at which the arrays begin; camera: K (3, 3) and
    camera_from_world (4, 4); calm: takes single pixels away, before the floor is."""
    kernels, out = native("depth_maps.depth_points"), np.empty(room.shape, np.uint8)
    empty = plain(room, np.float32)
    kernels.free_before(empty, plain(person, np.uint8), np.float32(limit_m), out)
    out = plain(calm(out), np.uint8)
    lens = np.asarray(camera[0], dtype=np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]
    pose = np.asarray(camera[1], dtype=np.float64)
    up = np.append(pose[:3, 2], -(pose[:3, 3] @ pose[:3, 2]))
    return out, int(kernels.without_floor(out, empty, *corner, lens, up, float(floor_m)))


def middle_of_piece(labels: NDArray[np.integer], label: int, depth: NDArray[np.float32]) -> float:
    """m: median of what a depth map (h, w) m shows at the pixels of a label (h, w); NaN where all are holes."""
    values = np.empty(depth.size + 1, np.float32)
    n = native("depth_maps.depth_points").measured(plain(labels, np.int32), label, plain(depth, np.float32), values)
    return middle(values[:n])


def middle(values: NDArray[np.float32]) -> float:
    """np.median of finite values (N,), sooner; NaN of none."""
    n = len(values)
    if not n:
        return float("nan")
    ordered = np.partition(values, n // 2)  # two places at once take twice as long
    upper = ordered[n // 2]
    return float(upper) if n % 2 else float((ordered[: n // 2].max() + upper) / np.float32(2))


def extents_of_pieces(
    labels: NDArray[np.integer], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Of the labels 0 to count - 1 of labels (h, w): pixels (count,), 0 of the label 0, first column (count,), and the
    one after the last (count,)."""
    areas, left, right = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    native("depth_maps.depth_points").extents(plain(labels, np.int32), areas, left, right)
    return areas, left, right


def holes_filled(mask: NDArray[np.uint8], depth: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(h, w) 0/1: a mask (h, w) with the holes of a depth map (h, w) m that it closes over (a morphological closing of
    5 px where solid (h, w), else of 3 px)."""
    out = np.empty(mask.shape, np.uint8)
    given = plain(mask, np.uint8), plain(depth, np.float32), plain(solid, np.bool_).view(np.uint8)
    native("depth_maps.depth_points").holes_filled(*given, out)
    return out

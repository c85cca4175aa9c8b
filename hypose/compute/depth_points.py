"""Extract from a depth map the points of a person's surface, and the things in front of an empty room."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.arrays import plain
from hypose.compute.compiled import kernel
from hypose.geometry import Array

Box = tuple[int, int, int, int]
f4 = np.float32
_AROUND = 2
"""px around a point that are read."""
_LEAST_COSINE = 0.05


def points_of_surface(
    depth: NDArray[np.float32], person: NDArray[np.uint8], box: Box, k: ArrayLike, jump_m: float, count: int
) -> tuple[Array, Array, Array]:
    """Sample points of a person's surface from a depth map, evenly over the person.

    depth: (h, w) m, 0 = hole.
    person: (h, w) 0/1.
    box: x0, y0, x1, y1 around the person (half open).
    k: (3, 3) of a pinhole camera.
    jump_m: least difference between neighbouring pixels of two surfaces, m.
    count: largest number of points.
    Returns: points (N, 3) m and unit outward normals (N, 3) in the camera's frame, and the cosine (N,) between normal
        and ray. A point is the median of 3 x 3 px without a hole or a jump, so that values between both sides of an
        edge are excluded.
    """
    lens = np.asarray(k, dtype=np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]
    points, normals, cosines = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    at = np.array(box, dtype=np.int64)
    find = _surface_points
    n = find(plain(depth, np.float32), plain(person, np.uint8), at, lens, float(jump_m), points, normals, cosines)
    return points[:n], normals[:n], cosines[:n]


def before_room(
    depth: NDArray[np.float32], room: NDArray[np.float32], sd: NDArray[np.float32], sds: float, least_m: float
) -> NDArray[np.uint8]:
    """Find the pixels at which a depth map lies in front of the empty room.

    depth, room, sd: (h, w) m: depth map, empty room (0 = not known), and standard deviation.
    sds, least_m: least distance, in standard deviations and in m.
    Returns: (h, w) 1 where it lies in front, or where the room is not known.
    """
    near = room - depth > np.maximum(np.float32(sds) * sd, np.float32(least_m))
    return ((near | (room <= 0)) & (depth > 0)).view(np.uint8)


def things_before(
    room: NDArray[np.float32],
    person: NDArray[np.uint8],
    corner: tuple[int, int],
    camera: tuple[ArrayLike, ArrayLike],
    limit_m: float,
    floor_m: float,
    calm: Callable[[NDArray[np.uint8]], NDArray[np.uint8]],
) -> tuple[NDArray[np.uint8], int]:
    """Find the pixels of things that are nearer than a limit, above the floor, and not of the person.

    room: (h, w) m, 0 = not known.
    person: (h, w) non-zero = person.
    corner: px x, y of the map at which the arrays begin.
    camera: K (3, 3) and camera_from_world (4, 4).
    limit_m: largest depth, m.
    floor_m: least height, m.
    calm: function that removes single pixels from a mask, before the floor is removed.
    Returns: (h, w) 1 at those pixels, and their number.
    """
    out = np.array(calm(((room > 0) & (room < limit_m) & (person == 0)).view(np.uint8)), dtype=np.uint8)
    v, u = np.nonzero(out)
    k, pose = (np.asarray(a, dtype=np.float64) for a in camera)
    z = room[v, u].astype(np.float64)
    across, down = (u + corner[0] - k[0, 2]) / k[0, 0] * z, (v + corner[1] - k[1, 2]) / k[1, 1] * z
    up = pose[:3, 2]
    out[v, u] = up[0] * across + up[1] * down + up[2] * z - pose[:3, 3] @ up >= floor_m
    return out, int(np.count_nonzero(out))


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


@kernel
def _median(depth, y, x, nine):
    """Compute the median of the 3 x 3 px about (x, y)."""
    n = 0
    for i in range(y - 1, y + 2):
        for j in range(x - 1, x + 2):
            value, k = depth[i, j], n
            while k > 0 and nine[k - 1] > value:
                nine[k] = nine[k - 1]
                k -= 1
            nine[k] = value
            n += 1
    return nine[4]


@kernel
def _sound(depth, person, x0, y0, x1, y1, jump, found):
    """Find the person's pixels in a box whose 3 x 3 px lie on one surface: no hole and no jump.

    found: (M,) gets their numbers y * w + x.
    Returns: number of pixels.
    """
    w = depth.shape[1]
    low, high = np.empty(w, np.float32), np.empty(w, np.float32)
    n = 0
    for y in range(y0, y1):
        above, row, below = depth[y - 1], depth[y], depth[y + 1]
        for x in range(x0 - 1, x1 + 1):
            low[x] = min(min(above[x], below[x]), row[x])
            high[x] = max(max(above[x], below[x]), row[x])
        for x in range(x0, x1):
            if person[y, x] != 0:
                least = min(min(low[x - 1], low[x + 1]), low[x])
                if least > f4(0) and max(max(high[x - 1], high[x + 1]), high[x]) - least < jump:
                    found[n] = y * w + x
                    n += 1
    return n


@kernel
def _surface_points(depth, person, box, lens, jump, points, normals, cosines):
    """Sample points of the person's surface as `points_of_surface`; return how many were found.

    box: x0, y0, x1, y1 around the person.
    lens: fx, fy, cx, cy.
    points, normals, cosines: (N, 3) m, (N, 3) and (N,) get the result.

    The normal of a point is that of the neighbouring medians, which must lie on the surface too.
    """
    height, width = depth.shape
    x0, y0 = max(box[0], _AROUND), max(box[1], _AROUND)
    x1, y1 = min(box[2], width - _AROUND), min(box[3], height - _AROUND)
    if x0 >= x1 or y0 >= y1:
        return 0
    found = np.empty((x1 - x0) * (y1 - y0), np.int64)
    n = _sound(depth, person, x0, y0, x1, y1, f4(jump), found)
    count = min(n, points.shape[0])
    nine, neighbours = np.empty(9, np.float32), np.empty((5, 3))
    made = 0
    for k in range(count):
        for i in range(k * n // count, (k + 1) * n // count):
            y, x = found[i] // width, found[i] % width
            z = _median(depth, y, x, nine)
            smooth = True
            for m in range(5):  # itself, right, left, below, above
                v, u = y + (1 if m == 3 else -1 if m == 4 else 0), x + (1 if m == 1 else -1 if m == 2 else 0)
                own = z if m == 0 else _median(depth, v, u, nine)
                if not own > f4(0) or abs(own - z) >= f4(jump):
                    smooth = False
                    break
                neighbours[m, 0], neighbours[m, 1] = (u - lens[2]) / lens[0] * own, (v - lens[3]) / lens[1] * own
                neighbours[m, 2] = own
            if not smooth:
                continue
            ax, ay, az = (
                neighbours[1, 0] - neighbours[2, 0],
                neighbours[1, 1] - neighbours[2, 1],
                neighbours[1, 2] - neighbours[2, 2],
            )
            bx, by, bz = (
                neighbours[3, 0] - neighbours[4, 0],
                neighbours[3, 1] - neighbours[4, 1],
                neighbours[3, 2] - neighbours[4, 2],
            )
            # x right, y down: the product looks away from the camera
            nx, ny, nz = az * by - ay * bz, ax * bz - az * bx, ay * bx - ax * by
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if not length > 1e-12:
                continue
            px, py, pz = neighbours[0, 0], neighbours[0, 1], neighbours[0, 2]
            cosine = -(nx * px + ny * py + nz * pz) / (length * math.sqrt(px * px + py * py + pz * pz))
            if not cosine > _LEAST_COSINE:
                continue
            points[made, 0], points[made, 1], points[made, 2] = px, py, pz
            normals[made, 0], normals[made, 1], normals[made, 2] = nx / length, ny / length, nz / length
            cosines[made] = cosine
            made += 1
            break
    return made

"""numba: points of the surface that a depth map shows of a person, and what lies before an empty room."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel

f4 = np.float32
_AROUND = 2
"""px about a point that are looked at"""
_LEAST_COSINE = 0.05


@kernel
def _median(depth, y, x, nine):
    """Median of the 3 x 3 px about (x, y)."""
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
    """found (M,): number y * w + x of the person's pixels in a box whose 3 x 3 px lie on one surface: no hole, and no
    jump. Returns how many."""
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
def surface_points(depth, person, box, lens, jump, points, normals, cosines):
    """Points (N, 3) m and unit outward normals (N, 3), both in the camera's frame, and cosines (N,) between normal and
    ray, of places evenly over the person in a map (h, w) f4 m; returns how many were found.

    box: x0, y0, x1, y1 around the person; lens: fx, fy, cx, cy. A place is the median of 3 x 3 px that lie on one
    surface, its normal is that of the medians beside it, which must lie on the surface too."""
    height, width = depth.shape
    x0, y0 = max(box[0], _AROUND), max(box[1], _AROUND)
    x1, y1 = min(box[2], width - _AROUND), min(box[3], height - _AROUND)
    if x0 >= x1 or y0 >= y1:
        return 0
    found = np.empty((x1 - x0) * (y1 - y0), np.int64)
    n = _sound(depth, person, x0, y0, x1, y1, f4(jump), found)
    count = min(n, points.shape[0])
    nine, beside = np.empty(9, np.float32), np.empty((5, 3))
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
                beside[m, 0], beside[m, 1] = (u - lens[2]) / lens[0] * own, (v - lens[3]) / lens[1] * own
                beside[m, 2] = own
            if not smooth:
                continue
            ax, ay, az = (beside[1, 0] - beside[2, 0], beside[1, 1] - beside[2, 1], beside[1, 2] - beside[2, 2])
            bx, by, bz = (beside[3, 0] - beside[4, 0], beside[3, 1] - beside[4, 1], beside[3, 2] - beside[4, 2])
            # x right, y down: the product looks away from the camera
            nx, ny, nz = az * by - ay * bz, ax * bz - az * bx, ay * bx - ax * by
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if not length > 1e-12:
                continue
            px, py, pz = beside[0, 0], beside[0, 1], beside[0, 2]
            cosine = -(nx * px + ny * py + nz * pz) / (length * math.sqrt(px * px + py * py + pz * pz))
            if not cosine > _LEAST_COSINE:
                continue
            points[made, 0], points[made, 1], points[made, 2] = px, py, pz
            normals[made, 0], normals[made, 1], normals[made, 2] = nx / length, ny / length, nz / length
            cosines[made] = cosine
            made += 1
            break
    return made


@kernel
def before_room(depth, room, sd, sds, least, out):
    """out (h, w) u1 = 1 where a map (h, w) f4 m lies before the room (h, w), 0 where that is not known, by more than
    `sds` times its sd (h, w), and by `least`."""
    for y in range(depth.shape[0]):
        own, empty, wide, to = depth[y], room[y], sd[y], out[y]
        for x in range(depth.shape[1]):
            near = (empty[x] - own[x] > max(sds * wide[x], least)) | (empty[x] <= f4(0))
            to[x] = near & (own[x] > f4(0))


@kernel
def free_before(room, person, limit, out):
    """out (h, w) u1 = 1 where a room (h, w) f4 m is known and nearer than `limit`, and no person (h, w) is."""
    for y in range(room.shape[0]):
        empty, own, to = room[y], person[y], out[y]
        for x in range(room.shape[1]):
            to[x] = np.uint8((empty[x] > f4(0)) & (empty[x] < limit) & (own[x] == 0))


@kernel
def without_floor(before, room, left, top, lens, up, floor):
    """Clears the pixels of before (h, w) u1 at which a room (h, w) f4 m lies lower than `floor` m; returns how many
    are left.

    left, top: px of the map at which the arrays begin; lens: fx, fy, cx, cy; up (4,): height of a point x, y, z of the
    camera's frame is up[0] x + up[1] y + up[2] z + up[3]."""
    count = 0
    for y in range(before.shape[0]):
        for x in range(before.shape[1]):
            if before[y, x] != 0:
                z = np.float64(room[y, x])
                across, down = (x + left - lens[2]) / lens[0] * z, (y + top - lens[3]) / lens[1] * z
                before[y, x] = up[0] * across + up[1] * down + up[2] * z + up[3] >= floor
                count += before[y, x]
    return count


@kernel
def measured(labels, label, depth, out):
    """out (M,) f4: the values of depth (h, w) f4 m that are known at the pixels with a label, of labels (h, w) i4;
    returns how many."""
    n = 0
    for y in range(depth.shape[0]):
        own, values = labels[y], depth[y]
        for x in range(depth.shape[1]):
            out[n] = values[x]
            n += (own[x] == label) & (values[x] > f4(0))
    return n


@kernel
def extents(labels, areas, left, right):
    """Of each label of labels (h, w) i4, 0 left out: areas (n,), its pixels, and left, right (n,), its first column and
    the one after its last."""
    areas[:] = 0
    left[:] = labels.shape[1]
    right[:] = 0
    for y in range(labels.shape[0]):
        own = labels[y]
        for x in range(labels.shape[1]):
            k = own[x]
            if k != 0:
                areas[k] += 1
                left[k] = min(left[k], x)
                right[k] = max(right[k], x + 1)


@kernel
def _grown(mask, across, other, out):
    """out (h, w) u1: mask (h, w) u1 of 0 and 1 with what is not `other` grown by a pixel each way; its rim stays;
    across: scratch."""
    h, w = mask.shape
    for y in range(h):
        own, to = mask[y], across[y]
        for x in range(1, w - 1):
            to[x] = (own[x - 1] ^ other) | (own[x] ^ other) | (own[x + 1] ^ other)
    for y in range(1, h - 1):
        above, own, below, to = across[y - 1], across[y], across[y + 1], out[y]
        for x in range(1, w - 1):
            to[x] = (above[x] | own[x] | below[x]) ^ other


@kernel
def holes_filled(mask, depth, solid, out):
    """out (h, w) u1 = 1 at the pixels of mask (h, w) u1, and at the holes of depth (h, w) f4 m that it closes over: of
    5 px where solid (h, w) u1 says so, else of 3 px. What lies outside of the picture says nothing."""
    h, w = mask.shape
    wide, narrow = np.zeros((h + 2, w + 2), np.uint8), np.ones((h + 2, w + 2), np.uint8)
    once, twice = np.zeros((h + 2, w + 2), np.uint8), np.ones((h + 2, w + 2), np.uint8)
    across = np.empty((h + 2, w + 2), np.uint8)
    for y in range(h):
        own, to = mask[y], wide[y + 1]
        for x in range(w):
            to[x + 1] = own[x] != 0
    _grown(wide, across, np.uint8(0), once)
    _grown(once, across, np.uint8(0), twice)  # twice of 3 px are 5
    for a in (once, twice):
        a[0, :], a[h + 1, :], a[:, 0], a[:, w + 1] = 1, 1, 1, 1
    _grown(once, across, np.uint8(1), narrow)
    _grown(twice, across, np.uint8(1), once)
    _grown(once, across, np.uint8(1), twice)
    for y in range(h):
        own, seen, whole, to = wide[y + 1], depth[y], solid[y], out[y]
        five, three = twice[y + 1], narrow[y + 1]
        for x in range(w):
            closed = five[x + 1] if whole[x] != 0 else three[x + 1]
            to[x] = own[x + 1] | (closed & np.uint8(seen[x] <= f4(0)))

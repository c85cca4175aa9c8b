"""numba: rays against capsules, for simulated depth sensors."""

from __future__ import annotations

import math

from hypose.compute.compiled import kernel

FAR = 1e9
"""Distance along a ray that meets nothing."""


@kernel
def _capsule(origin, dx, dy, dz, capsule, c):
    """Distance along a unit ray to capsule c (a, b, radius), FAR when it misses. After I. Quilez's closed form."""
    ax, ay, az = capsule[c, 0], capsule[c, 1], capsule[c, 2]
    bx, by, bz = capsule[c, 3] - ax, capsule[c, 4] - ay, capsule[c, 5] - az
    ox, oy, oz = origin[0] - ax, origin[1] - ay, origin[2] - az
    r2 = capsule[c, 6] * capsule[c, 6]
    length = bx * bx + by * by + bz * bz
    if length > 1e-12:
        bd = bx * dx + by * dy + bz * dz
        bo = bx * ox + by * oy + bz * oz
        rd = dx * ox + dy * oy + dz * oz
        oo = ox * ox + oy * oy + oz * oz
        a = length - bd * bd
        q = length * rd - bo * bd
        s = q * q - a * (length * oo - bo * bo - r2 * length)
        if a > 1e-12:
            if s < 0:
                return FAR
            t = (-q - math.sqrt(s)) / a
            y = bo + t * bd
            if 0 < y < length and t > 0:
                return t
            if y > 0:
                ox, oy, oz = ox - bx, oy - by, oz - bz
    rd = dx * ox + dy * oy + dz * oz
    s = rd * rd - (ox * ox + oy * oy + oz * oz - r2)
    if s > 0:
        t = -rd - math.sqrt(s)
        if t > 0:
            return t
    return FAR


@kernel
def cast_rays(origin, directions, capsules, out):
    """Unit directions (N, 3) from origin (3,) against capsules (C, 7) = a, b, radius in m -> out (N,) distance along
    the ray to the first surface, FAR when there is none."""
    for n in range(directions.shape[0]):
        nearest = FAR
        for c in range(capsules.shape[0]):
            t = _capsule(origin, directions[n, 0], directions[n, 1], directions[n, 2], capsules, c)
            if t < nearest:
                nearest = t
        out[n] = nearest


@kernel
def seen_share(origin, joints, offsets, capsules, own, margin, out):
    """Share of the points joint + offset (offsets (Q, 3) m) that a sensor at origin sees: joints (J, 3), capsules
    (C, 7), own (J, C): capsules that hold the joint and never hide it -> out (J,)."""
    for j in range(joints.shape[0]):
        seen = 0
        for q in range(offsets.shape[0]):
            dx = joints[j, 0] + offsets[q, 0] - origin[0]
            dy = joints[j, 1] + offsets[q, 1] - origin[1]
            dz = joints[j, 2] + offsets[q, 2] - origin[2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            hidden = False
            for c in range(capsules.shape[0]):
                if not own[j, c] and _capsule(origin, dx / d, dy / d, dz / d, capsules, c) < d - margin:
                    hidden = True
                    break
            if not hidden:
                seen += 1
        out[j] = seen / offsets.shape[0]

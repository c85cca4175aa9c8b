"""Find which bone a vertex sees through the inside of its mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel


def nearest_visible(
    vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike, closest: ArrayLike, distance: ArrayLike
) -> NDArray[np.bool_]:
    """Find the nearest line segments (bones) that each vertex sees through the inside of the mesh.

    vertices, faces, normals: (V, 3), (F, 3), and (V, 3) outward unit normals.
    closest: (V, B, 3) point of segment b nearest to vertex v.
    distance: (V, B) to that point.
    Returns: (V, B) True where segment b is the nearest one that vertex v sees, or as near as that; all False for a
        vertex that sees none.

    A segment is seen where no face without the vertex lies between the two, and the way does not start outwards. Why
    the second condition: where a hand is pressed into a thigh, no face lies between the thigh's skin and the hand's
    bone.
    Source: the visibility test of Baran & Popovic 2007, section 4. Deviation: a ray test instead of a distance field,
        and the nearest of the visible bones instead of the nearest bone if it is visible.
    """
    v, n, c, d = (np.ascontiguousarray(a, dtype=np.float64) for a in (vertices, normals, closest, distance))
    f = np.ascontiguousarray(faces, dtype=np.int64)
    near, corners = np.zeros(d.shape, dtype=np.bool_), v[f]
    centre = corners.mean(1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(1)
    _nearest_visible(v, f, n, c, d, centre, radius, near)
    return near


TIE = 1.0001  # segments that share an end are equally far up to rounding
LEAVE, ARRIVE = 1e-3, 1e-6  # shares of the way that are not tested: the vertex's own surface, the bone itself
OUTWARD = 0.0  # largest cosine between the way to a bone and the outward normal


@kernel
def _blocked(origin, way, own, vertices, faces, centre, radius):
    """Return whether a face that does not contain the vertex `own` lies across the path origin + t way, 0 < t < 1.

    origin, way: (3,) m.
    own: index of a vertex.
    vertices, faces: (V, 3) m and (F, 3).
    centre, radius: (F, 3) and (F,) m, a sphere around each face.
    """
    ox, oy, oz = origin[0], origin[1], origin[2]
    dx, dy, dz = way[0], way[1], way[2]
    length2 = dx * dx + dy * dy + dz * dz
    if length2 < 1e-18:
        return False
    for f in range(len(faces)):
        wx, wy, wz = centre[f, 0] - ox, centre[f, 1] - oy, centre[f, 2] - oz
        t = (wx * dx + wy * dy + wz * dz) / length2
        t = min(max(t, 0.0), 1.0)
        wx -= t * dx
        wy -= t * dy
        wz -= t * dz
        if wx * wx + wy * wy + wz * wz > radius[f] * radius[f]:
            continue
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if i == own or j == own or k == own:
            continue
        # Moeller & Trumbore 1997
        ax, ay, az = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        e1x, e1y, e1z = vertices[j, 0] - ax, vertices[j, 1] - ay, vertices[j, 2] - az
        e2x, e2y, e2z = vertices[k, 0] - ax, vertices[k, 1] - ay, vertices[k, 2] - az
        px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
        det = e1x * px + e1y * py + e1z * pz
        if abs(det) < 1e-16:
            continue
        sx, sy, sz = ox - ax, oy - ay, oz - az
        u = (sx * px + sy * py + sz * pz) / det
        if u < 0 or u > 1:
            continue
        qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
        v = (dx * qx + dy * qy + dz * qz) / det
        if v < 0 or u + v > 1:
            continue
        t = (e2x * qx + e2y * qy + e2z * qz) / det
        if t > ARRIVE and t < 1 - ARRIVE:
            return True
    return False


@kernel
def _nearest_visible(vertices, faces, normals, closest, distance, centre, radius, near):
    """Mark in near (V, B) the nearest visible segments of each vertex, ties included; see `nearest_visible`.

    vertices, faces, normals, closest, distance: as in `nearest_visible`.
    centre, radius: (F, 3) and (F,) m, a sphere around each face.
    """
    origin, way = np.empty(3), np.empty(3)
    for i in range(len(vertices)):
        order = np.argsort(distance[i])
        found = -1.0
        for b in order:
            if found >= 0 and distance[i, b] > found * TIE:
                break
            out = 0.0
            for k in range(3):
                way[k] = closest[i, b, k] - vertices[i, k]
                out += way[k] * normals[i, k]
                origin[k] = vertices[i, k] + LEAVE * way[k]
                way[k] *= 1 - LEAVE
            if out > OUTWARD * distance[i, b]:
                continue
            if not _blocked(origin, way, i, vertices, faces, centre, radius):
                near[i, b] = True
                if found < 0:
                    found = distance[i, b]

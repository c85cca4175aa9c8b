"""Which bone a vertex sees through the inside of its mesh: definition (numpy) and choice of the back end."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import selection
from hypose.compute.native import native

# the same constants as in cpu_visibility.py, which must not be imported without numba
_TIE, _LEAVE, _ARRIVE, _OUTWARD = 1.0001, 1e-3, 1e-6, 0.0


def nearest_visible(
    vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike, closest: ArrayLike, distance: ArrayLike
) -> NDArray[np.bool_]:
    """(V, B): segment b is the nearest one that vertex v sees, or as near as that.

    vertices (V, 3), faces (F, 3), outward unit normals (V, 3); closest (V, B, 3): the point of segment b nearest to
    vertex v, distance (V, B) to it. Seen: no face that does not contain the vertex lies between the two, and the way
    does not start outwards: where a hand is pressed into a thigh, the thigh's skin has the hand's bone before it
    without a face between. Rows of a vertex that sees none are False.
    Source: the visibility test of Baran & Popovic 2007, section 4; deviation: a ray test instead of a distance field,
    and the nearest of the visible bones instead of the nearest bone if it is visible.
    """
    v, n, c, d = (np.ascontiguousarray(a, dtype=np.float64) for a in (vertices, normals, closest, distance))
    f = np.ascontiguousarray(faces, dtype=np.int64)
    if selection.backend() == "numpy":
        return _reference(v, f, n, c, d)
    near = np.zeros(d.shape, dtype=np.bool_)
    native("pictures.visibility").nearest_visible(v, f, n, c, d, near)
    return near


def _reference(v: NDArray, f: NDArray, normals: NDArray, closest: NDArray, distance: NDArray) -> NDArray[np.bool_]:
    near = np.zeros(distance.shape, dtype=np.bool_)
    a, e1, e2 = v[f[:, 0]], v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]
    for i in range(len(v)):
        found = -1.0
        for b in np.argsort(distance[i], kind="stable"):
            if found >= 0 and distance[i, b] > found * _TIE:
                break
            way = closest[i, b] - v[i]
            if way @ normals[i] > _OUTWARD * distance[i, b]:
                continue
            origin, way = v[i] + _LEAVE * way, way * (1 - _LEAVE)
            if way @ way >= 1e-18:
                p = np.cross(way, e2)
                det = (e1 * p).sum(1)
                s = origin - a
                q = np.cross(s, e1)
                with np.errstate(divide="ignore", invalid="ignore"):
                    u, w, t = (s * p).sum(1) / det, (q @ way) / det, (e2 * q).sum(1) / det
                hit = (np.abs(det) >= 1e-16) & (u >= 0) & (u <= 1) & (w >= 0) & (u + w <= 1)
                hit &= (t > _ARRIVE) & (t < 1 - _ARRIVE) & ~(f == i).any(1)
                if hit.any():
                    continue
            near[i, b] = True
            if found < 0:
                found = distance[i, b]
    return near

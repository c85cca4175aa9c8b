"""Where a person whom depth cameras see may be: the seen surface and what lies behind it."""

from __future__ import annotations

import numpy as np

from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth, back_projected, in_world, smooth_surface
from hypose.evidence.hull import Hull
from hypose.geometry import Array

_THICK_M, _VOXEL_M = 0.16, 0.03


def space_behind(depth: Depth, bounds: Array | None = None) -> Hull:
    """What the person may fill, in place of a visual hull: the surface and _THICK_M behind it, as far as it lies inside
    bounds (2, 3) m. An EvidenceError when no sensor shows anything."""
    found, rays = [], []
    for c in np.flatnonzero(depth.usable):
        w, h = depth.rig.sizes[c]
        z, sound = smooth_surface(np.ascontiguousarray(depth.maps[c, :h, :w]))
        v, u = np.nonzero(sound & (depth.person[c, :h, :w] > 0))
        points = in_world(depth.rig[int(c)], back_projected(depth.rig[int(c)], u, v, z[v, u]))
        ray = points - depth.rig[int(c)].position
        found.append(points)
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    if not sum(len(p) for p in found):
        raise EvidenceError("No depth camera shows a person; choose another frame, or record the empty room again.")
    seen, ray = np.concatenate(found), np.concatenate(rays)
    ray[:, 2] = 0  # feet and head are where they are seen
    behind = np.arange(0.0, _THICK_M, _VOXEL_M)
    points = (seen[:, None] + behind[:, None] * ray[:, None]).reshape(-1, 3)
    if bounds is not None:
        points = points[((points >= bounds[0]) & (points <= bounds[1])).all(1)]
    if not len(points):
        return Hull(np.zeros((1, 1, 1), dtype=np.bool_), np.zeros(3), _VOXEL_M)
    origin = points.min(0)
    index = np.rint((points - origin) / _VOXEL_M).astype(int)
    solid = np.zeros(index.max(0) + 1, dtype=np.bool_)
    solid[tuple(index.T)] = True
    return Hull(solid, origin, _VOXEL_M)

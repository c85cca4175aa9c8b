"""Depth as evidence: measured points on the person's surface, space that is known to be empty, and the floor.

A depth pixel means two things: the surface is there, within the sensor's noise; and nothing lies in front of it. Values
next to jumps of depth are mixtures of both sides (flying pixels) and are left out.
Source: noise model of Khoshelham & Elberink 2012 (grows with the square of the distance) and Nguyen, Izadi & Lovell
    2012 (grows at grazing angles).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute.depth_points import points_of_surface
from hypose.errors import EvidenceError
from hypose.geometry import Array, rotation_between, se3

POINTS = 200
"""number of surface points used of one sensor's map; more take time and give no new information"""
JUMP_M = 0.06
"""m: neighbours with a larger difference belong to different surfaces"""
_LEAST_COSINE, _CONSTANT_M, _SQUARE = 0.15, 0.0015, 0.0012


def depth_sd(z: ArrayLike, cosine: ArrayLike = 1.0) -> Array:
    """Compute the standard deviation of a depth sensor's noise.

    z: (...) distances along the optical axis, m.
    cosine: (...) cosine of the angle between ray and normal of the surface.
    Returns: (...) m: (constant + square z^2) / cosine. The constants are compared with real frames in docs/depth.md.
    """
    along = np.maximum(np.asarray(cosine, dtype=np.float64), _LEAST_COSINE)
    return (_CONSTANT_M + _SQUARE * np.asarray(z, dtype=np.float64) ** 2) / along


@dataclass(frozen=True)
class SurfacePoints:
    """Measured points on the person's surface in the world.

    points: (M, 3) m.
    normals: (M, 3) outward unit vectors.
    sd: (M,) standard deviation along the ray, m.
    first: (C + 1,) points first[c] to first[c + 1] are those of view c.
    """

    points: Array
    normals: Array
    sd: Array
    first: NDArray[np.int64]


@dataclass(frozen=True)
class Depth:
    """Depth maps of one instant, one per view of a rig.

    maps: (C, h, w) float32 m along the optical axis, 0 = hole, undistorted; views of different size are padded with 0,
        see `rig.sizes`.
    person: (C, h, w) uint8, 1 = the person.
    usable: (C,) False for a view without a map, for example one that is no depth camera.
    blank: (C,) True for depth cameras whose whole map is a hole; None: there are none.
    """

    maps: NDArray[np.float32]
    person: NDArray[np.uint8]
    rig: CameraRig
    usable: NDArray[np.bool_]
    blank: NDArray[np.bool_] | None = None

    def unseen(self) -> Depth:
        """Copy the maps and mark all views as not usable."""
        return replace(self, usable=np.zeros_like(self.usable))

    @cached_property
    def boxes(self) -> list[tuple[int, int, int, int]]:
        """Boxes x0, y0, x1, y1 (half open, px) around each view's person; all 0 where there is no person."""
        around = [cv2.boundingRect(own) for own in self.person]
        return [(x, y, x + w, y + h) for x, y, w, h in around]

    @cached_property
    def surface(self) -> SurfacePoints:
        """At most POINTS surface points of each usable view, evenly over its person."""
        found, first = [], [0]
        for c, camera in enumerate(self.rig):
            made = 0
            if self.usable[c]:
                w, h = camera.size
                seen = self.maps[c, :h, :w], self.person[c, :h, :w], self.boxes[c]
                points, normals, cosines = points_of_surface(*seen, camera.K, JUMP_M, POINTS)
                sd = depth_sd(points[:, 2], cosines)
                found.append((in_world(camera, points), normals @ camera.camera_from_world[:3, :3], sd))
                made = len(points)
            first.append(first[-1] + made)
        found = found or [(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
        points, normals, sd = (np.concatenate([f[k] for f in found]) for k in range(3))
        return SurfacePoints(points, normals, sd, np.array(first, dtype=np.int64))

    @cached_property
    def pixels(self) -> tuple[NDArray[np.int64], Array]:
        """Measured pixels of the person: view, row, column (N, 3), and their positions in the world (N, 3), m."""
        at = np.argwhere((self.person > 0) & (self.maps > 0) & self.usable[:, None, None])
        points = np.empty((len(at), 3))
        for c, camera in enumerate(self.rig):
            own = slice(*np.searchsorted(at[:, 0], (c, c + 1)))
            v, u = at[own, 1], at[own, 2]
            points[own] = in_world(camera, back_projected(camera, u, v, self.maps[c, v, u]))
        return at, points


def back_projected(camera: Camera, u: ArrayLike, v: ArrayLike, z: ArrayLike) -> Array:
    """Back-project pixels (...,) at z (...,) m along the optical axis of a pinhole camera; return (..., 3), m, in its
    frame.

    u, v: pixel coordinates.
    z: depth; arrays of one shape.
    """
    u, v, z = (np.asarray(a, dtype=np.float64) for a in (u, v, z))
    return np.stack([(u - camera.K[0, 2]) / camera.K[0, 0] * z, (v - camera.K[1, 2]) / camera.K[1, 1] * z, z], -1)


def in_world(camera: Camera, points_camera: Array) -> Array:
    """Transform points (..., 3), m, from the camera's frame to the world."""
    rotation, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    return (points_camera - shift) @ rotation


# ---- pose of a sensor from the floor -------------------------------------------------------------------------------
# Find the floor in a depth map: the upward direction, and the height of the sensor.


_DRAWS, _POINTS = 300, 4000
_NEAR_M, _TILTED = 0.02, np.cos(np.radians(50))
# share of the map that the floor must fill
_LEAST_SHARE = 0.04
# m: least distance of a floor below a table; cosine of the largest angle between two level planes
_BELOW_M, _LEVEL = 0.15, np.cos(np.radians(8))


def camera_on_floor(depth: NDArray[np.float32], camera: Camera) -> Array:
    """Estimate a sensor's pose from its depth map (h, w), m: floor at z = 0, sensor above the origin, looking along +y.

    The sensor must be upright within 50 degrees; the given camera's own pose is not used. Of several level planes (a
    table, the floor) the lowest is the floor.
    Returns: camera_from_world (4, 4).
    Raises: EvidenceError where no plane fills enough of the map.
    Source: Fischler & Bolles 1981 (random sample consensus).
    """
    v, u = np.nonzero(depth > 0)
    chosen = np.linspace(0, max(len(v) - 1, 0), min(_POINTS, len(v))).astype(int)
    v, u = v[chosen], u[chosen]
    points = back_projected(camera, u, v, depth[v, u])
    rng = np.random.default_rng(0)
    found = _plane(points, rng, _LEAST_SHARE * len(points))
    if found is None:
        raise EvidenceError(
            "The depth map shows no floor; turn the sensor so that it stands upright and sees the floor in front, or "
            "write a recording.toml with its place in the calibration."
        )
    normal, offset = found
    while True:
        below = points[points @ normal - offset < -_BELOW_M]
        lower = _plane(below, rng, _LEAST_SHARE * len(points)) if len(below) >= _LEAST_SHARE * len(points) else None
        if lower is None or lower[0] @ normal < _LEVEL:
            break
        normal, offset = lower
    # columns of rotation: the world's axes in the camera
    ahead = np.array([0, 0, 1.0]) - normal[2] * normal
    if np.linalg.norm(ahead) < 1e-3:
        ahead = rotation_between(np.array([0, 0, 1.0]), normal) @ np.array([0, 1.0, 0])
    ahead = ahead / np.linalg.norm(ahead)
    rotation = np.stack([np.cross(ahead, normal), ahead, normal], 1)
    return se3(rotation, offset * normal)


def _plane(points: Array, rng: np.random.Generator, least: float) -> tuple[Array, float] | None:
    """Fit the plane below the sensor that holds most of the points (N, 3), m, in the camera's frame.

    Returns: upward normal (3,) and offset; None where it holds fewer than `least` points.
    """
    if len(points) < 4:
        return None
    a, b, c = points[rng.integers(len(points), size=(3, _DRAWS))]
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    normals *= np.where(normals[:, 1:2] > 0, -1.0, 1.0)  # up: against y
    offsets, near = (normals * a).sum(1), _NEAR_M * (1 + points[:, 2] / 4)
    possible = (-normals[:, 1] >= _TILTED) & (offsets <= 0)  # a plane above the sensor is the ceiling
    counts = (np.abs(points @ normals.T - offsets) < near[:, None]).sum(0) * possible
    normal, offset = normals[counts.argmax()], float(offsets[counts.argmax()])
    if counts.max() < least or not possible.any():
        return None
    for _ in range(5):  # refit to all points in it
        inside = np.abs(points @ normal - offset) < near
        middle = points[inside].mean(0)
        own = np.linalg.svd(points[inside] - middle, full_matrices=False)[2][2]
        normal = own if own @ normal > 0 else -own
        offset = float(normal @ middle)
    return normal, offset

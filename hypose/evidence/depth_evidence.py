"""Depth: what depth cameras measure of a person, as points of the surface and as space that is known to be empty.

A depth pixel says two things: the surface is there, within the noise of the sensor; and nothing lies before it. Values
beside jumps of depth are mixtures of both sides (flying pixels), and are left out.
Source of the form of the noise: Khoshelham & Elberink 2012 (growing with the square of the distance); Nguyen, Izadi &
Lovell 2012 (growing at grazing angles).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.geometry import Array

POINTS = 200
"""points of the surface that are taken from one sensor's map; more cost time and tell nothing new"""
JUMP_M = 0.06
"""m: neighbours that lie further apart belong to different surfaces"""
_LEAST_COSINE = 0.15
_STEP = 1  # px to the neighbours that a normal is made of: forearms are six wide


@dataclass(frozen=True)
class DepthNoise:
    """sd (m) of one value at z m: constant + square z^2, divided by the cosine between the ray and the normal.

    The usual figures are checked against real frames in docs/depth.md."""

    constant: float = 0.0015
    square: float = 0.0012

    def sd(self, z: ArrayLike, cosine: ArrayLike = 1.0) -> Array:
        """(...,) m at distances z (...,) m, where the surface's normal has this cosine with the ray."""
        along = np.maximum(np.asarray(cosine, dtype=np.float64), _LEAST_COSINE)
        return (self.constant + self.square * np.asarray(z, dtype=np.float64) ** 2) / along


@dataclass(frozen=True)
class SurfacePoints:
    """Points (M, 3) m in the world on the person's surface, unit outward normals (M, 3), sd (M,) m along the ray, first
    (C + 1,): points first[c] to first[c + 1] are those of view c."""

    points: Array
    normals: Array
    sd: Array
    first: NDArray[np.int64]


@dataclass(frozen=True)
class Depth:
    """Depth maps of one instant, one per view of a rig; views that are no depth cameras are not usable.

    maps (C, h, w) float32 m along the optical axis, 0 = hole, undistorted; person (C, h, w) uint8, 1 = the person;
    views of different size are padded with 0, `rig.sizes` tells each view's own size. usable (C,): False for a view
    without a map. noise: of the sensors."""

    maps: NDArray[np.float32]
    person: NDArray[np.uint8]
    rig: CameraRig
    usable: NDArray[np.bool_]
    noise: DepthNoise = DepthNoise()

    def __post_init__(self) -> None:
        if self.maps.ndim != 3 or self.maps.shape != self.person.shape or len(self.maps) != len(self.rig):
            raise InputError(
                f"Depth of {len(self.rig)} views needs maps and person of shape ({len(self.rig)}, h, w), got "
                f"{self.maps.shape} and {self.person.shape}."
            )
        if self.usable.shape != (len(self.rig),):
            raise InputError(f"Depth needs one usable per view, {len(self.rig)}, got {self.usable.shape}.")

    @cached_property
    def surface(self) -> SurfacePoints:
        """At most POINTS points of each usable view, evenly over its person."""
        return surface_points(self, POINTS)

    @cached_property
    def centre(self) -> Array | None:
        """(3,) m: median of the surface's points, None when there are none."""
        return np.median(self.surface.points, axis=0) if len(self.surface.points) else None


def surface_points(depth: Depth, count: int) -> SurfacePoints:
    """At most `count` points per usable view of what the maps show of the person."""
    found, first = [], [0]
    for c in range(len(depth.rig)):
        w, h = depth.rig.sizes[c]
        made = _of_view(depth.maps[c, :h, :w], depth.person[c, :h, :w], depth.rig[c], depth.noise, count)
        if depth.usable[c]:
            found.append(made)
        first.append(first[-1] + (len(made[0]) if depth.usable[c] else 0))
    if not found:
        none = np.zeros((0, 3))
        return SurfacePoints(none, none, np.zeros(0), np.array(first, dtype=np.int64))
    points, normals, sd = (np.concatenate([f[k] for f in found]) for k in range(3))
    return SurfacePoints(points, normals, sd, np.array(first, dtype=np.int64))


def back_projected(camera: Camera, u: ArrayLike, v: ArrayLike, z: ArrayLike) -> Array:
    """(..., 3) m in the camera's frame: pixels (...,) at z (...,) m along the optical axis of a pinhole camera."""
    u, v, z = (np.asarray(a, dtype=np.float64) for a in (u, v, z))
    return np.stack([(u - camera.K[0, 2]) / camera.K[0, 0] * z, (v - camera.K[1, 2]) / camera.K[1, 1] * z, z], -1)


def in_world(camera: Camera, points_camera: Array) -> Array:
    """(..., 3) m in the world from points (..., 3) m in the camera's frame."""
    rotation, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    return (points_camera - shift) @ rotation


def smooth_surface(depth: NDArray[np.float32], jump_m: float = JUMP_M) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A map (h, w) m with the median of 3 x 3 px in place of every value, and where that stands on one surface: no
    hole and no jump among the 3 x 3 px."""
    kernel = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
    sound = (low > 0) & (high - low < jump_m)
    return np.asarray(cv2.medianBlur(depth, 3), dtype=np.float32), sound


def _of_view(
    depth: NDArray[np.float32], person: NDArray[np.uint8], camera: Camera, noise: DepthNoise, count: int
) -> tuple[Array, Array, Array]:
    rows, columns = np.flatnonzero(person.any(1)), np.flatnonzero(person.any(0))
    none = np.zeros((0, 3))
    if not len(rows):
        return none, none, np.zeros(0)
    # only the box around the person is looked at
    margin = _STEP + 2
    y0, x0 = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    box = slice(y0, int(rows[-1]) + margin + 1), slice(x0, int(columns[-1]) + margin + 1)
    z, sound = smooth_surface(np.ascontiguousarray(depth[box]))
    sound &= person[box] > 0
    s = _STEP
    if min(z.shape) <= 2 * s:
        return none, none, np.zeros(0)
    middle = z[s:-s, s:-s]
    inner = sound[s:-s, s:-s]
    for beside in (z[s:-s, : -2 * s], z[s:-s, 2 * s :], z[: -2 * s, s:-s], z[2 * s :, s:-s]):
        inner &= (beside > 0) & (np.abs(beside - middle) < JUMP_M)
    found = np.flatnonzero(inner)
    if not len(found):
        return none, none, np.zeros(0)
    pick = np.linspace(0, len(found) - 1, min(count, len(found))).round().astype(int)
    v, u = (k + s for k in np.divmod(found[pick], inner.shape[1]))
    # the pixel and the four beside it
    dv, du = np.array([0, 0, 0, s, -s])[:, None], np.array([0, s, -s, 0, 0])[:, None]
    points, right, left, down, up = back_projected(camera, u + x0 + du, v + y0 + dv, z[v + dv, u + du])
    across = np.cross(right - left, down - up)
    length = np.linalg.norm(across, axis=1)
    normals = -across / np.maximum(length, 1e-12)[:, None]  # x right, y down: the product looks away from the camera
    ray = points / np.linalg.norm(points, axis=1, keepdims=True)
    cosine = -(normals * ray).sum(1)
    facing = (length > 1e-12) & (cosine > 0.05)
    points, normals, cosine = points[facing], normals[facing], cosine[facing]
    sd = noise.sd(points[:, 2], cosine)
    return in_world(camera, points), normals @ camera.camera_from_world[:3, :3], sd

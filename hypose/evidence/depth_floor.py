"""Find the floor in a depth map: the upward direction, and the height of the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import back_projected
from hypose.geometry import Array, rotation_between, se3

_DRAWS, _POINTS = 300, 4000
_NEAR_M, _TILTED = 0.02, np.cos(np.radians(50))
_LEAST_SHARE = 0.04
"""share of the map that the floor must fill"""
_BELOW_M, _LEVEL = 0.15, np.cos(np.radians(8))
"""m: least distance of a floor below a table; cosine of the largest angle between two level planes"""


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
    best: tuple[int, Array, float] | None = None
    for _ in range(_DRAWS if len(points) > 3 else 0):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            continue
        normal = normal / length
        normal = -normal if normal[1] > 0 else normal  # up: against y
        if -normal[1] < _TILTED or normal @ a > 0:  # a plane above the sensor is the ceiling
            continue
        count = int((np.abs((points - a) @ normal) < _NEAR_M * (1 + points[:, 2] / 4)).sum())
        if best is None or count > best[0]:
            best = count, normal, float(normal @ a)
    if best is None or best[0] < least:
        return None
    _, normal, offset = best
    for _ in range(5):  # refit to all points in it
        inside = np.abs(points @ normal - offset) < _NEAR_M * (1 + points[:, 2] / 4)
        middle = points[inside].mean(0)
        own = np.linalg.svd(points[inside] - middle, full_matrices=False)[2][2]
        normal = own if own @ normal > 0 else -own
        offset = float(normal @ middle)
    return normal, offset

"""Simulate a structured-light depth sensor: draw the inverse depth of a known scene, then add the sensor's faults."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.zbuffer import draw_faces, inverse_depth

NEAR = 0.2
"""Triangles with a corner nearer than this (m) are not drawn."""
TABLE = 16384


def draw(
    points_camera: ArrayLike,
    faces: NDArray[np.int32],
    lens: tuple[float, float, float, float],
    inverse: NDArray[np.float32],
) -> None:
    """Draw triangles into a picture of inverse depth with a z-buffer, in place.

    points_camera: (V, 3) m in the camera's frame.
    faces: (F, 3), of either orientation.
    lens: fx, fy, cx, cy px.
    inverse: (h, w) 1/m, 0 = empty.
    """
    p = np.asarray(points_camera, dtype=np.float64)
    near = inverse_depth(p[:, 2], NEAR)
    draw_faces(p[:, :2] * near[:, None] * lens[:2] + lens[2:], near, faces, inverse)


def _tables() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw the normal and the uniform random numbers (TABLE,) that all frames share."""
    rng = np.random.default_rng(5)  # one long sequence that every frame enters at other places
    return rng.standard_normal(TABLE).astype(np.float32), rng.random(TABLE).astype(np.float32)


_NORMALS, _UNIFORMS = _tables()


def sense(
    inverse: NDArray[np.float32], fx: float, rng: np.random.Generator, baseline: float = 0.075
) -> NDArray[np.uint16]:
    """Simulate the depth picture of a drawn scene as the first Kinect delivers it.

    inverse: (h, w) inverse depth, 1/m.
    fx: focal length, px.
    rng: random generator of the noise.
    baseline: distance of the projector from the camera, m.
    Returns: (h, w) uint16 mm, 0 = hole.

    Simulated are a lateral jitter of 0.6 px, the shadow of the projector, noise of the disparity (smooth 0.03 and white
    0.05 px) and its steps of 1/8 px, holes on grazing surfaces and at random, and the range 0.5-7.5 m. The values are
    assumptions after published measurements of that sensor, not fitted to one.
    """
    h, w = inverse.shape
    smooth = rng.standard_normal((h // 8 + 2, w // 8 + 2)).astype(np.float32)
    first, second = np.moveaxis(rng.integers(0, TABLE, (h, 2)), 1, 0)[..., None]
    x, y = np.arange(w), np.arange(h)[:, None]

    def noise(table: NDArray[np.float32], begin: NDArray[np.int64], step: int, shift: int = 0) -> NDArray[np.float64]:
        """Read the random numbers (h, w) of a table from the places (h, 1) on at which the rows begin."""
        return table[(begin + x * step + shift) & (TABLE - 1)].astype(np.float64)

    # the projector stands next to the camera: going along the baseline, a point is lit only when it lies beyond every
    # column that was lit before it
    lit = np.where(inverse > 0, x + fx * baseline * inverse.astype(np.float64), -1e9)
    shown = (inverse <= 0) | (lit >= np.maximum.accumulate(lit, 1) - 1.5)
    across = np.clip((x + noise(_NORMALS, first, 3) * 0.6 + 0.5).astype(np.int64), 1, w - 2)
    down = np.clip((y + noise(_NORMALS, second, 5, 1) * 0.6 + 0.5).astype(np.int64), 1, h - 2)
    v = inverse[down, across].astype(np.float64)
    z = 1 / np.maximum(v, 1e-6)
    # the smaller of the two one-sided differences: else every silhouette would be a hole
    steps = (
        np.minimum(abs(inverse[down + a, across + b] - v), abs(v - inverse[down - a, across - b]))
        for a, b in ((0, 1), (1, 0))
    )
    slope = np.maximum(*steps) * z * fx
    shown &= (v >= 1 / 7.5) & (v <= 2.0)
    shown &= (slope <= 4) | (noise(_UNIFORMS, first, 7) >= np.minimum(0.85, (slope - 4) * 0.06))
    shown &= noise(_UNIFORMS, second, 11) >= 0.002 + 0.0008 * z * z
    d = fx * baseline * v + smooth[y // 8, x // 8] * 0.03 + noise(_NORMALS, second, 13, 5) * 0.05
    d = np.floor(d * 8 + 0.5) / 8
    shown &= d > 0
    millimetres = np.minimum(65535, 1000 * fx * baseline / np.where(shown, d, 1.0) + 0.5)
    return np.where(shown, millimetres, 0).astype(np.uint16)

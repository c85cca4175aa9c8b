"""Simulate a structured-light depth sensor: draw the inverse depth of a known scene, then add the sensor's faults."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel
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


@kernel
def _sense(inverse, fx, baseline, smooth, rows, normals, uniforms, out):
    """Convert a drawn scene to what the sensor delivers; see `sense`.

    inverse: (h, w) f4 inverse depth, 1/m; 0: nothing.
    fx, baseline: focal length, px, and distance of the projector, m.
    smooth: (h / 8 + 2, w / 8 + 2) f4 normal numbers of the smooth noise.
    rows: (h, 2) places in the tables at which each row begins.
    normals, uniforms: (TABLE,) f4 random numbers.
    out: (h, w) u2 gets mm, 0 = hole.
    """
    h, w = inverse.shape
    for y in range(h):
        reached = -1e9
        r, r2 = rows[y, 0], rows[y, 1]
        for x in range(w):
            out[y, x] = 0
            seen = inverse[y, x]
            # the projector stands next to the camera: going along the baseline, a point is lit only when it lies
            # beyond every column that was lit before it
            if seen > 0:
                lit = x + fx * baseline * seen
                if lit < reached - 1.5:
                    continue
                reached = max(reached, lit)
            n0, n1 = normals[(r + x * 3) & (TABLE - 1)], normals[(r2 + x * 5 + 1) & (TABLE - 1)]
            xx, yy = int(x + n0 * 0.6 + 0.5), int(y + n1 * 0.6 + 0.5)
            xx, yy = min(max(xx, 1), w - 2), min(max(yy, 1), h - 2)
            v = inverse[yy, xx]
            if v < 1 / 7.5 or v > 2.0:
                continue
            z = 1.0 / v
            # the smaller of the two one-sided differences: else every silhouette would be a hole
            ax = min(abs(inverse[yy, xx + 1] - v), abs(v - inverse[yy, xx - 1]))
            ay = min(abs(inverse[yy + 1, xx] - v), abs(v - inverse[yy - 1, xx]))
            slope = max(ax, ay) * z * fx
            if slope > 4 and uniforms[(r + x * 7) & (TABLE - 1)] < min(0.85, (slope - 4) * 0.06):
                continue
            if uniforms[(r2 + x * 11) & (TABLE - 1)] < 0.002 + 0.0008 * z * z:
                continue
            d = fx * baseline * v + smooth[y // 8, x // 8] * 0.03 + normals[(r2 + x * 13 + 5) & (TABLE - 1)] * 0.05
            d = np.floor(d * 8 + 0.5) / 8
            if d > 0:
                out[y, x] = min(65535, int(1000 * fx * baseline / d + 0.5))


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
    rows = rng.integers(0, TABLE, (h, 2))
    out = np.empty((h, w), np.uint16)
    _sense(inverse, float(fx), float(baseline), smooth, rows, _NORMALS, _UNIFORMS, out)
    return out

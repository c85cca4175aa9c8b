"""Cluttered backgrounds for a single camera: overlapping shapes and lines, texture, and one strong vertical edge."""

from __future__ import annotations

import cv2
import numpy as np

from hypose.geometry import Array
from hypose.synthetic.render_rgb import Backdrop

_SHAPES = 70
_PILLAR, _SHADE = 235.0, 40.0


def cluttered(size: tuple[int, int], pillar: tuple[float, float], rng: np.random.Generator) -> Backdrop:
    """A picture (width, height) = size full of edges that are nobody's: boxes and lines in all colours under a
    texture, and a white pillar with a dark side between the shares `pillar` of the width (the white pillar of
    Sminchisescu & Triggs 2001, section 6)."""
    s = 2  # drawn twice as large, so that edges are as soft as a lens makes them
    w, h = size[0] * s, size[1] * s
    image = np.full((h, w, 3), 110.0)
    for _ in range(_SHAPES):
        color = (rng.uniform(30, 220) + rng.normal(0, 15, 3)).tolist()
        x, y = rng.uniform(0, w), rng.uniform(0, h)
        a, b = rng.uniform(0.03, 0.2) * w, rng.uniform(0.03, 0.3) * h
        if rng.random() < 0.6:
            cv2.rectangle(image, (int(x), int(y)), (int(x + a), int(y + b)), color, -1)
        else:
            end = int(x + rng.normal(0, 2 * a)), int(y + rng.normal(0, b))
            cv2.line(image, (int(x), int(y)), end, color, int(rng.integers(2, 8)))
    for _ in range(3):
        cell = int(rng.integers(4, 20))
        image += cv2.resize(rng.normal(0, 9, (h // cell, w // cell)), (w, h), interpolation=cv2.INTER_CUBIC)[..., None]
    left, right = (round(p * w) for p in pillar)
    image[:, left:right] = _PILLAR + rng.normal(0, 2, (h, right - left, 1))
    image[:, right : right + round(0.012 * w)] = _SHADE
    small = cv2.resize(np.clip(image, 0, 255), size, interpolation=cv2.INTER_AREA)
    return Backdrop(
        np.asarray(small, dtype=np.float32),
        np.zeros((size[1], size[0]), dtype=np.bool_),
        np.full((size[1], size[0]), np.inf, dtype=np.float32),
    )


def woven(vertices: Array, rng: np.random.Generator, depth: float = 0.28) -> Array:
    """(V,) brightness factors of a solid texture that sticks to the surface of vertices (V, 3) m: optical flow has
    something to follow. Sums of plane waves of 3 to 15 cm."""
    total = np.zeros(len(vertices))
    bands = (18.0, 44.0, 90.0)
    for per_metre in bands:
        for _ in range(5):
            k = rng.normal(size=3)
            k *= per_metre * rng.uniform(0.7, 1.4) / np.linalg.norm(k)
            total += np.cos(vertices @ k + rng.uniform(0, 2 * np.pi)) / len(bands)
    return np.clip(1 + depth * total, 0.2, 1.8)

"""Shaded pictures of known scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.zbuffer import interpolate


def blend_shaded(
    picture: NDArray[np.float32],
    face: NDArray[np.int32],
    bary: NDArray[np.float32],
    faces: NDArray[np.int32],
    values: ArrayLike,
    samples: int,
    light: tuple[float, float, float],
) -> None:
    """Blend a drawn mesh into picture (h, w, 3), in place.

    face, bary: what `rasterize` drew at samples x samples per pixel.
    values (V, 5): BGR colour, cosine to the light, and upward component of the normal, per vertex.
    light: (ambient, direct, sky). A pixel gets the mean of its samples, Lambert-shaded, the picture showing through
        where there are none.
    """
    (h, w), drawn = picture.shape[:2], face >= 0
    ambient, direct, sky = (np.float32(x) for x in light)
    at = interpolate(face[drawn], bary[drawn], faces, values)
    lit = ambient + direct * np.maximum(at[:, 3:4], 0) + sky * at[:, 4:]
    colour = np.zeros((*face.shape, 3), np.float32)
    colour[drawn] = lit * at[:, :3]
    blocks = h, samples, w, samples
    picture *= 1 - drawn.reshape(blocks).mean((1, 3), dtype=np.float32)[..., None]
    picture += colour.reshape(*blocks, 3).mean((1, 3))


def darken(picture: NDArray[np.float32], shade: NDArray[np.float32], where: NDArray[np.bool_], depth: float) -> None:
    """picture (h, w, 3) *= 1 - depth * shade (h, w) where `where` (h, w), in place."""
    at = where & (shade > 0)
    picture[at] *= (1 - np.float32(depth) * shade[at])[:, None]


def expose(picture: NDArray[np.float32], gain: ArrayLike, noise: NDArray[np.int16]) -> NDArray[np.uint8]:
    """round(picture (h, w, 3) * gain (3,) + noise (h, w, 3)), clipped to 8 bit."""
    seen = picture * np.asarray(gain, dtype=np.float32)
    seen += noise
    seen += np.float32(0.5)
    return np.clip(seen, 0, 255, out=seen).astype(np.uint8)

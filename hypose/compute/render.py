"""Shaded pictures of known scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel


@kernel
def _blend(picture, face, bary, faces, values, s, ambient, direct, sky):
    h, w = picture.shape[0], picture.shape[1]
    share = np.float32(1.0 / (s * s))
    for y in range(h):
        for x in range(w):
            n = 0
            r0 = r1 = r2 = np.float32(0.0)
            for i in range(s):
                for k in range(s):
                    f = face[y * s + i, x * s + k]
                    if f < 0:
                        continue
                    n += 1
                    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                    w1, w2 = bary[y * s + i, x * s + k, 0], bary[y * s + i, x * s + k, 1]
                    w0 = np.float32(1.0) - w1 - w2
                    facing = w0 * values[a, 3] + w1 * values[b, 3] + w2 * values[c, 3]
                    up = w0 * values[a, 4] + w1 * values[b, 4] + w2 * values[c, 4]
                    lit = ambient + direct * max(facing, np.float32(0.0)) + sky * up
                    r0 += lit * (w0 * values[a, 0] + w1 * values[b, 0] + w2 * values[c, 0])
                    r1 += lit * (w0 * values[a, 1] + w1 * values[b, 1] + w2 * values[c, 1])
                    r2 += lit * (w0 * values[a, 2] + w1 * values[b, 2] + w2 * values[c, 2])
            if n:
                rest = np.float32(1.0) - n * share
                picture[y, x, 0] = rest * picture[y, x, 0] + share * r0
                picture[y, x, 1] = rest * picture[y, x, 1] + share * r1
                picture[y, x, 2] = rest * picture[y, x, 2] + share * r2


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

    face, bary: what `rasterize` drew at samples x samples per pixel; values (V, 5): BGR colour, cosine to the
    light, and upward component of the normal, per vertex; light: (ambient, direct, sky). A pixel gets the
    mean of its samples, Lambert-shaded, the picture showing through where there are none.
    """
    a, d, s = (np.float32(x) for x in light)
    v = np.ascontiguousarray(values, dtype=np.float32)
    _blend(picture, face, bary, np.ascontiguousarray(faces, dtype=np.int32), v, int(samples), a, d, s)


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

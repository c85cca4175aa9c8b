"""Z-buffer rasterizer for rendering known scenes: exact pixels of the truth mesh, with depth and interpolated
attributes.

This is the renderer of the truth, kept apart from the scorer of the trackers (which approximates): a pixel
belongs to a triangle when its centre lies inside. Pixel centres are at integer coordinates.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.compiled import kernel
from hypose.compute.pictures.cpu_parts import NEAR
from hypose.compute.pictures.parts import covered


@kernel
def _raster(uv, z, faces, cull, depth, face_id, bary):
    """Draw faces into depth/face_id/bary (h, w[, 2]); perspective-correct barycentrics of corners 1 and 2."""
    h, w = depth.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        za, zb, zc = z[a], z[b], z[c]
        if not (za > NEAR and zb > NEAR and zc > NEAR):
            continue
        xa, ya, xb, yb, xc, yc = uv[a, 0], uv[a, 1], uv[b, 0], uv[b, 1], uv[c, 0], uv[c, 1]
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        # y points down: a triangle that is counter-clockwise from outside has negative area when seen from
        # outside
        if area == 0.0 or (cull and area > 0.0):
            continue
        if not np.isfinite(area):
            continue
        x0 = max(0, int(np.ceil(min(xa, min(xb, xc)))))
        x1 = min(w - 1, int(np.floor(max(xa, max(xb, xc)))))
        y0 = max(0, int(np.ceil(min(ya, min(yb, yc)))))
        y1 = min(h - 1, int(np.floor(max(ya, max(yb, yc)))))
        if x0 > x1 or y0 > y1:
            continue
        inv = 1.0 / area
        iza, izb, izc = 1.0 / za, 1.0 / zb, 1.0 / zc
        db_dx, dc_dx = (yc - ya) * inv, -(yb - ya) * inv
        for y in range(y0, y1 + 1):
            kb = ((x0 - xa) * (yc - ya) - (xc - xa) * (y - ya)) * inv
            kc = ((xb - xa) * (y - ya) - (x0 - xa) * (yb - ya)) * inv
            for x in range(x0, x1 + 1):
                ka = 1.0 - kb - kc
                if ka >= -1e-9 and kb >= -1e-9 and kc >= -1e-9:
                    iz = ka * iza + kb * izb + kc * izc
                    d = 1.0 / iz
                    if d < depth[y, x]:
                        depth[y, x] = d
                        face_id[y, x] = f
                        bary[y, x, 0] = kb * izb * d
                        bary[y, x, 1] = kc * izc * d
                kb += db_dx
                kc += dc_dx


def rasterize(
    uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], size: tuple[int, int], *, cull: bool = True
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]:
    """Draw triangles with a z-buffer.

    uv (V, 2) px and z (V,) m: projected vertices and their depth along the optical axis; faces (F, 3),
    counter-clockwise from outside; size (width, height); cull: leave out faces seen from inside. Returns
    depth (h, w) m (inf where empty), face_id (h, w) (-1 where empty) and bary (h, w, 2): perspective-correct
    weights of the face's second and third corner. A triangle that reaches nearer than NEAR is left out.
    """
    w, h = size
    depth = np.full((h, w), np.inf, dtype=np.float32)
    face_id = np.full((h, w), -1, dtype=np.int32)
    bary = np.zeros((h, w, 2), dtype=np.float32)
    _raster(
        np.ascontiguousarray(uv, dtype=np.float64),
        np.ascontiguousarray(z, dtype=np.float64),
        np.ascontiguousarray(faces, dtype=np.int32),
        cull,
        depth,
        face_id,
        bary,
    )
    return depth, face_id, bary


@kernel
def _interpolate(face, b1, b2, faces, values, out):
    for i in range(face.shape[0]):
        a, b, c = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        w1, w2 = b1[i], b2[i]
        w0 = np.float32(1.0) - w1 - w2
        for k in range(values.shape[1]):
            out[i, k] = w0 * values[a, k] + w1 * values[b, k] + w2 * values[c, k]


def interpolate(
    face: NDArray[np.int32], bary: NDArray[np.float32], faces: NDArray[np.int32], values: ArrayLike
) -> NDArray[np.float32]:
    """Vertex values (V, K) at N drawn pixels: face (N,) >= 0 and bary (N, 2) of `rasterize` -> (N, K)."""
    v = np.ascontiguousarray(values, dtype=np.float32)
    out = np.empty((len(face), v.shape[1]), dtype=np.float32)
    b1, b2 = np.ascontiguousarray(bary[:, 0]), np.ascontiguousarray(bary[:, 1])
    _interpolate(np.ascontiguousarray(face), b1, b2, np.ascontiguousarray(faces, dtype=np.int32), v, out)
    return out


def silhouette(
    uv: ArrayLike, z: ArrayLike, faces: NDArray[np.int32], size: tuple[int, int], supersample: int = 1
) -> NDArray[np.float32] | NDArray[np.uint8]:
    """Exact silhouette of a mesh.

    uv (V, 2) px, z (V,) m, faces (F, 3) of any orientation, size (width, height). With supersample = 1 a mask
    (h, w) uint8 of 0 and 1 (pixel centres inside); with s > 1 the coverage (h, w) float32 in 0..1 from s x s
    samples per pixel.
    """
    w, h = size
    s = int(supersample)
    p = np.ascontiguousarray(uv, dtype=np.float64)
    if s > 1:
        p = (p + 0.5) * s - 0.5
    mask = covered(p, z, faces, (h * s, w * s))
    if s == 1:
        return mask
    return cv2.resize(mask.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA)


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


@kernel
def _darken(picture, shade, floor, depth):
    for y in range(picture.shape[0]):
        for x in range(picture.shape[1]):
            if floor[y, x] and shade[y, x] > 0:
                k = np.float32(1.0) - depth * shade[y, x]
                for c in range(3):
                    picture[y, x, c] *= k


def darken(picture: NDArray[np.float32], shade: NDArray[np.float32], where: NDArray[np.bool_], depth: float) -> None:
    """picture (h, w, 3) *= 1 - depth * shade (h, w) where `where` (h, w), in place."""
    _darken(picture, shade, where, np.float32(depth))


@kernel
def _expose(picture, gain, noise, out):
    for y in range(picture.shape[0]):
        for x in range(picture.shape[1]):
            for c in range(3):
                v = picture[y, x, c] * gain[c] + noise[y, x, c] + np.float32(0.5)
                out[y, x, c] = np.uint8(min(max(v, np.float32(0.0)), np.float32(255.0)))


def expose(picture: NDArray[np.float32], gain: ArrayLike, noise: NDArray[np.int16]) -> NDArray[np.uint8]:
    """round(picture (h, w, 3) * gain (3,) + noise (h, w, 3)), clipped to 8 bit."""
    out = np.empty(picture.shape, dtype=np.uint8)
    _expose(picture, np.asarray(gain, dtype=np.float32), noise, out)
    return out

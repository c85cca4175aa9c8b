"""Rotations and rigid motions: exponential and logarithm of rotations, averages, Procrustes alignment.

All functions take leading batch axes. Angles are in radians, lengths in metres. A rigid motion is a (4, 4) matrix named
`target_from_source`; it maps homogeneous source coordinates to target coordinates.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
"""(h, w, 3) blue, green, red, or (h, w) grey"""
Mask = NDArray[np.uint8]
"""(h, w), 0 or 255"""
DepthMap = NDArray[np.float32]
"""(h, w) m along the optical axis, 0 where nothing was measured"""


def skew(vector: ArrayLike) -> Array:
    """Compute the cross-product matrix of vectors, so that skew(a) @ b = a x b.

    vector: (..., 3).
    Returns: (..., 3, 3) antisymmetric matrices.
    """
    v = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def unit(vector: ArrayLike) -> Array:
    """Divide vectors (..., 3) by their lengths; a vector of length 0 stays 0."""
    v = np.asarray(vector, dtype=np.float64)
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def so3_exp(rotation_vector: ArrayLike) -> Array:
    """Convert rotation vectors to rotation matrices with Rodrigues' formula.

    rotation_vector: (..., 3) axis times angle, rad.
    Returns: (..., 3, 3) rotation matrices.
    """
    r = np.asarray(rotation_vector, dtype=np.float64)
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    k = skew(r)
    return np.eye(3) + a * k + b * (k @ k)


def so3_log(rotation: ArrayLike) -> Array:
    """Convert rotation matrices to rotation vectors.

    rotation: (..., 3, 3) rotation matrices.
    Returns: (..., 3) axis times angle, rad, with an angle of 0 to pi.
    Why: the computation uses the unit quaternion, because it is accurate at every angle, pi included.
    """
    q = quaternion_from_matrix(rotation)
    q = np.where(q[..., :1] < 0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(norm, q[..., :1])
    scale = np.where(norm < 1e-12, 2.0, angle / np.where(norm < 1e-12, 1.0, norm))
    return scale * q[..., 1:]


def quaternion_from_matrix(rotation: ArrayLike) -> Array:
    """Convert rotation matrices to unit quaternions.

    rotation: (..., 3, 3) rotation matrices.
    Returns: (..., 4) quaternions in the order w, x, y, z; the sign is arbitrary.
    """
    m = np.asarray(rotation, dtype=np.float64)
    t = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    k = np.empty((*m.shape[:-2], 4, 4))
    k[..., 0, 0] = t
    across = [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]]
    k[..., 0, 1:] = k[..., 1:, 0] = np.stack(across, -1)
    k[..., 1:, 1:] = m + np.swapaxes(m, -1, -2) - t[..., None, None] * np.eye(3)
    # K/3's dominant eigenvector is the quaternion (Bar-Itzhack 2000); its column of largest diagonal is
    # proportional to it for exact rotations and avoids an eigen-decomposition.
    best = np.einsum("...ii->...i", k).argmax(-1)
    column = np.take_along_axis(k, best[..., None, None], axis=-1)[..., 0]
    column = column + np.where(np.arange(4) == best[..., None], 1.0, 0.0)
    return column / np.linalg.norm(column, axis=-1, keepdims=True)


def so3_left_jacobian(rotation_vector: ArrayLike) -> Array:
    """Compute the left Jacobian J of the exponential map at rotation vectors.

    To first order, exp(r + dr) = exp(J(r) dr) exp(r).

    rotation_vector: (..., 3) rad.
    Returns: (..., 3, 3).
    """
    r = np.asarray(rotation_vector, dtype=np.float64)
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    k = skew(r)
    return np.eye(3) + b * k + c * (k @ k)


def so3_turns(rotation_vector: ArrayLike) -> Array:
    """Compute the derivative of rotation vectors with respect to a small rotation in the world frame.

    To first order, exp(r + B w) = exp(w) exp(r). B is the inverse of `so3_left_jacobian`.

    rotation_vector: (..., 3) rad, r in the formula.
    Returns: (..., 3, 3) matrices B.
    """
    return np.asarray(np.linalg.inv(so3_left_jacobian(rotation_vector)), dtype=np.float64)


_FEW_VECTORS = 4
"""Largest number of rotation vectors that are tested in a Python loop, which is faster for so few."""


def _other_branch(r: list[float], reference: list[float]) -> float:
    """Find out whether the other branch of a rotation vector is nearer to a reference.

    r, reference: x, y, z in rad.
    Returns: the angle of `r` where r (1 - 2 pi / |r|) is nearer; 0 otherwise.
    """
    (x, y, z), (a, b, c) = r, reference
    squared = x * x + y * y + z * z
    angle = math.sqrt(squared)
    return angle if angle > 1e-9 and x * a + y * b + z * c < squared - math.pi * angle else 0.0


def nearest_branch(rotation_vector: ArrayLike, reference: ArrayLike) -> Array:
    """Choose, of the equivalent vectors of a rotation, the one nearest to a reference.

    The vectors r and r (1 - 2 pi / |r|) describe the same rotation. Differences and means of rotation vectors are only
    meaningful when all vectors are on the same branch.

    rotation_vector: (..., 3) rad.
    reference: (..., 3) rad.
    Returns: (..., 3) rad.
    """
    r = np.asarray(rotation_vector, dtype=np.float64)
    ref = np.asarray(reference, dtype=np.float64)
    if r.ndim == ref.ndim == 1:  # the same, many times faster
        angle = _other_branch(r.tolist(), ref.tolist())
        return r - 2 * np.pi * r / angle if angle else r.copy()
    if r.ndim == 2 and len(r) <= _FEW_VECTORS and ref.shape in (r.shape, r.shape[1:]):
        rows = ref.tolist() if ref.ndim == 2 else [ref.tolist()] * len(r)
        if not any(map(_other_branch, r.tolist(), rows)):
            return r.copy()
    squared = (r * r).sum(-1, keepdims=True)
    # the other branch is r - 2 pi r / |r|: nearer when r.ref lies more than pi |r| below |r|^2
    angle = np.sqrt(squared)
    closer = ((r * ref).sum(-1, keepdims=True) < squared - np.pi * angle) & (angle > 1e-9)
    if not closer.any():
        return r.copy()
    return np.where(closer, r - 2 * np.pi * r / np.maximum(angle, 1e-12), r)


def se3(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Assemble rigid motions from rotations and translations.

    rotation: (..., 3, 3).
    translation: (..., 3) m.
    Returns: (..., 4, 4).
    """
    r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
    out = np.zeros((*np.broadcast_shapes(r.shape[:-2], t.shape[:-1]), 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = r, t, 1
    return out


def se3_inverse(motion: ArrayLike) -> Array:
    """Invert rigid motions (..., 4, 4), so that b_from_a becomes a_from_b."""
    m = np.asarray(motion, dtype=np.float64)
    r = np.swapaxes(m[..., :3, :3], -1, -2)
    return se3(r, -np.einsum("...ij,...j->...i", r, m[..., :3, 3]))


def transform(motion: ArrayLike, points: ArrayLike) -> Array:
    """Apply a rigid motion to points.

    motion: (..., 4, 4) target_from_source.
    points: (..., N, 3) in the source frame.
    Returns: (..., N, 3) points in the target frame.
    """
    m, p = np.asarray(motion, dtype=np.float64), np.asarray(points, dtype=np.float64)
    return p @ np.swapaxes(m[..., :3, :3], -1, -2) + m[..., None, :3, 3]


def frame_of(first: ArrayLike, second: ArrayLike) -> Array:
    """Make the rotation matrix (3, 3) of two directions (3,).

    Its columns are `first`, the part of `second` across it, and their cross product, normalised.
    """
    a, b = unit(first), np.asarray(second, dtype=np.float64)
    b = unit(b - (b @ a) * a)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def rotation_between(a: ArrayLike, b: ArrayLike) -> Array:
    """Compute the smallest rotation that turns one direction into another.

    a, b: (3,) directions of any length.
    Returns: (3, 3) rotation matrix, R a parallel to b; for opposite directions the axis is any perpendicular one.
    """
    u, v = unit(a), unit(b)
    axis = np.cross(u, v)
    sine, cosine = np.linalg.norm(axis), float(u @ v)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis = np.cross(u, np.eye(3)[int(np.abs(u).argmin())])  # opposite directions: any perpendicular axis serves
        return so3_exp(np.pi * unit(axis))
    return so3_exp(axis / sine * np.arctan2(sine, cosine))


def procrustes(
    source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None, *, scale: bool = False
) -> tuple[Array, float]:
    """Compute the rigid or similarity motion that maps source points to target points with the least squared error.

    source: (N, 3) points.
    target: (N, 3) the corresponding points.
    weights: (N,), of any sum; None for equal weights.
    scale: estimate a scale factor as well.
    Returns: target_from_source (4, 4) and the scale s (1 without `scale`). The map is x -> s R x + t, and the matrix
        holds s R.
    Why: a test of the determinant (Umeyama 1991) keeps R a rotation. With three points, or with noise, the unguarded
        SVD solution is a reflection in half of the cases.
    """
    a, b = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    w = np.ones(len(a)) if weights is None else np.asarray(weights, dtype=np.float64)
    w = w / w.sum()
    ca, cb = w @ a, w @ b
    u, s, vt = np.linalg.svd(((b - cb) * w[:, None]).T @ (a - ca))
    guard = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    r = (u * guard) @ vt
    k = float((s * guard).sum() / (w @ ((a - ca) ** 2).sum(1))) if scale else 1.0
    return se3(k * r, cb - k * r @ ca), k


def far_apart(points: Array, first: int, count: int, apart: float = 0.0) -> list[int]:
    """Choose points that lie as far from each other as possible (farthest-point sampling).

    points: (N, D) of any space.
    first: index of the point that is chosen first.
    count: largest number of points.
    apart: least distance of a point from those chosen before; nearer ones are left out.
    Returns: indices in increasing order.
    """
    chosen, distance = [first], np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < min(count, len(points)) and distance.max() > apart:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return sorted(chosen)


def runs(flags: NDArray[np.bool_]) -> list[range]:
    """Find the consecutive marked frames in flags (T,), as ranges."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [range(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def interpolated(values: ArrayLike) -> Array:
    """Fill unknown frames (NaN) of each number in values (T, ...) by linear interpolation in time.

    Before the first and after the last known frame the value of that frame is taken; numbers that are never known stay
    NaN.
    """
    out = np.array(values, dtype=np.float64)
    frames, columns = np.arange(len(out)), out.reshape(len(out), -1)
    for column in columns.T:
        known = np.isfinite(column)
        if known.any() and not known.all():
            column[:] = np.interp(frames, frames[known], column[known])
    return out

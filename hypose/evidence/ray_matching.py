"""Geometry of rays for several calibrated views and several people: distances of rays and points, robust triangulation.

All distances are metres: the size of a pixel error at the person's depth, so that limits hold for any picture size and
any distance.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.geometry import Array

NOT_COMPARABLE_M = 9.0
"""m: distance that stands for pairs that cannot be compared."""
_LEAST_CONFIDENCE = 0.1  # least confidence of a point that counts
_NEAREST = 0.3  # m, least distance in front of a camera
_PARALLEL = 0.05  # least sine of the angle between two rays whose distance is used
_PRIOR = 0.7  # weight of a prediction, in views
_PRIOR_M = 0.35


class Views:
    """Pinhole cameras of a rig as arrays.

    projections: (C, 3, 4).
    centres: (C, 3) m.
    world_from_pixel: (C, 3, 3).
    pairs: (Q, 2) all pairs of views.
    """

    def __init__(self, rig: CameraRig) -> None:
        self.projections = rig.projections
        self.centres = rig.positions
        self._focal = np.array([0.5 * (c.K[0, 0] + c.K[1, 1]) for c in rig])
        self.world_from_pixel = np.stack([c.camera_from_world[:3, :3].T @ np.linalg.inv(c.K) for c in rig])
        self.pairs = np.array(list(itertools.combinations(range(len(rig)), 2)), dtype=np.int64).reshape(-1, 2)

    def __len__(self) -> int:
        return len(self.centres)

    def rays(self, pixels: Array, which: NDArray[np.int64] | slice = slice(None)) -> Array:
        """Compute the unit directions (M, ..., 3), in the world, of the rays of pixels (M, ..., 2).

        which: (M,) view of each row (default: one row per view).
        """
        shape = pixels.shape
        flat = pixels.reshape(shape[0], -1, 2)
        one = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], -1)
        d = one @ self.world_from_pixel[which].transpose(0, 2, 1)
        d /= np.sqrt((d * d).sum(-1, keepdims=True))
        return d.reshape(*shape[:-1], 3)

    def seen_at(self, points: Array) -> tuple[Array, Array]:
        """Project points (..., 3), m, into all views.

        Returns: pixels (C, ..., 2); metres per pixel (C, ...) at their depth; NaN behind a camera or nearly in it.
        """
        flat = points.reshape(-1, 3)
        h = flat @ self.projections[:, :, :3].transpose(0, 2, 1) + self.projections[:, None, :, 3]
        z = np.where(h[..., 2] > _NEAREST, h[..., 2], np.nan)
        shape = (len(self), *points.shape[:-1])
        return (h[..., :2] / z[..., None]).reshape(*shape, 2), (z / self._focal[:, None]).reshape(shape)


def distances(views: Views, expected: Array, found: Array, limit: float) -> Array:
    """Compute the distances of candidates' points from those of expected people.

    views: the cameras.
    expected: (N, K, 3) m.
    found: (C, P, K, 3) candidates of each view.
    limit: upper bound of a distance, m.
    Returns: (C, N, P, K) m, at most `limit`; NaN where one of the two is unknown.
    """
    uv, metres = views.seen_at(expected)
    e = uv[:, :, None] - found[:, None, :, :, :2]
    e = np.sqrt((e * e).sum(-1)) * metres[:, :, None]
    return np.where(found[:, None, ..., 2] > _LEAST_CONFIDENCE, np.minimum(e, limit), np.nan)


def mean_of_known(values: Array, least: int) -> Array:
    """Average values (..., K) over the last axis without NaN; NOT_COMPARABLE_M where fewer than `least` are known."""
    known = np.isfinite(values)
    n, total = known.sum(-1), np.where(known, values, 0.0).sum(-1)
    return np.where(n >= least, total / np.maximum(n, 1e-9), NOT_COMPARABLE_M)


def between_rays(views: Views, which: NDArray[np.int64], found: Array, limit: float, least: int) -> Array:
    """Compute the distances between the rays of candidates, averaged over their common points.

    views: the cameras.
    least: number of common points that a comparison needs.
    which: (M,) view of each candidate.
    found: (M, K, 3).
    limit: m, at which single distances end.
    Returns: (M, M) m; NOT_COMPARABLE_M for candidates of one view, or with fewer than `least` common points.
    """
    d = views.rays(found[..., :2], which)
    centre = views.centres[which]
    u, v = d[:, None], d[None]
    n0 = u[..., 1] * v[..., 2] - u[..., 2] * v[..., 1]
    n1 = u[..., 2] * v[..., 0] - u[..., 0] * v[..., 2]
    n2 = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    w = (centre[None, :] - centre[:, None])[:, :, None]
    along = np.abs(n0 * w[..., 0] + n1 * w[..., 1] + n2 * w[..., 2])
    apart = np.where(size > _PARALLEL, along / np.maximum(size, 1e-9), 0.5 * limit)
    seen = found[..., 2] > _LEAST_CONFIDENCE
    both = seen[:, None] & seen[None]
    out = mean_of_known(np.where(both, np.minimum(apart, limit), np.nan), least)
    return np.where(which[:, None] == which[None], NOT_COMPARABLE_M, out)


def meet(views: Views, found: Array, near: float, prior: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate points from rays, some of which may be wrong.

    Every pair of rays is tried (there are few views); the pair with most support wins, and all rays near it are solved
    by least squares, weighted by confidence and pixel size.
    found: (C, N, K, 3) px and confidence.
    near: largest distance of a ray from the point, m.
    prior: (N, K, 3) expected points, which decide between two places where rays meet.
    Returns: points (N, K, 3), m, NaN where fewer than two rays meet; rays used (C, N, K).
    """
    count, n, k = found.shape[:3]
    seen = found[..., 2] > _LEAST_CONFIDENCE
    if count < 2 or n == 0:
        return np.full((n, k, 3), np.nan), np.zeros(seen.shape, dtype=np.bool_)
    d = views.rays(found[..., :2])
    a, b = views.pairs.T
    da, db, apart = d[a], d[b], (views.centres[a] - views.centres[b])[:, None, None]  # (Q, N, K, 3)
    cos = (da * db).sum(-1)
    sine2 = 1 - cos * cos
    ea, eb = (da * apart).sum(-1), (db * apart).sum(-1)
    safe = np.where(sine2 > 1e-5, sine2, np.inf)
    s, t = (cos * eb - ea) / safe, (eb - cos * ea) / safe
    one = views.centres[a][:, None, None] + s[..., None] * da
    middle = 0.5 * (one + views.centres[b][:, None, None] + t[..., None] * db)
    usable = seen[a] & seen[b] & (s > 0) & (t > 0) & (sine2 > 1e-5)
    with np.errstate(invalid="ignore"):
        uv, metres = views.seen_at(middle)  # (C, Q, N, K, ...)
        e = uv - found[:, None, ..., :2]
        e = np.sqrt((e * e).sum(-1)) * metres
        e = np.where(seen[:, None] & np.isfinite(e), np.minimum(e / near, 1.0), 1.0)  # shares of `near`
        score = (e < 1).sum(0) - e.sum(0) / np.maximum(seen.sum(0), 1)
        if prior is not None:
            off = middle - prior
            off = np.sqrt((off * off).sum(-1)) / _PRIOR_M
            score = score - _PRIOR * np.where(np.isfinite(off), np.minimum(off, 2.0), 0.0)
    score = np.where(usable, score, -np.inf)
    best = score.argmax(0)[None]  # (1, N, K)
    used = np.take_along_axis(e, best[None], 1)[:, 0] < 1
    used &= np.take_along_axis(usable, best, 0)
    found_any = used.sum(0) >= 2
    used &= found_any
    scale = np.take_along_axis(metres, best[None], 1)[:, 0]
    w = np.where(used, found[..., 2] / np.where(used, scale, 1.0) ** 2, 0.0)
    across = np.eye(3) - d[..., :, None] * d[..., None, :]  # (C, N, K, 3, 3)
    left = (w[..., None, None] * across).sum(0)
    right = (w[..., None] * (across @ views.centres[:, None, None, :, None])[..., 0]).sum(0)
    left = np.where(found_any[..., None, None], left, np.eye(3))
    points = np.linalg.solve(left, right[..., None])[..., 0]
    return np.where(found_any[..., None], points, np.nan), used

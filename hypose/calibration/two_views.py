"""Cameras and offsets without a start value: epipolar geometry of pairs of views that see one moving person.

Only the key points and, perhaps, the lenses are known. The offset of a pair is the one at which its key points fit an
epipolar geometry best. The rig starts with the pair of the best essential matrix; the other cameras are added one by
one with the points that are triangulated already (perspective n points).
Source: Hartley and Zisserman 2004, chapters 9 to 12; MAGSAC++ by Barath et al. 2020; SQPnP by Terzakis and Lourakis
    2020.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.calibration.refine_points import adjust
from hypose.calibration.sync_motion import Curves, coordinate_descent, sampson
from hypose.calibration.synchronisation import points_at
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.geometry import Array, interpolated, se3, so3_exp, unit

SEEN_CONFIDENCE = 0.3  # confidence above which a key point counts
LOOSE_PX = (2.0, 5.0, 0.7)  # sd (rad, m, share of the focal length) within which a rig from scratch may move
FOCAL_FACTORS = (0.55, 0.75, 1.0, 1.35, 1.8, 2.4)  # focal lengths that are tried, in pictures' longer sides
_COARSE = 3  # frames between the offsets that are tried first
_FEWEST_PAIRS, _MANY = 500, 4000  # correspondences that estimate an epipolar geometry, and that judge it
_LEAST_PAIRS = 40
_POINTS, _TRIES = 1500, 4  # points for a start rig, and pairs of views from which it is tried


def on_common_clock(points: Array, late: Array, frames: NDArray[np.int64]) -> Array:
    """Interpolate key points at frames of the common clock.

    points: (C, T, K, 3) px, px, confidence.
    late: (C,) delay of each view, frames.
    Returns: (C, F, K, 3).
    """
    return np.stack([points_at(p, float(x))[frames] for p, x in zip(points, late, strict=True)])


def epipolar_curves(points: Array, lenses: Sequence[Array] | None, sd: float, largest: int) -> Curves:
    """Compute how much the key points of each pair of views disagree with the epipolar geometry that fits them best,
    for every whole time offset between the two views.

    points: (C, T, K, 3) undistorted px, and confidence.
    lenses: K (3, 3) of each view; None where unknown.
    sd: standard deviation of a detection, px.
    largest: largest offset, frames.
    """
    rng = np.random.default_rng(0)
    count, frames, kinds = points.shape[:3]
    lags = np.arange(-largest, largest + 1)
    pairs = tuple(itertools.combinations(range(count), 2))
    cost = np.full((len(pairs), len(lags)), np.nan)
    for (a, b), curve in zip(pairs, cost, strict=True):
        wanted = list(range(0, len(lags), _COARSE))
        for _ in range(2):
            for k in wanted:
                first, last = max(0, -int(lags[k])), min(frames, frames - int(lags[k]))
                pa, pb = points[a, first:last], points[b, first + lags[k] : last + lags[k]]
                both = (pa[..., 2] > SEEN_CONFIDENCE) & (pb[..., 2] > SEEN_CONFIDENCE)
                chosen = rng.permutation(int(both.sum()))[:_MANY]
                xa, xb = pa[both][chosen, :2], pb[both][chosen, :2]
                if len(chosen) < _LEAST_PAIRS:
                    continue
                known = None if lenses is None else (lenses[a], lenses[b])
                found = _epipolar(xa[:_FEWEST_PAIRS], xb[:_FEWEST_PAIRS], known, sd, 300)
                if found is not None:  # errors of one point last for several frames, as in keypoint_curves
                    curve[k] = 0.2 * kinds * frames / 3 * _disagreement(found[0], xa, xb, sd)
            best = np.argsort(np.nan_to_num(curve, nan=np.inf))[:_COARSE]
            near = {k for o in best for k in range(o - _COARSE, o + _COARSE + 1) if 0 <= k < len(lags)}
            wanted = [k for k in near if np.isnan(curve[k])]
        curve[:] = interpolated(curve)
    return Curves(pairs, lags.astype(np.float64), cost)


def rival_offsets(curves: Curves, frames: Array, apart: float = 5.0) -> tuple[float, Array] | None:
    """Find the best alternative offsets, in which at least one pair differs by more than `apart` frames.

    curves: disagreement of pairs of views over the offset.
    frames: (C,) the offsets found.
    Returns: relative increase of the disagreement, and the alternative offsets (C,); None where there are none.
    """
    usable = [(pair, c) for pair, c in zip(curves.pairs, curves.cost, strict=True) if np.isfinite(c).all()]

    def total(x: Array) -> float:
        return sum(float(np.interp(x[b] - x[a], curves.lags, c)) for (a, b), c in usable)

    found = []
    for (a, b), c in usable:
        far = np.abs(curves.lags - (frames[b] - frames[a])) > apart
        dip = np.r_[False, (c[1:-1] <= c[:-2]) & (c[1:-1] <= c[2:]), False]
        for k in sorted(np.flatnonzero(far & dip), key=lambda k: float(c[k]))[:2]:
            start = frames.copy()
            start[b] = start[a] + curves.lags[k]
            x = coordinate_descent(total, start, {*range(len(frames))} - {a, b}, curves.lags)
            found.append((total(x) / total(frames) - 1, x))
    return min(found, key=lambda f: f[0]) if found else None


def start_rig(points: Array, rig: CameraRig, sd: float) -> list[tuple[float, CameraRig]]:
    """Find a start rig of arbitrary scale that explains key points on one clock.

    points: (C, F, K, 3) undistorted px, and confidence.
    rig: lenses; their poses are ignored.
    sd: standard deviation of a detection, px.
    Returns: a list of one pair, the mean robust cost of a detection and the rig; empty where no pair of views gives a
        start.
    """
    count = len(rig)
    uv = points.reshape(count, -1, 3)
    if uv.shape[1] > _POINTS:
        uv = uv[:, np.random.default_rng(0).choice(uv.shape[1], _POINTS, replace=False)]
    seen = uv[..., 2] > SEEN_CONFIDENCE
    pairs = []
    for a, b in itertools.combinations(range(count), 2):
        both = seen[a] & seen[b]
        if both.sum() >= 1.5 * _LEAST_PAIRS:
            pairs += [(*found, a, b) for found in _pair(rig[a], rig[b], uv[a, both, :2], uv[b, both, :2], sd)]
    found = []
    for _, pose, a, b in sorted(pairs, key=lambda p: p[0])[:_TRIES]:
        two = {a: replace(rig[a], camera_from_world=np.eye(4)), b: replace(rig[b], camera_from_world=pose)}
        chained = _chained(two, rig, uv, seen, sd)
        if chained is None:
            continue
        adjusted = adjust(chained, uv[..., :2], seen.astype(float), hold=LOOSE_PX, iterations=12)
        off = np.linalg.norm(
            np.stack([c.project_pinhole(adjusted.points) for c in adjusted.rig]) - uv[..., :2], axis=-1
        )
        off = np.where(np.isfinite(off), off, 20 * sd)[seen]
        found.append((float(np.log1p((off / (2 * sd)) ** 2).mean()), adjusted.rig))
    return sorted(found, key=lambda f: f[0])[:1]


def _chained(
    cameras: dict[int, Camera], rig: CameraRig, uv: Array, seen: NDArray[np.bool_], sd: float
) -> CameraRig | None:
    """Add cameras to a pair one by one, next the one with which most of the triangulated points agree.

    cameras: the pair, by index; the others are added to it.
    rig: lenses of all cameras.
    uv: (C, N, 3) px, and confidence.
    seen: (C, N) whether a point counts.
    sd: standard deviation of a detection, px.
    Returns: the rig; None where a camera sees too few of the points.
    """
    while len(cameras) < len(rig):
        have = sorted(cameras)
        known = CameraRig(tuple(cameras[c] for c in have))
        x, _ = triangulate(known, uv[have, :, :2], seen[have].astype(float))
        off = np.linalg.norm(np.stack([c.project_pinhole(x) for c in known]) - uv[have, :, :2], axis=-1)
        fine = np.isfinite(x).all(1) & (np.where(seen[have], off, 0).max(0) < 4 * sd)
        found = []
        for k in set(range(len(rig))) - set(have):
            use = fine & seen[k]
            if use.sum() >= _LEAST_PAIRS:
                ok, turn, shift, inliers = cv2.solvePnPRansac(
                    x[use], uv[k, use, :2], rig[k].K, np.zeros(5),
                    iterationsCount=300, reprojectionError=4 * sd, flags=cv2.SOLVEPNP_SQPNP,
                )  # fmt: skip
                if ok and inliers is not None:
                    found.append((len(inliers) / use.sum(), k, se3(so3_exp(turn[:, 0]), shift[:, 0])))
        if not found:
            return None
        _, k, pose = max(found, key=lambda f: f[0])
        cameras[k] = replace(rig[k], camera_from_world=pose)
    return CameraRig(tuple(cameras[k] for k in range(len(rig))))


def _pair(a: Camera, b: Camera, xa: Array, xb: Array, sd: float) -> list[tuple[float, Array]]:
    """Estimate the relative pose of two cameras.

    a, b: cameras; their poses are ignored.
    xa, xb: (N, 2) px, corresponding points.
    sd: standard deviation of a detection, px.
    Returns: a list of one pair: badness as a start (disagreement, nearly parallel rays, points behind the cameras) and
        b_from_a (4, 4); empty without an epipolar geometry.
    """
    found = _epipolar(xa, xb, (a.K, b.K), sd, 1000)
    if found is None:
        return []
    fundamental, essential, na, nb = found
    front, turn, shift = cv2.recoverPose(essential, na, nb, np.eye(3))[:3]
    pose = se3(turn, shift[:, 0])
    two = CameraRig((replace(a, camera_from_world=np.eye(4)), replace(b, camera_from_world=pose)))
    x = triangulate(two, np.stack([xa, xb]), np.ones((2, len(xa))))[0]
    sine = np.linalg.norm(np.cross(*unit(x - two.positions[:, None])), axis=1)
    return [(_disagreement(fundamental, xa, xb, sd) - 0.6 * float(np.nanmedian(sine)) - 0.5 * front / len(xa), pose)]


def _epipolar(
    xa: Array, xb: Array, lenses: tuple[Array, Array] | None, sd: float, iterations: int
) -> tuple[Array, Array, Array, Array] | None:
    """Estimate the epipolar geometry of corresponding points.

    xa, xb: (N, 2) px.
    lenses: K of both; None where unknown.
    sd: standard deviation of a detection, px.
    iterations: largest number of samples of MAGSAC.
    Returns: fundamental matrix F with x_b^T F x_a = 0, essential matrix, and points at depth 1; without lenses the
        pixels and no essential matrix. None where the estimation fails.
    """
    if lenses is None:
        f, _ = cv2.findFundamentalMat(xa, xb, cv2.USAC_MAGSAC, 1.5 * sd, 0.999, iterations)
        return None if f is None or f.shape != (3, 3) else (np.asarray(f, np.float64), xa[:0], xa, xb)
    ia, ib = (np.linalg.inv(k) for k in lenses)
    na, nb = ((np.c_[x, np.ones(len(x))] @ i.T)[:, :2] for x, i in ((xa, ia), (xb, ib)))
    focal = np.sqrt(lenses[0][0, 0] * lenses[1][0, 0])
    e, _ = cv2.findEssentialMat(
        na, nb, np.eye(3), method=cv2.USAC_MAGSAC, prob=0.999, threshold=1.5 * sd / focal, maxIters=iterations
    )
    return None if e is None or e.shape != (3, 3) else (ib.T @ e @ ia, np.asarray(e, np.float64), na, nb)


def _disagreement(fundamental: Array, xa: Array, xb: Array, sd: float) -> float:
    """Compute the mean robust Sampson error of corresponding points xa, xb (N, 2), px."""
    return float(np.log1p((sampson(fundamental, xa, xb) / (2 * sd)) ** 2).mean())

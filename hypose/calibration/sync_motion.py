"""Time offsets between cameras from the motion of a person, seen as key points or silhouettes.

At the same instant, two views of the same person agree in their epipolar geometry. For key points this is the epipolar
constraint of every point. For silhouettes it is the pencil of planes through the baseline, which both views have in
common: the two planes tangent to the person are the same (frontier points), and the silhouette changes at the same
place along the pencil. Each pair of views gives a curve of disagreement over the offset, and the offsets of all views
are those that fit all curves together. Lasting disagreement (a biased calibration, a detector that places a joint too
high) is removed first, so that timing can be checked before the calibration.

Sources: epipolar residuals over time lags as in Elhayek et al. 2012 and Wolf and Zomet 2002; frontier points for timing
    from Sinha and Pollefeys 2010, "Camera network calibration and synchronization from silhouettes", section 5. The
    activity along the pencil is an addition, because arms that move in front of the trunk touch no frontier plane.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hypose.cameras.camera import CameraRig
from hypose.compute.losses import lorentzian, lorentzian_weight
from hypose.errors import EvidenceError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoint_check import sizes
from hypose.evidence.silhouettes import biggest_parts
from hypose.geometry import Array, frame_of, interpolated, skew, unit

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

BINS = 8
"""Number of parts of the pencil of planes in which activity is counted."""
_SPAN = 2  # frames to either side between which a change is looked for
_STEP = 0.25  # of the offsets at which the curves are sampled, frames
_TOGETHER = 2.0  # sd of a detection within which points share their error
_LASTING = 16.0
"""Standard deviation of the running mean, frames. Anything that lasts longer is an error of a point or of the
calibration, without information on time. With 14, a person who stands and waves makes a camera late; with 20, a
balancing person does."""
_SMOOTH_POINTS, _SMOOTH_MASKS = 2.0, 1.0  # frames: so that interpolation smooths no more than the frames are already


@dataclass(frozen=True)
class Curves:
    """Disagreement of pairs of views as a function of the offset.

    pairs: P pairs of view indices.
    lags: (L,) delay of the second view of a pair against the first, frames.
    cost: (P, L) half a log likelihood ratio; NaN where a pair has no motion in common.
    """

    pairs: tuple[tuple[int, int], ...]
    lags: Array
    cost: Array

    def __add__(self, other: Curves) -> Curves:
        """Add the costs of both; a pair that only one of them has keeps its cost."""
        both = np.stack([self.cost, other.cost])
        return Curves(self.pairs, self.lags, np.where(np.isnan(both).all(0), np.nan, np.nansum(both, axis=0)))


@dataclass(frozen=True)
class Offsets:
    """Time offsets of all views.

    frames: (C,) delay of each view against the median view.
    sd: (C,) standard deviation, frames; infinite for a view without motion in common with the others.
    gain: decrease of the disagreement compared with no offset, in half log likelihoods.
    """

    frames: Array
    sd: Array
    gain: float


def fundamental(rig: CameraRig, a: int, b: int) -> Array:
    """Compute the fundamental matrix F (3, 3) of the pinhole cameras a and b, with x_b^T F x_a = 0."""
    ca, cb = rig[a], rig[b]
    motion = cb.camera_from_world @ np.linalg.inv(ca.camera_from_world)
    return np.linalg.inv(cb.K).T @ (skew(motion[:3, 3]) @ motion[:3, :3]) @ np.linalg.inv(ca.K)


def point_sd(pixels: Array, confidence: Array) -> float:
    """Estimate the usual error of a detection: 1.6 % of the person's size in the median view, px.

    pixels: (C, T, K, 2) px.
    confidence: (C, T, K).
    """
    known = sizes(np.concatenate([pixels, confidence[..., None]], -1))
    known = known[known > 0]
    return max(0.016 * float(np.median(known)) if len(known) else 4.0, 0.5)


def sampson(fundamental: Array, xa: Array, xb: Array) -> Array:
    """Compute the signed Sampson distances (...), px, of corresponding points xa, xb (..., 2), px, of two views."""
    ha, hb = _homogeneous(xa), _homogeneous(xb)
    lines_b, lines_a = ha @ fundamental.T, hb @ fundamental
    size = np.sqrt((lines_b[..., :2] ** 2).sum(-1) + (lines_a[..., :2] ** 2).sum(-1))
    return (hb * lines_b).sum(-1) / np.maximum(size, 1e-12)


def keypoint_curves(rig: CameraRig, pixels: Array, confidence: Array, largest: float, *, step: float = _STEP) -> Curves:
    """Compute from key points how much each pair of views disagrees, as a function of the time offset between them.

    pixels: (C, T, K, 2) undistorted px of the rig.
    confidence: (C, T, K) confidence of each point.
    largest: largest offset, frames.
    step: step of the offsets, frames.
    """
    n, scale_px, seen = len(pixels), point_sd(pixels, confidence), confidence > 0.3
    pairs, lags, times = _grid(n, pixels.shape[1], largest, step)
    smooth = np.stack([_smoothed(p, s[..., None], _SMOOTH_POINTS) for p, s in zip(pixels, seen, strict=True)])
    splines = [_spline(s) for s in smooth]
    counts = _independent(smooth, scale_px)
    cost = np.full((len(pairs), len(lags)), np.nan)
    later = {}
    for b in range(n):
        later[b] = [(splines[b](times + lag), seen[b][np.rint(times + lag).astype(int)]) for lag in lags]
    for p, (a, b) in enumerate(pairs):
        f = fundamental(rig, a, b)
        for k, (xb, there) in enumerate(later[b]):
            both = seen[a][times] & there
            enough = both.sum(0) >= max(8, 0.2 * len(times))
            if not enough.any():
                continue
            e, both = sampson(f, smooth[a][times], xb)[:, enough], both[:, enough]
            e = np.where(both, e - _running_mean(e, both, scale_px), 0.0)
            # the residual lasts for several frames and all points share the calibration's errors: count a seventh
            mean = np.average(lorentzian((e / (2 * scale_px)) ** 2)[0], weights=both * counts[enough])
            cost[p, k] = 0.3 * mean * counts[enough].sum() * len(times)
    return Curves(pairs, lags, cost)


def _independent(pixels: Array, scale_px: float) -> Array:
    """Compute the effective weight of each point.

    pixels: (C, T, K, 2) px.
    scale_px: standard deviation of a detection, px.
    Returns: (K,) 1 for a point by itself, less for points that are close together.
    Why: points that are close together in every view, as in a face or hand, have the same error.
    """
    apart = np.zeros((pixels.shape[2], pixels.shape[2]))
    for view in pixels:
        between = [np.median(np.linalg.norm(view - view[:, [k]], axis=-1), axis=0) for k in range(len(apart))]
        apart = np.maximum(apart, between)
    return 1 / np.exp(-((apart / (_TOGETHER * scale_px)) ** 2)).sum(0)


@dataclass(frozen=True)
class MaskTrack:
    """Features of one view's masks over T frames, for timing.

    outline: (T, n, 2) convex hulls, px, the last point of each repeated; NaN where there is no mask.
    changed: T sets of pixels (m, 2) that differ between frames t - 2 and t + 2, or None.
    area: (T,) px.
    cut: (T,) whether the mask touches the image border.
    """

    outline: Array
    changed: tuple[Array | None, ...]
    area: Array
    cut: NDArray[np.bool_]

    def at(self, frames: NDArray[np.int64]) -> MaskTrack:
        """Select the frames (n,) of the track; frames outside of it have no mask."""
        n = len(self.area)
        inside, near = (frames >= 0) & (frames < n), np.clip(frames, 0, n - 1)
        return MaskTrack(
            np.where(inside[:, None, None], self.outline[near], np.nan),
            tuple(self.changed[k] if ok else None for k, ok in zip(near.tolist(), inside.tolist(), strict=True)),
            np.where(inside, self.area[near], 0.0),
            self.cut[near] | ~inside,
        )

    @property
    def size(self) -> float:
        """Median over the frames of the person's longer side, px; 0 without masks."""
        sides = np.ptp(self.outline[self.area > 0], axis=1).max(1)
        return float(np.median(sides)) if len(sides) else 0.0


def mask_tracks(silhouettes: Sequence[Silhouettes | None]) -> list[MaskTrack]:
    """Compute the mask tracks of all views from the silhouettes of consecutive frames.

    Raises: EvidenceError where there are no silhouettes.
    """
    known = next((s for s in silhouettes if s is not None), None)
    if known is None:
        raise EvidenceError("No frame has silhouettes; give masks, a background, or key points.")
    out = []
    for c, (w, h) in enumerate(known.rig.sizes.tolist()):
        found = [biggest_parts(s.masks[c, :h, :w], 0.2) if s is not None and s.usable[c] else None for s in silhouettes]
        masks = [m if m is not None and m.any() else None for m in found]
        steady = [_majority(masks, t) for t in range(len(masks))]
        edges = [() if m is None else (m[:2], m[-2:], m[:, :2], m[:, -2:]) for m in masks]
        outlines = [
            () if m is None else cv2.findContours(m, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0] for m in masks
        ]
        hulls = [cv2.convexHull(np.concatenate(o))[:, 0] if o else np.full((1, 2), np.nan) for o in outlines]
        longest = max(len(hull) for hull in hulls)
        out.append(
            MaskTrack(
                np.array([np.pad(h, ((0, longest - len(h)), (0, 0)), mode="edge") for h in hulls], dtype=np.float64),
                tuple(_changed(steady, t) for t in range(len(masks))),
                np.array([0.0 if m is None else m.sum() for m in masks]),
                np.array([any(edge.any() for edge in four) for four in edges]),
            )
        )
    return out


def _changed(masks: Sequence[NDArray[np.uint8] | None], t: int) -> Array | None:
    """List the pixels (m, 2) that differ between the masks before and after frame t; None where one is missing."""
    x, y = (masks[k] if 0 <= k < len(masks) else None for k in (t - _SPAN, t + _SPAN))
    if x is None or y is None:
        return None
    found = cv2.findNonZero(cv2.morphologyEx(x ^ y, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)))
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def _majority(masks: Sequence[NDArray[np.uint8] | None], t: int) -> NDArray[np.uint8] | None:
    """Compute the majority of three neighbouring masks, because edges flicker from frame to frame."""
    near = [masks[k] for k in (t - 1, t, t + 1) if 0 <= k < len(masks)]
    if masks[t] is None or len(near) < 3 or any(m is None for m in near):
        return masks[t]
    return np.asarray(np.sum([m for m in near if m is not None], axis=0) >= 2, dtype=np.uint8)


def tangent_planes(rig: CameraRig, tracks: Sequence[MaskTrack], a: int, b: int) -> tuple[Array, Array]:
    """Compute the two planes through the baseline of views a and b that are tangent to the person, in each view.

    tracks: mask track of each view.
    Returns: angles about the baseline (2, T, 2), rad, and pixels per radian (2, T, 2), for view a and view b; NaN where
        a view has no mask, is cut by the image border, or contains the epipole.
    """
    out, size = np.full((2, 2, len(tracks[a].area), 2), np.nan)
    frame = _pencil(rig, a, b)
    for side, c in enumerate((a, b)):
        angle, px = _angles(rig, c, tracks[c].outline, frame)
        ends = np.stack([angle.argmin(1), angle.argmax(1)], 1)
        whole = ~tracks[c].cut & (np.ptp(angle, axis=1) < 0.9 * np.pi)
        out[side, whole], size[side, whole] = (np.take_along_axis(of, ends, 1)[whole] for of in (angle, px))
    return out, size


def silhouette_curves(rig: CameraRig, tracks: Sequence[MaskTrack], largest: float) -> Curves:
    """Compute from silhouettes how much each pair of views disagrees, as a function of the time offset between them.

    Compared are the planes through both cameras that are tangent to the person, and the directions about the baseline
    in which the masks change.

    tracks: mask track of each view.
    largest: largest offset, frames.
    """
    scale_px = max(float(np.median([t.size for t in tracks])) / 130, 0.5)
    pairs, lags, times = _grid(len(tracks), len(tracks[0].area), largest)
    cost = np.full((len(pairs), len(lags)), np.nan)
    for p, (a, b) in enumerate(pairs):
        planes, px = tangent_planes(rig, tracks, a, b)
        usable = np.asarray(np.isfinite(planes).all(-1), dtype=np.bool_)
        active = _activity(rig, tracks, a, b, planes)
        sa, sb = (_smoothed(x, u[:, None], _SMOOTH_MASKS) for x, u in zip(planes, usable, strict=True))
        later = _spline(sb)
        px_a = np.nanmedian(px[0]) if usable[0].any() else np.nan
        ea = None if active is None else gaussian_filter1d(active[0], _SMOOTH_MASKS, axis=0)
        eb = None if active is None else _spline(gaussian_filter1d(active[1], _SMOOTH_MASKS, axis=0))
        for k, lag in enumerate(lags):
            value = 0.0
            both = usable[0][times] & usable[1][np.rint(times + lag).astype(int)]
            if both.sum() >= max(8, 0.3 * len(times)):
                r = (later(times + lag) - sa[times])[both] * px_a
                r = r - np.median(r, axis=0)
                value += 0.3 * float(lorentzian((r / (2 * scale_px)) ** 2)[0].mean() * 2 * len(times))
            if ea is not None and eb is not None:
                x, y = ea[times], eb(times + lag)
                x, y = x - x.mean(0), y - y.mean(0)
                rho = (x * y).sum() / max(np.sqrt((x * x).sum() * (y * y).sum()), 1e-12)
                value += 0.5 * len(times) * float(np.log(max(1 - max(rho, 0.0) ** 2, 1e-3)))
            cost[p, k] = value
        if not usable[0].any() and ea is None:
            cost[p] = np.nan
    return Curves(pairs, lags, cost)


def solve_offsets(curves: Curves, n_views: int) -> Offsets:
    """Find the offsets of all views that fit the curves of all pairs best.

    The method is coordinate descent on whole frames from several starts, then a continuous search.

    curves: disagreement of pairs of views over the offset.
    n_views: number of views.
    Raises: EvidenceError where no pair of views has motion in common.
    """
    from scipy.optimize import minimize  # takes long to import

    lags = curves.lags
    known = [p for p in range(len(curves.pairs)) if np.isfinite(curves.cost[p]).all()]
    if not known:
        raise EvidenceError(
            "No two views see the person move at the same time; give a longer range of frames, or offsets by hand."
        )
    splines = {curves.pairs[p]: _spline(curves.cost[p] - curves.cost[p].min(), lags) for p in known}
    low, high = lags[0], lags[-1]

    def total(x: Array) -> float:
        value = 0.0
        for (a, b), s in splines.items():
            d = float(x[b] - x[a])
            inside = min(max(d, low), high)
            value += float(s(inside)) + 10.0 * abs(d - inside)
        return value + 1e-6 * float((x**2).sum())

    whole = np.arange(np.ceil(low), np.floor(high) + 1)
    tried = [coordinate_descent(total, x, range(n_views), whole) for x in _starts(splines, lags, n_views)]
    best = min([np.zeros(n_views), *tried], key=total)
    found = minimize(total, best, method="Powell", options={"xtol": 1e-3, "ftol": 1e-9, "maxiter": 40}).x
    joined = {c for pair in splines for c in pair}
    shift = float(np.median([found[c] for c in joined]))
    sd = np.full(n_views, np.inf)
    for c in joined:
        left, middle, right = (total(np.r_[found[:c], found[c] + d, found[c + 1 :]]) for d in (-0.5, 0.0, 0.5))
        bend = 4 * (left - 2 * middle + right)
        sd[c] = 1 / np.sqrt(bend) if bend > 1e-6 else np.inf
    frames = np.where([c in joined for c in range(n_views)], found - shift, 0.0)
    return Offsets(frames, sd, total(np.zeros(n_views)) - total(found))


def coordinate_descent(total: Callable[[Array], float], start: Array, views: Iterable[int], steps: Array) -> Array:
    """Move one view after the other by the step that lessens a cost most, until none does.

    total: cost of the offsets (C,).
    start: (C,) offsets at the start.
    views: indices of the views that may move.
    steps: (S,) steps that are tried; one of them is 0.
    """
    x, views = start.copy(), list(views)
    for _ in range(10):
        before = total(x)
        for c in views:
            x[c] += steps[int(np.argmin([total(np.r_[x[:c], x[c] + step, x[c + 1 :]]) for step in steps]))]
        if total(x) >= before:
            break
    return x


def solve_widely(curves_of: Callable[[float], Curves], n_views: int, largest: float) -> tuple[Offsets, float]:
    """Find the offsets as `solve_offsets` does, with a range that is doubled while two views lie at its ends.

    curves_of: function of the largest offset (frames) that gives the curves.
    largest: largest offset at the start, frames.
    Returns: the offsets, and the largest offset that was searched, frames; views at its ends may be farther apart
        (`at_the_end`).
    """
    found, reach = None, 0.0
    while True:
        try:
            curves = curves_of(largest)
            wider = solve_offsets(curves, n_views)
        except EvidenceError:
            if found is None:
                raise
            return found, reach
        if found is not None and not at_the_end(wider, reach):  # no farther: more frames decide better
            return found, float(curves.lags[-1])
        found, reach = wider, float(curves.lags[-1])
        if not at_the_end(found, reach) or reach < largest - 1:  # the clip is too short to look farther
            return found, reach
        largest *= 2


def at_the_end(found: Offsets, reach: float) -> bool:
    """Test whether two views are as far apart as the searched range, so that their true offset may be larger.

    found: offsets of all views; views without a finite standard deviation do not count.
    reach: largest offset that was searched, frames.
    """
    sure = found.frames[np.isfinite(found.sd)]
    return len(sure) > 1 and float(np.ptp(sure)) > reach - 0.5


def _starts(splines: dict[tuple[int, int], CubicSpline], lags: Array, n: int) -> list[Array]:
    """List start offsets: all zero, and for every view as reference the best offsets of its pairs.

    splines: disagreement of each pair of views over the offset.
    lags: (L,) offsets, frames.
    n: number of views.
    Returns: n + 1 arrays (n,), whole frames.
    """
    out = [np.zeros(n)]
    for reference in range(n):
        x = np.zeros(n)
        for (a, b), s in splines.items():
            if reference in (a, b):
                d = float(lags[int(np.argmin(s(lags)))])
                x[b if reference == a else a] = d if reference == a else -d
        out.append(np.rint(x))
    return out


def _running_mean(e: Array, known: NDArray[np.bool_], scale: float) -> Array:
    """Compute a robust mean (T, K) of e (T, K) over time around each frame, where known."""
    w, middle = known.astype(np.float64), np.zeros(e.shape)
    for _ in range(3):
        weight = gaussian_filter1d(w, _LASTING, axis=0, mode="constant")
        middle = gaussian_filter1d(w * e, _LASTING, axis=0, mode="constant") / np.maximum(weight, 1e-9)
        w = lorentzian_weight(((e - middle) / (2 * scale)) ** 2, known)
    return middle


def offsets_within(largest: float, frames: int) -> float:
    """Limit the largest offset, frames, to what a clip of this many frames allows: (frames - 12) / 3."""
    return min(float(largest), (frames - 12) / 3)


def _grid(
    views: int, frames: int, largest: float, step: float = _STEP
) -> tuple[tuple[tuple[int, int], ...], Array, NDArray[np.int64]]:
    """List the pairs of views, the offsets (L,) that are tried, and the frames of the first view that have a partner in
    the second view at all of them; EvidenceError for too few frames.
    """
    largest = offsets_within(largest, frames)
    if largest < 1:
        raise EvidenceError(
            f"{frames} frames are too few to find how late the cameras are; at least 16 consecutive frames are needed."
        )
    count = int(largest / step)
    margin = int(np.ceil(count * step)) + 1
    lags = np.arange(-count, count + 1, dtype=np.float64) * step
    return tuple(itertools.combinations(range(views), 2)), lags, np.arange(margin, frames - margin)


def _smoothed(values: Array, seen: NDArray[np.bool_], sd: float) -> Array:
    """Smooth values (T, ...) over time where seen (of as many axes); gaps are interpolated, and values that are never
    seen are 0.
    """
    filled = np.nan_to_num(interpolated(np.where(seen, values, np.nan)))
    return np.asarray(gaussian_filter1d(filled, sd, axis=0), dtype=np.float64)


def _spline(values: Array, at: Array | None = None) -> CubicSpline:
    from scipy.interpolate import CubicSpline  # takes long to import

    return CubicSpline(np.arange(len(values)) if at is None else at, values, axis=0)


def _homogeneous(x: Array) -> Array:
    return np.concatenate([x, np.ones((*x.shape[:-1], 1))], -1)


def _pencil(rig: CameraRig, a: int, b: int) -> Array:
    """Compute the frame of the pencil of planes through the baseline of two cameras.

    a, b: indices of the cameras.
    Returns: (3, 3) rows: the baseline's direction and two perpendicular ones, in the world. Planes are identified by
        their angle about the first row, from the middle of the cameras' viewing directions.
    """
    base = rig[b].position - rig[a].position
    look = rig[a].camera_from_world[2, :3] + rig[b].camera_from_world[2, :3]
    if np.linalg.norm(np.cross(unit(base), look)) < 1e-6:  # two cameras that look at each other
        look = np.eye(3)[int(np.abs(base).argmin())]
    return frame_of(base, look).T


def _angles(rig: CameraRig, c: int, pixels: Array, pencil: Array) -> tuple[Array, Array]:
    """Compute the planes through the baseline and pixels.

    c: index of the camera.
    pixels: (..., 2) px, undistorted.
    pencil: (3, 3) frame of the pencil of planes.
    Returns: angle (...) of each plane about the baseline, rad, and pixels per radian there (...).
    """
    camera = rig[c]
    turned = np.linalg.inv(camera.K).T @ camera.camera_from_world[:3, :3] @ pencil.T
    along, x, y = np.moveaxis(_homogeneous(pixels) @ turned, -1, 0)
    return np.arctan2(y, x), camera.K[0, 0] * np.hypot(x, y)


def _activity(rig: CameraRig, tracks: Sequence[MaskTrack], a: int, b: int, planes: Array) -> tuple[Array, Array] | None:
    """Compute the share of the mask that changed, by the place along the pencil of planes.

    tracks: mask track of each view.
    a, b: indices of the views.
    planes: (2, T, 2) angles of the tangent planes in both views, rad, NaN where unknown.
    Returns: (T, BINS) square roots of shares for a and for b; None with fewer than 8 known frames.
    """
    known = planes[np.isfinite(planes).all(-1)]
    if len(known) < 8:
        return None
    edges = np.linspace(np.percentile(known[:, 0], 2), np.percentile(known[:, 1], 98), BINS + 1)
    frame = _pencil(rig, a, b)
    out = []
    for c in (a, b):
        activity = np.full((len(tracks[c].area), BINS), np.nan)
        for t, points in enumerate(tracks[c].changed):
            if points is not None and tracks[c].area[t] > 0:
                angle, _ = _angles(rig, c, points, frame) if len(points) else (np.zeros(0), None)
                activity[t] = np.histogram(np.clip(angle, edges[0], edges[-1]), edges)[0] / tracks[c].area[t]
        if np.isfinite(activity).all(1).sum() < 8:
            return None
        out.append(interpolated(np.sqrt(activity)))
    return out[0], out[1]

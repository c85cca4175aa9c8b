"""Evidence of cameras that are not in step, brought to one clock: resampled in time, no frame dropped or repeated.

A view that is late by o frames shows in its frame t + o what the reference shows in its frame t. Key points are
interpolated between frames; masks by their signed distance (a mask half way between two masks), which is right for
parts that move less than their width between two frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.calibration.sync_motion import (
    Curves,
    Offsets,
    keypoint_curves,
    mask_tracks,
    silhouette_curves,
    solve_offsets,
)
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.geometry import Array

WHOLE = 0.05
"""frames: offsets nearer than this to a whole number are taken as whole, and nothing is interpolated"""


_BESIDE = 0.25  # weight of silhouettes beside key points, whose errors are the smaller ones


class Frames(Protocol):
    """Frames by number."""

    def __len__(self) -> int: ...

    def frame(self, index: int, /) -> Frame:
        """Frame number index, 0 <= index < len."""
        ...


def offsets_from_motion(
    rig: CameraRig,
    keypoints: tuple[Array, Array] | None,
    silhouettes: Sequence[Silhouettes | None] | None,
    *,
    largest: float = 12.0,
) -> Offsets:
    """How late each view is, from consecutive frames of key points, silhouettes or both.

    rig: as calibrated; keypoints: pixels (C, T, K, 2) undistorted px of the calibrated size and confidence (C, T, K);
    silhouettes: T, at any working size. largest: offset in frames that is looked for. An EvidenceError when the
    recording is too short or nobody moves."""
    curves: Curves | None = None
    n = len(rig)
    if keypoints is not None:
        pixels, confidence = keypoints
        curves = keypoint_curves(rig, pixels, confidence, largest, point_sd(pixels, confidence))
    masks = None if silhouettes is None else next((s for s in silhouettes if s is not None), None)
    if masks is not None and silhouettes is not None:
        tracks = mask_tracks(silhouettes)
        extent = np.nanmedian([np.ptp(h, axis=0).max() for t in tracks for h in t.outline if h is not None])
        more = silhouette_curves(masks.rig, tracks, largest, max(float(extent) / 130, 0.5))
        curves = more if curves is None else curves + replace(more, cost=_BESIDE * more.cost)
    if curves is None:
        raise EvidenceError("There are neither key points nor silhouettes to take the timing from.")
    return solve_offsets(curves, n)


def point_sd(pixels: Array, confidence: Array) -> float:
    """Usual error of a detection, px: 1.6 % of the person's size in the median view."""
    sizes = []
    for p, c in zip(pixels, confidence, strict=True):
        seen = c > 0.3
        size = [np.ptp(x[s], axis=0).max() for x, s in zip(p, seen, strict=True) if s.sum() > 3]
        if size:
            sizes.append(float(np.median(size)))
    return max(0.016 * float(np.median(sizes)) if sizes else 4.0, 0.5)


def points_at(points: Array, late: float) -> Array:
    """Key points (T, K, 3) of one view at t + late for t = 0..T-1; confidence 0 outside, and where a neighbour that is
    needed is missing; at most half a frame beside a missing one its neighbour serves."""
    n = len(points)
    out = np.zeros_like(points)
    at = np.arange(n) + (round(late) if abs(late - round(late)) < WHOLE else late)
    low = np.floor(at).astype(int)
    share = (at - low)[:, None]
    a, b = np.clip(low, 0, n - 1), np.clip(low + 1, 0, n - 1)
    inside = (at >= -0.5) & (at <= n - 0.5)
    pa, pb = points[a], points[b]
    ca, cb = pa[..., 2] > 0, pb[..., 2] > 0
    both = (1 - share[..., None]) * pa + share[..., None] * pb
    value = np.where((ca & cb)[..., None], both, np.where(ca[..., None], pa, pb))
    near = np.where(ca & cb, True, np.where(ca, share <= 0.5, share >= 0.5) & (ca | cb))
    out[:] = np.where((near & inside[:, None])[..., None], value, 0.0)
    return out


def mask_between(before: NDArray[np.uint8], after: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    """The mask (h, w) 0/1 at `share` of the way from one mask to the next: zero set of the mixed signed distances.

    Parts that do not overlap in the two masks would vanish in the middle; they are taken from the nearer one."""
    if share <= WHOLE or not after.any():
        return before
    if share >= 1 - WHOLE or not before.any():
        return after
    h, w = before.shape
    size = np.array([[w, h], [w, h]])
    d = compute.signed_distance(np.stack([before, after]).astype(np.uint8), size)
    mixed = ((1 - share) * d[0] + share * d[1] < 0).astype(np.uint8)
    return mixed if mixed.any() else (before if share < 0.5 else after)


class Resampled:
    """Frames of a source on the common clock. late (C,): frames by which each view is late."""

    def __init__(self, source: Frames, late: Sequence[float] | Array) -> None:
        self.source = source
        if not np.isfinite(np.asarray(late, dtype=np.float64)).all():
            raise InputError(f"Offsets must be finite numbers of frames, got {list(late)}.")
        self.late = np.array([round(x) if abs(x - round(x)) < WHOLE else float(x) for x in late], dtype=np.float64)
        self._kept: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self.source)

    def _get(self, index: int) -> Frame:
        if index not in self._kept:
            span = int(np.ceil(np.abs(self.late).max())) + 2
            self._kept = {k: v for k, v in self._kept.items() if abs(k - index) <= 2 * span}
            self._kept[index] = self.source.frame(index)
        return self._kept[index]

    def frame(self, index: int, /) -> Frame:
        """Frame `index` of the common clock; a view that has no frame there (it started later, or ended earlier) is not
        usable and says so."""
        here = self._get(index)
        n = len(self.source)
        silhouettes, keypoints = here.silhouettes, here.keypoints
        masks = points = None
        usable: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        reasons: list[str] = []
        if silhouettes is not None:
            if len(self.late) != len(silhouettes.rig):
                raise InputError(f"{len(self.late)} offsets are given for {len(silhouettes.rig)} views; give one each.")
            masks, usable, reasons = silhouettes.masks.copy(), silhouettes.usable.copy(), list(silhouettes.reasons)
        if keypoints is not None:
            points = keypoints.points.copy()
        for c, late in enumerate(self.late):
            if late == 0:
                continue
            low = int(np.floor(index + late))
            share = index + late - low
            inside = 0 <= low and low + (share > 0) < n
            a = self._get(min(max(low, 0), n - 1))
            b = self._get(min(max(low + 1, 0), n - 1)) if share > 0 else a
            if masks is not None and a.silhouettes is not None and b.silhouettes is not None:
                fine = inside and bool(a.silhouettes.usable[c]) and bool(b.silhouettes.usable[c])
                usable[c] = fine
                reasons[c] = "" if fine else _why(a.silhouettes, b.silhouettes, c, index, late, inside)
                masks[c] = mask_between(a.silhouettes.masks[c], b.silhouettes.masks[c], share) if fine else 0
            if points is not None and a.keypoints is not None and b.keypoints is not None:
                pair = np.stack([a.keypoints.points[c], b.keypoints.points[c]])
                points[c] = points_at(pair, share)[0] if inside else 0.0
        new_masks = (
            None
            if silhouettes is None or masks is None
            else Silhouettes(masks, silhouettes.rig, usable, tuple(reasons))
        )
        new_points = None if keypoints is None or points is None else Keypoints(points, keypoints.names, keypoints.rig)
        return Frame(here.time, here.index, new_masks, new_points, here.detections, here.sensor_joints)


def _why(a: Silhouettes, b: Silhouettes, c: int, index: int, late: float, inside: bool) -> str:
    if not inside:
        return f"{a.rig.names[c]}, frame {index}: the view has no image {late:+.2f} frames from here"
    return a.reasons[c] or b.reasons[c]

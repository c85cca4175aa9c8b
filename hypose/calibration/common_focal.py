"""By which factor all focal lengths together are wrong, as far as a moving person tells.

Cameras whose focal lengths are all too long by the same factor show a smaller world: somebody who stays where all of
them look only becomes shorter, and no view contradicts another. Off that middle the rays miss each other, along lines
that are known, and the factor follows from that by least squares. How far it can be trusted is told by leaving out each
view, since what is wrong with one of them is wrong in all frames, and each key point or tangent, whose errors last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.calibration.doctor_findings import Finding
from hypose.calibration.doctor_masks import tangency
from hypose.calibration.doctor_points import sizes, undistorted
from hypose.calibration.refine_camera import changed
from hypose.calibration.sync_motion import MaskTrack
from hypose.cameras.camera import CameraRig, triangulate
from hypose.geometry import Array

_LARGEST = 0.35
"""of a factor's logarithm: what lies beyond is another minimum, or another fault"""
_STEP = 1e-3
_ROUNDS = 8
_TUKEY = 4.7
_LEAST_ROWS = 40
Rows = Callable[[CameraRig, list[int]], Array]
"""Residuals (R, G) of some views through a rig, NaN where there is none: G kinds whose errors last over the R moments,
in shares of the person's size."""


@dataclass(frozen=True)
class CommonFocal:
    """factor by which all focal lengths would have to be multiplied, and the sd of its logarithm; inf where nothing is
    known."""

    factor: float
    sd: float


FAR, CERTAIN, LIKELY, KNOWN = 0.06, 3.5, 2.7, 0.08
"""A factor is a fault when its logarithm is beyond FAR and beyond CERTAIN of its sd, which is KNOWN at most, and worth
a look beyond LIKELY of it. Of 33 scenes with spoilt key points, things in the masks or late cameras (seeds 600 to 602)
none had more than 3.4 sd."""


def focal_findings(found: CommonFocal) -> Iterator[Finding]:
    """What is said of a factor."""
    off = abs(float(np.log(found.factor)))
    if off > FAR and off > LIKELY * found.sd and found.sd < KNOWN:
        text = (
            f"All cameras: the views agree best if every focal length were {found.factor:.2f} times as long (sd "
            f"{found.factor * found.sd:.2f}); as they are, the person comes out {found.factor:.2f} times as large"
        )
        cure = "calibrate the lenses again as the videos were filmed (zoom, picture size), or correct all focal lengths"
        yield Finding("focal", (), text, cure, off, fault=off > CERTAIN * found.sd)


def focal_by_points(rig: CameraRig, pixels: Array) -> CommonFocal:
    """From key points (C, T, K, 3) in px of the calibrated, distorted pictures."""
    size = np.maximum(sizes(pixels), 1.0)

    def rows(moved: CameraRig, views: list[int]) -> Array:
        own = CameraRig(tuple(moved[c] for c in views))
        uv, confidence = undistorted(own, pixels[views])
        n, frames, count = confidence.shape
        seen = np.where(confidence > 0.3, confidence, 0.0).reshape(n, -1)
        flat = uv.reshape(n, -1, 2)
        points, _ = triangulate(own, flat, seen)
        away = np.stack([c.project_pinhole(points) for c in own]) - flat
        away = np.where(((seen > 0).sum(0) > 1)[None] & (seen > 0), np.moveaxis(away, -1, 0), np.nan)
        away /= size[views][:, None]
        return away.reshape(2 * n, frames, count).transpose(1, 0, 2).reshape(frames * 2 * n, count)

    return _factor(rig, rows)


def focal_by_masks(rig: CameraRig, tracks: Sequence[MaskTrack]) -> CommonFocal:
    """From the planes that touch a person's outlines in pairs of views; rig: that of the masks."""
    found = [np.median([np.ptp(h, axis=0).max() for h in t.outline if h is not None] or [1.0]) for t in tracks]
    size = np.maximum(np.array(found, dtype=np.float64), 1.0)

    def rows(moved: CameraRig, views: list[int]) -> Array:
        pairs = tangency(CameraRig(tuple(moved[c] for c in views)), [tracks[c] for c in views])
        scaled = [v / np.sqrt(size[views[a]] * size[views[b]]) for (a, b), v in pairs.items()]
        return np.concatenate(scaled, 1) if scaled else np.zeros((0, 1))

    return _factor(rig, rows)


def _factor(rig: CameraRig, rows: Rows) -> CommonFocal:
    views = list(range(len(rig)))
    found = _solve(rig, rows, views, 0.0) if len(views) > 2 else None  # two views cannot be told from a wrong pose
    if found is None or abs(found[0]) >= _LARGEST:
        return CommonFocal(1.0, float("inf"))
    x, slope, residual, weight = found
    # kinds of rows err by themselves, and so do views
    own = np.nansum(weight * slope * residual, 0) / max(float(np.nansum(weight * slope**2)), 1e-12)
    left = [_solve(rig, rows, [v for v in views if v != c], x, once=True) for c in views]
    moves = np.array([f[0] - x for f in left if f is not None])
    if len(moves) < len(views):
        return CommonFocal(1.0, float("inf"))
    variance = (own**2).sum() + (len(views) - 1) / len(views) * (moves**2).sum()
    return CommonFocal(float(np.exp(x)), float(np.sqrt(variance)))


def _solve(
    rig: CameraRig, rows: Rows, views: list[int], begin: float, *, once: bool = False
) -> tuple[float, Array, Array, Array] | None:
    """The factor's logarithm, and the rows' slopes by it, residuals and weights; None where nothing is known."""
    x = begin
    slope = residual = weight = np.zeros((0, 1))
    for _ in range(2 if once else _ROUNDS):
        residual = rows(_scaled(rig, x), views)
        slope = (rows(_scaled(rig, x + _STEP), views) - residual) / _STEP
        known = np.isfinite(residual) & np.isfinite(slope)
        if known.sum() < _LEAST_ROWS:
            return None
        residual, slope = np.where(known, residual, np.nan), np.where(known, slope, np.nan)
        weight = _tukey(residual)
        step = -float(np.nansum(weight * slope * residual)) / max(float(np.nansum(weight * slope**2)), 1e-12)
        x = float(np.clip(x + np.clip(step, -0.1, 0.1), -_LARGEST, _LARGEST))
        if abs(step) < 0.1 * _STEP:
            break
    return x, slope, residual, weight


def _tukey(residual: Array) -> Array:
    limit = _TUKEY * 1.4826 * max(float(np.nanmedian(np.abs(residual))), 1e-6)
    return np.maximum(1 - (residual / limit) ** 2, 0.0) ** 2


def _scaled(rig: CameraRig, log_factor: float) -> CameraRig:
    return CameraRig(tuple(changed(c, np.r_[np.zeros(6), log_factor]) for c in rig))

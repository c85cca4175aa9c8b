"""Which views are not in step with the others, by their key points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.doctor_findings import Finding, Limits
from hypose.calibration.doctor_points import undistorted
from hypose.calibration.in_step import point_sd
from hypose.calibration.sync_motion import (
    Curves,
    farther,
    keypoint_curves,
    offsets_within,
    solve_offsets,
    solve_widely,
)
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.geometry import Array

_LEAST_FRAMES = 24
_PART = 0.62
"""share of a clip that tells by itself what the whole does: of a half too little is left once it is moved by a lag"""


def late_views(rig: CameraRig, pixels: Array, o: Limits) -> tuple[Array, Array]:
    """(C,) frames by which each view is late, 0 where that is not certain, and its sd, infinite where the clip is too
    short to tell how much more it is. pixels (C, T, K, 3) distorted px of consecutive frames."""
    n, frames = pixels.shape[:2]
    late, sd = np.zeros(n), np.zeros(n)
    if n < 2 or frames < _LEAST_FRAMES:
        return late, sd
    uv, confidence = undistorted(rig, pixels)
    scatter = point_sd(uv, confidence)

    def curves(largest: float) -> Curves:
        return keypoint_curves(rig, uv, confidence, largest, scatter, step=0.5)

    try:
        offsets, reach = solve_widely(curves, n, o.largest_lag)
    except EvidenceError:
        return late, sd
    if offsets.gain < o.late_gain:
        return late, sd
    found = _by_first_of_two(offsets.frames)
    certain = (np.abs(found) >= o.late) & (np.abs(found) >= o.late_sd * offsets.sd)
    if certain.any():
        certain &= ~_contradicted(rig, uv, confidence, scatter, found, o)
    later = certain & farther(offsets, found, reach)
    return np.where(certain, found, 0.0), np.where(later, np.inf, offsets.sd)


def _contradicted(
    rig: CameraRig, uv: Array, confidence: Array, scatter: float, found: Array, o: Limits
) -> NDArray[np.bool_]:
    """(C,) views that the earlier or the later part of the clip, where it tells, puts elsewhere than the whole, found
    (C,) frames late. Who stands and waves moves few points, whose errors last and look like motion that comes late;
    they are others in another part."""
    out, long = np.zeros(len(rig), np.bool_), round(_PART * uv.shape[1])
    if long < _LEAST_FRAMES:
        return out
    for part in (slice(None, long), slice(-long, None)):
        curves = keypoint_curves(rig, uv[:, part], confidence[:, part], o.largest_lag, scatter, step=0.5)
        try:
            offsets = solve_offsets(curves, len(rig))
        except EvidenceError:
            continue
        size = np.abs(found)
        away = np.abs(_by_first_of_two(offsets.frames) - found)
        out |= (offsets.sd < size / 3) & (away > np.maximum(size / 2, 0.5))
    return out & (np.abs(found) < offsets_within(o.largest_lag, long) - 1)


def _by_first_of_two(frames: Array) -> Array:
    """(C,) frames by which views are late; of two views, against the first one."""
    return frames - (frames[0] if len(frames) == 2 else 0.0)


def timing_findings(rig: CameraRig, late: Array, sd: Array, fault: bool = True) -> Iterator[Finding]:
    """Of each view that `late_views` found out of step."""
    for name, x, s in zip(rig.names, late, sd, strict=True):
        if x != 0:
            way, cure = "late" if x > 0 else "early", "run hypose sync, and track what it writes"
            text = f"{name}: {abs(x):.1f} frames {way} against the other views (sd {s:.2f})"
            if not np.isfinite(s):
                text = (
                    f"{name}: {abs(x):.1f} frames {way} against the other views, or more: the clip is too short to tell"
                )
                cure = "run hypose sync on more frames, with a larger --largest"
            yield Finding("late", (name,), text, cure, abs(x), fault)

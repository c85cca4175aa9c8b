"""Which views are not in step with the others, by their key points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hypose.calibration.doctor_findings import Finding, Limits
from hypose.calibration.doctor_points import undistorted
from hypose.calibration.in_step import point_sd
from hypose.calibration.sync_motion import Curves, farther, keypoint_curves, solve_widely
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.geometry import Array

_LEAST_FRAMES = 24


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
    found = offsets.frames - (offsets.frames[0] if n == 2 else 0.0)
    certain = (np.abs(found) >= o.late) & (np.abs(found) >= o.late_sd * offsets.sd)
    later = certain & farther(offsets, found, reach)
    return np.where(certain, found, 0.0), np.where(later, np.inf, offsets.sd)


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

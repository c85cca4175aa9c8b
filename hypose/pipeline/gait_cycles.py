"""Joint angles over the gait cycle: strides of a motion laid over each other, 0 to 100 % from strike to strike.

Each side's angles run from a strike of that foot to its next; those of pelvis, trunk and neck from the right foot's.
The spread between strides and the uncertainty of the tracking are told apart: the one says how alike a person's steps
are, the other how well their mean is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hypose.body.joint_angles import ANGLE_NAMES, is_length, joint_angles
from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.pipeline.gait_events import CORRELATION, GaitEvent

PERCENT = np.linspace(0.0, 100.0, 101)
_SHORTEST, _LONGEST = 0.6, 2.5  # s of a stride


@dataclass(frozen=True)
class AngleCycle:
    """One angle over the cycle: mean (101,) rad of n strides, sd (101,) between them (NaN for one stride), and
    uncertainty (101,), the standard deviation of the mean by the tracking alone (NaN where it is not known)."""

    name: str
    mean: Array
    sd: Array
    uncertainty: Array
    n: int


def strides(events: Sequence[GaitEvent], motion: Motion, side: str) -> list[tuple[float, float]]:
    """Times (s) from a strike to the same foot's next, of those whose frames are all known."""
    strikes = [e.time for e in events if e.side == side and e.kind == "strike"]
    known = ~(motion.lost | motion.extrapolated).astype(bool)
    if motion.poses is not None:
        known &= np.isfinite(motion.poses).all(1)
    out = []
    for a, b in zip(strikes, strikes[1:], strict=False):
        first, stop = np.searchsorted(motion.times, a), np.searchsorted(motion.times, b, "right")
        if _SHORTEST <= b - a <= _LONGEST and first < stop and known[first:stop].all():
            out.append((a, b))
    return out


def angle_cycles(events: Sequence[GaitEvent], motion: Motion) -> list[AngleCycle]:
    """The cycle of every joint angle that has one; none without a whole stride. The motion needs poses."""
    if motion.poses is None:
        return []
    _, values = joint_angles(motion.skeleton, motion.poses)
    given = motion.angle_sd if motion.angle_sd is not None else np.full(values.shape, np.nan)
    whole = {side: strides(events, motion, side) for side in ("left", "right")}
    out = []
    for k, name in enumerate(ANGLE_NAMES):
        spans = whole["left" if name.endswith("_l") else "right"]
        if is_length(name) or name == "pelvis_rotation" or not spans:  # where somebody walks is no cycle
            continue
        begin, end = np.array(spans).T[..., None]
        at = begin + PERCENT / 100 * (end - begin)
        curves, sds = (np.interp(at, motion.times, a[:, k]) for a in (values, given))
        # strides lie farther apart than an error lasts, so each counts anew
        apart = min(1.0, CORRELATION / np.mean([b - a for a, b in spans]))
        count = max(1.0, len(spans) * (1 - apart) + apart)
        sd = curves.std(axis=0, ddof=1) if len(spans) > 1 else np.full(len(PERCENT), np.nan)
        uncertainty = np.sqrt((sds**2).mean(0) / count)
        out.append(AngleCycle(name, curves.mean(0), sd, uncertainty, len(spans)))
    return out

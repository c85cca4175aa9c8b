"""How somebody walks, as the plots show it: events, figures of the steps, and angles over the cycle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import HyposeError
from hypose.io.motions.results import load_body, load_motion
from hypose.pipeline.gait import angle_cycles, gait_of

NOBODY_WALKS: dict[str, Any] = {"events": [], "figures": [], "cycles": []}


def gait_view(results: Path) -> dict[str, Any]:
    """Of a results folder: events by time (s of the motion's times), figures, and the cycles in degrees at 0 to 100 %;
    all empty where nobody walks, or where the motion has no poses or body."""
    try:
        motion, body = load_motion(results / "motion.npz"), load_body(results / "body.npz")
        if motion.poses is None or body.skeleton.joint_names != motion.skeleton.joint_names:
            return NOBODY_WALKS
        found = gait_of(motion, body)
    except HyposeError:
        return NOBODY_WALKS
    return {
        "events": [{"time": e.time, "side": e.side, "kind": e.kind} for e in found.events],
        "figures": [
            {"name": f.name, "unit": f.unit, "mean": f.mean, "low": f.low, "high": f.high, "n": f.n}
            for f in found.figures
        ],
        "cycles": [
            {"name": c.name, "mean": np.degrees(c.mean), "sd": np.degrees(c.sd), "n": c.n}
            for c in angle_cycles(found.events, motion)
        ],
    }
